"""Goals of the orientation of bars and of triples of nodes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from moving_prism import FREE, PINNED, PRISM, problem
from scipy.spatial.transform import Rotation

import ocp
import tenscasadi as tc

TOP = (3, 4, 5)


def normal(nodes):
    """Unit normal of the plane of the top nodes."""
    first, second = nodes[4] - nodes[3], nodes[5] - nodes[3]
    cross = np.cross(first, second)
    return cross / np.linalg.norm(cross)


def test_plan_turns_a_bar():
    axis = PRISM.nodes[PRISM.bars[0, 1]] - PRISM.nodes[PRISM.bars[0, 0]]
    wanted = Rotation.from_euler("z", 6, degrees=True).apply(axis)
    plan = ocp.solve(problem([ocp.BarOrientation(0, 3 * wanted), ocp.AtRest()]))
    assert plan.success, plan.message
    a, b = plan.replay().nodes[-1][PRISM.bars[0]]
    np.testing.assert_allclose(b - a, wanted, atol=1e-4)


@pytest.mark.parametrize("model", [PINNED, FREE], ids=["pinned", "free"])
def test_plan_turns_three_nodes(model):
    turn = Rotation.from_rotvec((0.1, 0, 0))
    goals = [ocp.NodeTripleOrientation(TOP, turn.as_matrix()), ocp.AtRest()]
    plan = ocp.solve(problem(goals, model=model))
    assert plan.success, plan.message
    end = plan.replay().nodes[-1]
    edge, start = end[4] - end[3], PRISM.nodes[4] - PRISM.nodes[3]
    expected = turn.apply(start / np.linalg.norm(start))
    np.testing.assert_allclose(edge / np.linalg.norm(edge), expected, atol=1e-4)
    np.testing.assert_allclose(normal(end), turn.apply(normal(PRISM.nodes)), atol=1e-4)


def test_residuals_vanish_in_the_orientation_alone():
    turn = Rotation.from_rotvec((0.3, -0.2, 0.5))
    goal = ocp.NodeTripleOrientation(TOP, (0.3, -0.2, 0.5))
    wider = 1.2 * turn.apply(np.array(PRISM.nodes)) + (1, 2, 3)
    assert np.abs(residuals(goal, wider)).max() < 1e-12
    flipped = turn.apply(PRISM.nodes * (-1, 1, -1))
    assert np.abs(residuals(goal, flipped)).max() > 0.1
    relaxed = goal.rows(PRISM, ca.DM(np.array(wider.T)), None).quadratic
    assert np.abs(relaxed.full()).max() < 1e-12


def residuals(goal, nodes):
    """Values of a goal's rows at nodes (n, 3)."""
    return goal.rows(PRISM, ca.DM(np.array(nodes.T)), None).value.full()


@pytest.mark.parametrize(
    "goal",
    [ocp.NodeTripleOrientation(TOP, (0.2, 0.1, -0.4)), ocp.BarOrientation(1, (1, -2, 0.5))],
    ids=["triple", "bar"],
)
def test_goals_move_nodes_to_the_orientation(goal):
    moved = goal.move(PRISM, PRISM.nodes + (1, 2, 3))
    assert np.abs(residuals(goal, moved)).max() < 1e-12


def test_orientation_of_pins_is_proven_infeasible():
    with pytest.raises(ocp.InfeasibleGoalError, match="NodeTripleOrientation: y of the first edge"):
        ocp.solve(problem([ocp.NodeTripleOrientation((0, 1, 2), (0, 0, 0.3))]))


def test_problem_files_hold_the_goals(tmp_path):
    goals = [ocp.BarOrientation(1, (0, 0, 2)), ocp.NodeTripleOrientation(TOP, (0, 0, 0.1))]
    ocp.save_problem(problem(goals), tmp_path / "problem.toml")
    bar, triple = ocp.load_problem(tmp_path / "problem.toml").goals
    assert (bar.bar, bar.direction.tolist()) == (1, [0.0, 0.0, 1.0])
    assert (triple.nodes, triple.rotation.tolist()) == (TOP, [0.0, 0.0, 0.1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ocp.BarOrientation(-1, (0, 0, 1)), "BarOrientation.bar is -1"),
        (lambda: ocp.BarOrientation(0, (0, 0, 0)), "direction is zero"),
        (lambda: ocp.NodeTripleOrientation((0, 1), (0, 0, 1)), "three different nodes"),
        (lambda: ocp.NodeTripleOrientation((0, 1, 1), (0, 0, 1)), "three different nodes"),
        (lambda: ocp.NodeTripleOrientation(TOP, 2 * np.eye(3)), "orthonormal with determinant 1"),
        (lambda: problem([ocp.BarOrientation(3, (0, 0, 1))]), "bar indices run from 0 to 2"),
        (lambda: problem([ocp.NodeTripleOrientation((0, 1, 9), (0, 0, 1))]), "nodes"),
    ],
)
def test_wrong_fields_are_rejected(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_nodes_on_a_line_are_rejected():
    chain = tc.Structure([(0, 0, 0), (0, 0, 1), (0, 0, 2)], bars=[(0, 1), (1, 2)], strings=[(0, 2)])
    with pytest.raises(ValueError, match="three nodes on a line"):
        ocp.NodeTripleOrientation((0, 1, 2), (0, 0, 0.1)).check(chain)
