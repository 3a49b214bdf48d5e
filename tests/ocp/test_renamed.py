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
        ("Collocation", "DirectCollocation"),
        ("replay_wound", "replay_rest_lengths"),
        ("reachable", "is_realizable"),
        ("load_arguments", "load_solve_arguments"),
    ],
)
def test_old_name_warns_and_works(old, new):
    with pytest.warns(DeprecationWarning, match=rf"use ocp\.{new}"):
        assert getattr(ocp, old) is getattr(ocp, new)


@pytest.mark.parametrize(
    ("make", "old", "new", "value"),
    [
        (ocp.Ipopt, "seconds", "time_limit", 2.0),
        (ocp.Ipopt, "watch", "callback", print),
        (ocp.Ipopt, "warm", "warm_start", True),
        (ocp.Ipopt, "restart", "restart_at_saddle", False),
        (ocp.Sampling, "watch", "callback", print),
        (ocp.PiecewiseConstant, "changes", "max_changes", 3),
        (lambda **given: ocp.SplineNoise(1.0, **given), "finest", "min_scale", 0.1),
    ],
)
def test_old_option_warns_and_works(make, old, new, value):
    with pytest.warns(DeprecationWarning, match=rf"\({old}=\) is deprecated: use {new}="):
        options = make(**{old: value})
    assert getattr(options, new) == value
    with pytest.warns(DeprecationWarning, match=f"use {new}"):
        assert getattr(options, old) == value


def test_unknown_name_raises():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        ocp.Nothing  # noqa: B018
