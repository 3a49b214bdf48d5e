"""Path constraints: the names of what several bounds limit."""

from __future__ import annotations

from rising import MODEL

import ocp
from ocp.problem.bounds.bound import PathBound
from ocp.problem.path_constraints import path_constraints


def test_only_what_several_bounds_limit_is_numbered():
    boxes = [
        ocp.InsideBox((-9.0, None, None), nodes=[0, 1]),
        ocp.InsideBox(upper=(9.0, 9.0, None), nodes=[1]),
    ]
    asked = ocp.Problem(MODEL, bounds=[*boxes, ocp.TensionLimits(upper=90.0)])
    found = [one.names for one in path_constraints(asked, PathBound)]
    assert found[:2] == [
        ("x of node 0", "x of node 1 (bounds[0])"),
        ("x of node 1 (bounds[1])", "y of node 1"),
    ]
    assert found[2][0] == "tension of string 0"
