"""Names of earlier versions."""

from __future__ import annotations

import pytest

import ocp


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("UnreachableGoal", "InfeasibleGoalError"),
        ("Arrays", "TrajectoryGuess"),
        ("Equilibrium", "EquilibriumGuess"),
        ("CentreOfMass", "CenterOfMass"),
        ("replay_wound", "replay_rest_lengths"),
        ("reachable", "is_realizable"),
    ],
)
def test_old_name_warns_and_works(old, new):
    with pytest.warns(DeprecationWarning, match=rf"use ocp\.{new}"):
        assert getattr(ocp, old) is getattr(ocp, new)


def test_unknown_name_raises():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        ocp.Nothing  # noqa: B018
