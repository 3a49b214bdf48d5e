"""Pictures of pages: drawn by the code of their page, and shown."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
OWN = {"notation.png"}  # of docs/site/draw_notation.py
TEXT_ONLY = {
    *("README.md", "glossary.md", "questions.md", "release_notes.md"),
    *("statement_of_need.md", "troubleshooting.md"),
}


def test_each_guide_shows_a_picture() -> None:
    pages = [*DOCS.glob("*.md"), *(DOCS / "tutorials").glob("*.md")]
    assert {
        page.name for page in pages if "![" not in page.read_text(encoding="utf-8")
    } <= TEXT_ONLY


def test_code_of_pages_writes_each_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS / "site"))
    draw_pages = pytest.importorskip("draw_pages")
    shown = set()
    for page in draw_pages.find_pages().values():
        code = "".join(re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S))
        for picture in draw_pages.list_pictures(page):
            assert f'"{picture}"' in code, page
            shown.add(f"{page.stem}_{picture}")
    assert {path.name for path in (DOCS / "pictures").iterdir()} == shown | OWN
    sys.modules.pop("draw_pages")
