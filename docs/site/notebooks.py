"""Tutorials as notebooks: text becomes cells of text, Python blocks cells of code."""

from __future__ import annotations

import json
import re
from typing import Any

LINK = re.compile(r"(\]\([\w./]+)\.md\b")  # to another page, which the site has as HTML
BLOCK = re.compile(r"^```python\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)


def notebook(page: str) -> str:
    """The notebook (JSON, format 4.5) of a page (Markdown)."""
    cells = []
    for index, part in enumerate(BLOCK.split(page)):
        if not part.strip():
            continue
        code = index % 2 == 1
        text = part.strip() if code else LINK.sub(r"\1.html", part.strip())
        cell: dict[str, Any] = {
            "id": f"cell-{index}",
            "metadata": {},
            "source": text.splitlines(keepends=True),
        }
        cells.append(
            {"cell_type": "code", "execution_count": None, "outputs": [], **cell}
            if code
            else {"cell_type": "markdown", **cell}
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return json.dumps(
        {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5},
        indent=1,
        ensure_ascii=False,
    )
