"""Plans carried out by winding elastic strings."""

from __future__ import annotations

import numpy as np
import pytest
from planning import taller

import ocp


def test_wound_strings_do_what_force_densities_do():
    fine = ocp.solve(taller(), ocp.MultipleShooting(20))
    errors = []
    for updates in (5, 20):
        wound = ocp.replay_rest_lengths(fine, 500.0, damping=1.0, updates=updates)
        assert wound.success
        errors.append(np.abs(wound.nodes[-1] - fine.trajectory.nodes[-1]).max())
    assert errors[1] < 1e-3
    assert ocp.is_realizable(fine).all()
    soft = ocp.is_realizable(fine, 8.0)
    assert soft.any()
    assert not soft.all()
    assert not ocp.is_realizable(fine, 500.0, min_rest_length=1.05).all()
    with pytest.raises(ValueError, match="stiffness of string"):
        ocp.replay_rest_lengths(fine, 8.0)
    with pytest.raises(ValueError, match="stiffness of string 0 is -5: it must be at least 0"):
        ocp.is_realizable(fine, -5.0)
    with pytest.raises(
        ValueError, match="min_rest_length of string 0 is -1: it must be at least 0"
    ):
        ocp.is_realizable(fine, 500.0, -1.0)


def test_strings_are_wound_in_time_on_unequal_intervals():
    fine = ocp.solve(taller(), ocp.MultipleShooting((1.0,) * 10 + (1.4,) * 8))
    wound = ocp.replay_rest_lengths(fine, 500.0, damping=1.0, updates=1)
    assert np.abs(wound.nodes[-1] - fine.trajectory.nodes[-1]).max() < 3e-4
