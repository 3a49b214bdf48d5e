"""Multiple shooting: the same motion as simulate."""

from __future__ import annotations

import numpy as np
import pytest
from planning import raising

import ocp
import tenscasadi as tc


@pytest.mark.parametrize(
    ("scheme", "control"),
    [
        (tc.RungeKutta4(), ocp.PiecewiseConstant()),
        (tc.DormandPrince54(), ocp.PiecewiseConstant()),
        (tc.Collocation(2), ocp.PiecewiseConstant()),
        (tc.RungeKutta4(), ocp.PiecewiseLinear()),
    ],
)
def test_plan_is_the_motion_of_the_scheme(scheme, control):
    """A simulation by the same scheme, steps and projection agrees with the plan."""
    shooting = ocp.MultipleShooting(6, scheme, substeps=2, control=control)
    plan = ocp.solve(raising(), shooting, ocp.Ipopt(tolerance=1e-10), tolerance=0.1)
    assert plan.success, plan.message
    if control.linear:  # which simulations hold in each step
        finer = ocp.MultipleShooting(6, scheme, substeps=4, control=control)
        other = ocp.solve(raising(), finer, ocp.Ipopt(tolerance=1e-10), tolerance=0.1)
        assert other.trajectory.states == pytest.approx(plan.trajectory.states, abs=1e-3)
        return
    run = tc.simulate(
        plan.model,
        1.0,
        1 / 12,
        scheme,
        state=plan.trajectory.states[0],
        control=plan.force_density,
        correction=tc.Projection(every=2),
        save_every=2,
        compiled=False,
    )
    # projections at one or the other end of a drift differ by its square
    assert np.abs(run.states - plan.trajectory.states).max() < 1e-6


class Midpoint(tc.RungeKutta4):
    """The explicit midpoint rule."""

    coefficients = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([0.0, 1.0])


def test_schemes_of_ones_own_give_their_coefficients():
    plan = ocp.solve(raising(), ocp.MultipleShooting(10, Midpoint()), tolerance=0.1)
    assert plan.success, plan.message
    dynamics = [name for name in plan.duals.names if "acceleration, interval 9, stage" in name]
    assert len(dynamics) == 2 * plan.model.nq


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"scheme": tc.Rattle()}, ValueError, r"MultipleShooting\.scheme is Rattle"),
        ({"scheme": tc.RungeKutta4}, TypeError, r"MultipleShooting\.scheme"),
        ({"substeps": 0}, ValueError, r"MultipleShooting\.substeps is 0"),
    ],
)
def test_wrong_values_are_rejected(changes, error, words):
    with pytest.raises(error, match=words):
        ocp.MultipleShooting(4, **changes)
