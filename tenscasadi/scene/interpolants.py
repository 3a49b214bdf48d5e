"""Functions of time as interpolants, or as calls of Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import comb
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import probe_times, sample_times
from tenscasadi.scene.time_functions import CURE, as_numbers, express, format_row, interpolate
from tenscasadi.schema.field_types import POINTS, TIMES
from tenscasadi.schema.value import Value
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    MAX_COUNT,
    NEGLIGIBLE,
    TOLERANCE,
    Array,
    call_user_function,
    finite_array,
)

Sample = Callable[[float], Array]

# degree of pieces: of a value, and of a path whose acceleration counts, too
VALUE, PATH = 3, 7


@dataclass(frozen=True, eq=False)
class VectorFunction:
    """Function of time that calls a CasADi Function.

    Parameters
    ----------
    at : casadi.Function
        t (s) → entries (m,).
    shape : tuple of int
        Shape of the result, whose rows the entries fill one after the other.
    span : tuple of float
        First and last time [s]. An interpolant is constant outside.
    """

    at: ca.Function
    shape: tuple[int, ...]
    span: tuple[float, float] = (-np.inf, np.inf)

    def __call__(self, time: Any) -> Any:
        """Evaluate the function at a time, a number or a CasADi symbol."""
        values = self.at(time)
        if isinstance(values, ca.DM):
            return values.full().reshape(self.shape)
        return ca.reshape(values, *self.shape[::-1]).T if len(self.shape) == 2 else values

    def check_run(self, field: str, first: float, last: float) -> None:
        """Check that a run is within the span of the interpolant.

        The run is from `first` to `last` [s]. Messages name `field`. Raises ValueError.
        """
        low, high = self.span
        rounding = NEGLIGIBLE * (high - low)
        if first < low - rounding or last > high + rounding:
            raise ValueError(
                f"{field} is interpolated from {low:g} to {high:g} s, and the run is from {first:g} "
                f"to {last:g} s: give Model.interpolate_functions(first, last) of a longer time"
            )


@dataclass(frozen=True, eq=False)
class Samples(Value, kind="Samples"):
    """Function of time that interpolates samples.

    It is linear between its times and constant outside. Saved results hold such functions in
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
        super().__post_init__()
        finite_array("Samples.values", self.values, (len(self.times), 3))

    def __call__(self, time: Any) -> Any:
        """Interpolate the samples at a time, a number or a CasADi symbol."""
        if isinstance(time, (ca.SX, ca.MX, ca.DM)) and len(self.times) > 1:
            return interpolate(time, self.times, self.values, 3)
        number = 0.0 if isinstance(time, (ca.SX, ca.MX)) else float(time)
        return [float(np.interp(number, self.times, column)) for column in self.values.T]


class PythonFunction(ca.Callback):
    """Python function of time, callable from CasADi's virtual machine.

    Its derivatives are finite differences.
    """

    def __init__(self, sample: Sample, size: int) -> None:
        ca.Callback.__init__(self)
        self._sample, self._size = sample, size
        self.construct("python_function", {"enable_fd": True, "never_inline": True})

    def get_n_in(self) -> int:
        """Return the number of inputs, which is 1: the time."""
        return 1

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        """Return the shape of the only output, a dense column."""
        return ca.Sparsity.dense(self._size)

    def eval(self, arguments: Any) -> list[ca.DM]:
        """Evaluate the function at a time.

        The time is the only one of the `arguments` [s].
        """
        return [ca.DM(self._sample(float(arguments[0])))]


def is_traceable(field: str, function: Callable[[Any], Any]) -> bool:
    """Return whether CasADi can evaluate a function at a symbol.

    `function` is one of time, and `field` its name.
    """
    try:
        express(field, function, ca.MX.sym("t"))
    except ValueError:
        return False
    return True


def call_python(field: str, function: Callable[[Any], Any], shape: tuple[int, ...]) -> Any:
    """Wrap a function that CasADi cannot trace, for single evaluations.

    Returns a function of time with results of the given shape, which also accepts CasADi symbols.
    `field` is its name in messages. Runs use interpolants instead.
    """
    sample = read_function(field, function, shape)
    python = PythonFunction(sample, sample(0.0).size)
    # CasADi's Functions do not keep it alive, and outlive scene and model.
    python.__disown__()  # type: ignore[attr-defined]
    return VectorFunction(python, shape)


def read_function(
    field: str, function: Callable[[Any], Any], shape: tuple[int, ...]
) -> Callable[[float], Array]:
    """Wrap a function of time so that its results are checked.

    Results must be finite and have the given `shape`. The wrapped function returns them as a flat
    array. Messages name `field`.
    """
    wanted = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" if shape else "one number"
    hint = f"give a function of time [s] that returns {wanted}"

    def sample(time: float) -> Array:
        given = call_user_function(f"{field}({time:g})", function, time, hint)
        return np.asarray(finite_array(f"{field}({time:g})", as_numbers(given), shape)).ravel()

    return sample


def sample_twice(field: str, sample: Sample, first: float, last: float) -> dict[float, Array]:
    """Sample a function at five times from `first` to `last` [s].

    Returns the values by time. Raises ValueError, naming `field`, if the function returns other
    values at a second call.
    """
    known = {time: sample(time) for time in probe_times(first, last)[::1000].tolist()}
    for time, values in known.items():
        if not np.array_equal(again := sample(time), values):
            raise ValueError(
                f"{field}({time:g}) is {format_row(values)} and then {format_row(again)}: "
                "give the same values at each call"
            )
    return known


def interpolate_function(
    field: str,
    sample: Sample,
    first: float,
    last: float,
    breakpoints: Array,
    degree: int = VALUE,
    shortest: float | None = None,
    cure: str = "declare breakpoints=(…)",
) -> tuple[ca.Function, Array]:
    """Interpolate a function by pieces of polynomials.

    A piece is halved until it agrees with the function to a billionth of the largest value, or, for
    a path, of its change within the piece. It is compared at thousands of times, see `probe_times`.

    Parameters
    ----------
    field : str
        Name of the function in messages.
    sample : callable
        Function of time that returns entries (m,).
    first, last : float
        Start and end of the run [s].
    breakpoints : ndarray, shape (B,)
        Times [s] at which pieces end.
    degree : int
        Degree of the pieces.
    shortest : float, optional
        Shortest piece [s]. Default: a billionth of the run.
    cure : str
        Cure in the message on too many pieces.

    Returns
    -------
    tuple
        Function t (s) → entries (m,), and ends of the pieces that do not agree.

    Raises
    ------
    ValueError
        The function raises, or needs too many pieces; the message names it.
    """
    known: dict[float, Array] = {}

    def at(times: Array) -> Array:
        for time in times.tolist():
            if time not in known:
                known[time] = sample(time)
        return np.array([known[time] for time in times.tolist()]).reshape(len(times), -1)

    around = 4 * np.spacing(max(abs(first), abs(last)))
    shortest = max(NEGLIGIBLE * (last - first) if shortest is None else shortest, 4 * around)
    nodes, between, to_bezier = _piece(degree)
    probes = probe_times(first, last)
    inside = breakpoints[(breakpoints > first) & (breakpoints < last)]
    jumps = [inside - around, inside + around] if degree == VALUE else [inside]
    edges = np.union1d(sample_times(first, last), np.concatenate(jumps))
    waiting = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))[::-1]
    pieces: list[tuple[float, float, Array]] = []
    steep: list[float] = []
    largest = 0.0
    while waiting:
        low, high = waiting.pop()
        values = at(np.append(low + (high - low) * nodes[:-1], high))
        own = probes[slice(*np.searchsorted(probes, (low, high)))]
        s = np.append(between, (own - low) / (high - low))
        bezier, found = to_bezier @ values, at(np.append(low + (high - low) * between, own))
        largest = max(largest, abs(values).max(initial=0.0), abs(found).max(initial=0.0))
        scale = largest if degree == VALUE else np.ptp(values, axis=0).max(initial=0.0)
        least = max(NEGLIGIBLE * scale, 16 * np.spacing(largest))
        wrong = abs(_bernstein(degree, s) @ bezier - found).max(initial=0.0) > least
        if wrong and high - low > shortest:
            middle = (low + high) / 2
            waiting += [(middle, high), (low, middle)]
        else:
            pieces.append((low, high, bezier))
            steep += [low, high] if wrong else []
        if len(pieces) + len(waiting) > MAX_COUNT:
            raise add_address(
                ValueError(
                    f"{field} changes too fast near t = {low:g} s to be sampled: {cure}, or {CURE}"
                )
            )
    if degree == PATH:
        steep += _find_corners(pieces, largest)
    return _spline(pieces, degree), np.array(sorted({t for t in steep if first < t < last}))


def _find_corners(pieces: list[tuple[float, float, Array]], largest: float) -> list[float]:
    """Find the times at which the velocity jumps [s].

    They are ends of polynomial pieces. A piece is its first time, its last time, and its
    coefficients in Bernstein form. `largest` is the largest value, for the rounding error.
    """
    lengths = np.array([high - low for low, high, _ in pieces])[:, None]
    begin, end = (
        PATH * np.array([bezier[k + 1] - bezier[k] for *_, bezier in pieces]) / lengths
        for k in (0, PATH - 1)
    )
    jumps = abs(begin[1:] - end[:-1])
    rounding = 100 * PATH**2 * np.spacing(largest) / np.minimum(lengths[1:], lengths[:-1])
    corner = jumps > TOLERANCE * abs(begin).max(initial=0.0) + rounding
    return [pieces[k + 1][0] for k in np.flatnonzero(corner.any(axis=1))]


@cache
def _piece(degree: int) -> tuple[Array, Array, Array]:
    """Compute interpolation nodes, times between them, and a matrix.

    The nodes are degree + 1 fractions of a piece, from 0 to 1. The matrix converts values at the
    nodes to the coefficients of a polynomial of this degree in Bernstein form.
    """
    nodes: Array = (1 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2
    between = (nodes[1:] + nodes[:-1]) / 2
    to_bezier: Array = np.linalg.inv(_bernstein(degree, nodes)).astype(float)
    return nodes, between, to_bezier


def _bernstein(degree: int, s: Array) -> Array:
    return np.array([comb(degree, k) * s**k * (1 - s) ** (degree - k) for k in range(degree + 1)]).T


def _spline(pieces: list[tuple[float, float, Array]], degree: int) -> ca.Function:
    """Join polynomial pieces in Bernstein form to a Function of time.

    The first and the last piece extend by a hundredth of their length, because rounding may take a
    clock past the end. A piece is its first time, its last time [s], and its degree + 1 rows of
    coefficients.
    """
    pieces = list(pieces)
    s = np.linspace(0, 1, degree + 1)
    for k, before, after in ((0, 0.01, 0.0), (-1, 0.0, 0.01)):
        low, high, bezier = pieces[k]
        values = _bernstein(degree, s * (1 + before + after) - before) @ bezier
        own = np.linalg.solve(_bernstein(degree, s), values).astype(float)
        pieces[k] = low - before * (high - low), high + after * (high - low), own
    ends = np.array([pieces[0][0], *(high for _, high, _ in pieces)])
    knots = np.concatenate([ends[:1], np.repeat(ends, degree), ends[-1:]])
    rows = np.concatenate([pieces[0][2][:1], *(bezier[1:] for _, _, bezier in pieces)])
    lookup = {"lookup_mode": ["binary"]}
    spline = ca.Function.bspline(
        "spline", [knots.tolist()], rows.ravel().tolist(), [degree], rows.shape[1], lookup
    )
    t = ca.MX.sym("t")
    inside = ca.fmin(ca.fmax(t, ends[0]), ends[-1])
    # scalar code cannot inline a spline
    return ca.Function("sampled", [t], [spline(inside)], {"never_inline": True})
