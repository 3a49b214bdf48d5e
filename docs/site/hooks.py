"""What MkDocs calls while it builds the site: pages made from the code, notebooks made from the tutorials, mathematics as MathML."""

from __future__ import annotations

from typing import Any

from api_pages import api_pages
from command_line import command_line_page
from mathml import with_mathml
from mkdocs.structure.files import File
from notebooks import notebook
from other_examples import with_other_examples
from scene_fields import scene_fields_page
from viewers import viewer_pages


def on_config(config: Any) -> Any:
    """The generated pages of the API take their place in the navigation."""
    (api,) = (entry["API"] for entry in config.nav if "API" in entry)
    api += [path for path in api_pages() if path not in api]
    return config


def on_files(files: Any, config: Any) -> Any:
    generated = {
        **api_pages(),
        "command_line.md": command_line_page(),
        "scene_fields.md": scene_fields_page(),
        **viewer_pages(),
    }
    for page in list(files.documentation_pages()):
        if page.src_uri.startswith("tutorials/"):
            generated[page.src_uri.replace(".md", ".ipynb")] = notebook(page.content_string)
    for path, content in generated.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    if not page.file.src_uri.startswith("tutorials/"):
        return with_other_examples(markdown)
    name = page.file.name + ".ipynb"
    return f"{markdown}\n\n[This page as a notebook]({name}){{: download={name} }}\n"


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    return with_mathml(html)
