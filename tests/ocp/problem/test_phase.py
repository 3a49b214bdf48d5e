"""Phases: what they refuse, by name."""

from __future__ import annotations

import numpy as np
import pytest
from jumping import flight, jumping, low_prism, push, standing

import ocp
import tenscasadi as tc


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"duration": 0.0}, r"Phase\.duration"),
        ({"duration": (0.5, 0.1)}, r"Phase\.duration is \(0\.5, 0\.1\)"),
        ({"contact_nodes": [0, 0]}, r"Phase\.contact_nodes is \(0, 0\)"),
        ({"contact_nodes": [-1]}, r"Phase\.contact_nodes"),
        ({"goals": [ocp.Effort()]}, r"Phase\.goals\[0\]"),
        ({"bounds": [ocp.AtRest()]}, r"Phase\.bounds\[0\]"),
    ],
)
def test_a_phase_refuses_by_name(given, named):
    with pytest.raises((TypeError, ValueError), match=named):
        ocp.Phase(**{"duration": 1.0, **given})


@pytest.mark.parametrize(
    ("phases", "changes", "named"),
    [
        ([push(contact_nodes=[0, 9])], {}, r"Problem\.phases\[0\]\.contact_nodes.*9"),
        (
            [push(contact_nodes=[0, 4])],
            {},
            r"phases\[0\]\.contact_nodes has node 4, which starts 0\.6 m above the ground",
        ),
        (
            [push(goals=[ocp.Waypoint([ocp.AtRest()], share=0.5)])],
            {},
            r"phases\[0\]\.goals has a Waypoint",
        ),
        (
            [push(goals=[ocp.StringLengths({12: 1.0})])],
            {},
            "string is 12: string indices run from 0 to 8",
        ),
        ([push()], {"goals": [ocp.Periodic()]}, r"Problem\.goals has a Periodic"),
        (
            [push()],
            {"duration": 2.0},
            r"Problem\.duration is 2\.0, and phases have durations of their own",
        ),
        ([push()], {"start": ocp.FreeStart()}, r"Problem\.start is free"),
        (
            [push()],
            {"costs": [ocp.Tracking({0: lambda time: (time, 0.0, 0.0)})]},
            "Tracking, which depends on the time",
        ),
        (
            [push()],
            {"costs": [ocp.Integral("late", lambda now: now.time * now.nodes[2, 3] ** 2)]},
            "Integral, which depends on the time",
        ),
        (
            [push(bounds=[ocp.RestLengthRateLimits(0.1, 100.0)])],
            {},
            r"phases\[0\]\.bounds has RestLengthRateLimits",
        ),
        (
            [push()],
            {"model": tc.Model(standing().scene, coordinates="full")},
            r'Problem\.phases needs Model\(scene, coordinates="reduced"\)',
        ),
        ([0.5], {}, r"Problem\.phases\[0\]"),
    ],
)
def test_a_problem_refuses_phases_that_do_not_fit(phases, changes, named):
    with pytest.raises((TypeError, ValueError), match=named):
        jumping(*phases, **changes)


@pytest.mark.parametrize(
    ("ground", "named"),
    [
        (None, "the scene has no ground"),
        (tc.Ground(), "the ground has no friction"),
        (
            [tc.Ground(friction=0.5), tc.Ground(friction=0.5, normal=(1, 0, 0), height=-9)],
            "the scene has 2 grounds",
        ),
        (tc.Ground(friction=0.5, nodes=[0, 1]), "node 2, on which the ground does not act"),
    ],
)
def test_nodes_stand_on_one_ground_with_friction(ground, named):
    model = tc.Model(
        tc.Scene(low_prism(), control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground)
    )
    with pytest.raises(ValueError, match=named):
        jumping(push(), model=model)


def test_a_pinned_node_cannot_stand():
    pinned = low_prism().replace(pinned=[0])
    model = tc.Model(
        tc.Scene(
            pinned, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=tc.Ground(friction=0.5)
        )
    )
    with pytest.raises(ValueError, match="node 0, which is pinned"):
        jumping(push(), model=model)


def test_the_duration_is_that_of_all_phases():
    problem = jumping(push(), flight(0.1), ocp.Phase(0.25))
    assert np.allclose((problem.shortest, problem.longest), (0.1 + 0.02 + 0.25, 0.5 + 0.5 + 0.25))


def test_who_cannot_use_phases_says_so():
    problem = jumping(push())
    for refused in (
        lambda: ocp.Mpc(problem, 0.1, 3),
        lambda: ocp.Mppi(problem, 0.1, 3),
        lambda: ocp.export_program(problem, ocp.Variational(5), "."),
    ):
        with pytest.raises(ValueError, match="no problem with phases"):
            refused()


def test_the_model_keeps_its_ground():
    assert jumping(push()).model is standing()


def test_phases_take_tracking_of_fixed_places():
    costs = [ocp.Tracking({3: (0.0, 0.0, 0.6)})]
    assert jumping(push(), costs=costs).costs == tuple(costs)
