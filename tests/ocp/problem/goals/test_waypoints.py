"""Waypoints: met on the way, counted in the replay, named where they are missed."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from planning import driven, integrated, prism

import ocp

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


def test_a_waypoint_between_the_ends_of_intervals():
    plan = planned(
        ocp.Waypoint([ocp.Shape(prism(1.06).nodes)], time=0.47),
        ocp.Shape(prism(1.0).nodes),
        ocp.AtRest(),
        intervals=16,
    )
    assert plan.success
    replay = plan.replay(step=1e-3)
    middle = replay.nodes[np.argmin(abs(replay.time - 0.47))]
    assert distances(middle) == pytest.approx(distances(prism(1.06).nodes), abs=2e-3)
    assert distances(replay.nodes[-1]) == pytest.approx(distances(prism(1.0).nodes), abs=1e-3)


def test_waypoints_count_in_the_replay_error():
    coarse = planned(
        ocp.Waypoint([ocp.Shape(prism(1.15).nodes), ocp.AtRest()], share=0.5), intervals=8
    )
    assert coarse.success
    replay = coarse.replay()
    middle = replay.nodes[np.argmin(abs(replay.time - 0.5))]
    assert (
        coarse.replay_error >= 0.99 * np.abs(distances(middle) - distances(prism(1.15).nodes)).max()
    )


@pytest.mark.slow
def test_a_missed_waypoint_is_named():
    asked = ocp.Waypoint([ocp.Shape(prism(1.3).nodes), ocp.AtRest()], share=0.1)
    coarse = planned(asked, intervals=10)
    assert not coarse.success
    assert "waypoint at 0.1 of the duration, 18 rows of goals need more than 9" in coarse.message
    plan = planned(asked, intervals=20, bounds=[ocp.ForceDensityLimits(5.0, 12.0)])
    assert not plan.success
    assert plan.message.startswith("no plan: ")
    assert plan.replay_error > 0.01 or np.isnan(plan.replay_error)


@pytest.mark.slow
def test_waypoints_at_one_time_are_one():
    """Given as a time and as a share, apart by rounding, in parts that repeat each other."""
    high, still = ocp.StringLengths({0: 0.9}), ocp.AtRest()
    shape = ocp.Shape(prism(1.0).nodes)
    once = planned(ocp.Waypoint([high, still], time=0.3), shape, intervals=16)
    parts = [
        ocp.Waypoint([high], share=0.1 + 0.2),
        ocp.Waypoint([still], time=0.3),
        ocp.Waypoint([high], time=0.3),
    ]
    several = planned(*parts, shape, intervals=16)
    assert once.success
    assert several.success, several.message
    assert several.force_density == pytest.approx(once.force_density, abs=1e-4)


def test_a_free_duration_with_a_waypoint():
    plan = planned(
        ocp.Waypoint([ocp.Shape(prism(1.05).nodes)], share=0.5),
        ocp.Shape(prism(1.1).nodes),
        ocp.AtRest(),
        duration=(0.8, 1.4),
    )
    assert plan.success
    assert 0.8 <= plan.time[-1] <= 1.4


SHAPES = [ocp.Shape(prism(1.1).nodes), ocp.AtRest()]
PRICED = {"bounds": [PRESTRESS], "costs": [ocp.Effort(), ocp.Duration(100.0)]}


@pytest.mark.slow
def test_times_of_waypoints_and_of_the_end_are_free():
    """The waypoint is met as SciPy integrates the plan, and the same waypoint at other shares of the duration costs more."""
    way = [ocp.Shape(prism(1.05).nodes)]
    plan = ocp.solve(
        ocp.Problem(
            MODEL, (0.4, 1.0), goals=[ocp.Waypoint(way, time=(0.1, 0.9)), *SHAPES], **PRICED
        )
    )
    assert plan.success, plan.message
    met = plan.time[len(plan.time) // 2]
    assert 0.1 <= met <= 0.9
    assert 0.4 <= plan.time[-1] < 1.0
    assert distances(MODEL.nodes(integrated(plan, met / plan.time[-1]))) == pytest.approx(
        distances(prism(1.05).nodes), abs=1e-3
    )
    assert distances(MODEL.nodes(integrated(plan))) == pytest.approx(
        distances(prism(1.1).nodes), abs=1e-3
    )
    for change in (-0.15, 0.0, 0.15):
        fixed = ocp.Problem(
            MODEL,
            (0.4, 1.0),
            goals=[ocp.Waypoint(way, share=met / plan.time[-1] + change), *SHAPES],
            **PRICED,
        )
        assert ocp.solve(fixed, ocp.Variational(40)).objective > 0.99 * plan.objective


def test_times_of_waypoints_have_limits_and_an_order():
    ways = [
        ocp.Waypoint([ocp.Shape(prism(height).nodes)], time=times)
        for height, times in ((1.04, (0.3, 0.32)), (1.07, (0.1, 0.8)))
    ]
    problem = ocp.Problem(MODEL, (0.5, 1.5), goals=[*ways, *SHAPES], **PRICED)
    assert [phase.end_time for phase in problem.phases] == [(0.3, 0.32), (0.1, 0.8), (0.5, 1.5)]
    plan = ocp.solve(problem, ocp.Variational(12))
    assert plan.success, plan.message
    first, second = plan.time[12], plan.time[24]
    assert 0.3 - 1e-6 <= first <= 0.32 + 1e-6
    assert first < second <= 0.8 + 1e-6
    assert 0.5 - 1e-6 <= plan.time[-1] <= 1.5 + 1e-6


WAY = [ocp.AtRest()]
UNTIMELY = {
    "pair of nothing": (
        lambda: ocp.Waypoint(WAY, time=(0.0, 1.0)),
        r"Waypoint.time is \(0, 1\): give \(earliest, latest\), greater than 0",
    ),
    "pair crossed": (lambda: ocp.Waypoint(WAY, time=(0.5, 0.4)), r"Waypoint.time is \(0.5, 0.4\)"),
    "beyond the end": (
        lambda: timed((2.0, 3.0)),
        r"Waypoint.time is \(2, 3\), and the plan takes 1 s at most",
    ),
    "out of order": (
        lambda: timed((0.5, 0.6), (0.1, 0.2)),
        r"Waypoint.time is \(0.1, 0.2\), and the waypoint before is met at 0.5 s or later",
    ),
    "free and given": (
        lambda: ocp.Problem(
            MODEL, goals=[ocp.Waypoint(WAY, time=(0.1, 0.2)), ocp.Waypoint(WAY, share=0.5)]
        ),
        "waypoints of free and of given times",
    ),
    "wish": (
        lambda: ocp.Problem(MODEL, goals=[ocp.Waypoint(WAY, time=(0.1, 0.2)).soft()]),
        "goals of phases are met",
    ),
}


def timed(*times):
    return ocp.Problem(MODEL, goals=[ocp.Waypoint(WAY, time=pair) for pair in times])


@pytest.mark.parametrize("name", UNTIMELY)
def test_times_that_are_none_are_refused_by_name(name):
    make, message = UNTIMELY[name]
    with pytest.raises(ValueError, match=message):
        make()
