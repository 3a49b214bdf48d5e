"""Functions of time that users write: their expressions, and the checks of these."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, probe_times
from tenscasadi.schema.field_types import POINTS, TIMES
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, finite_array, format_value

_CASADI = (ca.SX, ca.MX, ca.DM)
CURE = "write it with NumPy's or CasADi's mathematics, without math, float() and if"


def express(field: str, function: Callable[[Any], Any], time: Any) -> Any:
    """Return what a user's function makes of a CasADi time: a matrix, a vector or the rows of one. Raises ValueError naming `field`."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", FutureWarning
        )  # CasADi's, about NumPy functions of its symbols
        try:
            found = function(time)
        except Exception as error:  # whatever the caller's function raises
            fault = re.sub(
                r"\S+:\d+: ", "", str(error)
            )  # CasADi begins with its own files and lines
            raise ValueError(
                f"{field} raised {type(error).__name__}({fault}) on a CasADi time: {CURE}"
            ) from error
        try:
            if isinstance(found, _CASADI):
                return found
            return ca.vertcat(*map(_row, found)) if isinstance(found, Iterable) else ca.DM(found)
        except Exception as error:  # CasADi's own words list all that it could take
            raise ValueError(
                f"{field} returns {format_value(found)} on a CasADi time: give numbers and expressions of it; {CURE}"
            ) from error


def _row(entries: Any) -> Any:
    if isinstance(entries, _CASADI):
        return ca.vec(entries).T
    return ca.horzcat(*entries) if isinstance(entries, Iterable) else entries


def as_numbers(value: Any) -> Any:
    """Return what a user's function returned for a number, CasADi's numbers and vectors in it as Python's and NumPy's."""
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
) -> None:
    """Check that a function of time is finite in a run, and the same for numbers as for symbols.

    `math` and `float` make a constant of a CasADi time: the comparison shows it.

    Raises
    ------
    ValueError
        It is not; the message names `field` and the time.
    """
    times = probe_times(first, last)
    breaks = find_breakpoints(traced, first, last)
    some = np.unique(
        np.concatenate([times, breaks, np.nextafter(breaks, first), np.nextafter(breaks, last)])
    )
    kinds = ("", ": its velocity", ": its acceleration")
    for k, kind in zip(range(traced.n_out()), kinds, strict=False):
        bad = ~np.isfinite(values_at(traced, some, k)).all(axis=1)
        if bad.any():
            raise ValueError(
                f"{field}{kind} is not finite at t = {some[bad.argmax()]:g} s: give finite values over the whole run; {CURE}"
            )
    for time in times[::1000].tolist():
        try:
            number = np.asarray(as_numbers(function(time)), dtype=float).ravel()
        except (
            TypeError,
            ValueError,
            AttributeError,
            ArithmeticError,
            RuntimeError,
        ):  # a function of CasADi's symbols alone
            return
        value = traced.call([time])[0].full().T.ravel()
        if not is_same(number, value):
            raise ValueError(
                f"{field} is {number} for the number t = {time:g} and {value} for a CasADi time: give the same at each call; {CURE}"
            )


def is_same(number: Array, value: Array) -> bool:
    """Return whether two values of a function agree but for rounding."""
    return number.shape != value.shape or np.allclose(
        number, value, rtol=1e-6, atol=1e-9 * max(1.0, abs(number).max(initial=0.0))
    )


def values_at(traced: ca.Function, times: Array, output: int = 0) -> Array:
    """Evaluate an output of a function of time at times (K,): (K, entries)."""
    if not len(times):
        return np.empty((0, traced.numel_out(output)))
    values = traced.call([times[None]])[output].full()
    return np.asarray(
        values.reshape(len(values), len(times), -1).transpose(1, 0, 2).reshape(len(times), -1)
    )


def trace(function: Any) -> ca.Function:
    """Return the Function t -> what `function` makes of a CasADi time."""
    t = ca.MX.sym("t")
    return ca.Function("traced", [t], [ca.densify(ca.MX(function(t)))])


def interpolate(time: Any, times: Array, table: Array, rows: int) -> Any:
    """Piecewise linear values (rows × m/rows, column by column) from a table (K, m), held constant outside its times: zeros cost nothing.

    Only the two entries around a time have a share in the sum: pieces of CasADi's `pw_lin` go on
    beyond their ends and cancel there, which leaves nothing of a steep pulse's neighbours but
    rounding.
    """
    t = ca.SX.sym("t")
    begun = [t >= float(at) for at in times]
    shares = [ca.SX(1 - begun[0]), *[ca.SX(0)] * (len(times) - 2), begun[-1]]
    for k, (first, last) in enumerate(pairwise(times)):
        within, part = begun[k] - begun[k + 1], (t - float(first)) / float(last - first)
        shares[k] += within * (1 - part)
        shares[k + 1] += within * part
    entries = [
        sum(
            (float(value) * share for value, share in zip(column, shares, strict=True) if value),
            ca.SX(0),
        )
        for column in table.T
    ]
    columns = [ca.vertcat(*entries[k : k + rows]) for k in range(0, len(entries), rows)]
    return ca.Function("table", [t], [ca.densify(ca.SX(ca.horzcat(*columns)))])(time)


@dataclass(frozen=True, eq=False)
class Samples(Value, kind="Samples"):
    """Function of time that is known at some times.

    It is linear between them and constant before and after. Saved results hold such functions in
    place of those of Python. Nodes cannot follow the jumps of its velocity in a simulation.

    Parameters
    ----------
    times : ndarray, shape (K,)
        Times [s].
    values : ndarray, shape (K, 3)
        Values at these times.
    """

    times: Annotated[Array, TIMES]
    values: Annotated[Array, POINTS]

    def __post_init__(self) -> None:
        times = finite_array("Samples.times", self.times, (None,))
        object.__setattr__(self, "times", times)
        values = finite_array("Samples.values", self.values, (len(times), 3))
        object.__setattr__(self, "values", values)

    def __call__(self, time: Any) -> Any:
        """Interpolate at a time, a number or a CasADi symbol."""
        if isinstance(time, (ca.SX, ca.MX, ca.DM)) and len(self.times) > 1:
            return interpolate(time, self.times, self.values, 3)
        number = 0.0 if isinstance(time, (ca.SX, ca.MX)) else float(time)
        return [float(np.interp(number, self.times, column)) for column in self.values.T]
