"""In a notebook a view shows itself, and starts no server that stays."""

from __future__ import annotations

import pytest

CELL = """import tenscasadi as tc
shown = tc.shapes.prism(prestress=50.0).view(title="in a notebook")
print(shown.url)
shown"""


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of Jupyter's own
def test_a_view_shows_itself_in_its_cell(tmp_path):
    for name in ("viser", "nbclient", "ipykernel"):
        pytest.importorskip(
            name, reason=f"{name} is not installed: pip install 'tenscasadi[view,docs]'"
        )
    import nbclient
    import nbformat

    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    nbclient.NotebookClient(
        book, timeout=120, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    printed, result = book.cells[0].outputs  # and nothing of what viser prints
    assert printed["text"] == "None\n"
    page = result["data"]["text/html"]
    assert page.startswith("<iframe srcdoc=")
    assert "in a notebook" in page
