"""Checks of user-defined functions of time, and their CasADi expressions."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, probe_times
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array, call_user_function, format_value

_CASADI = (ca.SX, ca.MX, ca.DM)
_HINT = "give a function of time [s] that returns finite values over the whole run"
# errors of functions that cannot evaluate numbers
_UNSUITABLE = (TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError)
CURE = "write it with NumPy's or CasADi's mathematics, without math, float() and if"


def express(field: str, function: Callable[[Any], Any], time: Any) -> Any:
    """Evaluate a user's function of time at a CasADi symbol.

    The function can return a matrix, a vector or a sequence of rows. Raises ValueError naming
    `field`.
    """
    with warnings.catch_warnings():
        # CasADi warns of NumPy functions of its symbols
        warnings.simplefilter("ignore", FutureWarning)
        try:
            found = function(time)
        except Exception as error:  # user code can raise anything
            fault = re.sub(r"\S+:\d+: ", "", str(error))  # without CasADi's own file and line
            raise add_address(
                ValueError(
                    f"{field} raised {type(error).__name__}({fault}) on a CasADi time: {CURE}"
                )
            ) from error
        try:
            if isinstance(found, _CASADI):
                return found
            if isinstance(found, Iterable):
                return ca.vertcat(*map(_convert_row, found))
            return ca.DM(found)
        except Exception as error:  # CasADi's message lists all types that it accepts
            raise add_address(
                ValueError(
                    f"{field} returns {format_value(found)} on a CasADi time: "
                    f"give numbers and expressions of it; {CURE}"
                )
            ) from error


def _convert_row(entries: Any) -> Any:
    if isinstance(entries, _CASADI):
        return ca.vec(entries).T
    return ca.horzcat(*entries) if isinstance(entries, Iterable) else entries


def as_numbers(value: Any) -> Any:
    """Convert CasADi numbers in a value to Python floats and arrays.

    The value is a number, a vector, or a list of them; others are unchanged.
    """
    if isinstance(value, ca.DM):
        return float(value) if value.is_scalar() else value
    if isinstance(value, (list, tuple)):
        parts = [as_numbers(part) for part in value]
        return [
            part.full().ravel() if isinstance(part, ca.DM) and part.is_vector() else part
            for part in parts
        ]
    return value


def check_over_run(
    field: str, function: Callable[[Any], Any], traced: ca.Function, first: float, last: float
) -> list[float]:
    """Check the values of a function of time, and its tracing.

    The run is from `first` to `last` [s]. `traced` is the CasADi Function of the Python function.
    `math` and `float` convert a CasADi time to a constant. A comparison of numbers and symbols
    finds that. Returns the largest absolute value of each output of `traced`.

    Raises
    ------
    ValueError
        If values are not finite, or the traced ones differ. The message names `field` and the time.
    """
    times = probe_times(first, last)
    breaks = find_breakpoints(traced, first, last)
    some = np.unique(
        np.concatenate([times, breaks, np.nextafter(breaks, first), np.nextafter(breaks, last)])
    )
    kinds, sizes = ("", ": its velocity", ": its acceleration"), []
    for values, kind in zip(outputs_at(traced, some), kinds, strict=False):
        sizes.append(float(abs(values).max(initial=0.0)))
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            raise add_address(
                ValueError(
                    f"{field}{kind} is not finite at t = {some[bad.argmax()]:g} s: "
                    f"give finite values over the whole run; {CURE}"
                )
            )
    for k, time in enumerate(times[::1000].tolist()):
        try:
            given = call_user_function(f"{field}({time:g})", function, time, _HINT)
            number = np.asarray(as_numbers(given), dtype=float).ravel()
        except (TypeError, ValueError) as error:
            if k == 0 and isinstance(error.__cause__ or error, _UNSUITABLE):
                break  # a function for CasADi symbols only
            raise add_address(error) from None
        value = traced.call([time])[0].full().T.ravel()
        if not is_same(number, value):
            raise add_address(
                ValueError(
                    f"{field} is {format_row(number)} for the number t = {time:g} and "
                    f"{format_row(value)} for a CasADi time: give the same at each call; {CURE}"
                )
            )
    return sizes


def format_row(values: Array) -> str:
    """Format an array of values in one line."""
    return " ".join(str(values).split())


def is_same(number: Array, value: Array) -> bool:
    """Return whether two arrays agree up to rounding.

    `number` is the reference value, and `value` the other one.
    """
    return number.shape == value.shape and np.allclose(
        number, value, rtol=1e-6, atol=1e-9 * max(1.0, abs(number).max(initial=0.0))
    )


def values_at(traced: ca.Function, times: Array) -> Array:
    """Evaluate the first output of a CasADi Function at times.

    `traced` is a Function of the time, and `times` are (K,) [s]. The result is (K, entries).
    """
    return outputs_at(traced, times)[0]


def outputs_at(traced: ca.Function, times: Array) -> list[Array]:
    """Evaluate all outputs of a CasADi Function at times.

    `traced` is a Function of the time, and `times` are (K,) [s]. Each result is (K, entries).
    """
    if not len(times):
        return [np.empty((0, traced.numel_out(k))) for k in range(traced.n_out())]
    every = [values.full() for values in traced.call([times[None]])]
    return [
        values.reshape(len(values), len(times), -1).transpose(1, 0, 2).reshape(len(times), -1)
        for values in every
    ]


def trace(function: Any) -> ca.Function:
    """Convert a Python function of time to a CasADi Function.

    The function is evaluated at a CasADi symbol. The result is t (s) → value.
    """
    t = ca.MX.sym("t")
    return ca.Function("traced", [t], [ca.densify(ca.MX(function(t)))])


def interpolate(time: Any, times: Array, table: Array, rows: int) -> Any:
    """Interpolate linearly in a table (K, m) at a time.

    The rows belong to `times` (K,). The result is constant outside the times. The m entries fill a
    matrix with `rows` rows column by column. Zeros in the table need no instructions. Each value is
    a sum of the two entries around a time. CasADi's `pw_lin` would cancel long pieces instead, and
    lose the digits beside a steep pulse.
    """
    t = ca.SX.sym("t")
    reached = [t >= float(at) for at in times]
    weights = [ca.SX(1 - reached[0]), *[ca.SX(0)] * (len(times) - 2), reached[-1]]
    for k, (first, last) in enumerate(pairwise(times)):
        within, part = reached[k] - reached[k + 1], (t - float(first)) / float(last - first)
        weights[k] += within * (1 - part)
        weights[k + 1] += within * part
    entries = [
        sum((float(value) * weights[k] for k, value in enumerate(column) if value), ca.SX(0))
        for column in table.T
    ]
    columns = [ca.vertcat(*entries[k : k + rows]) for k in range(0, len(entries), rows)]
    return ca.Function("table", [t], [ca.densify(ca.SX(ca.horzcat(*columns)))])(time)
