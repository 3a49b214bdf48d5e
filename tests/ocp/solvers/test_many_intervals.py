"""Programs of many intervals: pivots are ordered in a way that does not stall."""

from __future__ import annotations

import pytest
from planning import folding

import ocp
from ocp.solvers import ipopt


@pytest.mark.parametrize(
    ("intervals", "given", "order"), [(20, {}, 0), (800, {}, 5), (20, {"mumps_pivot_order": 7}, 7)]
)
def test_pivots_are_ordered_by_size(intervals, given, order, monkeypatch):
    asked = {}

    def nlpsol(name, kind, problem, options):
        asked.update(options["ipopt"])
        raise RuntimeError("seen")

    monkeypatch.setattr(ipopt.ca, "nlpsol", nlpsol)
    with pytest.raises(RuntimeError, match="seen"):
        ocp.solve(folding(), ocp.Variational(intervals), ocp.Ipopt(options=given))
    assert asked["mumps_pivot_order"] == order


@pytest.mark.slow
def test_a_thousand_intervals_are_solved():
    found = ocp.solve(folding(), ocp.Variational(1000), ocp.Ipopt(time_limit=60))
    assert found.success, found.message
