"""Time steps that end at breakpoints, with a resolution check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.scene.breakpoints import clock_error
from tenscasadi.scene.control_function import ControlFunction, build_schedule, read_function
from tenscasadi.scene.strings import RestLength
from tenscasadi.scene.time_functions import values_at
from tenscasadi.simulation.control_input import (
    ControlInput,
    ControlProfile,
    SampledControl,
    append_constants,
    cut_steps,
    sample_control,
)
from tenscasadi.util.validate import Array, positive_number

UNSEEN = "changes within steps"  # in messages on unresolved functions of time


@dataclass(frozen=True, eq=False)
class LaidRun:
    """Model, start and steps of a run.

    Attributes
    ----------
    model : Model
        Model, driven by the control if that is a function of time.
    start : ndarray, shape (nx,)
        Initial state of that model.
    inputs : SampledControl
        Steps with their control and parameters.
    first : float
        Initial time of the clock [s].
    """

    model: Model
    start: Array
    inputs: SampledControl
    first: float

    def controls(self, time: Array, held: Array) -> Array:
        """Compute control and parameters (T, nw) at given times.

        `time` (T,) [s] counts from the start; `held` (T, nw) are the inputs of the steps.
        """
        schedule = self.model.schedule
        if schedule is None:
            return held
        total = held.copy()
        total[:, : self.model.nu] += values_at(schedule.at, self.first + time)
        return total

    def states(self, time: Array, states: Array) -> Array:
        """Append the clock of the schedule to states.

        `time` [s] counts from the start.
        """
        if states.shape[1] == self.model.nx:
            return states
        return np.column_stack([states, self.first + time])

    def include_schedule(self, function: ca.Function) -> ca.Function:
        """Add the control schedule to the inputs of a Function."""
        if self.model.schedule is None:
            return function
        x, w = ca.MX.sym("x", self.model.nx), ca.MX.sym("w", self.model.nw)
        time = self.model.split(x)[2]
        value = function(x[: function.size1_in(0)], self.model.add_schedule(w, time))
        return ca.Function(function.name(), [x, w], [ca.densify(value)])


def lay_run(
    model: Model,
    start: Array,
    t_end: float,
    step: float | None,
    scheme: Scheme,
    control: ControlInput | ControlProfile,
    p: Array,
) -> LaidRun:
    """Choose the steps of a run and their controls.

    The parameters p follow each control.
    """
    end = positive_number("t_end", t_end)
    if step is None:
        step = end / 100 if scheme.adaptive else 1e-3
    positive = isinstance(model.scene.control, RestLength)
    first = float(start[-1]) if model.has_clock else 0.0
    if callable(control):
        control = ControlFunction(control)
    if isinstance(control, ControlFunction):
        driven = _drive(model, control, first, end)
        control = np.zeros(model.nu)
        positive = False  # added to the schedule, which is already checked
        if driven.has_clock and not model.has_clock:
            start = np.append(start, first)
        model = driven

    def sample(end: float, steps: int) -> SampledControl:
        inputs = sample_control(control, model.control_at(p), end, steps, positive)
        return append_constants(inputs, p) if model.np else inputs

    inputs = lay_grid(model, first, end, positive_number("step", step), sample)
    return LaidRun(model, start, inputs, first)


def _drive(model: Model, control: ControlFunction, first: float, t_end: float) -> Model:
    """Build or reuse the model driven by a control function."""
    positive = isinstance(model.scene.control, RestLength)
    if not model.nu:
        read_function(control.function, 0, positive)(0.0)  # it must return an empty array
        return model
    key = (control.function, *control.breakpoints.tolist(), control.resolution, first, t_end)
    if model.driven is None or model.driven[0] != key:
        schedule = build_schedule(control, model.nu, first, t_end, positive)
        model.driven = key, model.with_schedule(schedule)
    return model.driven[1]


def lay_grid(
    model: Model,
    first: float,
    end: float,
    step: float,
    sample: Callable[[float, int], SampledControl],
) -> SampledControl:
    """Choose the steps over `end` s from time `first` [s].

    The Function `sample` (end, steps) gives them their controls.
    """
    n_steps = _count(end, step)
    if model.has_clock:
        _check_clock(abs(first) + end, end / n_steps)
    return cut_at_changes(model.over_time, sample(end, n_steps), first)


def _count(t_end: float, step: float) -> int:
    """Count the equal steps that cover t_end.

    Each is at most `step` up to rounding.
    """
    ratio = t_end / step
    if ratio > 1e12:
        raise ValueError(
            f"step is {step:g}: t_end = {t_end:g} would take {ratio:.1g} steps, give a larger step or a smaller t_end"
        )
    nearest = round(ratio)
    return max(1, nearest if abs(ratio - nearest) <= 1e-9 * ratio else int(np.ceil(ratio)))


def _check_clock(latest: float, step: float) -> None:
    """Raise ValueError if rounding dominates the clock's steps."""
    if np.spacing(latest) > 1e-6 * step:
        raise ValueError(
            f"state: the clock runs to {latest:g} s, where steps of {step:g} s drown in rounding: start it nearer to 0"
        )


class Changing(Protocol):
    """Time-varying part of a model.

    It is a load, a support motion, or a control.
    """

    @property
    def field(self) -> str:
        """Name of the quantity in messages."""

    def check_run(self, first: float, last: float) -> None:
        """Check the function between two times [s].

        Raises ValueError.
        """

    def find_breakpoints(self, first: float, last: float, steps: int) -> Array:
        """Find the times at which steps must end [s]."""

    def changing(self) -> ca.Function | None:
        """Build the function of time, or return None."""


def cut_at_changes(
    changing: Sequence[Changing], inputs: SampledControl, first: float
) -> SampledControl:
    """Cut the steps of a run at breakpoints in time.

    Parameters
    ----------
    changing : sequence of Changing
        Time-varying parts of a model.
    inputs : SampledControl
        Steps of the run with their controls.
    first : float
        Initial time of the clock [s].

    Returns
    -------
    SampledControl
        Cut steps.

    Raises
    ------
    TypeError, ValueError
        A function of time is not finite or moves supports by a jump; the message names it.
    """
    if not changing:
        return inputs
    last, steps = first + inputs.t_end, inputs.steps
    for part in changing:
        part.check_run(first, last)
    error = clock_error(first, last, steps)
    breaks = [part.find_breakpoints(first, last, steps) for part in changing]
    inputs = cut_steps(inputs, np.concatenate(breaks) - first)
    # A step that ends at a jump is also cut just before it, so that no stage reaches the jump.
    functions = [part.changing() for part in changing]
    jumps = [
        times[_find_jumps(function, times, 2 * error, first, last)]
        for function, times in zip(functions, breaks, strict=True)
        if function is not None
    ]
    inputs = cut_steps(inputs, np.concatenate([np.empty(0), *jumps]) - first, error / 2)
    beyond = np.array([last + error])
    if all(f is None or np.isfinite(values_at(f, beyond)).all() for f in functions):
        return inputs
    # Rounding may take the clock past the end, where a function need not be finite.
    return replace(inputs, ends=inputs.times(np.arange(inputs.steps + 1)), early=error)


def _find_jumps(
    function: ca.Function, times: Array, around: float, first: float, last: float
) -> Array:
    """Find the jumps of a function.

    Returns whether it jumps within `around` s of each of `times` (k,); a kink is no jump.
    """
    before, after = values_at(function, times - around), values_at(function, times + around)
    some = values_at(function, np.linspace(first, last, 65))
    largest = max(abs(values).max(initial=0.0) for values in (some, before, after))
    return np.asarray(abs(after - before).max(axis=1, initial=0.0) > 1e-6 * largest)


def describe_unseen(
    changing: Sequence[Changing], inputs: SampledControl, first: float, step: float, order: int
) -> str:
    """Describe functions of time that the steps do not resolve.

    Each function is sampled at eight points of each step, or of its parts if there are few steps.
    Their quadrature is compared with one that has as many points as the stages of a scheme of this
    order.

    Parameters
    ----------
    changing : sequence of Changing
        Time-varying parts of a model.
    inputs : SampledControl
        The steps of the run.
    first : float
        Initial time of the clock [s].
    step : float
        Mean step of the scheme [s].
    order : int
        Order of the scheme.

    Returns
    -------
    str
        A clause for each function, after a semicolon.
    """
    text = ""
    for part in changing:
        function = part.changing()
        if function is None:
            continue
        ends = _refine(first + inputs.times(np.arange(inputs.steps + 1)), step)
        unseen, size = _compare_quadratures(function, ends, order)
        if unseen.sum() > 0.01 * size:  # of the impulse over the run
            time = ends[int(unseen.argmax())]
            text += (
                f"; {part.field} {UNSEEN} near t = {time:.6g} s more than their stages see: "
                "declare breakpoints=(…) there, or try a smaller step"
            )
    return text


def _refine(ends: Array, step: float) -> Array:
    """Divide steps longer than `step` s."""
    parts = np.maximum(1, np.ceil(np.diff(ends) / step - 1e-9)).astype(int)
    owner = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    return np.append(ends[owner] + share * np.diff(ends)[owner], ends[-1])


def _compare_quadratures(function: ca.Function, ends: Array, order: int) -> tuple[Array, float]:
    """Compare coarse and fine quadratures over K steps.

    Returns the differences (K,) and the integral of the function's absolute value.
    """
    points, weights = np.polynomial.legendre.leggauss(8)
    divisions = -(-2048 // (len(ends) - 1))  # at least 2048 parts in all
    fine = ((np.arange(divisions)[:, None] + (1 + points) / 2) / divisions).ravel()
    fine_weights = np.tile(weights / 2 / divisions, divisions)
    coarse, coarse_weights = _lobatto(max(2, (order + 3) // 2))
    unseen, size = [], 0.0
    block = max(1, 16384 // divisions)  # bounds the memory
    for begin in range(0, len(ends) - 1, block):
        starts = ends[begin : begin + block + 1]
        lengths = np.diff(starts)[:, None]
        sampled = [
            values_at(function, (starts[:-1, None] + lengths * places).ravel()).reshape(
                len(lengths), len(places), -1
            )
            for places in (fine, coarse)
        ]
        exact, seen = (
            np.einsum("kpm,p->km", values, w)
            for values, w in zip(sampled, (fine_weights, coarse_weights), strict=True)
        )
        unseen.append((abs(exact - seen) * lengths).max(axis=1, initial=0.0))
        average = np.einsum("kpm,p->km", abs(sampled[0]), fine_weights)
        size += float((average * lengths).sum(axis=0).max(initial=0.0))
    return np.concatenate(unseen), size


def _lobatto(count: int) -> tuple[Array, Array]:
    """Compute points in [0, 1] and weights of Gauss-Lobatto quadrature."""
    inner = np.polynomial.legendre.Legendre.basis(count - 1).deriv().roots()
    places = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    at = np.polynomial.legendre.Legendre.basis(count - 1)(places)
    return (1 + places) / 2, 1 / (count * (count - 1) * at**2)
