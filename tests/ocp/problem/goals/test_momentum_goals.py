"""Goals of the velocity of the center of mass and of the angular momentum."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from moving_prism import FREE, problem

import ocp
import tenscasadi as tc
from ocp.problem.instant import Instant
from ocp.problem.rows import goal_rows


def at_end(plan, quantity):
    """A quantity of an instant at the end of the replay."""
    now = Instant(plan.problem.model, ca.MX(plan.replay().states[-1]), ca.MX(plan.control[-1]), 0)
    return ca.evalf(getattr(now, quantity)).full().ravel()


def values(goals, model, state):
    """Residuals of goals at a state."""
    x = ca.SX.sym("x", model.nx)
    return ca.Function("rows", [x], [goal_rows(goals, model, x).value])(state).full().ravel()


def test_plan_meets_velocity_of_center_of_mass():
    plan = ocp.solve(problem([ocp.CenterOfMassVelocity((None, None, 0.2))]))
    assert plan.success, plan.message
    assert at_end(plan, "center_of_mass_velocity")[2] == pytest.approx(0.2, abs=1e-5)


def test_plan_meets_angular_momentum():
    plan = ocp.solve(problem([ocp.AngularMomentum((None, None, 0.05))]))
    assert plan.success, plan.message
    assert at_end(plan, "angular_momentum")[2] == pytest.approx(0.05, abs=1e-5)


def test_residuals_are_those_of_a_rigid_motion():
    nodes, spin, drift = FREE.structure.nodes, np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    x = FREE.state(nodes, drift + np.cross(spin, nodes - nodes.mean(axis=0)))
    now = Instant(FREE, ca.MX(x), None, None)
    momentum = ca.evalf(now.angular_momentum).full().ravel()
    goals = [ocp.CenterOfMassVelocity(tuple(drift)), ocp.AngularMomentum(tuple(momentum))]
    assert np.abs(values(goals, FREE, x)).max() < 1e-14
    faster = [ocp.CenterOfMassVelocity((None, 2.5, None))]
    assert values(faster, FREE, x) == pytest.approx([-0.5])
    rows = goal_rows(faster, FREE, ca.SX.sym("x", FREE.nx))
    assert rows.names == ("CenterOfMassVelocity: y",)


def test_angular_momentum_is_scaled_to_speeds():
    bar = tc.Structure([(0, 0, 0), (2, 0, 0)], bars=[(0, 1)], strings=[(0, 1)], bar_mass=3.0)
    model = tc.Model(tc.Scene(bar, control=tc.ForceDensity()))
    x = model.state(bar.nodes, [(0, -1, 0), (0, 1, 0)])  # turns with 1 rad/s about its center
    # its radius of gyration × 1 rad/s
    assert values([ocp.AngularMomentum((None, None, 0.0))], model, x) == pytest.approx(2 / 12**0.5)


@pytest.mark.parametrize(
    "goal", [ocp.CenterOfMassVelocity((0.1, None, None)), ocp.AngularMomentum((None, None, 0.1))]
)
def test_conserved_momentum_of_a_free_structure_is_proven(goal):
    with pytest.raises(ocp.InfeasibleGoalError, match="whatever the strings do"):
        ocp.solve(problem([goal], model=FREE))


def test_soft_goals_and_waypoints_have_them():
    goals = [
        ocp.Waypoint([ocp.CenterOfMassVelocity((None, None, 0.1))], share=0.5),
        ocp.AngularMomentum((None, None, 0.02)).soft(1e6),
    ]
    plan = ocp.solve(problem(goals))
    assert plan.success, plan.message
    assert at_end(plan, "angular_momentum")[2] == pytest.approx(0.02, abs=1e-3)
    assert plan.report().missed[0].name.startswith("AngularMomentum: z")


def test_problem_files_hold_the_goals(tmp_path):
    goals = [ocp.CenterOfMassVelocity((0.0, None, 0.5)), ocp.AngularMomentum((None, 0.1, None))]
    ocp.save_problem(problem(goals), tmp_path / "problem.toml")
    velocity, spin = ocp.load_problem(tmp_path / "problem.toml").goals
    assert velocity.velocity == (0.0, None, 0.5)
    assert spin.momentum == (None, 0.1, None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ocp.CenterOfMassVelocity((None,) * 3), "CenterOfMassVelocity.velocity"),
        (lambda: ocp.AngularMomentum((None,) * 3), "AngularMomentum.momentum"),
        (lambda: ocp.AngularMomentum((1.0, 2.0)), "AngularMomentum.momentum"),
        (lambda: ocp.CenterOfMassVelocity((np.inf, 0, 0)), "CenterOfMassVelocity.velocity"),
    ],
)
def test_wrong_fields_are_rejected(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_point_mass_has_no_angular_momentum():
    hung = [(0, 0, 0), (1, 0, 0), (0.5, 0, -1)]
    s = tc.Structure(hung, strings=[(0, 2), (1, 2)], pinned=(0, 1), node_mass=[0, 0, 1.0])
    model = tc.Model(tc.Scene(s, control=tc.ForceDensity()))
    with pytest.raises(ValueError, match="whole mass is in one point"):
        problem([ocp.AngularMomentum((0, 0, 0))], model=model)
    assert len(problem([ocp.CenterOfMassVelocity((0, 0, 0))], model=model).goals) == 1
