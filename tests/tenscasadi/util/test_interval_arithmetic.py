"""Interval arithmetic: bounds hold at every point of an interval, and are as wide as the function for narrow ones."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tenscasadi.util.interval_arithmetic import UnknownOperation, bound

T = ca.SX.sym("t")
LEAVES = st.one_of(st.just(T), st.floats(-3, 3).map(ca.SX))
ONE: list[Any] = [
    ca.sin,
    ca.cos,
    ca.tan,
    ca.exp,
    ca.tanh,
    ca.sinh,
    ca.cosh,
    ca.atan,
    ca.fabs,
    ca.floor,
    ca.ceil,
    ca.sign,
    ca.asinh,
    ca.erf,
    ca.expm1,
]
ONE += [lambda x, f=f: f(ca.fabs(x)) for f in (ca.sqrt, ca.log, ca.log1p)]
ONE += [lambda x, f=f: f(ca.tanh(x)) for f in (ca.asin, ca.acos)]
ONE += [
    ca.sqrt,
    ca.log,
    ca.log1p,
    ca.asin,
    ca.acos,
    ca.atanh,
    ca.acosh,
    lambda x: x**1.5,
]  # which may be not defined
ONE += [
    lambda x: x**2,
    lambda x: x**3,
    lambda x: x**-2,
    lambda x: x**-1,
    lambda x: -x,
    ca.logic_not,
]
TWO: list[Any] = [
    lambda x, y: x + y,
    lambda x, y: x - y,
    lambda x, y: x * y,
    lambda x, y: x / (0.1 + ca.fabs(y)),
    ca.fmin,
    ca.fmax,
    ca.atan2,
    ca.hypot,
    lambda x, y: ca.fmod(x, 0.1 + ca.fabs(y)),
]
TWO += [
    lambda x, y: x < y,
    lambda x, y: x <= y,
    lambda x, y: ca.if_else(x > y, x, y),
    lambda x, y: ca.logic_and(x, y),
    lambda x, y: ca.fabs(x) ** y,
]
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(ONE), inner).map(lambda pair: pair[0](pair[1])),
        st.tuples(st.sampled_from(TWO), inner, inner).map(lambda pair: pair[0](pair[1], pair[2])),
    ),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(tree=TREES, low=st.floats(-4, 4), width=st.sampled_from([1e-3, 0.1, 1.0, 3.0]))
def test_bounds_hold(tree: ca.SX, low: float, width: float) -> None:
    function = ca.Function("f", [T], [ca.densify(tree)])
    points = np.linspace(low, low + width, 101)
    values = np.array([float(function(point)) for point in points])
    found = bound(function, np.array([low]), np.array([low + width]))
    known = values[np.isfinite(values)]
    slack = 1e-9 * np.maximum(1, abs(known))
    assert np.all(known >= found.low[0, 0] - slack)
    assert np.all(known <= found.high[0, 0] + slack)


@pytest.mark.parametrize(
    "hidden", [ca.sqrt(T - 0.5), ca.log(T - 0.5), ca.asin(2.5 - 3 * T), (T - 0.5) ** 1.5]
)
def test_what_is_not_defined_may_hide_behind_a_choice(hidden: ca.SX) -> None:
    """The lesser and the greater of two pass over what is not defined: the other is then a bound, and where that begins, something switches."""
    function = ca.Function("f", [T], [ca.fmax(hidden, -7.0)])
    found = bound(function, np.array([0.0, 0.4, 0.6]), np.array([0.3, 0.7, 0.8]))
    assert found.low[0, 0] == found.high[0, 0] == -7.0
    assert found.low[0, 1] == -7.0
    assert found.low[0, 2] > -7.0
    assert found.switches.tolist() == [False, True, False]


def test_narrow_intervals_have_narrow_bounds() -> None:
    function = ca.Function(
        "f",
        [T],
        [ca.vertcat(ca.sin(3 * T) * ca.exp(-(T**2)) / (1 + T**4), ca.sqrt(1 + T) + ca.atan2(T, 2))],
    )
    low = np.linspace(0, 2, 20001)[:-1]
    found = bound(function, low, low + 1e-4)
    assert (found.high - found.low).max() < 2e-3
    assert not found.switches.any()


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda t: t > 0.35, 0.35),
        (lambda t: ca.fmax(t, 0.35), 0.35),
        (lambda t: ca.fabs(t - 0.35), 0.35),
        (lambda t: ca.sign(t - 0.35), 0.35),
        (lambda t: ca.floor(2 * t + 0.3), 0.35),
        (lambda t: ca.fmod(t, 0.35), 0.35),
        (lambda t: ca.sin(1000 * t) > 0.999999, np.arcsin(0.999999) / 1000),
    ],
)
def test_switches_are_told_where_they_are(make: Any, place: float) -> None:
    edges = np.array([0.0, place - 1e-3, place - 1e-9, place + 1e-9, place + 1e-3])
    found = bound(ca.Function("f", [T], [make(T)]), edges[:-1], edges[1:])
    assert found.switches[2]
    if place == 0.35:
        assert found.switches.tolist() == [False, False, True, False]


def test_what_has_no_bounds_is_told() -> None:
    t = ca.MX.sym("t")
    with pytest.raises(UnknownOperation, match="no expression of scalar operations"):
        bound(ca.Function("f", [t], [ca.sin(t)]), np.zeros(1), np.ones(1))
