"""Goals: shapes wherever they are, waypoints, periodic motions; met by the replay, and refused by name where they cannot be."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import ocp
import tenscasadi as tc

BAR = 1.4
PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


MODEL = driven(prism(1.0))


def planned(*goals, duration=1.0, intervals=12, model=MODEL, **changes):
    given = {"bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(ocp.Problem(model, duration, goals=goals, **given), ocp.MultipleShooting(intervals))


def distances(nodes):
    return np.array([np.linalg.norm(nodes[a] - nodes[b]) for a, b in combinations(range(len(nodes)), 2)])


def turned(nodes):
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return nodes @ turn.T + [3.0, -1.0, 0.5]


def test_a_shape_wherever_it_is():
    plan = planned(ocp.Shape(turned(prism(1.1).nodes)), ocp.AtRest())
    assert plan.success
    assert "30 → 18 rows: 6 bar, 6 momentum" in plan.message
    assert distances(plan.replay().nodes[-1]) == pytest.approx(distances(prism(1.1).nodes), abs=1e-4)


def test_a_waypoint_between_the_ends_of_intervals():
    plan = planned(ocp.Waypoint([ocp.Shape(prism(1.06).nodes)], time=0.47), ocp.Shape(prism(1.0).nodes), ocp.AtRest(), intervals=16)
    assert plan.success
    replay = plan.replay(step=1e-3)
    middle = replay.nodes[np.argmin(abs(replay.time - 0.47))]
    assert distances(middle) == pytest.approx(distances(prism(1.06).nodes), abs=2e-3)
    assert distances(replay.nodes[-1]) == pytest.approx(distances(prism(1.0).nodes), abs=1e-3)


def test_waypoints_count_in_the_replay_error():
    coarse = planned(ocp.Waypoint([ocp.Shape(prism(1.15).nodes), ocp.AtRest()], share=0.5), intervals=8)
    assert coarse.success
    replay = coarse.replay()
    middle = replay.nodes[np.argmin(abs(replay.time - 0.5))]
    assert coarse.replay_error >= 0.99 * np.abs(distances(middle) - distances(prism(1.15).nodes)).max()


def test_a_missed_waypoint_is_named():
    asked = ocp.Waypoint([ocp.Shape(prism(1.3).nodes), ocp.AtRest()], share=0.1)
    with pytest.raises(ValueError, match=r"intervals is 10: waypoint at 0.1 .* 9 force densities in each of the 1 .* 18 rows .* at least 20"):
        planned(asked, intervals=10)
    plan = planned(asked, intervals=20, bounds=[ocp.ForceDensityLimits(5.0, 12.0)])
    assert not plan.success
    assert plan.message.startswith("no plan: ")
    assert plan.replay_error > 0.01 or np.isnan(plan.replay_error)


def test_waypoints_at_one_time_are_one():
    """Given as a time and as a share, apart by rounding, in parts that repeat each other."""
    high, still = ocp.StringLengths({0: 0.9}), ocp.AtRest()
    shape = ocp.Shape(prism(1.0).nodes)
    once = planned(ocp.Waypoint([high, still], time=0.3), shape, intervals=16)
    parts = [ocp.Waypoint([high], share=0.1 + 0.2), ocp.Waypoint([still], time=0.3), ocp.Waypoint([high], time=0.3)]
    several = planned(*parts, shape, intervals=16)
    assert once.success
    assert several.success, several.message
    assert several.force_density == pytest.approx(once.force_density, abs=1e-4)


def test_one_free_node_may_come_back_elsewhere():
    """Only its velocities are asked for."""
    nodes = [(0, 0, 0), (1, 0, 0), (-1, 0, 1), (-1, 0, -1), (-1, 1, 0), (-1, -1, 0)]
    hinged = tc.Structure(nodes, bars=[(0, 1)], strings=[(0, node) for node in range(2, 6)], pinned=range(1, 6))
    plan = planned(ocp.Periodic((None, None, None)), model=driven(hinged), bounds=[ocp.ForceDensityLimits(0.0, 10.0)])
    assert "3 → 2 rows: 1 bar" in plan.message
    assert plan.success, plan.message


def test_a_periodic_motion_repeats():
    plan = planned(ocp.Waypoint([ocp.StringLengths(prism(1.08).string_lengths)], share=0.5), ocp.Periodic(), intervals=16)
    assert plan.success, plan.message
    twice = tc.simulate(MODEL, 2.0, 1e-3, control=np.tile(plan.force_density, (2, 1)), compiled=False)
    once = twice.nodes[np.argmin(abs(twice.time - 1.0))]
    assert once == pytest.approx(MODEL.structure.nodes, abs=1e-3)
    assert twice.nodes[-1] == pytest.approx(MODEL.structure.nodes, abs=3e-2)


def test_a_free_duration_with_a_waypoint():
    plan = planned(ocp.Waypoint([ocp.Shape(prism(1.05).nodes)], share=0.5), ocp.Shape(prism(1.1).nodes), ocp.AtRest(), duration=(0.8, 1.4))
    assert plan.success
    assert 0.8 <= plan.time[-1] <= 1.4


def test_some_axes_of_some_nodes():
    model = driven(prism(1.0, pinned=[0, 1, 2]))
    plan = planned(ocp.NodePositions({3: (None, None, 0.98)}), ocp.AtRest(), model=model, intervals=20)
    assert plan.success
    assert plan.replay().nodes[-1, 3, 2] == pytest.approx(0.98, abs=1e-4)


OTHER = tc.shapes.prism(3, 0.5, 1.4).nodes
BAD = {
    "shape of other bars": (lambda: planned(ocp.Shape(OTHER)), ValueError, "Shape.nodes make bar 0"),
    "shape of other size": (lambda: planned(ocp.Shape(OTHER[:4])), ValueError, "Shape.nodes"),
    "shape not finite": (lambda: ocp.Shape([[np.nan, 0, 0]]), ValueError, "Shape.nodes"),
    "waypoint without goals": (lambda: ocp.Waypoint([], time=0.5), TypeError, "Waypoint.goals"),
    "waypoint in a waypoint": (lambda: ocp.Waypoint([ocp.Waypoint([ocp.AtRest()], time=0.2)], time=0.5), TypeError, r"Waypoint.goals\[0\]"),
    "waypoint nowhere": (lambda: ocp.Waypoint([ocp.AtRest()]), ValueError, "Waypoint.time and .share"),
    "waypoint twice": (lambda: ocp.Waypoint([ocp.AtRest()], 0.5, 0.5), ValueError, "Waypoint.time and .share"),
    "waypoint after the end": (lambda: planned(ocp.Waypoint([ocp.AtRest()], time=1.5)), ValueError, "Waypoint.time is 1.5"),
    "waypoint at the end": (lambda: ocp.Waypoint([ocp.AtRest()], share=1.0), ValueError, "Waypoint.share is 1"),
    "waypoint all but at the end": (lambda: planned(ocp.Waypoint([ocp.AtRest()], time=1 - 1e-12)), ValueError, "a goal of the end"),
    "waypoint at the start": (lambda: planned(ocp.Waypoint([ocp.AtRest()], time=1e-12)), ValueError, "Waypoint.time is 1e-12, where .* hardly begun"),
    "waypoints that contradict each other": (
        lambda: planned(*(ocp.Waypoint([ocp.StringLengths({0: length})], time=0.5) for length in (0.8, 0.9))),
        ocp.UnreachableGoal,
        "waypoint at 0.5 of the duration: StringLengths: string 0 misses its goal by 0.05 m at best, as the goals contradict each other",
    ),
    "waypoint at no time": (lambda: planned(ocp.Waypoint([ocp.AtRest()], time=0.5), duration=(0.5, 1.0)), ValueError, "duration is free"),
    "waypoint unknown node": (
        lambda: planned(ocp.Waypoint([ocp.NodePositions({9: (0, 0, 0)})], time=0.5)),
        ValueError,
        "NodePositions.positions: node is 9",
    ),
    "periodic of two": (lambda: ocp.Periodic((1.0, 2.0)), ValueError, "Periodic.shift"),
    "periodic of a number": (lambda: ocp.Periodic(1.0), TypeError, "Periodic.shift"),
    "periodic from no pair": (lambda: ocp.Periodic(start=np.zeros((6, 3))), TypeError, "Periodic.start is no pair"),
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
        ocp.UnreachableGoal,
        "Periodic: node 0 x misses its goal by 1 m at best, as the centre of mass",
    ),
    "waypoint out of reach": (
        lambda: planned(ocp.Waypoint([ocp.NodePositions(prism(1.0).nodes + [1.0, 0, 0])], time=0.5)),
        ocp.UnreachableGoal,
        "waypoint at 0.5 of the duration: NodePositions",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_goals_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
