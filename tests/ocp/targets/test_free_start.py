"""Starts that are found with the plan: gaits and other motions that repeat."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc

ANCHORED = driven(prism(1.0, pinned=[0, 1, 2]))
FREE = driven(prism(1.0))
HIGH = ocp.Waypoint([ocp.NodePositions({3: (None, None, 1.01)})], share=0.5)


def problem(model=ANCHORED, start=None, goals=(HIGH, ocp.Periodic()), **changes):
    given = {"bounds": [ocp.ForceDensityLimits(5.0, 100.0)], "costs": [ocp.Effort()], **changes}
    return ocp.Problem(
        model, start=ocp.FreeStart() if start is None else start, goals=goals, **given
    )


TRANSCRIPTIONS = [
    ocp.MultipleShooting(24),
    ocp.ImplicitMidpoint(40),
    ocp.Variational(40),
    ocp.DirectCollocation(20),
]


@pytest.mark.parametrize("transcription", TRANSCRIPTIONS, ids=lambda value: type(value).__name__)
def test_a_motion_that_repeats_is_found_with_its_start(transcription):
    plan = ocp.solve(problem(), transcription, tolerance=0.05)
    assert plan.success, plan.message
    assert "18 → 12 rows: 6 bar" in plan.message
    assert plan.objective == pytest.approx(233.2, abs=0.4)  # 330 from the built state
    first, last = plan.trajectory.states[[0, -1]]
    assert last == pytest.approx(first, abs=1e-7)
    assert np.abs(first - ANCHORED.initial_state).max() > 0.01
    assert plan.trajectory.bar_length_error.max() < 1e-7


def test_the_replay_repeats_three_times():
    plan = ocp.solve(problem(), ocp.MultipleShooting(24))
    state = ANCHORED.state(plan.trajectory.nodes[0], plan.trajectory.velocities[0])
    thrice = tc.simulate(
        ANCHORED,
        3.0,
        1e-3,
        state=state,
        control=np.tile(plan.force_density, (3, 1)),
        compiled=False,
    )
    for seconds in (1.0, 2.0, 3.0):
        assert thrice.nodes[np.argmin(abs(thrice.time - seconds))] == pytest.approx(
            plan.trajectory.nodes[0], abs=5e-3
        )


def test_a_free_start_costs_less_than_a_given_one():
    given = ocp.solve(problem(start=prism(1.0).nodes), ocp.MultipleShooting(24))
    found = ocp.solve(problem(), ocp.MultipleShooting(24))
    assert given.success
    assert found.objective < 0.9 * given.objective


def test_a_free_structure_keeps_its_momenta():
    """No string sets it in motion: it drifts from the start, which the solver is free to choose."""
    taller = ocp.Waypoint([ocp.StringLengths(prism(1.08).string_lengths)], share=0.5)
    plan = ocp.solve(
        problem(FREE, goals=[taller, ocp.Periodic((0.3, 0.0, 0.0))]), ocp.MultipleShooting(12)
    )
    assert plan.success, plan.message
    assert "36 → 24 rows: 6 bar, 6 momentum" in plan.message
    assert plan.trajectory.velocities.mean(axis=1) == pytest.approx(
        np.tile([0.3, 0.0, 0.0], (13, 1)), abs=1e-6
    )


def test_goals_and_bounds_of_a_free_start():
    start = ocp.FreeStart(goals=[ocp.AtRest(), ocp.NodePositions({3: (None, None, 0.99)})])
    box = ocp.InsideBox((None, None, 0.985), nodes=[4])
    plan = ocp.solve(
        problem(start=start, bounds=[ocp.ForceDensityLimits(5.0, 100.0), box]),
        ocp.MultipleShooting(24),
    )
    assert plan.success, plan.message
    assert plan.trajectory.velocities[0] == pytest.approx(0.0, abs=1e-7)
    assert plan.trajectory.nodes[0, 3, 2] == pytest.approx(0.99, abs=1e-7)
    assert plan.trajectory.nodes[0, 4, 2] >= 0.985 - 1e-7


def test_other_plans_start_from_what_was_found():
    first = ocp.solve(problem(), ocp.MultipleShooting(24))
    again = ocp.solve(problem(), ocp.MultipleShooting(24), ocp.Ipopt(warm_start=True), guess=first)
    assert again.success
    assert again.iterations < first.iterations


FALLING = driven(prism(1.0), gravity=tc.Gravity())
SPLIT = tc.Model(
    tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()), coordinates="full"
)
BAD = {
    "falls": (
        lambda: ocp.solve(problem(FALLING, goals=[ocp.Periodic()])),
        ocp.InfeasibleGoalError,
        "Periodic cannot be met, as the center of mass",
    ),
    "joints": (lambda: problem(SPLIT, goals=[]), ValueError, "Problem.start is free"),
    "no value": (lambda: problem(start=ocp.FreeStart), TypeError, "the class FreeStart"),
    "near nothing": (
        lambda: problem(start=ocp.FreeStart(np.zeros((5, 3)))),
        ValueError,
        "FreeStart.near",
    ),
    "near other bars": (
        lambda: problem(start=ocp.FreeStart(2 * prism(1.0).nodes)),
        ValueError,
        "FreeStart.near",
    ),
    "waypoint as start": (
        lambda: ocp.FreeStart(goals=[HIGH]),
        TypeError,
        r"FreeStart.goals\[0\] is a Waypoint",
    ),
    "goals are no list": (lambda: ocp.FreeStart(goals=ocp.AtRest()), TypeError, "FreeStart.goals"),
    "unknown node": (
        lambda: problem(start=ocp.FreeStart(goals=[ocp.NodePositions({9: (0, 0, 0)})])),
        ValueError,
        "node is 9",
    ),
    "periodic on the way": (
        lambda: problem(goals=[ocp.Waypoint([ocp.Periodic()], share=0.5)]),
        ValueError,
        "the start is free",
    ),
}


def starting(*goals, end=()):
    """The plan of an upright bar of 1 m that comes back."""
    hinged = tc.Structure(
        [(0, 0, 0), (0, 0, 1), (-1, 0, 0), (1, 0, 0)], [(0, 1)], [(1, 2), (1, 3)], pinned=[0, 2, 3]
    )
    return ocp.solve(
        problem(driven(hinged), ocp.FreeStart(goals=goals), goals=[ocp.Periodic(), *end]),
        ocp.MultipleShooting(10),
    )


BAD |= {
    "a place out of reach": (
        lambda: starting(ocp.NodePositions({1: (5.0, None, None)})),
        ocp.InfeasibleGoalError,
        "free start: NodePositions: node 1 x misses its goal by 4.* m at best, as bar 0 keeps its length",
    ),
    "another place than the end, which repeats it": (
        lambda: starting(
            ocp.NodePositions({1: (0.1, None, None)}),
            end=[ocp.NodePositions({1: (0.3, None, None)})],
        ),
        ocp.InfeasibleGoalError,
        "free start: NodePositions: node 1 x misses its goal by 0.1 m at best, as the goals contradict each other",
    ),
    "two places at once": (
        lambda: starting(*(ocp.NodePositions({1: (x, None, None)}) for x in (0.1, 0.3))),
        ocp.InfeasibleGoalError,
        "free start: NodePositions: node 1 x misses its goal by 0.1 m at best, as the goals contradict each other",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_free_starts_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
