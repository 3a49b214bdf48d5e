"""Limits of the velocity of the center of mass and of the angular momentum."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from moving_prism import PINNED, problem, rise

import ocp
from ocp.problem.instant import symbolic


def along(plan, quantity):
    """A quantity of an instant (T, 3) along the plan."""
    now = symbolic(PINNED)
    value = ca.Function("value", [now.state], [getattr(now, quantity)])
    return np.array([value(x).full().ravel() for x in plan.trajectory.states])


@pytest.mark.parametrize(
    ("bound", "quantity", "axis", "most"),
    [
        (
            ocp.CenterOfMassVelocityLimits(upper=(None, None, 0.04)),
            "center_of_mass_velocity",
            2,
            0.04,
        ),
        (ocp.AngularMomentumLimits(upper=(0.006, None, None)), "angular_momentum", 0, 0.006),
    ],
    ids=["velocity", "momentum"],
)
def test_plan_keeps_the_limit(bound, quantity, axis, most):
    free, limited = ocp.solve(problem(rise())), ocp.solve(problem(rise(), bound))
    assert limited.success, limited.message
    assert along(free, quantity)[:, axis].max() > 1.1 * most
    assert along(limited, quantity)[:, axis].max() <= most * (1 + 1e-6)
    assert any(f"along {'xyz'[axis]}" in one.name for one in limited.report().active)


def test_start_outside_is_rejected():
    with pytest.raises(ValueError, match="velocity of the center of mass along z at 0"):
        problem(rise(), ocp.CenterOfMassVelocityLimits(lower=(None, None, 0.1)))


def test_problem_files_hold_the_limits(tmp_path):
    bounds = [
        ocp.CenterOfMassVelocityLimits(lower=(None, -1.0, None)),
        ocp.AngularMomentumLimits((None, None, -0.1), (None, None, 0.2)),
    ]
    ocp.save_problem(problem(rise(), *bounds), tmp_path / "problem.toml")
    _, velocity, momentum = ocp.load_problem(tmp_path / "problem.toml").bounds
    assert velocity.lower == (None, -1.0, None)
    assert momentum.upper == (None, None, 0.2)


@pytest.mark.parametrize("kind", [ocp.CenterOfMassVelocityLimits, ocp.AngularMomentumLimits])
def test_wrong_fields_are_rejected(kind):
    with pytest.raises(ValueError, match="open on all sides"):
        kind()
    with pytest.raises(ValueError, match="give lower < upper"):
        kind((1, None, None), (0, None, None))
