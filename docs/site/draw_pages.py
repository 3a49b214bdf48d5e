"""Draws docs/pictures/: the pictures that the code of pages writes, made small.

A page shows its `path.png` as `pictures/statics_path.png`, with the name of the page in front.
All of them take two minutes; some: python docs/site/draw_pages.py statics design
"""

from __future__ import annotations

import os
import re
import runpy
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from draw_gallery import shrink

DOCS = Path(__file__).resolve().parents[1]


def find_pages() -> dict[str, Path]:
    """Find the pages that show pictures of their own code."""
    pages = [*DOCS.glob("*.md"), *(DOCS / "tutorials").glob("*.md")]
    return {page.stem: page for page in pages if list_pictures(page)}


def list_pictures(page: Path) -> list[str]:
    """List the pictures of its own code that a page shows, such as "path.png"."""
    shown = rf"pictures/{page.stem}_(\w+\.png)\)"
    return re.findall(shown, page.read_text(encoding="utf-8"))


def draw(page: Path) -> None:
    """Run the code of a page and keep its pictures, small."""
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    with TemporaryDirectory() as folder:
        script = Path(folder, "page.py")
        script.write_text("\n".join(blocks), encoding="utf-8")
        before = Path.cwd()
        os.chdir(folder)
        try:
            runpy.run_path(str(script))
        finally:
            os.chdir(before)
        for picture in list_pictures(page):
            shrink(Path(folder, picture), DOCS / "pictures" / f"{page.stem}_{picture}")


def main() -> None:
    """Draw the pictures of the pages that the command line names, of all by default."""
    pages = find_pages()
    (DOCS / "pictures").mkdir(exist_ok=True)
    for name in sys.argv[1:] or sorted(pages):
        draw(pages[name])


if __name__ == "__main__":
    main()
