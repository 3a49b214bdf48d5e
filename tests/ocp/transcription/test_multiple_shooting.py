"""The nonlinear program: exact derivatives, the same motion as simulate, and nothing that a problem lacks."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.boundary.find_target import find_target
from ocp.problem.scaling import Scales
from ocp.transcription.initial_guess import make_guess

PRISM = tc.shapes.prism()
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), gravity=tc.Gravity()))
LENGTHS = ocp.StringLengths({0: 0.8, 6: 1.0})


def program(shooting=ocp.MultipleShooting(4), **changes):
    problem = ocp.Problem(**{"model": MODEL, "duration": 0.4, "goals": [LENGTHS], **changes})
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    guess = make_guess(problem, target, shooting.intervals)
    return shooting.program(problem, target, scales, guess), guess, target


FULL = {"bounds": [ocp.TensionLimits(1.0, 50.0)], "costs": [ocp.Effort(2.0), ocp.Smoothness(0.1)], "duration": (0.3, 0.5)}


def test_derivatives_agree_with_differences():
    built, _, _ = program(**FULL)
    w, f, g = (built.problem[name] for name in "xfg")
    weights = ca.DM(np.random.default_rng(0).normal(size=g.shape[0]))
    lagrangian = f + ca.dot(weights, g)
    values = ca.Function("values", [w], [f, g, ca.gradient(lagrangian, w)])
    exact = ca.Function("exact", [w], [ca.jacobian(f, w), ca.jacobian(g, w), ca.hessian(lagrangian, w)[0]])
    rng = np.random.default_rng(1)
    at = built.first + 0.1 * rng.normal(size=built.first.shape)
    along = rng.normal(size=built.first.shape)
    e = 1e-5
    up, down = values(at + e * along), values(at - e * along)
    for derivative, more, less in zip(exact(at), up, down, strict=True):
        assert derivative.full() @ along == pytest.approx((more - less).full().ravel() / (2 * e), rel=1e-6, abs=1e-6)


def test_the_guess_comes_back():
    built, guess, target = program(**FULL)
    states, controls, duration = (value.full().T for value in built.unpack(built.first))
    assert states == pytest.approx(guess.states, abs=1e-12)
    assert controls == pytest.approx(guess.force_density, abs=1e-12)
    assert float(duration.squeeze()) == pytest.approx(0.4)
    assert states[0] == pytest.approx(target.start, abs=0)
    assert len(built.first) == len(built.w_names) == len(built.w_lower) == len(built.w_upper) == 4 * (9 + 36) + 1


def test_gaps_close_on_a_simulated_motion():
    """Rows of the dynamics vanish on what simulate computes with the same scheme, steps and projection."""
    shooting = ocp.MultipleShooting(4, substeps=5)
    built, _, target = program(shooting)
    controls = np.random.default_rng(2).uniform(0, 20, size=(4, 9))
    run = tc.simulate(MODEL, 0.4, 0.02, state=target.start, control=controls, correction=tc.Projection(every=5), save_every=5, compiled=False)
    unscaled = built.unpack(np.ones_like(built.first))
    scales = np.concatenate([unscaled[1].full(), unscaled[0].full()[:, 1:]]).T
    w = (np.concatenate([controls, run.states[1:]], axis=1) / scales).ravel()
    states, forces, _ = (value.full().T for value in built.unpack(w))
    assert states == pytest.approx(run.states, abs=1e-12)
    assert forces == pytest.approx(controls, rel=1e-12)
    g = ca.Function("g", [built.problem["x"]], [built.problem["g"]])(w).full().ravel()
    rows = [name.startswith("dynamics") for name in built.names]
    assert sum(rows) == 4 * 36
    assert np.abs(g[rows]).max() < 1e-10


def names(built, start):
    return [name for name in built.names if name.startswith(start)]


def test_what_a_problem_lacks_is_not_built():
    bare, _, _ = program()
    assert len(bare.names) == len(names(bare, "dynamics")) + 2
    assert "duration" not in bare.w_names
    none, _, target = program(goals=[])
    assert len(none.names) == len(names(none, "dynamics"))
    assert target.state is None
    limited, _, _ = program(bounds=[ocp.TensionLimits(upper=[np.inf] * 8 + [5.0])])
    tension = names(limited, "tension")
    assert len(tension) == 2 * 4
    assert all("string 8" in name for name in tension)
    pushing, _, _ = program(bounds=[ocp.TensionLimits(lower=0.0)])  # γ ≥ 0 says so already
    assert not names(pushing, "tension")
    timed, _, _ = program(duration=(0.3, 0.5))
    assert timed.w_names[-1] == "duration"


def test_costs_are_what_they_say():
    gamma = ca.DM(np.arange(6.0).reshape(2, 3))
    assert float(ocp.Effort(2.0).expression(gamma, 0.5)) == pytest.approx(2.0 * 0.5 * 55)
    assert float(ocp.Smoothness(2.0).expression(gamma, 0.5)) == pytest.approx(2.0 * 4 / 0.5)


def test_the_guess_keeps_bars_and_limits_and_follows_the_path():
    problem = ocp.Problem(MODEL, 0.4, goals=[LENGTHS], bounds=[ocp.ForceDensityLimits(1.0, [30.0] * 8 + [1.0])])
    target = find_target(problem, Scales.of(problem))
    guess = make_guess(problem, target, 8)
    assert max(MODEL.bar_length_error(state) for state in guess.states) < 1e-12
    assert guess.states[0] == pytest.approx(target.start)
    assert guess.states[-1] == pytest.approx(target.state)
    assert guess.force_density.min() >= 1.0
    assert guess.force_density[:, :8].max() <= 30.0
    assert np.all(guess.force_density[:, 8] == 1.0)
    assert guess.duration == 0.4


def test_the_guess_holds_a_structure_at_rest_in_equilibrium():
    """What the path leaves open is self-stress: with a lower limit the guess prestresses, and nothing accelerates."""
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
    problem = ocp.Problem(model, 1.0, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(5.0, 100.0)])
    guess = make_guess(problem, find_target(problem, Scales.of(problem)), 5)
    assert guess.states == pytest.approx(np.repeat(guess.states[:1], 6, axis=0), abs=1e-12)
    assert guess.force_density.min() >= 5.0
    for gamma in guess.force_density:
        assert model.ode(guess.states[0], gamma).full() == pytest.approx(np.zeros((model.nx, 1)), abs=0.05)
