"""Scales: sizes of a problem, and of the objective."""

from __future__ import annotations

import numpy as np
import pytest
from planning import raising

import ocp
from ocp.problem.scaling import Scales, typical_cost


def test_scales_are_those_of_the_structure_and_the_longest_duration():
    problem = raising(duration=(0.5, 2.0))
    scales, model = Scales.of(problem), problem.model
    assert scales.length == pytest.approx(np.linalg.norm(np.ptp(model.structure.nodes, axis=0)))
    assert scales.mass == pytest.approx(3.0)
    assert scales.units == pytest.approx(
        {
            "m": scales.length,
            "m/s": scales.length / 2,
            "m/s²": scales.length / 4,
            "m²/s": scales.length**2 / 2,
            "kg m²/s": 3.0 * scales.length**2 / 2,
            "s": 2.0,
        }
    )
    assert scales.state == pytest.approx(np.repeat([scales.length, scales.length / 2], model.nq))


def test_a_typical_cost_does_not_grow_with_the_intervals():
    """Σ γ² dt of force densities that swing about 3 by √½ of that is 9 · 9 strings · (1 + ¼), and rates swing once, however fine the mesh."""
    problem = raising(costs=[ocp.Effort()])
    state = problem.initial_state
    for count in (8, 40):
        found = typical_cost(
            problem, 3.0, np.tile(state, (count + 1, 1)), np.zeros((count, 9)), 1.0
        )
        assert found == pytest.approx(9 * 9 * 1.25)
    smooth = raising(costs=[ocp.Smoothness()])
    coarse, fine = (
        typical_cost(smooth, 3.0, np.tile(state, (count + 1, 1)), np.zeros((count, 9)), 1.0)
        for count in (20, 80)
    )
    assert fine == pytest.approx(coarse, rel=0.1)
