"""Inverse dynamics: what a path leaves open is self-stress."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

import ocp
import tenscasadi as tc
from ocp.guess.inverse_dynamics import _minimize_quadratics
from ocp.guess.path import make_guess
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target

PRISM = tc.shapes.prism()


def test_the_guess_holds_a_structure_at_rest_in_equilibrium():
    """What the path leaves open is self-stress: with a lower limit the guess prestresses, and nothing accelerates."""
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
    problem = ocp.Problem(
        model, 1.0, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(5.0, 100.0)]
    )
    guess = make_guess(problem, find_target(problem, Scales.of(problem)), 5)
    assert guess.states == pytest.approx(np.repeat(guess.states[:1], 6, axis=0), abs=1e-12)
    assert guess.force_density.min() >= 5.0
    for gamma in guess.force_density:
        assert model.ode(guess.states[0], gamma).full() == pytest.approx(
            np.zeros((model.nx, 1)), abs=0.05
        )


def test_bounded_minima_are_those_of_scipy():
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(8, 6, 4)), 3.0 * rng.normal(size=(8, 6))
    lower = np.column_stack([rng.uniform(-0.5, 0.0, (8, 3)), np.full(8, 0.2)])
    upper = lower + [0.5, np.inf, 1.0, 0.0]
    transposed = A.transpose(0, 2, 1)
    found = _minimize_quadratics(
        transposed @ A, (transposed @ b[:, :, None])[:, :, 0], lower, upper
    )
    for own, side, x, low, high in zip(A, b, found, lower, upper, strict=True):
        known = scipy.optimize.lsq_linear(
            own[:, :3], side - 0.2 * own[:, 3], (low[:3], high[:3]), tol=1e-14
        )
        assert x == pytest.approx(np.append(known.x, 0.2), abs=1e-6)
