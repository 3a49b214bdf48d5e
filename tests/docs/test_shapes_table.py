"""The table of shapes in the documentation holds what is computed."""

from __future__ import annotations

from pathlib import Path

import pytest
from shapes_table import shapes_table

from tenscasadi.structure.shapes import ShapeFamily

PAGE = Path(__file__).resolve().parents[2] / "docs" / "shapes.md"


def rows(table: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.strip().splitlines()
    ]


def test_the_table_of_shapes_is_current():
    told = rows(PAGE.read_text(encoding="utf-8").split("<!-- table -->")[1])
    found = rows(shapes_table())
    assert [row[:-1] for row in told] == [row[:-1] for row in found], (
        "write it again: python docs/site/shapes_table.py"
    )
    for own, other in zip(told[2:], found[2:], strict=True):
        if own[-1] == "–":
            assert other[-1] == "–"
        else:
            assert float(own[-1]) == pytest.approx(float(other[-1]), rel=2e-3)


def test_every_shape_is_in_the_table():
    told = {row[0] for row in rows(PAGE.read_text(encoding="utf-8").split("<!-- table -->")[1])}
    assert {f"`{name}`" for name in ShapeFamily.members} <= told
