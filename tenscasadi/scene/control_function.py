"""Control functions of time, traced or interpolated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, probe_times, sample_times
from tenscasadi.scene.time_functions import as_numbers, express, format_row, is_same, values_at
from tenscasadi.util.validate import (
    MAX_COUNT,
    NEGLIGIBLE,
    SMALLEST,
    Array,
    call_user_function,
    finite_array,
    format_value,
    positive_number,
)


@dataclass(frozen=True, eq=False)
class ControlFunction:
    """Control as a function of time, evaluated at all integrator stages.

    A function that CasADi cannot trace, as with Python's ``if``, is interpolated by piecewise
    cubics. Pieces are halved until they agree with the function. Steps of a simulation end at the
    breakpoints.

    Parameters
    ----------
    function : callable
        Function of the time since the start of the run [s] that returns the control (nu,).
    breakpoints : array_like, shape (B,), optional
        Times [s] at which the function jumps or has a kink, or a pulse begins or ends. Jumps of
        comparisons, signs and roundings are found automatically.
    resolution : float, optional
        Shortest piece of the interpolation [s]. A faster change becomes a ramp of this length.
        Default: a billionth of the run.

    Raises
    ------
    TypeError, ValueError
        If a field is wrong.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> u = model.initial_control
    >>> pull = tc.ControlFunction(lambda t: u if t < 0.02 else 1.1 * u, breakpoints=[0.02])
    >>> tc.simulate(model, 0.05, control=pull, compiled=False).success
    True
    """

    function: Callable[[Any], Any]
    breakpoints: Any = ()
    resolution: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise TypeError(
                f"ControlFunction.function is {format_value(self.function)}: give a function of time"
            )
        times = finite_array("ControlFunction.breakpoints", self.breakpoints, (None,))
        object.__setattr__(self, "breakpoints", times)
        if self.resolution is not None:
            length = positive_number("ControlFunction.resolution", self.resolution)
            object.__setattr__(self, "resolution", length)


@dataclass(frozen=True, eq=False)
class ControlSchedule:
    """Control as a CasADi Function of a run's clock.

    Attributes
    ----------
    at : casadi.Function
        t (s) → control (nu).
    breakpoints : ndarray, shape (B,)
        Times [s] at which steps must end, in addition to those found in `at`.
    """

    at: ca.Function
    breakpoints: Array
    field: str = "control"

    def check_run(self, first: float, last: float) -> None:
        """Do nothing, because `build_schedule` checks the values."""

    def find_breakpoints(self, first: float, last: float) -> Array:
        """Find the jumps and kinks of the control.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        ndarray
            Increasing times [s].
        """
        found = [self.breakpoints, find_breakpoints(self.at, first, last)]
        return np.unique(np.concatenate(found))

    def sample(self, first: float, last: float) -> Array:
        """Sample the control at times of a run.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        ndarray, shape (K, nu)
            Controls.
        """
        return values_at(self.at, sample_times(first, last))

    def changing(self) -> ca.Function:
        """Return the function of time that integration steps must resolve.

        Returns
        -------
        casadi.Function
            `at`.
        """
        return self.at


def build_schedule(
    control: ControlFunction, nu: int, first: float, t_end: float, positive: bool
) -> ControlSchedule:
    """Build the schedule of a control function for a run.

    Parameters
    ----------
    control : ControlFunction
        Control function of the time since the start of the run.
    nu : int
        Size of the control.
    first : float
        Clock at the start [s].
    t_end : float
        Duration of the run [s].
    positive : bool
        Whether the entries must be greater than 0, as rest lengths.

    Raises
    ------
    ValueError
        If the function raises an error, is not deterministic, or returns numbers that are not
        finite or have another shape. The message names the time.
    """
    sample = read_function(control.function, nu, positive)
    t = ca.MX.sym("t")
    traced = _trace(control.function, sample, nu, t_end)
    inside = control.breakpoints[(control.breakpoints > 0) & (control.breakpoints < t_end)]
    edges = inside
    if traced is None:
        shortest = NEGLIGIBLE * t_end if control.resolution is None else control.resolution
        traced, steep = _interpolate(sample, nu, t_end, inside, shortest)
        edges = np.union1d(inside, steep)
    times = np.union1d(probe_times(0.0, t_end), find_breakpoints(traced, 0.0, t_end))
    for time, values in zip(times, values_at(traced, times), strict=True):
        if not np.isfinite(values).all() or (positive and (values < SMALLEST).any()):
            _check_values(values, nu, positive, time)
    at = ca.Function("control", [t], [ca.densify(traced(t - first))])
    return ControlSchedule(at, first + edges)


def _check_values(given: Any, nu: int, positive: bool, time: float) -> Array:
    field = f"control({time:g})"
    values = finite_array(field, as_numbers(given), (nu,))
    bad = np.flatnonzero(values < SMALLEST)
    if positive and len(bad):
        raise ValueError(
            f"{field}[{bad[0]}] is {values[bad[0]]:g}: rest lengths (RestLength) must be greater than 0"
        )
    return values


def read_function(
    function: Callable[[Any], Any], nu: int, positive: bool
) -> Callable[[float], Array]:
    """Wrap a control function in checks of its results."""
    hint = f"give a function of time [s] that returns ({nu},)"

    def sample(time: float) -> Array:
        given = call_user_function(f"control({time:g})", function, time, hint)
        return _check_values(given, nu, positive, time)

    return sample


def _trace(
    function: Callable[[Any], Any], sample: Callable[[float], Array], nu: int, t_end: float
) -> ca.Function | None:
    """Trace a function by CasADi.

    Returns None if that fails, or the expression differs from the function's numbers.
    """
    t = ca.MX.sym("t")
    known = [(time, sample(time)) for time in probe_times(0.0, t_end)[::1000].tolist()]
    for time, values in known:
        if not np.array_equal(again := sample(time), values):
            raise ValueError(
                f"control({time:g}) is {format_row(values)} and then {format_row(again)}: "
                "give the same values at each call"
            )
    try:
        value = ca.vec(ca.MX(express("control", function, t)))
    except ValueError:
        return None
    if value.numel() != nu:
        return None
    traced = ca.Function("control", [t], [ca.densify(value)])
    same = all(is_same(values, traced(time).full().ravel()) for time, values in known)
    return traced if same else None


def _interpolate(
    sample: Callable[[float], Array], nu: int, t_end: float, breakpoints: Array, shortest: float
) -> tuple[ca.Function, Array]:
    """Interpolate a function by piecewise cubics.

    A piece is halved until it agrees with the function or is as short as `shortest` [s]. Returns
    the interpolant, and the ends of pieces that do not agree.
    """
    known: dict[float, Array] = {}

    def at(times: Array) -> Array:
        for time in times.tolist():
            if time not in known:
                known[time] = sample(time)
        return np.array([known[time] for time in times.tolist()]).reshape(len(times), nu)

    around = 4 * np.spacing(t_end)
    own = np.concatenate([breakpoints - around, breakpoints + around])
    edges = np.union1d(sample_times(0.0, t_end), own)
    waiting = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))[::-1]
    pieces, steep = [], []
    while waiting:
        low, high = waiting.pop()
        nodes, between = (low + (high - low) * k / 6 for k in (_NODES, _BETWEEN))
        bezier = _TO_BEZIER @ at(np.append(nodes[:-1], high))
        largest = max(abs(values).max(initial=0.0) for values in known.values())
        wrong = abs(_AT_BETWEEN @ bezier - at(between)).max(initial=0.0) > NEGLIGIBLE * largest
        if wrong and high - low > max(shortest, 4 * around):
            middle = (low + high) / 2
            waiting += [(middle, high), (low, middle)]
        else:
            pieces.append((low, high, bezier))
            steep += [low, high] if wrong else []
        if len(pieces) + len(waiting) > MAX_COUNT:
            raise ValueError(
                f"control changes too fast near t = {low:g} s to be sampled: give "
                "ControlFunction(function, breakpoints=(…), resolution=…), or CasADi's mathematics"
            )
    return _spline(pieces, nu), np.unique([time for time in steep if 0 < time < t_end])


_NODES, _BETWEEN = np.array([0.0, 2.0, 4.0, 6.0]), np.array([1.0, 3.0, 5.0])  # sixths of a piece
_TO_BEZIER = np.array([[6.0, 0, 0, 0], [-5, 18, -9, 2], [2, -9, 18, -5], [0, 0, 0, 6]]) / 6
_AT_BETWEEN = np.array(
    [[(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3] for s in _BETWEEN / 6]
)


def _spline(pieces: list[tuple[float, float, Array]], nu: int) -> ca.Function:
    """Join cubics in Bernstein form to a Function of time."""
    ends = np.array([pieces[0][0], *(high for _, high, _ in pieces)])
    knots = np.concatenate([ends[:1], np.repeat(ends, 3), ends[-1:]])
    rows = np.concatenate([pieces[0][2][:1], *(bezier[1:] for _, _, bezier in pieces)])
    spline = ca.Function.bspline(
        "spline", [knots.tolist()], rows.ravel().tolist(), [3], nu, {"lookup_mode": ["binary"]}
    )
    t = ca.MX.sym("t")
    inside = ca.fmin(ca.fmax(t, ends[0]), ends[-1])
    # scalar code cannot inline a spline
    return ca.Function("sampled", [t], [spline(inside)], {"never_inline": True})
