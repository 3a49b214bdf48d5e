"""Limits of node accelerations."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from moving_prism import PINNED, problem, rise

import ocp
from ocp.problem.instant import symbolic

MOST = 1.6  # m/s²


def largest(plan):
    """Largest acceleration of node 3 at both ends of the plan's intervals."""
    now = symbolic(PINNED)
    value = ca.Function("value", [now.state, now.control], [ca.norm_2(now.accelerations[:, 3])])
    states, control = plan.trajectory.states, plan.control
    ends = [(states[:-1], control), (states[1:], control)]
    return max(float(value(x, u)) for side in ends for x, u in zip(*side, strict=True))


def test_plan_keeps_the_limit():
    bound = ocp.NodeAccelerationLimits(MOST, nodes=[3])
    free, limited = ocp.solve(problem(rise())), ocp.solve(problem(rise(), bound))
    assert limited.success, limited.message
    assert largest(free) > 1.1 * MOST
    assert largest(limited) <= MOST * (1 + 1e-6)
    assert "acceleration of node 3" in [one.name for one in limited.report().active]


def test_limited_value_is_the_acceleration():
    now = symbolic(PINNED)
    limit = ocp.NodeAccelerationLimits(MOST).limit(now)
    assert limit.names == tuple(f"acceleration of node {node}" for node in (3, 4, 5))
    values = [limit.value, ca.jacobian(limit.value, now.control), now.accelerations]
    function = ca.Function("value", [now.state, now.control], values)
    value, _, own = function(PINNED.initial_state, np.linspace(1, 9, 9))
    np.testing.assert_allclose(
        value.full().ravel(), np.linalg.norm(own.full(), axis=0)[3:], rtol=1e-4
    )
    _, slope, own = function(PINNED.initial_state, 0)  # at rest without forces
    assert np.isfinite(slope.full()).all()
    assert np.abs(own.full()).max() < 1e-12


def test_problem_files_hold_the_limit(tmp_path):
    bound = ocp.NodeAccelerationLimits(30.0, nodes=[4, 5])
    ocp.save_problem(problem(rise(), bound), tmp_path / "problem.toml")
    again = ocp.load_problem(tmp_path / "problem.toml").bounds[1]
    assert (again.magnitude, tuple(again.nodes)) == (30.0, (4, 5))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ocp.NodeAccelerationLimits(0.0), "NodeAccelerationLimits.magnitude"),
        (lambda: problem(rise(), ocp.NodeAccelerationLimits(1.0, [0])), "node 0, which is pinned"),
        (lambda: problem(rise(), ocp.NodeAccelerationLimits(1.0, [9])), "nodes"),
        (lambda: problem(rise(), ocp.NodeAccelerationLimits(1.0, [])), "nodes is empty"),
    ],
)
def test_wrong_fields_are_rejected(make, message):
    with pytest.raises(ValueError, match=message):
        make()
