"""Functions of time that users write: their expressions, whether these are finite, and where they jump or have a kink."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.interval_arithmetic import UnknownOperation, bound
from tenscasadi.util.validate import Array, shown

_CASADI = (ca.SX, ca.MX, ca.DM)
_PROBES = 4000  # parts of a run at whose ends functions are looked at
_COMPARED_TIMES = 4  # times of a run at which functions are called with numbers, too
_ENTRIES = 2_000_000  # values looked at, at most
CURE = "write it with NumPy's or CasADi's mathematics, without math, float() and if"
_STEEP = 10.0  # times the median of a run: values above are looked at more closely
_FINEST = 100  # roundings of the time: no closer
_LAST, _GROWS = (
    4,
    10.0,
)  # what grows as much in so many looks, each on a tenth of the last, has no end
_FAR_LONGER = 100.0  # than the next piece of a table
_ROUNDINGS = (
    4.0  # of the clock in a step: jumps are stepped over from as many before to as many after
)
_REFINEMENTS = 40  # halvings of a part of a run in which a condition may hold for a short time
_BISECTIONS = 60  # from a part of a run to the last digit
_COMPARED = (
    ca.OP_LT,
    ca.OP_LE,
    ca.OP_EQ,
    ca.OP_NE,
    ca.OP_FMIN,
    ca.OP_FMAX,
)  # they switch where both operands are equal
_SIGNED = (ca.OP_SIGN, ca.OP_FABS)  # they switch where their operand is 0
_ROUNDED = (ca.OP_FLOOR, ca.OP_CEIL)  # they switch where their operand is whole
_POSITIVE = (
    ca.OP_SQRT,
    ca.OP_LOG,
    ca.OP_POW,
    ca.OP_CONSTPOW,
)  # not defined below 0, but for whole exponents
_WITHIN_ONE = (ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATANH)
_REMAINDERS = {
    ca.OP_FMOD: ca.sin,
    ca.OP_REMAINDER: ca.cos,
}  # they switch where the quotient of their operands is whole, or half of odd


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
                f"{field} returns {shown(found)} on a CasADi time: give numbers and expressions of it; {CURE}"
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


def probe_times(first: float, last: float) -> Array:
    """Return times, s, evenly over a run."""
    return np.linspace(first, last, _PROBES + 1)


def find_breaks(function: ca.Function, first: float, last: float) -> Array:
    """Return the times in [first, last], s, where conditions, signs and roundings in a function of time switch, but for those in calls."""
    t = ca.SX.sym("t")
    values = expand(function, t)
    found = (
        [] if values is None else list(_switches(values))
    )  # what cannot be expanded cannot be looked into
    if not found:
        return np.empty(0)
    switches = ca.Function("switches", [t], [ca.densify(ca.vertcat(*found))])
    beyond = last + _FINEST * np.spacing(
        max(abs(first), abs(last))
    )  # what switches at the end may do so a rounding later
    times = _refine(switches, np.append(probe_times(first, last), beyond))
    signs = np.sign(switches(times[None]).full())
    which, part = np.nonzero(signs[:, 1:] != signs[:, :-1])
    low, high, before = times[part], times[part + 1], signs[which, part]
    if not len(which):
        return np.empty(0)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        same = np.sign(switches(middle[None]).full())[which, np.arange(len(which))] == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.unique(np.clip(high, first, last))


def _refine(switches: ca.Function, times: Array) -> Array:
    """Return `times` and more between them, where a switching function may change its sign twice from one to the next."""
    low, high, found = times[:-1], times[1:], [times]
    try:
        for _ in range(_REFINEMENTS):
            bounds = bound(switches, low, high)
            ends = (np.sign(switches(edge[None]).full()) for edge in (low, high))
            hidden = ((bounds.low < 0) & (bounds.high > 0) & (next(ends) == next(ends))).any(axis=0)
            if not hidden.any() or np.count_nonzero(hidden) > _PROBES:
                break
            middle = (low[hidden] + high[hidden]) / 2
            found.append(middle)
            low, high = (
                np.concatenate([low[hidden], middle]),
                np.concatenate([middle, high[hidden]]),
            )
    except UnknownOperation:  # the times have to do
        pass
    return np.unique(np.concatenate(found))


def expand(function: ca.Function, t: ca.SX) -> ca.SX | None:
    """Return the outputs of a function of time at the symbol t, one below the other, as scalar operations; None where that is not possible."""
    try:
        return ca.densify(ca.vertcat(*(ca.vec(value) for value in function.call([t]))))
    except RuntimeError:
        return None


def _switches(values: ca.SX) -> Iterator[ca.SX]:
    """Yield what changes its sign where the expressions switch, or cease to be defined."""
    waiting, seen = [values[k] for k in range(values.numel())], set()
    while waiting:
        item = waiting.pop()
        if item.element_hash() in seen:
            continue
        seen.add(item.element_hash())
        parts = [item.dep(k) for k in range(item.n_dep())] if not item.is_leaf() else []
        waiting.extend(parts)
        if parts and item.op() in _COMPARED:
            yield parts[0] - parts[1]
        elif (parts and item.op() in _SIGNED) or (
            parts and item.op() in _POSITIVE and not (len(parts) == 2 and _is_whole(parts[1]))
        ):
            yield parts[0]
        elif parts and item.op() in _WITHIN_ONE:
            yield 1 - parts[0] ** 2
        elif parts and item.op() in (ca.OP_LOG1P, ca.OP_ACOSH):
            yield parts[0] - {ca.OP_LOG1P: -1, ca.OP_ACOSH: 1}[item.op()]
        elif parts and item.op() in _ROUNDED:
            yield ca.sin(np.pi * parts[0])
        elif parts and item.op() in _REMAINDERS:
            yield _REMAINDERS[item.op()](np.pi * parts[0] / parts[1])


def _is_whole(exponent: ca.SX) -> bool:
    return bool(exponent.is_constant()) and float(exponent).is_integer()


def check_over_run(
    field: str, function: Callable[[Any], Any], traced: ca.Function, first: float, last: float
) -> None:
    """Raise ValueError, naming `field`, unless traced (t) -> value, rates … is finite in [first, last], s, and what `function` gives for numbers.

    `math` and `float` make a constant of a CasADi time: the latter shows it.
    """
    times = probe_times(first, last)
    breaks = find_breaks(traced, first, last)
    some = times[:: max(1, traced.numel_out() * len(times) // _ENTRIES)]
    some = np.unique(
        np.concatenate([some, breaks, np.nextafter(breaks, first), np.nextafter(breaks, last)])
    )
    for k, kind in zip(
        range(traced.n_out()), ("", ": its velocity", ": its acceleration"), strict=False
    ):
        values = _values(traced, k, some)
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            raise ValueError(
                f"{field}{kind} is not finite at t = {some[bad.argmax()]:g} s: give finite values over the whole run; {CURE}"
            )
        for pole in _find_poles(traced, k, some, values):
            raise ValueError(
                f"{field}{kind} grows beyond all bounds at t = {pole:.10g} s: give finite values over the whole run"
            )
    for time in times[:: len(times) // _COMPARED_TIMES].tolist():
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
        if number.shape == value.shape and not np.allclose(
            number, value, rtol=1e-6, atol=1e-9 * max(1.0, abs(number).max(initial=0.0))
        ):
            raise ValueError(
                f"{field} is {number} for the number t = {time:g} and {value} for a CasADi time: give the same at each call; {CURE}"
            )


def _values(traced: ca.Function, output: int, times: Array) -> Array:
    """Return an output at times (K,) as (K, entries)."""
    values = traced.call([times[None]])[output].full()
    return np.asarray(
        values.reshape(len(values), len(times), -1).transpose(1, 0, 2).reshape(len(times), -1)
    )


def _find_poles(traced: ca.Function, output: int, times: Array, values: Array) -> Iterator[float]:
    """Yield times at which an output grows without end the closer one looks, between the `times` (K,) of its `values` (K, entries).

    Looked at is where each entry is largest: what is finite there ceases to grow, narrow as a pulse
    may be.
    """
    sizes = np.abs(values)
    rows = sizes.argmax(axis=0)
    steep = np.flatnonzero(sizes.max(axis=0) > _STEEP * np.median(sizes, axis=0))
    for row, entry in {int(rows[entry]): int(entry) for entry in steep}.items():
        size_at = _size_of_entry(traced, output, entry)
        low, high = times[max(row - 1, 0)], times[min(row + 1, len(times) - 1)]
        middle: list[float] = []
        while high - low > _FINEST * np.spacing(max(abs(low), abs(high))):
            near = np.linspace(low, high, 21)
            size = size_at(near)
            place = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
            middle.append(float(np.median(size)))
            low, high = near[max(place - 1, 0)], near[min(place + 1, 20)]
        if len(middle) > _LAST and not middle[-1] < _GROWS * middle[-1 - _LAST]:
            yield float(near[place])


def _size_of_entry(traced: ca.Function, output: int, entry: int) -> Callable[[Array], Array]:
    """Return the function times (K,) → size of one entry of an output (K,), without the cost of the others where that is possible."""
    t = ca.SX.sym("t")
    try:
        values = ca.densify(traced.call([t])[output])
    except RuntimeError:  # it cannot be expanded
        return lambda times: np.abs(_values(traced, output, times)[:, entry])
    alone = ca.Function("entry", [t], [values[divmod(entry, values.shape[1])]])
    return lambda times: np.abs(alone(times[None]).full().ravel())


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


def short_beside_steep(times: Array) -> Array:
    """Return the times of a table, and more of them beside pieces far shorter than the next one, as far away as those are long.

    A step that ends where a steep piece begins may see a rounding of the clock of it, and counts
    that for its whole length.
    """
    inner, before, after = times[1:-1], np.diff(times)[:-1], np.diff(times)[1:]
    late, early = after > _FAR_LONGER * before, before > _FAR_LONGER * after
    return np.unique(
        np.concatenate([times, inner[late] + before[late], inner[early] - after[early]])
    )


def at_edges(breaks: Array, first: float, last: float, steps: int) -> Array:
    """Return the times just before and just after each of `breaks`, s: as far as the clock of a run of so many steps may be off."""
    around = clock_error(first, last, steps)
    return np.unique(np.concatenate([breaks - around, breaks + around]))


def clock_error(first: float, last: float, steps: int) -> float:
    """Return by how much, s, the clock of a run of so many steps may be off: it is the sum of them."""
    return _ROUNDINGS * (steps + 1) * float(np.spacing(max(abs(first), abs(last))))
