"""All transcriptions: the same optimum at their order, bars kept, what they cannot take, and how one is added."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import pytest
from planning import folding, integrated, program, raising, shaken

import ocp
import tenscasadi as tc
from ocp.transcription.base import Defects, Transcription
from ocp.transcription.sparse_nlp import Block, expand, split_symbol
from ocp.transcription.variables import name_intervals, name_states


@pytest.mark.parametrize(
    "make",
    [ocp.MultipleShooting, ocp.ImplicitMidpoint, ocp.Variational, ocp.DirectCollocation],
    ids=lambda kind: kind.__name__,
)
def test_all_find_the_same_plan(make):
    """On one grid the planned force densities differ by the methods' errors only."""
    problem = raising()
    found = ocp.solve(problem, make(24), ocp.Ipopt(tolerance=1e-10))
    assert found.success
    assert found.objective == pytest.approx(375.07, abs=0.002)
    assert found.replay_error < (1e-4 if make in (ocp.ImplicitMidpoint, ocp.Variational) else 2e-6)
    assert found.trajectory.bar_length_error.max() < 1e-9


def end_error(make, intervals):
    """How far the plan ends from what its force densities do."""
    plan = ocp.solve(raising(), make(intervals))
    assert plan.success
    return plan.replay_error


@pytest.mark.parametrize(
    ("make", "order", "grids"),
    [
        (ocp.ImplicitMidpoint, 2, (10, 20, 40)),
        (ocp.Variational, 2, (10, 20, 40)),
        (ocp.MultipleShooting, 4, (8, 12, 16)),
        (lambda n: ocp.DirectCollocation(n, degree=2), 4, (8, 12, 16)),
    ],
    ids=["ImplicitMidpoint", "Variational", "MultipleShooting", "Collocation"],
)
@pytest.mark.slow
def test_replay_errors_fall_at_the_order(make, order, grids):
    found = [end_error(make, n) for n in grids]
    rate = np.log(found[0] / found[-1]) / np.log(grids[-1] / grids[0])
    assert rate > order - 0.5


@pytest.mark.parametrize(
    "transcription",
    [ocp.ImplicitMidpoint(30), ocp.Variational(30), ocp.DirectCollocation(15, degree=2)],
    ids=lambda v: type(v).__name__,
)
def test_joined_and_pinned_bars(transcription):
    found = ocp.solve(folding(), transcription)
    assert found.success
    assert found.replay_error < 5e-3
    assert found.trajectory.bar_length_error.max() < 1e-8
    assert np.abs(found.trajectory.nodes[:, 0] - found.trajectory.nodes[0, 0]).max() == 0.0


@cache
def shaken_by_shooting(free, control):
    slow = ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities[:, 5]), upper=0.01)
    problem = shaken((0.4, 2.0), slow) if free else shaken()
    return ocp.solve(problem, ocp.MultipleShooting(24, control=control))


MIDPOINT = ocp.ImplicitMidpoint(24)
LEAPFROG = ocp.Variational(24, accuracy=1e-7)
LINEAR = ocp.Variational(24, control=ocp.PiecewiseLinear(), accuracy=1e-6)
COLLOCATION = ocp.DirectCollocation(24)


@pytest.mark.parametrize(
    ("transcription", "free"),
    [
        *((transcription, False) for transcription in (LEAPFROG, COLLOCATION)),
        *((transcription, True) for transcription in (MIDPOINT, LEAPFROG, COLLOCATION)),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((MIDPOINT, False), (LINEAR, False), (LINEAR, True))
        ),
    ],
)
def test_supports_may_be_moved(transcription, free):
    """As multiple shooting knows them, and SciPy."""
    known = shaken_by_shooting(free, transcription.control)
    problem = known.problem
    found = ocp.solve(problem, transcription)
    assert found.success, found.message
    assert found.objective == pytest.approx(known.objective, rel=2e-3)
    assert found.time[-1] == pytest.approx(known.time[-1], rel=5e-3)
    assert found.trajectory.bar_length_error.max() < 1e-8
    if transcription.accuracy is not None and not transcription.control.linear:
        nodes, velocities = (
            read(integrated(found)) for read in (problem.model.nodes, problem.model.velocities)
        )
        assert nodes[5, 2] == pytest.approx(1.05, abs=1e-6)
        assert velocities[4, 2] == pytest.approx(0.0, abs=1e-6)
        assert nodes == pytest.approx(found.trajectory.nodes[-1], abs=1e-6)
    if free:
        assert 0.5 < found.time[-1] < 1.9
        assert np.linalg.norm(found.trajectory.velocities[:, 5], axis=1).max() == pytest.approx(
            0.1, rel=1e-3
        )


@pytest.mark.parametrize(
    "make",
    [ocp.ImplicitMidpoint, ocp.Variational, ocp.DirectCollocation, ocp.MultipleShooting],
    ids=lambda kind: kind.__name__,
)
def test_programs_in_full_coordinates_keep_joints(make):
    reduced, full = (
        tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()), coordinates)
        for coordinates in ("reduced", "full")
    )
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    objectives = []
    for model in (reduced, full):
        asked = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
        built = program(asked, make(8))
        solution = ocp.Ipopt(max_iterations=50).solve(built)
        assert solution.success
        cost = ca.Function("f", [built.problem["x"]], [built.problem["f"]])(solution.w)
        objectives.append(float(cost) * built.objective)
        states = built.unpack(solution.w)[0].full().T
        assert max(np.abs(model.joint_error(x)).max() for x in states) < 1e-7
    assert objectives[1] == pytest.approx(objectives[0], rel=1e-6)


@dataclass(frozen=True)
class Trapezoidal(Transcription):
    """x⁺ = x + h (f + f⁺)/2, and nothing that keeps bars."""

    def defects(self, variables, used):
        v, model = variables, variables.model
        z, (x, c, after, duration, share) = split_symbol(
            ca.MX, model.nx, v.interval_controls.shape[1], model.nx, 1, 1
        )
        slope = (model.ode(x, v.gamma(c, 0.0)) + model.ode(after, v.gamma(c, 1.0))) / 2
        row = (after - x - duration * share * slope) / ca.DM(v.scales.state)
        gap = expand(ca.Function("gap", [z], [row]))
        index = np.hstack(
            [v.states[:-1], v.interval_controls, v.states[1:], v.repeat(v.duration), v.share]
        )
        return Defects([Block(gap, index, name_intervals(v.count, name_states(model)))])


def test_a_transcription_is_a_subclass_that_gives_defects():
    found = ocp.solve(raising(), Trapezoidal(24))
    assert found.success, found.message
    assert found.objective == pytest.approx(375.07, rel=2e-3)
