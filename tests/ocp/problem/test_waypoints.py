"""Waypoints: met on the way, counted in the replay, named where they are missed."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from planning import driven, prism

import ocp

PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)
MODEL = driven(prism(1.0))


def planned(*goals, duration=1.0, intervals=12, model=MODEL, **changes):
    given = {"bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(ocp.Problem(model, duration, goals=goals, **given), ocp.MultipleShooting(intervals))


def distances(nodes):
    return np.array([np.linalg.norm(nodes[a] - nodes[b]) for a, b in combinations(range(len(nodes)), 2)])


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


def test_a_free_duration_with_a_waypoint():
    plan = planned(ocp.Waypoint([ocp.Shape(prism(1.05).nodes)], share=0.5), ocp.Shape(prism(1.1).nodes), ocp.AtRest(), duration=(0.8, 1.4))
    assert plan.success
    assert 0.8 <= plan.time[-1] <= 1.4
