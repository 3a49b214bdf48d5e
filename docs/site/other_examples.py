"""The table of the examples that a page does not name otherwise."""

from __future__ import annotations

import ast
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MARK = "<!-- other examples -->"


def with_other_examples(page: str) -> str:
    """A page (Markdown) with the table in the place of its mark."""
    others = [
        path for path in sorted(EXAMPLES.glob("*.py")) if f"`examples/{path.name}`" not in page
    ]
    rows = [f"| `examples/{path.name}` | {_summary(path)} |" for path in others]
    return page.replace(MARK, "\n".join(["| example | what it does |", "|---|---|", *rows]))


def _summary(path: Path) -> str:
    """The first line of an example's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.splitlines()[0].replace("|", "\\|")
