"""Lanes compute what C computes, number by number, NaN included; so do tables; what branches on numbers otherwise takes one lane."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.simulation.engine.build import build_kernel

pytestmark = pytest.mark.usefixtures("users_compiler")

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
    model = tc.Model(
        tc.Scene(
            tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=pins),
            control=tc.ForceDensity(),
        )
    )
    kernel = build_kernel(model, tc.RungeKutta4(), final=expression)
    states = np.tile([0.5, 0.0], (len(inputs), 1))
    w = np.concatenate([np.zeros((len(inputs), 1)), inputs], axis=1)
    return kernel(states, w[:, None], 1e-3, 1).cost, kernel


@pytest.mark.parametrize("kind", [pytest.param(ca.SX, marks=pytest.mark.slow), ca.MX])
def test_each_number_is_as_in_c(kind):
    """Sums of weighted results, so that one compilation serves all: each operation is told apart by a third input."""
    x, w = kind.sym("x", 2), kind.sym("w", 4)  # w: the control, which, a, b
    which, a, b = w[1], w[2:3], w[3:4]
    results = [function(a) for function in ONE.values()] + [
        function(a, b) for function in TWO.values()
    ]
    total = sum(ca.if_else(which == k, result, 0.0) for k, result in enumerate(results))
    function = ca.Function("told", [x, w], [total])
    pairs = np.array([(p, q) for p in SPECIAL for q in SPECIAL])
    inputs = np.concatenate([np.insert(pairs, 0, k, axis=1) for k in range(len(results))])
    found, kernel = cost_of(function, inputs)
    assert kernel.lanes > 1
    expected = np.array(
        [float(function(np.zeros(2), np.concatenate([[0.0], row]))) for row in inputs]
    )
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


@pytest.mark.parametrize(
    "mode",
    ["linear", *(pytest.param(mode, marks=pytest.mark.slow) for mode in ("exact", "binary"))],
)
def test_tables_are_looked_up_in_each_lane(mode):
    x, w = ca.MX.sym("x", 2), ca.MX.sym("w", 3)
    line = ca.interpolant(
        "line", "linear", [[0.0, 1.0, 2.0]], [1.0, 2.0, 0.1], {"lookup_mode": [mode]}
    )
    plane = ca.interpolant(
        "plane",
        "linear",
        [[0.0, 0.5, 1.0], [-1.0, 1.0]],
        [1.0, 2.0, 0.3, 0.7, 4.0, -1.0],
        {"lookup_mode": [mode] * 2},
    )
    looked = ca.Function("looked", [x, w], [line(w[1]) + 3 * plane(w[1:])])
    rng = np.random.default_rng(0)
    inputs = np.vstack(
        [rng.normal(0, 2, (40, 2)), rng.integers(-1, 4, (11, 2))]
    )  # beyond the table, and on its points
    found, kernel = cost_of(looked, inputs)
    assert kernel.lanes > 1
    np.testing.assert_array_equal(found, [float(looked([0, 0], [0, *row])) for row in inputs])


def test_splines_take_one_lane():
    x, w = ca.MX.sym("x", 2), ca.MX.sym("w", 3)
    spline = ca.interpolant("spline", "bspline", [[0.0, 1.0, 2.0, 3.0]], [1.0, 2.0, 0.0, 1.0])
    inputs = np.array([[0.0, 0.5], [0.0, 2.0], [0.0, 2.5]])
    found, kernel = cost_of(ca.Function("looked", [x, w], [spline(w[2])]), inputs)
    np.testing.assert_allclose(found, [float(spline(value)) for _, value in inputs], rtol=1e-14)
    assert kernel.lanes == 1


@pytest.mark.parametrize("lanes", [pytest.param(2, marks=pytest.mark.slow), None])
def test_terrain_is_looked_up_in_each_lane(lanes):
    rng = np.random.default_rng(0)
    fields = [
        tc.Terrain(
            0.2 * rng.random(shape),
            (-0.4, -0.3),
            (0.5, 0.4),
            stiffness=300.0,
            damping=2.0,
            friction=friction,
            slip_speed=0.05,
        )
        for shape, friction in (((7, 9), 0.5), ((4, 3), None))
    ]
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=5.0), ground=fields, gravity=tc.Gravity()))
    given = np.tile(model.initial_state, (11, 1)) + rng.normal(
        0, 0.3, (11, model.nx)
    )  # some beyond the grid
    states = tc.build_projection(model).map(11)(given.T).full().T
    kernel = build_kernel(model, tc.RungeKutta4(), lanes=lanes)
    assert kernel.lanes > 1
    expected = [tc.simulate(model, 0.05, 1e-3, state=x, compiled=False).states[-1] for x in states]
    states[4] = np.nan
    found = kernel(states, np.zeros((1, 1, 0)), 1e-3, 50)
    others = np.arange(11) != 4
    np.testing.assert_array_equal(found.states[others], np.array(expected)[others])
    assert (found.status[others] == 0).all()
    assert found.status[4] != 0
