"""The program of a plan: its guess, nothing that a problem lacks, and costs that are not hidden between the nodes of the mesh."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import raising

import ocp
import tenscasadi as tc
from ocp.guess.path import make_guess
from ocp.problem.instant import symbolic
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.assemble import build_program

PRISM = tc.shapes.prism()
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), gravity=tc.Gravity()))
LENGTHS = ocp.StringLengths({0: 0.8, 6: 1.0})
FULL = {
    "bounds": [ocp.TensionLimits(1.0, 50.0)],
    "costs": [ocp.Effort(2.0), ocp.Smoothness(0.1)],
    "duration": (0.3, 0.5),
}
LINEAR = ocp.PiecewiseLinear()


def growing(shooting=ocp.MultipleShooting(4), **changes):
    problem = ocp.Problem(**{"model": MODEL, "duration": 0.4, "goals": [LENGTHS], **changes})
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    guess = make_guess(problem, target, shooting.intervals)
    return build_program(shooting, problem, target, scales, guess), guess, target


def test_derivatives_agree_with_differences():
    built, _, _ = growing(**FULL)
    w, f, g = (built.problem[name] for name in "xfg")
    weights = ca.DM(np.random.default_rng(0).normal(size=g.shape[0]))
    lagrangian = f + ca.dot(weights, g)
    values = ca.Function("values", [w], [f, g, ca.gradient(lagrangian, w)])
    exact = ca.Function(
        "exact", [w], [ca.jacobian(f, w), ca.jacobian(g, w), ca.hessian(lagrangian, w)[0]]
    )
    rng = np.random.default_rng(1)
    at = built.first + 0.1 * rng.normal(size=built.first.shape)
    along = rng.normal(size=built.first.shape)
    e = 1e-5
    up, down = values(at + e * along), values(at - e * along)
    for derivative, more, less in zip(exact(at), up, down, strict=True):
        assert derivative.full() @ along == pytest.approx(
            (more - less).full().ravel() / (2 * e), rel=1e-6, abs=1e-6
        )


def test_the_guess_comes_back():
    built, guess, target = growing(**FULL)
    states, controls, duration = (value.full().T for value in built.unpack(built.first))
    assert states == pytest.approx(guess.states, abs=1e-12)
    assert controls == pytest.approx(guess.force_density, abs=1e-12)
    assert float(duration.squeeze()) == pytest.approx(0.4)
    assert states[0] == pytest.approx(target.start, abs=0)
    sizes = {len(one) for one in (built.first, built.w_names, built.w_lower, built.w_upper)}
    assert len(sizes) == 1


def names(built, start):
    return [name for name in built.names if name.startswith(start)]


def test_what_a_problem_lacks_is_not_built():
    bare, _, _ = growing()
    assert len(bare.names) == len(names(bare, "dynamics")) + 2
    assert "duration" not in bare.w_names
    none, _, target = growing(goals=[])
    assert len(none.names) == len(names(none, "dynamics"))
    assert target.state is None
    limited, _, _ = growing(bounds=[ocp.TensionLimits(upper=[np.inf] * 8 + [5.0])])
    tension = names(limited, "tension")
    assert len(tension) == 2 * 4
    assert all("string 8" in name for name in tension)
    pushing, _, _ = growing(bounds=[ocp.TensionLimits(lower=0.0)])  # γ ≥ 0 says so already
    assert not names(pushing, "tension")
    timed, _, _ = growing(duration=(0.3, 0.5))
    assert timed.w_names[-1] == "duration"


def test_costs_are_what_they_say():
    gamma = ca.DM(np.arange(6.0).reshape(2, 3))
    assert float(ocp.Effort(2.0).expression(gamma, 0.5)) == pytest.approx(2.0 * 0.5 * 55)
    assert float(ocp.Smoothness(2.0).expression(gamma, 0.5)) == pytest.approx(2.0 * 4 / 0.5)


def test_costs_of_rates_are_no_smaller_beside_the_tolerance_on_finer_grids():
    found, tight = (
        ocp.solve(raising(costs=[ocp.Smoothness()]), ocp.Variational(60), ocp.Ipopt(tolerance=each))
        for each in (1e-8, 1e-12)
    )
    assert found.success
    assert found.objective == pytest.approx(tight.objective, rel=1e-4)


@pytest.mark.parametrize("control", [ocp.PiecewiseConstant(), LINEAR], ids=["constant", "linear"])
@pytest.mark.parametrize(
    "make",
    [
        ocp.ImplicitMidpoint,
        ocp.Variational,
        pytest.param(ocp.MultipleShooting, marks=pytest.mark.slow),
    ],
    ids=lambda kind: kind.__name__,
)
def test_work_is_not_hidden_by_force_densities_that_jump(make, control):
    """Seen at nodes alone, or by central differences, strings seem to work less where γ and motion swing from interval to interval."""
    plan = ocp.solve(raising(costs=[ocp.Work(), ocp.Effort(1e-4)]), make(24, control=control))
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(2.171, rel=1e-3)
    assert np.abs(np.diff(plan.force_density, axis=0)).max() < 5.0  # to and fro by 30 where it pays


def test_work_is_what_the_replay_works():
    problem = raising(costs=[ocp.Work(), ocp.Effort(1e-4)])
    plan = ocp.solve(problem, ocp.Variational(24))
    now = symbolic(problem.model)
    rate = ca.Function("rate", [now.state, now.control], [ocp.Work().rate(now)])
    fine = plan.replay(step=plan.time[-1] / (24 * 40)).states
    work = 0.0
    for k, gamma in enumerate(plan.force_density):
        states = fine[40 * k : 40 * k + 41]
        work += np.trapezoid(
            rate(states.T, np.tile(gamma[:, None], 41)).full().ravel(),
            dx=plan.time[-1] / len(fine[1:]),
        )
    effort = 1e-4 * (plan.force_density**2).mean(axis=0).sum()
    assert work + effort == pytest.approx(plan.objective, rel=1e-3)


@pytest.mark.parametrize(
    "intervals",
    [pytest.param(24, marks=pytest.mark.slow), (1,) * 12 + (2,) * 8],
    ids=["equal", "unequal"],
)
def test_limits_of_velocities_hold_in_the_replay(intervals):
    quick = ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities[:, 3]), upper=0.006)
    problem = raising(bounds=[ocp.ForceDensityLimits(5.0, 100.0), quick])
    leapfrog, reference = (
        ocp.solve(problem, make(intervals)) for make in (ocp.Variational, ocp.MultipleShooting)
    )
    assert leapfrog.success
    assert leapfrog.objective == pytest.approx(reference.objective, rel=5e-3)
    highest = (leapfrog.replay().states[:, 27:30] ** 2).sum(axis=1).max()
    assert highest < 0.0075  # without the limit 0.0109
