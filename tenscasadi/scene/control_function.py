"""Control functions of time, traced or interpolated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, probe_times, sample_times
from tenscasadi.scene.interpolants import interpolate_function, read_function, sample_twice
from tenscasadi.scene.time_functions import express, is_same, values_at
from tenscasadi.util.validate import (
    SMALLEST,
    Array,
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
    field : str
        Name of the control in messages.
    """

    at: ca.Function
    breakpoints: Array
    field: str = "control"

    def check_run(self, first: float, last: float) -> None:
        """Do nothing, because `build_schedule` has checked the values.

        Loads check themselves here, from `first` to `last` [s].
        """

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
        """Return the function of time that the steps must resolve.

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
    sample = read_controls_at(control.function, nu, positive)
    t = ca.MX.sym("t")
    traced = _trace(control.function, sample_twice("control", sample, 0.0, t_end), nu)
    inside = control.breakpoints[(control.breakpoints > 0) & (control.breakpoints < t_end)]
    edges = inside
    if traced is None:
        traced, steep = interpolate_function(
            "control",
            sample,
            0.0,
            t_end,
            inside,
            shortest=control.resolution,
            cure="give ControlFunction(function, breakpoints=(…), resolution=…)",
        )
        edges = np.union1d(inside, steep)
    times = np.union1d(probe_times(0.0, t_end), find_breakpoints(traced, 0.0, t_end))
    for time, values in zip(times, values_at(traced, times), strict=True):
        finite_array(f"control({time:g})", values, (nu,))
        _check_positive(values, positive, time)
    at = ca.Function("control", [t], [ca.densify(traced(t - first))])
    return ControlSchedule(at, first + edges)


def _check_positive(values: Array, positive: bool, time: float) -> Array:
    bad = np.flatnonzero(values < SMALLEST)
    if positive and len(bad):
        raise ValueError(
            f"control({time:g})[{bad[0]}] is {values[bad[0]]:g}: rest lengths (RestLength) must be greater than 0"
        )
    return values


def read_controls_at(
    function: Callable[[Any], Any], nu: int, positive: bool
) -> Callable[[float], Array]:
    """Wrap a control function so that its results are checked.

    Results must be finite and of shape (nu,), and greater than 0 if `positive`. Returns a function
    of the time [s]; it raises ValueError.
    """
    sample = read_function("control", function, (nu,))
    return lambda time: _check_positive(sample(time), positive, time)


def _trace(
    function: Callable[[Any], Any], known: dict[float, Array], nu: int
) -> ca.Function | None:
    """Convert a Python control function to a CasADi Function by tracing.

    The result is t (s) → control (nu). It is None if tracing fails, or if the expression differs
    from the values `known` by time.
    """
    t = ca.MX.sym("t")
    try:
        value = ca.vec(ca.MX(express("control", function, t)))
    except ValueError:
        return None
    if value.numel() != nu:
        return None
    traced = ca.Function("control", [t], [ca.densify(value)])
    same = all(is_same(values, traced(time).full().ravel()) for time, values in known.items())
    return traced if same else None
