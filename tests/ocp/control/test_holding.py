"""What holds a structure after its motion: force densities of find_equilibrium, and the stationary regulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from controlling import MODEL
from planning import driven, leaning_arm

import ocp
import tenscasadi as tc
from ocp.control.holding import compute_stationary_cost, find_equilibrium, find_rest

LEAN = 0.5  # rad
MASS = 2.0


def leaning_bar(**options):
    nodes = [(0, 0, 0), (np.sin(LEAN), 0, np.cos(LEAN)), (-1, 0, 0), (1, 0, 0)]
    structure = tc.Structure(
        nodes,
        bars=[(0, 1)],
        strings=[(1, 2), (1, 3)],
        bar_mass=MASS,
        pinned={0: "xyz", 1: "y", 2: "xyz", 3: "xyz"},
    )
    return driven(structure, gravity=tc.Gravity(), **options)


def test_a_leaning_bar_is_held_against_its_weight():
    """Moments about its foot: m g sin(θ)/2 = γ cos(θ), and the string on the other side pulls no more than it has to."""
    model = leaning_bar()
    found = find_equilibrium(
        model, model.initial_state, np.array([0.0, 3.0]), np.array([100.0, 100.0])
    )
    assert found.exact
    assert found.force_density == pytest.approx(
        [MASS * 9.81 * np.tan(LEAN) / 2 + 3.0, 3.0], rel=1e-6
    )


def test_what_no_limits_allow_is_said():
    model = leaning_bar()
    rest = find_rest(model, model.initial_state, np.zeros(2), np.full(2, 1.0), 1e-3)
    assert rest.state is None
    assert "no force densities within the limits balance it" in rest.message
    assert "accelerates by" in rest.message
    moving = model.state(
        model.structure.nodes,
        np.array([(0, 0, 0), (np.cos(LEAN), 0, -np.sin(LEAN)), (0, 0, 0), (0, 0, 0)]),
    )
    assert (
        "the end is not held: it moves at"
        in find_rest(model, moving, np.zeros(2), np.full(2, 100.0), 1e-3).message
    )


def test_limits_that_exclude_each_other_are_named():
    model = leaning_bar()
    low, high = np.array([2.0, 0.0]), np.array([1.0, 9.0])
    found = find_rest(model, model.initial_state, low, high, 1.0)
    assert found.state is None
    assert "by string 0: its limits require at least 2 and at most 1" in found.message


def test_the_cost_of_holding_is_that_of_the_algebraic_equation():
    a, b = np.array([[1.0, 0.1], [0.3, 1.0]]), np.array([[0.005], [0.1]])
    Q, R = np.diag([1.0, 0.1]), np.array([[0.5]])
    np.testing.assert_allclose(
        compute_stationary_cost(a, b, Q, R), scipy.linalg.solve_discrete_are(a, b, Q, R), rtol=1e-8
    )


def test_what_nothing_steadies_does_not_spoil_the_rest():
    """A mode that grows and that no control moves, beside one that is controlled."""
    a, b = np.diag([1.0, 3.0]), np.array([[1.0], [0.0]])
    P = compute_stationary_cost(a, b, np.eye(2), np.eye(1))
    assert P[0, 0] == pytest.approx((1 + np.sqrt(5)) / 2)  # P = 1 + P / (1 + P)
    assert P[0, 1] == 0.0


@pytest.fixture(scope="module")
def arm():
    """Three hinged bars on top of each other, at first straight: unstable."""
    found = ocp.solve(leaning_arm(3, 0.8), ocp.Variational(20, accuracy=1e-6))
    assert found.success, found.message
    return found


def test_an_unstable_arm_is_held_at_its_goal(arm):
    tracker = ocp.track(arm)
    assert "held by force densities up to" in tracker.message
    held = ocp.run(tracker, 2.5).trajectory.nodes
    assert held[-1, 3, :2] == pytest.approx([0.8, 0.1], abs=1e-4)
    assert abs(held[-1] - arm.trajectory.nodes[-1]).max() < 1e-3
    many = tc.rollouts(arm.model, 2.5, 0.005, arm.trajectory.states[0], tracker.feedback).final[0]
    assert arm.model.nodes(many)[3, :2] == pytest.approx([0.8, 0.1], abs=1e-3)


def test_a_push_after_the_end_is_taken(arm):
    pushed = np.zeros(arm.model.nx)
    pushed[arm.model.nq : 2 * arm.model.nq] = 0.02

    def push(now, state):
        return state + pushed if abs(now - 1.5) < 0.02 else state

    held = ocp.run(ocp.track(arm), 7.0, disturbance=push).trajectory
    assert abs(held.nodes[-1] - arm.trajectory.nodes[-1]).max() < 1e-3


def test_a_predicting_controller_holds_the_end_of_a_plan(arm):
    controller = ocp.Mpc(arm.problem, 0.05, 10, plan=arm, substeps=2)
    held = ocp.run(controller, 3.0).trajectory.nodes[-1]
    assert abs(held - arm.trajectory.nodes[-1]).max() < 1e-4


def test_the_goal_of_a_predicting_controller_is_held_where_equilibrium_is_possible():
    asked = leaning_arm(1, 0.4, weight=True)
    held = ocp.run(ocp.Mpc(asked, 0.05, 10), 3.0).trajectory.nodes[-1]
    assert held[1, :2] == pytest.approx([0.4, 0.1], abs=1e-4)


def test_an_end_in_motion_is_kept_to_as_before(plan):
    motion = replace(
        plan.trajectory,
        states=plan.trajectory.states + np.repeat([[0.0, 0.1]], [MODEL.nq, MODEL.nq], axis=1),
    )
    tracker = ocp.track(replace(plan, trajectory=motion))
    assert tracker.hold is None
    assert "it moves at" in tracker.message
    assert len(tracker.feedback.controls) == len(tracker.inputs)
