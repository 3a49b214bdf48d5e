"""Inverse dynamics: what a path leaves open is self-stress."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
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
