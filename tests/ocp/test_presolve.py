"""Plans that cannot be: each failure is explained with its cause, its numbers and a cure."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc

BAR = 1.4


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


MODEL = driven(prism(1.0, bar_radius=0.005, stiffness=1000.0))
RISE = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())
LEAST = ocp.ForceDensityLimits(5.0, 100.0)


def arm():
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    return tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5])


def asked(*bounds, goals=RISE, duration=1.0, model=MODEL, start=None):
    return ocp.Problem(model, duration, start, goals=goals, bounds=[LEAST, *bounds], costs=[ocp.Effort()])


# --- refused before solving: what, by how much, why ---

REFUSED = {
    "bars are too short": (
        lambda: asked(goals=[ocp.StringLengths({0: 3.0})], model=driven(tc.shapes.d_bar())),
        ("string 0 misses its goal by", "bar", "keeps its length", "give goals that fit the bars"),
    ),
    "goals contradict each other": (
        lambda: asked(goals=[ocp.NodePositions({0: (0.5, None, None)}), ocp.NodePositions({0: (0.7, None, None)})]),
        ("node 0 x misses its goal by",),
    ),
    "the centre of mass would move": (
        lambda: asked(goals=[ocp.NodePositions(prism(1.0).nodes + [0.3, 0, 0])]),
        ("misses its goal by 0.3", "centre of mass", "pin a node"),
    ),
    "a spin would stop": (
        lambda: asked(goals=[ocp.AtRest()], start=MODEL.state(prism(1.0).nodes, np.cross([0, 0, 1.0], prism(1.0).nodes))),
        ("AtRest", "m/s", "angular momentum"),
    ),
    "a flat structure would leave its plane": (
        lambda: asked(goals=[ocp.NodePositions({1: (None, None, 0.2)})], model=driven(tc.shapes.d_bar(pinned=[0]))),
        ("node 1 z misses its goal by", "plane"),
    ),
    "a waypoint is out of reach": (
        lambda: asked(goals=[ocp.Waypoint([ocp.StringLengths({0: 3.0})], time=0.5)], model=driven(tc.shapes.d_bar())),
        ("waypoint at 0.5 of the duration", "string 0 misses", "bar"),
    ),
    "a gait would need a push": (lambda: asked(goals=[ocp.Periodic((0.5, 0, 0))]), (" x misses its goal by 0.5", "centre of mass")),
    "a falling prism would stay": (
        lambda: asked(goals=[ocp.AtRest()], model=driven(prism(1.0), gravity=tc.Gravity())),
        ("AtRest: node", "misses its goal by 9.8", "m/s", "the centre of mass keeps its speed along z"),
    ),
    "limits leave nothing": (lambda: asked(ocp.ForceDensityLimits(0.0, 4.0)), ("ForceDensityLimits leave string 0 nothing", "lower 5 and upper 4")),
    "the start is out of bounds": (lambda: asked(ocp.AboveGround(0.2)), ("Problem.start has z of node 0 at 0", "start within them")),
    "a pin is out of bounds": (lambda: asked(ocp.AboveGround(0.2), goals=[], model=driven(arm())), ("leaves out node 0, pinned at z = 0",)),
    "a pinned node would move": (
        lambda: asked(goals=[ocp.NodePositions({0: (None, None, 1.0)})], model=driven(arm())),
        ("node that is pinned at 0 m", "leave that axis None"),
    ),
    "limits contradict each other at the start": (
        lambda: asked(ocp.BarForceLimits(compression=5.0)),
        ("leave no force densities at the start: compression of bar", "has to be at most 5 N", "it is 9.17", "widen one"),
    ),
    "a constraint is broken at the start": (
        lambda: asked(ocp.Constraint("height", lambda now: now.nodes[2, 3] - now.nodes[2, 0], upper=0.5)),
        ("height has to be at most 0.5", "it is 1"),
    ),
    "a waypoint comes too soon": (
        lambda: asked(goals=[*RISE, ocp.Waypoint([ocp.Shape(prism(1.05).nodes), ocp.AtRest()], share=0.1)]),
        ("intervals is 8: waypoint at 0.1 of the duration, 9 force densities in each of the 1 up to there", "give at least 20"),
    ),
    "a waypoint comes at once": (
        lambda: asked(goals=[*RISE, ocp.Waypoint([ocp.Shape(prism(1.05).nodes)], time=1e-6)]),
        (
            "waypoint at 1e-06 of the duration: node ",
            "has to move by 0.0",
            "in 1e-06 s, in which force densities within their limits",
            "give more time",
        ),
    ),
    "a plan ends at once": (lambda: asked(duration=1e-5), ("m in 1e-05 s, in which force densities", "give more time")),
    "a shape has other bars": (lambda: asked(goals=[ocp.Shape(2 * prism(1.0).nodes)]), ("Shape.nodes make bar 0 2.8 m long, not 1.4 m",)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_before_solving(name):
    make, words = REFUSED[name]
    with pytest.raises(ValueError, match=re.escape(words[0])) as caught:
        ocp.solve(make(), ocp.MultipleShooting(8))
    for word in words:
        assert word in str(caught.value)


# --- found out by solving ---

FAILED = {
    "too little force": (lambda: asked(ocp.ForceDensityLimits(5.0, 7.5)), ("upper limits hold", "most often the force density of string")),
    "too little time": (lambda: asked(ocp.ForceDensityLimits(5.0, 20.0), duration=0.1), ("upper limits hold", "longer duration")),
    "too little tension": (lambda: asked(ocp.TensionLimits(upper=6.5)), ("upper limits hold", "tension of string")),
    "bars too slender": (lambda: asked(ocp.Buckling(3.9e9)), ("upper limits hold", "buckling of bar")),
    "a slow motor": (lambda: asked(ocp.RestLengthRateLimits(0.01)), ("rest length rate of string",)),
    "too few iterations": (lambda: asked(), ("raise max_iterations", "largest violation")),
    "vibrations are faster than steps": (
        lambda: asked(ocp.ForceDensityLimits(90.0), goals=[ocp.AtRest()]),
        ("steps of 0.12 s are too long for the fastest vibration", "give at least", "intervals or substeps"),
    ),
    "a cost is not a number": (
        lambda: ocp.Problem(MODEL, goals=RISE, costs=[ocp.Integral("log", lambda now: ca.log(now.control[0] - 50.0))]),
        ("the sum of Problem.costs is not a number", "logarithms"),
    ),
    "a cost has no derivative": (
        lambda: ocp.Problem(MODEL, goals=RISE, costs=[ocp.Integral("root", lambda now: ca.sqrt(ca.fmax(0.0, now.control[0] - 1e6)))]),
        ("the derivative of Problem.costs by force density of string 0", "is not a number", "roots"),
    ),
    "nothing holds the force densities": (
        lambda: ocp.Problem(driven(arm()), goals=[ocp.AtRest()], costs=[ocp.Integral("more", lambda now: -now.control[0])]),
        ("force density of string", "with nothing to hold it: give it a limit"),
    ),
    "a wind blows past the waypoint": (
        lambda: asked(goals=[ocp.Waypoint([ocp.AtRest()], share=0.5)], model=driven(prism(1.0), forces=tc.NodalForce([[0.5, 0.0, 0.0]] * 6))),
        ("waypoint at 0.5 of the duration, AtRest: node", "misses its goal by 0.5 m/s", "no string moves it there", "3 out of control"),
    ),
    "the goal is in the obstacle": (
        lambda: asked(
            ocp.Obstacle((0.6, 0.0, 0.8), 0.2), goals=[ocp.NodePositions({1: (0.6, 0.0, None)}), ocp.AtRest()], model=driven(arm()), duration=1.0
        ),
        ("obstacle clear of bar 0, end of interval",),
    ),
}


def test_long_intervals_are_no_lack_of_control():
    """Bars and momenta that coarse steps do not keep are missed, which more intervals cure."""
    turning = MODEL.state(prism(1.0).nodes, np.cross([0, 0, 6.0], prism(1.0).nodes))
    problem = ocp.Problem(MODEL, start=turning, goals=[ocp.Shape(prism(1.1).nodes)], bounds=[ocp.ForceDensityLimits(5, 200)], costs=[ocp.Effort()])
    lost = ocp.solve(problem, ocp.MultipleShooting(3), ocp.Ipopt(max_iterations=20))
    coarse, fine = (ocp.solve(problem, ocp.MultipleShooting(intervals)) for intervals in (8, 20))
    assert [plan.success for plan in (lost, coarse, fine)] == [False, False, True]
    advised = re.search("steps of 0.33 s are too long .* give at least ([0-9]+) of them", lost.message)
    assert advised is not None
    assert 3 < int(advised[1]) <= 20
    assert coarse.message.startswith("too coarse: a plan was found")
    for plan in (lost, coarse):
        assert "no string moves it" not in plan.message


@pytest.mark.parametrize("name", FAILED)
def test_what_cannot_be_solved_is_explained(name):
    make, words = FAILED[name]
    limit = 1 if name == "too few iterations" else 100
    plan = ocp.solve(make(), ocp.MultipleShooting(8), ocp.Ipopt(max_iterations=limit))
    assert not plan.success
    assert plan.message.startswith("no plan: ")
    for word in words:
        assert word in plan.message
