"""Rows: chosen by unit, stacked with places first, sized by their units."""

from __future__ import annotations

import casadi as ca
import pytest

from ocp.problem.rows import Rows, stack


def test_places_come_before_speeds():
    x = ca.SX.sym("x", 4)
    mixed, one = Rows(x[:3], ("a", "b", "c"), ("m/s", "m", "m/s")), Rows(x[3], ("d",), ("m",))
    found = stack([mixed, one])
    assert found.names == ("b", "d", "a", "c")
    assert found.units == ("m", "m", "m/s", "m/s")
    assert ca.Function("value", [x], [found.value])([0, 1, 2, 3]).full().ravel().tolist() == [
        1,
        3,
        0,
        2,
    ]
    assert found.sizes({"m": 2.0, "m/s": 0.5}) == pytest.approx([2.0, 2.0, 0.5, 0.5])
    scaled = ca.Function("scaled", [x], [found.scale({"m": 2.0, "m/s": 0.5})])
    assert scaled([0, 1, 2, 3]).full().ravel() == pytest.approx([0.5, 1.5, 0.0, 4.0])


@pytest.mark.parametrize("size", [0, 1, 3])
def test_no_rows_are_an_empty_column(size):
    rows = Rows(ca.SX.sym("x", size), ("row",) * size, ("m",) * size)
    assert rows.select("m/s").value.shape == (0, 1)
    assert stack([rows.select("m/s"), rows]).value.shape == (size, 1)
