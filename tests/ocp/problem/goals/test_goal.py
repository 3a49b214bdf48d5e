"""Goals: shapes wherever they are, nodes in places; those of any kind are refused by name where they cannot be."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc

PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)
MODEL = driven(prism(1.0))


def planned(*goals, duration=1.0, intervals=12, model=MODEL, **changes):
    given = {"bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(
        ocp.Problem(model, duration, goals=goals, **given), ocp.MultipleShooting(intervals)
    )


def distances(nodes):
    return np.array(
        [np.linalg.norm(nodes[a] - nodes[b]) for a, b in combinations(range(len(nodes)), 2)]
    )


def turned(nodes):
    angle = 0.7
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    return nodes @ turn.T + [3.0, -1.0, 0.5]


def test_a_shape_wherever_it_is():
    plan = planned(ocp.Shape(turned(prism(1.1).nodes)), ocp.AtRest())
    assert plan.success
    assert "30 → 18 rows: 6 bar, 6 momentum" in plan.message
    assert distances(plan.replay().nodes[-1]) == pytest.approx(
        distances(prism(1.1).nodes), abs=1e-4
    )


def test_some_axes_of_some_nodes():
    model = driven(prism(1.0, pinned=[0, 1, 2]))
    plan = planned(
        ocp.NodePositions({3: (None, None, 0.98)}), ocp.AtRest(), model=model, intervals=20
    )
    assert plan.success
    assert plan.replay().nodes[-1, 3, 2] == pytest.approx(0.98, abs=1e-4)


OTHER = tc.shapes.prism(3, 0.5, 1.4).nodes
BAD = {
    "shape of other bars": (
        lambda: planned(ocp.Shape(OTHER)),
        ValueError,
        "Shape.nodes make bar 0",
    ),
    "shape of other size": (lambda: planned(ocp.Shape(OTHER[:4])), ValueError, "Shape.nodes"),
    "shape not finite": (lambda: ocp.Shape([[np.nan, 0, 0]]), ValueError, "Shape.nodes"),
    "waypoint without goals": (lambda: ocp.Waypoint([], time=0.5), TypeError, "Waypoint.goals"),
    "waypoint in a waypoint": (
        lambda: ocp.Waypoint([ocp.Waypoint([ocp.AtRest()], time=0.2)], time=0.5),
        TypeError,
        r"Waypoint.goals\[0\]",
    ),
    "waypoint nowhere": (
        lambda: ocp.Waypoint([ocp.AtRest()]),
        ValueError,
        "Waypoint.time and .share",
    ),
    "waypoint twice": (
        lambda: ocp.Waypoint([ocp.AtRest()], 0.5, 0.5),
        ValueError,
        "Waypoint.time and .share",
    ),
    "waypoint after the end": (
        lambda: planned(ocp.Waypoint([ocp.AtRest()], time=1.5)),
        ValueError,
        "Waypoint.time is 1.5",
    ),
    "waypoint beyond the end": (
        lambda: ocp.Waypoint([ocp.AtRest()], share=1.01),
        ValueError,
        "Waypoint.share is 1.01",
    ),
    "waypoint at the start": (
        lambda: planned(ocp.Waypoint([ocp.AtRest()], time=1e-12)),
        ValueError,
        "Waypoint.time is 1e-12, where .* hardly begun",
    ),
    "waypoints that contradict each other": (
        lambda: planned(
            *(ocp.Waypoint([ocp.StringLengths({0: length})], time=0.5) for length in (0.8, 0.9))
        ),
        ocp.InfeasibleGoalError,
        "waypoint at 0.5 of the duration: StringLengths: string 0 misses its goal by 0.05 m at best, as the goals contradict each other",
    ),
    "waypoint at no time": (
        lambda: planned(ocp.Waypoint([ocp.AtRest()], time=0.5), duration=(0.5, 1.0)),
        ValueError,
        "duration is free",
    ),
    "waypoint unknown node": (
        lambda: planned(ocp.Waypoint([ocp.NodePositions({9: (0, 0, 0)})], time=0.5)),
        ValueError,
        "NodePositions.positions: node is 9",
    ),
    "periodic of two": (lambda: ocp.Periodic((1.0, 2.0)), ValueError, "Periodic.shift"),
    "periodic of a number": (lambda: ocp.Periodic(1.0), TypeError, "Periodic.shift"),
    "periodic from no pair": (
        lambda: ocp.Periodic(start=np.zeros((6, 3))),
        TypeError,
        "Periodic.start is no pair",
    ),
    "periodic from other nodes": (
        lambda: planned(ocp.Periodic(start=(np.zeros((5, 3)), np.zeros((6, 3))))),
        ValueError,
        "Periodic.start: nodes",
    ),
    "periodic moves a pin": (
        lambda: planned(ocp.Periodic((1.0, 0.0, 0.0)), model=driven(prism(1.0, pinned=[2]))),
        ValueError,
        "Periodic.shift moves node 2",
    ),
    "periodic leaves": (
        lambda: planned(ocp.Periodic((1.0, 0.0, 0.0))),
        ocp.InfeasibleGoalError,
        "Periodic: node . x misses its goal by 1 m at best, as the center of mass",
    ),
    "waypoint out of reach": (
        lambda: planned(
            ocp.Waypoint([ocp.NodePositions(prism(1.0).nodes + [1.0, 0, 0])], time=0.5)
        ),
        ocp.InfeasibleGoalError,
        "waypoint at 0.5 of the duration: NodePositions",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_goals_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
