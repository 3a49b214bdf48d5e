"""Interval arithmetic on CasADi expressions of one variable: what they can be, at most and at least, between two of its values."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from tenscasadi.util.validate import Array

Flags = NDArray[np.bool_]


class Bounds(NamedTuple):
    """Least and largest values (m, k) of m expressions in k intervals, and whether anything in them switches inside each (k,)."""

    low: Array
    high: Array
    switches: Flags


class UnknownOperation(ValueError):
    """Raised where an expression holds an operation of which no bounds are known."""


def bound(function: ca.Function, low: Array, high: Array) -> Bounds:
    """Return bounds on a Function t → dense column in the intervals from `low` to `high` (k,).

    They hold but for rounding, and may be wide where t stands in several places. Comparisons,
    signs, roundings and the like switch where they do so inside an interval, not at its ends. Where
    an operation is not defined, as a root of negative numbers, the bounds are those of where it is;
    the lesser and the greater of two, which pass over what is not defined, are then the other.

    Raises
    ------
    UnknownOperation
        Where the Function is not made of scalar operations, or holds one of which no bounds are
        known.
    """
    if function.class_name() != "SXFunction":
        raise UnknownOperation(f"{function.name()} is no expression of scalar operations")
    work: list[Any] = [None] * function.sz_w()
    undefined: list[tuple[Any, Any]] = [_DEFINED] * function.sz_w()  # somewhere, maybe; everywhere
    count = function.numel_out()
    found = np.zeros((2, count, len(low)))
    switches = np.zeros(len(low), dtype=bool)
    with np.errstate(all="ignore"):
        for k in range(function.n_instructions()):
            operation, places, results = (
                function.instruction_id(k),
                function.instruction_input(k),
                function.instruction_output(k),
            )
            if operation == ca.OP_INPUT:
                work[results[0]], undefined[results[0]] = (low, high), _DEFINED
            elif operation == ca.OP_CONST:
                value = np.float64(function.instruction_constant(k))
                work[results[0]], undefined[results[0]] = (value, value), _DEFINED
            elif operation == ca.OP_OUTPUT:
                found[0, results[1]], found[1, results[1]] = work[places[0]]
            else:
                arguments, lost = (
                    [work[place] for place in places],
                    [undefined[place] for place in places],
                )
                if operation in _SWITCHED:
                    switches |= _SWITCHED[operation](*arguments)
                if operation in _PASSING:
                    for maybe, surely in lost:
                        switches |= maybe & ~surely
                work[results[0]] = _without(
                    operation, _apply(operation, arguments), arguments, lost
                )
                undefined[results[0]] = _leave_domain(operation, arguments, lost)
    return Bounds(found[0], found[1], switches)


def _apply(operation: int, arguments: list[Any]) -> tuple[Any, Any]:
    rule = _RULES.get(operation)
    if rule is None:
        raise UnknownOperation(f"no bounds are known of CasADi's operation {operation}")
    low, high = rule(*arguments)
    unknown = np.isnan(low) | np.isnan(high)  # such as ∞ − ∞
    return np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high)


def _without(
    operation: int, value: Any, arguments: list[Any], lost: list[tuple[Any, Any]]
) -> tuple[Any, Any]:
    """Return bounds of an operation that also hold where it passes over an argument that is not defined."""
    if operation not in _PASSING or not any(np.any(maybe) for maybe, _ in lost):
        return value  # type: ignore[no-any-return]
    low, high = value
    if operation == ca.OP_IF_ELSE_ZERO:
        either = np.minimum(arguments[1][0], 0.0), np.maximum(arguments[1][1], 0.0)
        others = [either, either]
    else:
        others = arguments[::-1] if operation in _CHOICES else [(0.0, 1.0)] * len(lost)
    for (maybe, surely), (least, most) in zip(lost, others, strict=True):
        low = np.where(surely, least, np.where(maybe, np.minimum(low, least), low))
        high = np.where(surely, most, np.where(maybe, np.maximum(high, most), high))
    return low, high


def _leave_domain(
    operation: int, arguments: list[Any], lost: list[tuple[Any, Any]]
) -> tuple[Any, Any]:
    """Return where the result of an operation may be undefined, and where it surely is."""
    if operation in _CHOICES:
        return lost[0][0] & lost[1][0], lost[0][1] & lost[1][1]
    maybe, surely = (reduce(or_, parts) for parts in zip(*lost, strict=True))
    if operation == ca.OP_IF_ELSE_ZERO:
        always, never = (_as_truth(arguments[0])[0] == 1), (_as_truth(arguments[0])[1] == 0)
        return lost[1][0] & ~never, lost[1][1] & always & ~lost[0][0]
    if operation in _PASSING:
        return _DEFINED
    if operation in _DOMAINS:
        least, most = _DOMAINS[operation]
        return maybe | (arguments[0][0] < least) | (arguments[0][1] > most), surely | (
            arguments[0][1] < least
        ) | (arguments[0][0] > most)
    if operation in (ca.OP_POW, ca.OP_CONSTPOW):
        (low, high), (exponent, _) = arguments
        whole = exponent == np.round(exponent)
        return maybe | ((low < 0) & ~whole), surely | ((high < 0) & ~whole)
    return maybe, surely


def _rising(
    function: Callable[..., Any], least: float = -np.inf, most: float = np.inf
) -> Callable[..., Any]:
    """Return the rule of a monotonic function, defined from `least` to `most`."""
    return lambda x: (function(np.clip(x[0], least, most)), function(np.clip(x[1], least, most)))


def _product(x: Any, y: Any) -> tuple[Any, Any]:
    corners = [
        np.where((a == 0) | (b == 0), 0.0, a * b) for a in x for b in y
    ]  # 0 times ∞ is 0 here: a bound that is not reached
    return np.minimum.reduce(np.broadcast_arrays(*corners)), np.maximum.reduce(
        np.broadcast_arrays(*corners)
    )


def _inverse(x: Any) -> tuple[Any, Any]:
    inside = (x[0] < 0) & (x[1] > 0)
    low, high = np.where(x[1] == 0, -np.inf, 1 / x[1]), np.where(x[0] == 0, np.inf, 1 / x[0])
    return np.where(inside, -np.inf, low), np.where(inside, np.inf, high)


def _even(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the rule of a function of |x| that rises with it."""

    def rule(x: Any) -> tuple[Any, Any]:
        a, b = np.abs(x[0]), np.abs(x[1])
        return function(np.where((x[0] <= 0) & (x[1] >= 0), 0.0, np.minimum(a, b))), function(
            np.maximum(a, b)
        )

    return rule


def _power(x: Any, y: Any) -> tuple[Any, Any]:
    exponent = y[0]
    if np.all(y[0] == y[1]) and np.all(exponent == np.round(exponent)) and np.ndim(exponent) == 0:
        size = abs(exponent)
        positive = _even(lambda v: v**size)(x) if size % 2 == 0 else (x[0] ** size, x[1] ** size)
        return positive if exponent >= 0 else _inverse(positive)
    corners = np.broadcast_arrays(
        *(np.maximum(a, 0.0) ** b for a in x for b in y)
    )  # of positive numbers: monotonic in each
    wild = (x[0] < 0) & (y[0] != y[1])  # whole exponents may lie between
    return np.where(wild, -np.inf, np.minimum.reduce(corners)), np.where(
        wild, np.inf, np.maximum.reduce(corners)
    )


def _wave(function: Callable[..., Any], shift: float) -> Callable[..., Any]:
    """Return the rule of a sine or cosine: cos(x − shift)."""

    def rule(x: Any) -> tuple[Any, Any]:
        turns = (x[0] - shift) / (2 * np.pi), (x[1] - shift) / (2 * np.pi)
        ends = function(x[0]), function(x[1])
        top, bottom = (
            np.floor(turns[1]) >= np.ceil(turns[0]),
            np.floor(turns[1] - 0.5) >= np.ceil(turns[0] - 0.5),
        )
        wild = ~np.isfinite(turns[0]) | ~np.isfinite(turns[1])
        return np.where(bottom | wild, -1.0, np.minimum(*ends)), np.where(
            top | wild, 1.0, np.maximum(*ends)
        )

    return rule


def _tangent(x: Any) -> tuple[Any, Any]:
    pole = np.floor(x[1] / np.pi - 0.5) >= np.ceil(x[0] / np.pi - 0.5)
    return np.where(pole, -np.inf, np.tan(x[0])), np.where(pole, np.inf, np.tan(x[1]))


def _direction(y: Any, x: Any) -> tuple[Any, Any]:
    """Of atan2: its corners where the box is off the negative half of the axis x, everything where it is not."""
    corners = np.broadcast_arrays(*(np.arctan2(a, b) for a in y for b in x))
    cut = (y[0] <= 0) & (y[1] >= 0) & (x[0] <= 0)
    return np.where(cut, -np.pi, np.minimum.reduce(corners)), np.where(
        cut, np.pi, np.maximum.reduce(corners)
    )


def _hypotenuse(x: Any, y: Any) -> tuple[Any, Any]:
    (a, b), (c, d) = _RULES[ca.OP_SQ](x), _RULES[ca.OP_SQ](y)
    return np.sqrt(a + c), np.sqrt(b + d)


def _truth(never: Any, always: Any) -> tuple[Any, Any]:
    return np.where(always, 1.0, 0.0), np.where(never, 0.0, 1.0)


def _as_truth(x: Any) -> tuple[Any, Any]:
    """Of x ≠ 0."""
    return _truth((x[0] == 0) & (x[1] == 0), (x[0] > 0) | (x[1] < 0))


def _chosen(condition: Any, x: Any) -> tuple[Any, Any]:
    """Of `condition` ? x : 0."""
    surely, maybe = (edge > 0 for edge in _as_truth(condition))
    low, high = (
        np.where(surely, x[0], np.minimum(x[0], 0.0)),
        np.where(surely, x[1], np.maximum(x[1], 0.0)),
    )
    return np.where(maybe, low, 0.0), np.where(maybe, high, 0.0)


def _remainder(x: Any, y: Any) -> tuple[Any, Any]:
    """Of fmod: x less whole multiples of y."""
    ends = np.fmod(x[0], y[0]), np.fmod(x[1], y[1])
    same = (y[0] == y[1]) & (np.trunc(x[0] / y[0]) == np.trunc(x[1] / y[1])) & (ends[0] <= ends[1])
    size = np.maximum(np.abs(y[0]), np.abs(y[1]))
    low, high = np.where(x[0] < 0, -size, 0.0), np.where(x[1] > 0, size, 0.0)
    return np.where(same, ends[0], low), np.where(same, ends[1], high)


_RULES: dict[int, Callable[..., tuple[Any, Any]]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: lambda x, y: (x[0] + y[0], x[1] + y[1]),
    ca.OP_SUB: lambda x, y: (x[0] - y[1], x[1] - y[0]),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda x, y: _product(x, _inverse(y)),
    ca.OP_NEG: lambda x: (-x[1], -x[0]),
    ca.OP_TWICE: lambda x: (2 * x[0], 2 * x[1]),
    ca.OP_INV: _inverse,
    ca.OP_SQ: _even(lambda v: v * v),
    ca.OP_FABS: _even(lambda v: v),
    ca.OP_COSH: _even(np.cosh),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_EXP: _rising(np.exp),
    ca.OP_EXPM1: _rising(np.expm1),
    ca.OP_LOG: _rising(np.log, 0.0),
    ca.OP_LOG1P: _rising(np.log1p, -1.0),
    ca.OP_SQRT: _rising(np.sqrt, 0.0),
    ca.OP_SINH: _rising(np.sinh),
    ca.OP_TANH: _rising(np.tanh),
    ca.OP_ASINH: _rising(np.arcsinh),
    ca.OP_ACOSH: _rising(np.arccosh, 1.0),
    ca.OP_ATANH: _rising(np.arctanh, -1.0, 1.0),
    ca.OP_ASIN: _rising(np.arcsin, -1.0, 1.0),
    ca.OP_ATAN: _rising(np.arctan),
    ca.OP_ACOS: lambda x: (np.arccos(np.clip(x[1], -1, 1)), np.arccos(np.clip(x[0], -1, 1))),
    ca.OP_ERF: _rising(erf),
    ca.OP_SIN: _wave(np.sin, np.pi / 2),
    ca.OP_COS: _wave(np.cos, 0.0),
    ca.OP_TAN: _tangent,
    ca.OP_ATAN2: _direction,
    ca.OP_FLOOR: _rising(np.floor),
    ca.OP_CEIL: _rising(np.ceil),
    ca.OP_SIGN: _rising(np.sign),
    ca.OP_FMOD: _remainder,
    ca.OP_FMIN: lambda x, y: (np.minimum(x[0], y[0]), np.minimum(x[1], y[1])),
    ca.OP_FMAX: lambda x, y: (np.maximum(x[0], y[0]), np.maximum(x[1], y[1])),
    ca.OP_HYPOT: _hypotenuse,
    ca.OP_LT: lambda x, y: _truth(x[0] >= y[1], x[1] < y[0]),
    ca.OP_LE: lambda x, y: _truth(x[0] > y[1], x[1] <= y[0]),
    ca.OP_EQ: lambda x, y: _truth(
        (x[0] > y[1]) | (x[1] < y[0]), (x[0] == x[1]) & (y[0] == y[1]) & (x[0] == y[0])
    ),
    ca.OP_NE: lambda x, y: _truth(
        (x[0] == x[1]) & (y[0] == y[1]) & (x[0] == y[0]), (x[0] > y[1]) | (x[1] < y[0])
    ),
    ca.OP_NOT: lambda x: (1 - _as_truth(x)[1], 1 - _as_truth(x)[0]),
    ca.OP_AND: lambda x, y: tuple(map(np.minimum, _as_truth(x), _as_truth(y))),
    ca.OP_OR: lambda x, y: tuple(map(np.maximum, _as_truth(x), _as_truth(y))),
    ca.OP_IF_ELSE_ZERO: _chosen,
}


def _overlap(x: Any, y: Any) -> Any:
    return (x[0] < y[1]) & (y[0] < x[1])


def _crosses_whole(x: Any) -> Any:
    return np.ceil(x[1]) - 1 > np.floor(x[0])


_DEFINED = np.zeros(1, dtype=bool), np.zeros(1, dtype=bool)
_CHOICES = (ca.OP_FMIN, ca.OP_FMAX)  # they return the other where one is not defined
_PASSING = (
    *_CHOICES,
    ca.OP_LT,
    ca.OP_LE,
    ca.OP_EQ,
    ca.OP_NE,
    ca.OP_NOT,
    ca.OP_AND,
    ca.OP_OR,
    ca.OP_IF_ELSE_ZERO,
)
_DOMAINS = {
    ca.OP_SQRT: (0.0, np.inf),
    ca.OP_LOG: (0.0, np.inf),
    ca.OP_LOG1P: (-1.0, np.inf),
    ca.OP_ACOSH: (1.0, np.inf),
    **dict.fromkeys((ca.OP_ATANH, ca.OP_ASIN, ca.OP_ACOS), (-1.0, 1.0)),
}  # least and largest arguments

_SWITCHED: dict[int, Callable[..., Any]] = {
    **dict.fromkeys((ca.OP_LT, ca.OP_LE, ca.OP_FMIN, ca.OP_FMAX), _overlap),
    **dict.fromkeys((ca.OP_SIGN, ca.OP_FABS), lambda x: (x[0] < 0) & (x[1] > 0)),
    **dict.fromkeys((ca.OP_FLOOR, ca.OP_CEIL), _crosses_whole),
    ca.OP_FMOD: lambda x, y: _crosses_whole(_RULES[ca.OP_DIV](x, y)),
}
