"""Plans that cannot be found: each failure is explained with its cause, its numbers and a cure."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc
from ocp.results.diagnosis import explain_failure
from ocp.search.methods import program_of
from ocp.search.task import prepare
from ocp.solvers.base import Solution
from ocp.transcription.mesh import Guess

MODEL = driven(prism(1.0, bar_radius=0.005, stiffness=1000.0))


RISE = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())


LEAST = ocp.ForceDensityLimits(5.0, 100.0)


def arm():
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    return tc.Structure(
        nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5]
    )


def asked(*bounds, goals=RISE, duration=1.0, model=MODEL, start=None):
    return ocp.Problem(
        model, duration, start, goals=goals, bounds=[LEAST, *bounds], costs=[ocp.Effort()]
    )


FAILED = {
    "too little force": (
        lambda: asked(ocp.ForceDensityLimits(5.0, 7.5)),
        ("upper limits are active", "most often the force density of string"),
    ),
    "too little time": (
        lambda: asked(ocp.ForceDensityLimits(5.0, 20.0), duration=0.1),
        ("upper limits are active", "increase the duration"),
    ),
    "too little tension": (
        lambda: asked(ocp.TensionLimits(upper=6.5)),
        ("upper limits are active", "tension of string"),
    ),
    "bars too slender": (
        lambda: asked(ocp.Buckling(3.9e9)),
        ("upper limits are active", "buckling of bar"),
    ),
    "a slow motor": (
        lambda: asked(ocp.RestLengthRateLimits(0.01)),
        (
            "limits are too narrow",
            "rest length rate of string",
        ),
    ),
    "too few iterations": (lambda: asked(), ("increase max_iterations", "largest violation")),
    "vibrations are faster than steps": (
        lambda: asked(ocp.ForceDensityLimits(90.0), goals=[ocp.AtRest()]),
        (
            "steps of 0.2 s are too long for the fastest vibration",
            "give at least",
            "intervals or substeps",
        ),
    ),
    "a cost is not a number": (
        lambda: ocp.Problem(
            MODEL,
            goals=RISE,
            costs=[ocp.Integral("log", lambda now: ca.log(now.control[0] - 50.0))],
        ),
        ("the sum of Problem.costs is not a number", "logarithms"),
    ),
    "a cost has no derivative": (
        lambda: ocp.Problem(
            MODEL,
            goals=RISE,
            costs=[ocp.Integral("root", lambda now: ca.sqrt(ca.fmax(0.0, now.control[0] - 1e6)))],
        ),
        (
            "the derivative of Problem.costs by force density of string 0",
            "is not a number",
            "roots",
        ),
    ),
    "nothing holds the force densities": (
        lambda: ocp.Problem(
            driven(arm()),
            goals=[ocp.AtRest()],
            costs=[ocp.Integral("more", lambda now: -now.control[0])],
        ),
        ("force density of string", "without a limit: give it one"),
    ),
    "a wind blows past the waypoint": (
        lambda: asked(
            goals=[ocp.Waypoint([ocp.AtRest()], share=0.5)],
            model=driven(prism(1.0), forces=tc.NodalForce([[0.5, 0.0, 0.0]] * 6)),
        ),
        ("largest violation: ",),
    ),
}


@pytest.mark.slow
def test_long_intervals_are_no_lack_of_control():
    """Bars and momenta that coarse steps do not keep are missed, which more intervals cure."""
    turning = MODEL.state(prism(1.0).nodes, np.cross([0, 0, 6.0], prism(1.0).nodes))
    problem = ocp.Problem(
        MODEL,
        start=turning,
        goals=[ocp.Shape(prism(1.1).nodes)],
        bounds=[ocp.ForceDensityLimits(5, 200)],
        costs=[ocp.Effort()],
    )
    lost = ocp.solve(problem, ocp.MultipleShooting(3), ocp.Ipopt(max_iterations=20))
    coarse = ocp.solve(problem, ocp.MultipleShooting(8), tolerance=1e-6)
    fine = ocp.solve(problem, ocp.MultipleShooting(20))
    assert [plan.success for plan in (lost, coarse, fine)] == [False, False, True]
    advised = re.search(
        "steps of 0.33 s are too long .* give at least ([0-9]+) of them", lost.message
    )
    assert advised is not None
    assert 3 < int(advised[1]) <= 20
    assert coarse.message.startswith("a plan was found")


def test_violations_have_units(monkeypatch):
    monkeypatch.setattr("ocp.search.find_plan.explain_limits", lambda task: "")
    plan = ocp.solve(
        asked(ocp.TensionLimits(upper=6.5)), ocp.MultipleShooting(8), ocp.Ipopt(max_iterations=2)
    )
    assert "in its unit" not in plan.message
    assert re.search(
        "largest violation: (tension of string [^;]*, by [0-9.e+-]+ N|[^;]* misses its goal by [0-9.e+-]+ m|[^;]* of its scale)",
        plan.message,
    )


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name == "bars too slender"))
        for name in FAILED
    ],
)
def test_what_cannot_be_solved_is_explained(name, monkeypatch):
    """The search for wider limits, which `test_narrow_limits` tests, is left out elsewhere."""
    make, words = FAILED[name]
    if "limits are too narrow" in words:
        monkeypatch.setattr("ocp.search.narrow_limits._explain_duration", lambda *_: "")
    else:
        monkeypatch.setattr("ocp.search.find_plan.explain_limits", lambda task: "")
    limit = {"too few iterations": 1, "too little time": 300}.get(name, 60)
    plan = ocp.solve(
        make(), ocp.MultipleShooting(5), ocp.Ipopt(max_iterations=limit), tolerance=1e-5
    )
    if plan.success:  # the motion meets the goals, but the cost is not settled
        assert "the cost is not settled: " in plan.message
    else:
        assert plan.message.startswith("no plan: ")
    for word in words:
        assert word in plan.message


@pytest.mark.parametrize("transcription", [ocp.Variational(4), ocp.DirectCollocation(4)])
@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("bar 0 length force,",), ""),
        (("bar 0 length force,", "node 3 z,"), "node 3 z, interval 0"),
        (("node 3 z,", "force density of string 2"), "force density of string 2, interval 0"),
    ],
)
def test_growth_of_values_without_limits_is_named(transcription, names, found):
    """The last iterate has them at 1000 in scaled units; multipliers have no limits of the user."""
    problem = ocp.Problem(MODEL, goals=RISE, costs=[ocp.Effort()])
    program = program_of(problem, transcription)
    w = program.first.copy()
    w[
        [next(k for k, one in enumerate(program.w_names) if one.startswith(name)) for name in names]
    ] = 1e3
    status = "Maximum_Iterations_Exceeded"
    solution = Solution(program.first, False, status, 10, last=w)
    states, gamma, duration = (one.full() for one in program.unpack(program.first))
    target = prepare(problem, transcription.control, 0.01).target
    guess = Guess(states.T, gamma.T, duration.item())
    message = explain_failure(problem, target, lambda _: states[:, 0], program, solution, guess)
    cause = message.split(": ")[0]
    assert cause.startswith(f"{found} grows to" if found else "stopped at the iteration limit")
