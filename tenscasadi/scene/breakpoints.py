"""Times at which integration steps must end, such as jumps of loads."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array

# switch if both operands are equal
_COMPARISONS = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)
# switch if the operand is 0
_SIGNS = (ca.OP_SIGN, ca.OP_FABS)
# switch if the operand is a whole number
_ROUNDINGS = (ca.OP_FLOOR, ca.OP_CEIL)
# undefined below 0, except for whole exponents
_POSITIVE = (ca.OP_SQRT, ca.OP_LOG, ca.OP_POW, ca.OP_CONSTPOW)
# switch if the quotient of the operands is a whole number, or half an odd one
_REMAINDERS = {ca.OP_FMOD: ca.sin, ca.OP_REMAINDER: ca.cos}


def probe_times(first: float, last: float) -> Array:
    """Return 4001 equidistant times from `first` to `last` [s]."""
    return np.linspace(first, last, 4001)


def sample_times(first: float, last: float) -> Array:
    """Return 65 equidistant times from `first` to `last` [s].

    A control or load is evaluated there to find its largest values. The times are also the first
    ends of the pieces of an interpolant, which are halved as needed. Narrow features need
    breakpoints.
    """
    return np.linspace(first, last, 65)


def find_breakpoints(function: ca.Function, first: float, last: float) -> Array:
    """Find the times [s] at which conditions switch.

    Times are in [first, last]. Conditions are comparisons, signs and roundings. Each is bracketed
    between two probe times. A condition that switches twice between them is missed, and so is a
    condition in a Function that CasADi cannot expand.
    """
    t = ca.SX.sym("t")
    values = expand(function, t)
    found = [] if values is None else list(_find_switches(values))
    if not found:
        return np.empty(0)
    switches = ca.Function("switches", [t], [ca.densify(ca.vertcat(*found))])
    # by rounding, a condition that switches at the end may do so just after it
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
    """Expand the outputs of a function of time t to scalar expressions.

    Returns None if CasADi cannot expand the function.
    """
    try:
        return ca.densify(ca.vertcat(*(ca.vec(value) for value in function.call([t]))))
    except RuntimeError:
        return None


def _find_switches(values: ca.SX) -> Iterator[ca.SX]:
    """Find expressions whose sign changes are jumps of the values.

    `values` are expressions of the time. Jumps come from comparisons, signs and roundings.
    """
    waiting, seen = [values[k] for k in range(values.numel())], set()
    while waiting:
        item = waiting.pop()
        if item.element_hash() in seen or item.is_leaf():
            continue
        seen.add(item.element_hash())
        parts = [item.dep(k) for k in range(item.n_dep())]
        waiting.extend(parts)
        operation = item.op()
        if operation in _COMPARISONS:
            yield parts[0] - parts[1]
        elif operation in _SIGNS or (
            operation in _POSITIVE and not (len(parts) == 2 and _is_whole(parts[1]))
        ):
            yield parts[0]
        elif operation in _ROUNDINGS:
            yield ca.sin(np.pi * parts[0])
        elif operation in _REMAINDERS:
            yield _REMAINDERS[operation](np.pi * parts[0] / parts[1])


def _is_whole(exponent: ca.SX) -> bool:
    return bool(exponent.is_constant()) and float(exponent).is_integer()


def add_guard_times(times: Array) -> Array:
    """Add times beside very short intervals of a table.

    Each added time is as far from the interval as the interval is long. By rounding of the clock, a
    step that ends where a steep interval begins may see its slope. A short step limits the effect.
    """
    inner, before, after = times[1:-1], np.diff(times)[:-1], np.diff(times)[1:]
    late, early = after > 100 * before, before > 100 * after
    return np.unique(
        np.concatenate([times, inner[late] + before[late], inner[early] - after[early]])
    )


def clock_error(first: float, last: float, steps: int) -> float:
    """Bound the rounding error [s] of a clock that adds up steps.

    The clock runs from `first` to `last` [s] in the given number of steps.
    """
    return 4.0 * (steps + 1) * float(np.spacing(max(abs(first), abs(last))))
