"""Breakpoints: times at which steps of a simulation have to end."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array

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
_REMAINDERS = {
    ca.OP_FMOD: ca.sin,
    ca.OP_REMAINDER: ca.cos,
}  # they switch where the quotient of their operands is whole, or half of odd


def probe_times(first: float, last: float) -> Array:
    """Return 4001 equidistant times of a run, s."""
    return np.linspace(first, last, 4001)


def find_breakpoints(function: ca.Function, first: float, last: float) -> Array:
    """Find the times in [first, last], s, at which conditions in a function of time switch.

    Conditions are comparisons, signs and roundings. Each is bracketed between two of the probe
    times: a condition that switches there and back between two of them is not seen, nor is one in
    a Function that CasADi cannot expand.
    """
    t = ca.SX.sym("t")
    values = expand(function, t)
    found = [] if values is None else list(_switches(values))
    if not found:
        return np.empty(0)
    switches = ca.Function("switches", [t], [ca.densify(ca.vertcat(*found))])
    # A condition that switches at the end may do so a rounding later.
    beyond = last + 100 * np.spacing(max(abs(first), abs(last)))
    times = np.append(probe_times(first, last), beyond)
    signs = np.sign(switches(times[None]).full())
    which, part = np.nonzero(signs[:, 1:] != signs[:, :-1])
    if not len(which):
        return np.empty(0)
    low, high, before = times[part], times[part + 1], signs[which, part]
    for _ in range(60):  # bisections, to the last digit
        middle = (low + high) / 2
        same = np.sign(switches(middle[None]).full())[which, np.arange(len(which))] == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.unique(np.clip(high, first, last))


def expand(function: ca.Function, t: ca.SX) -> ca.SX | None:
    """Write the outputs of a function of time as one column of scalar operations; None where CasADi cannot."""
    try:
        return ca.densify(ca.vertcat(*(ca.vec(value) for value in function.call([t]))))
    except RuntimeError:
        return None


def _switches(values: ca.SX) -> Iterator[ca.SX]:
    """Yield expressions that change sign where the values switch, or cease to be defined."""
    waiting, seen = [values[k] for k in range(values.numel())], set()
    while waiting:
        item = waiting.pop()
        if item.element_hash() in seen or item.is_leaf():
            continue
        seen.add(item.element_hash())
        parts = [item.dep(k) for k in range(item.n_dep())]
        waiting.extend(parts)
        operation = item.op()
        if operation in _COMPARED:
            yield parts[0] - parts[1]
        elif operation in _SIGNED or (
            operation in _POSITIVE and not (len(parts) == 2 and _is_whole(parts[1]))
        ):
            yield parts[0]
        elif operation in _ROUNDED:
            yield ca.sin(np.pi * parts[0])
        elif operation in _REMAINDERS:
            yield _REMAINDERS[operation](np.pi * parts[0] / parts[1])


def _is_whole(exponent: ca.SX) -> bool:
    return bool(exponent.is_constant()) and float(exponent).is_integer()


def short_beside_steep(times: Array) -> Array:
    """Add times to those of a table beside pieces far shorter than the next one, as far away as those are long.

    A step that ends where a steep piece begins may see a rounding of the clock of it, and counts
    that for its whole length.
    """
    inner, before, after = times[1:-1], np.diff(times)[:-1], np.diff(times)[1:]
    late, early = after > 100 * before, before > 100 * after
    return np.unique(
        np.concatenate([times, inner[late] + before[late], inner[early] - after[early]])
    )


def clock_error(first: float, last: float, steps: int) -> float:
    """Bound the error, s, of the clock of a run of so many steps, which is the sum of them."""
    return 4.0 * (steps + 1) * float(np.spacing(max(abs(first), abs(last))))
