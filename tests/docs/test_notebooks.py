"""The tutorials as notebooks: all of each page, in order, and they run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from notebooks import notebook

TUTORIALS = sorted((Path(__file__).resolve().parents[2] / "docs" / "tutorials").glob("*.md"))
# with the viewer, pictures and worker processes; tests/test_readme.py runs the code of all
RUN = [TUTORIALS[0].with_stem(stem) for stem in ("plan", "simulate", "sweep")]


def test_text_and_code_keep_their_order():
    page = "# Title\n\n[text](../choose.md#here)\n\n```python\na = 1\n\nb = 2\n```\n\n```sh\nls\n```\n\n```python\nprint(a)\n```\n"
    cells = json.loads(notebook(page))["cells"]
    assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "markdown", "code"]
    assert "".join(cells[0]["source"]).endswith("[text](../choose.html#here)")
    assert "".join(cells[1]["source"]) == "a = 1\n\nb = 2"
    assert "".join(cells[2]["source"]) == "```sh\nls\n```"


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_nothing_of_a_tutorial_is_lost(tutorial):
    text = tutorial.read_text(encoding="utf-8")
    cells = json.loads(notebook(text))["cells"]
    code = [
        block.strip()
        for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    ]
    assert ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"] == code
    assert len({cell["id"] for cell in cells}) == len(cells)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of Jupyter's own
@pytest.mark.parametrize("tutorial", RUN, ids=lambda path: path.stem)
def test_notebooks_run(tutorial, tmp_path):
    nbclient, nbformat = (
        pytest.importorskip(name, reason="needs pip install 'tenscasadi[docs]'")
        for name in ("nbclient", "nbformat")
    )
    pytest.importorskip("ipykernel", reason="needs pip install 'tenscasadi[docs]'")
    book = nbformat.reads(notebook(tutorial.read_text(encoding="utf-8")), as_version=4)
    nbformat.validate(book)
    nbclient.NotebookClient(
        book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    assert all(cell.execution_count for cell in book.cells if cell.cell_type == "code")
