"""Row reduction: rows that are imposed repeat no invariant, and feel what lengths do not."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven

import ocp
import tenscasadi as tc
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.targets.invariants import invariants
from ocp.targets.row_reduction import RowFunction, soft_directions

PRISM = tc.shapes.prism()


def target(model, goals, duration=1.0, **options):
    problem = ocp.Problem(model, duration, goals=goals, **options)
    return find_target(problem, Scales.of(problem))


def test_imposed_rows_are_independent_of_the_invariants():
    model = driven(PRISM)
    found = target(model, [ocp.NodePositions(PRISM.nodes), ocp.AtRest()])
    x = ca.SX.sym("x", model.nx)
    rows = [
        found.rows(x),
        *(group.value for group in invariants(model, model.initial_state, x, ca.SX(1.0))),
    ]
    J = ca.Function("J", [x], [ca.jacobian(ca.vertcat(*rows), x)])(found.state).full()
    values = np.linalg.svd(J / np.linalg.norm(J, axis=1, keepdims=True))[1]
    assert len(J) == 36
    assert values[-1] > 0.05


def test_shape_rows_feel_the_flex_that_lengths_do_not():
    model = driven(PRISM)
    x = ca.SX.sym("x", model.nx)
    nodes = model.nodes(x).T
    goal = ocp.StringLengths(PRISM.string_lengths).rows(PRISM, nodes, model.velocities(x).T).value
    bars = [
        group.value
        for group in invariants(model, model.initial_state, x, ca.SX(0.0))
        if group.kind == "bar"
    ]
    value = ca.vertcat(goal, *bars)
    rows = RowFunction(x, [value], np.ones(model.nx))
    directions, _, curvature = soft_directions(rows, model.initial_state)
    assert directions.shape == (36, 1)
    assert abs(curvature).max() > 0.1
    assert (
        np.abs(rows.select(slice(goal.shape[0]))(model.initial_state)[1] @ directions).max() < 1e-9
    )
    found = target(model, [ocp.StringLengths(PRISM.string_lengths)])
    moved = model.initial_state + 1e-3 * directions[:, 0]
    assert np.abs(goal_misfit(goal, x, moved)).max() < 1e-5
    assert np.abs(found.rows(moved).full()).max() > 1e-4
    # nobody named the distances that fix the shape
    assert found.measure(lambda share: moved).values.max() < 1e-5
    turned = model.state((PRISM.nodes - PRISM.nodes.mean(axis=0)) @ rotation(0.3))
    assert np.abs(found.rows(turned).full()).max() < 1e-12


def goal_misfit(goal, x, value):
    return ca.Function("misfit", [x], [goal])(value).full()


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def test_curvatures_are_second_derivatives():
    y = ca.SX.sym("y", 5)
    groups = [ca.vertcat(y[0] * y[1] / 2 + y[2] ** 3, 3 * y[4]), 2 * ca.sin(y[0] * y[3])]
    scale = np.array([1.0, 2.0, 0.5, 3.0, 1.0])
    rows = RowFunction(y, groups, scale)
    rng = np.random.default_rng(1)
    at, weights, basis = rng.normal(size=5), rng.normal(size=(3, 2)), rng.normal(size=(5, 4))
    found = rows.curvatures(at, weights, basis)
    for w, form in zip(weights.T, found, strict=True):
        combined = ca.dot(ca.DM(w), ca.vertcat(*groups))
        H = ca.Function("H", [y], [ca.hessian(combined, y)[0]])(at).full()
        assert form == pytest.approx(basis.T @ (H * np.outer(scale, scale)) @ basis)
    one = rows.select(slice(0, 2)).curvatures(at, weights[:2], basis)
    both = rows.curvatures(at, np.vstack([weights[:2], np.zeros((1, 2))]), basis)
    assert one == pytest.approx(both)
