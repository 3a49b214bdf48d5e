"""Lanes compute what C computes, number by number, NaN included; what branches on numbers takes one lane."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.ensemble.kernel import build_kernel
from tenscasadi.ensemble.stages import write_step
from tenscasadi.integrators.tableaux import CLASSICAL

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.3, -2.5, 1e-300, 1e300, np.inf, -np.inf, np.nan]
ONE = {
    "abs": ca.fabs,
    "sign": ca.sign,
    "sqrt": ca.sqrt,
    "not": ca.logic_not,
    "floor, ceil": lambda x: ca.floor(x) + 3 * ca.ceil(x),
    "exp": ca.exp,
    "log": ca.log,
    "log1p": ca.log1p,
    "sin": ca.sin,
    "tanh": ca.tanh,
    "atan": ca.atan,
    "negative": lambda x: -x,
    "inverse": lambda x: 1 / x,
}
TWO = {
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "choice": lambda x, y: ca.if_else(x > y, x, y - 1),
    "choice by a number": lambda x, y: ca.if_else(x, y, 2.0),
    "less": lambda x, y: (x < y) + 2 * (x <= y) + 4 * (x == y) + 8 * (x != y),
    "and, or": lambda x, y: ca.logic_and(x, y) + 2 * ca.logic_or(x, y),
    "pow": lambda x, y: x**y,
    "fmod": ca.fmod,
    "atan2": ca.atan2,
    "hypot": ca.hypot,
    "copysign": ca.copysign,
}


def cost_of(expression, inputs):
    """Values (n,) of an expression of two numbers, as a cost, in lanes; and how many lanes it took."""
    pins = {0: "xyz", 1: "yz"}
    model = tc.Model(tc.Scene(tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=pins), control=tc.ForceDensity()))
    kernel = build_kernel(model, tc.RungeKutta4(), final=expression)
    states = np.tile([0.5, 0.0], (len(inputs), 1))
    w = np.concatenate([np.zeros((len(inputs), 1)), inputs], axis=1)
    return kernel(states, w[:, None], 1e-3, 1).cost, kernel


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_each_number_is_as_in_c(kind):
    """Sums of weighted results, so that one compilation serves all: each operation is told apart by a third input."""
    x, w = kind.sym("x", 2), kind.sym("w", 4)  # w: the control, which, a, b
    which, a, b = w[1], w[2:3], w[3:4]
    results = [function(a) for function in ONE.values()] + [function(a, b) for function in TWO.values()]
    total = sum(ca.if_else(which == k, result, 0.0) for k, result in enumerate(results))
    function = ca.Function("told", [x, w], [total])
    pairs = np.array([(p, q) for p in SPECIAL for q in SPECIAL])
    inputs = np.concatenate([np.insert(pairs, 0, k, axis=1) for k in range(len(results))])
    found, kernel = cost_of(function, inputs)
    assert kernel.lanes > 1
    expected = np.array([float(function(np.zeros(2), np.concatenate([[0.0], row]))) for row in inputs])
    names = [*ONE, *TWO]
    for k, name in enumerate(names):
        part = inputs[:, 0] == k
        np.testing.assert_array_equal(found[part], expected[part], err_msg=name)


def test_code_that_branches_takes_one_lane():
    x, w = ca.MX.sym("x", 2), ca.MX.sym("w", 3)
    branching = ca.Function("branching", [x, w], [ca.if_else(w[1] > 0, w[2], -1.0, True)])
    found, kernel = cost_of(branching, np.array([[1.0, 5.0], [-1.0, 5.0], [2.0, 7.0]]))
    assert found.tolist() == [5.0, -1.0, 7.0]
    assert kernel.lanes == 1
    assert kernel.note.startswith("not compiled in lanes: ")


def test_tables_that_are_looked_up_take_one_lane():
    x, w = ca.MX.sym("x", 2), ca.MX.sym("w", 3)
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 3.0]], [1.0, 2.0, 0.0])
    found, kernel = cost_of(ca.Function("looked", [x, w], [table(w[2])]), np.array([[0.0, 0.5], [0.0, 2.0], [0.0, 2.5]]))
    np.testing.assert_allclose(found, [1.5, 1.0, 0.5])
    assert kernel.lanes == 1


def test_stages_of_weight_zero_are_not_computed():
    text = write_step(CLASSICAL)
    assert text.count("motion_ode(") == 4
    assert "lanes *k3 = w + 3 * NZ;" in text
