"""Commands `new`, `schema` and `completion`, which print text."""

from __future__ import annotations

import argparse
import json
from typing import Annotated, Literal

from tenscasadi.cli.loading import load_ocp
from tenscasadi.cli.source import TEMPLATES

_NAMES = " ".join(TEMPLATES)
_COMPLETE = {"bash": "_tenscasadi_templates", "zsh": "_tenscasadi_templates"}
_FUNCTIONS = {
    "bash": (
        'compgen -W "{names}" -- "$1"',
        'for x in toml json; do compgen -f -X \'!*.\'$x -- "$1"; done; compgen -d -- "$1"',
        'compgen -f -- "$1"',
    ),
    "zsh": ("compadd {names}", "_files -g '*.(toml|json)'", "_files"),
}


def print_template(template: Annotated[str, {"metavar": "NAME", "complete": _COMPLETE}]) -> int:
    """Print a commented scene file to start from.

    tenscasadi new prism > my.toml; tenscasadi simulate my.toml

    Parameters
    ----------
    template : str
        One of the templates below.
    """
    if template not in TEMPLATES:
        raise ValueError(f"unknown template {template!r}: give one of {', '.join(TEMPLATES)}")
    print(TEMPLATES[template].read_text(encoding="utf-8"), end="")
    return 0


def print_schema() -> int:
    """Print the JSON Schema of scene files, for editors.

    tenscasadi schema > scene.schema.json
    """
    schema = load_ocp().io.plan_section.file_schema()
    print(json.dumps(schema, indent=1, ensure_ascii=False))
    return 0


def print_completion(shell: Literal["bash", "zsh"], parser: argparse.ArgumentParser) -> int:
    """Print a completion script for a shell.

    To turn it on in this shell: eval "$(tenscasadi completion bash)". For good: the same line in
    ~/.bashrc (zsh: after compinit in ~/.zshrc).

    Parameters
    ----------
    shell : str
        The shell.
    parser : ArgumentParser
        Parser of the command line.
    """
    try:
        import shtab
    except ImportError:
        raise ImportError("completion needs shtab: pip install 'tenscasadi[completion]'") from None
    templates, scenes, files = (line.format(names=_NAMES) for line in _FUNCTIONS[shell])
    bodies = {
        "templates": templates,
        "scenes": f"{templates}; {scenes}",
        "files": f"{templates}; {files}",
    }
    functions = "".join(f"_tenscasadi_{name}() {{ {body}; }}\n" for name, body in bodies.items())
    print(shtab.complete(parser, shell, preamble=functions))
    return 0
