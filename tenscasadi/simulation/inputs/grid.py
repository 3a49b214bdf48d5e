"""Time grid of a run, with breakpoints at interval ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import clock_error, sample_times
from tenscasadi.scene.time_functions import values_at
from tenscasadi.simulation.engine.request import Integers, Intervals
from tenscasadi.util.validate import Array, Indices


class Changing(Protocol):
    """Time-varying part of a model.

    It is a load, a support motion, or a control.
    """

    @property
    def field(self) -> str:
        """Name of the quantity in messages."""

    def check_run(self, first: float, last: float) -> None:
        """Check the function between the times `first` and `last` [s].

        Raises ValueError.
        """

    def find_breakpoints(self, first: float, last: float) -> Array:
        """Find the times of jumps and kinks [s].

        They lie between `first` and `last` [s].
        """

    def changing(self) -> ca.Function | None:
        """Build the function of time that steps must resolve, or None.

        Steps end at jumps of its first output, and must resolve all outputs.
        """


@dataclass(frozen=True, eq=False)
class Grid:
    """Time grid of a run, with equal steps in each of K intervals.

    Attributes
    ----------
    edges : ndarray, shape (K + 1,)
        Ends of the intervals, from 0 [s].
    counts : ndarray, shape (K,)
        Number of steps in each interval.
    rows : ndarray, shape (K,)
        Row of the control that is constant in each interval.
    early : float
        Reduction of the last interval [s], at most the rounding error of the clock. It is not 0 if
        a function of time is not finite after the end of the run.
    """

    edges: Array
    counts: Integers
    rows: Indices
    early: float = 0.0

    @cached_property
    def steps(self) -> int:
        """Number of steps."""
        return int(self.counts.sum())

    @property
    def t_end(self) -> float:
        """End of the run [s]."""
        return float(self.edges[-1])

    @property
    def step(self) -> float:
        """Mean step [s]."""
        return self.t_end / self.steps

    @cached_property
    def lengths(self) -> Array:
        """Length of the steps in each interval (K,) [s]."""
        lengths = np.diff(self.edges) / self.counts
        equal = abs(lengths - self.step) <= 1e-12 * self.step  # but for rounding
        lengths = np.where(equal, self.step, lengths)
        lengths[-1] -= self.early / self.counts[-1]
        return lengths

    @property
    def longest(self) -> float:
        """Longest step [s]."""
        return float(self.lengths.max())

    @property
    def intervals(self) -> Intervals:
        """Intervals of the grid as arguments of the time loop."""
        return Intervals(self.rows, self.counts, self.lengths)

    def times(self, steps: Indices) -> Array:
        """Compute the start times of steps [s] from step numbers.

        The step number `self.steps` denotes the end of the run.
        """
        if not np.ptp(self.lengths):
            return np.where(steps == self.steps, self.t_end, steps * self.step)
        begins = np.cumsum(self.counts) - self.counts
        place = np.searchsorted(begins, steps, side="right") - 1
        times = self.edges[place] + (steps - begins[place]) * self.lengths[place]
        return np.where(steps == self.steps, self.t_end, times)

    def locate(self, steps: Indices) -> Indices:
        """Find the number of the interval that contains each step.

        Steps past the end belong to the last interval.
        """
        return np.searchsorted(np.cumsum(self.counts), np.minimum(steps, self.steps - 1), "right")

    def scale_steps(self, factor: float) -> Grid:
        """Change the step lengths by about a factor.

        Before, neighboring intervals with the same control and about equal steps are merged.
        """
        if factor < 1:
            return Grid(self.edges, _divide(self.counts, factor), self.rows, self.early)
        change = np.diff(self.rows) != 0
        change |= abs(np.diff(self.lengths)) > 1e-6 * self.longest
        begins = np.flatnonzero(np.append(True, change))
        edges = np.append(self.edges[begins], self.t_end)
        counts = np.add.reduceat(self.counts, begins)
        return Grid(edges, _divide(counts, factor), self.rows[begins], self.early)


def _divide(counts: Integers, factor: float) -> Integers:
    return np.maximum(1, np.ceil(counts / factor)).astype(np.int64)


def build_grid(
    edges: Array, step: float, changing: Sequence[Changing], first: float, fewest: int = 1
) -> Grid:
    """Build the time grid of a run.

    Parameters
    ----------
    edges : ndarray, shape (K + 1,)
        Ends of the intervals with constant control, from 0 to the end of the run [s].
    step : float
        Largest step [s].
    changing : sequence of Changing
        Time-varying parts of the model, at whose breakpoints steps end.
    first : float
        Initial time of the clock [s].
    fewest : int
        Smallest number of steps of an interval.

    Returns
    -------
    Grid
        The fewest equal steps in each interval.

    Raises
    ------
    TypeError, ValueError
        A function of time is not finite or moves supports by a jump; the message names it.
    """
    t_end = float(edges[-1])
    if t_end / step > 1e12:
        raise ValueError(
            f"step is {step:g}: t_end = {t_end:g} would take {t_end / step:.1g} steps, give a larger step or a smaller t_end"
        )
    last = first + t_end
    for part in changing:
        part.check_run(first, last)
    error = clock_error(first, last, int(t_end / step) + len(edges))
    cuts = [_find_cuts(part, first, last, error) for part in changing]
    all_edges = _add_cuts(edges, np.concatenate(cuts) - first, error) if changing else edges
    counts = np.maximum(fewest, np.ceil(np.diff(all_edges) / step * (1 - 1e-9))).astype(np.int64)
    rows = np.searchsorted(edges, all_edges[:-1], side="right") - 1
    beyond = np.array([last + error])
    functions = [part.changing() for part in changing]
    finite = all(f is None or np.isfinite(values_at(f, beyond)).all() for f in functions)
    # Rounding error may take the clock past the end, where a function need not be finite.
    return Grid(all_edges, counts, rows, 0.0 if finite else error)


def _add_cuts(edges: Array, cuts: Array, error: float) -> Array:
    """Add breakpoints to the ends of intervals [s].

    The breakpoints are `cuts`, and the ends `edges`. Breakpoints that equal other ends within the
    rounding error `error` are omitted.
    """
    t_end = float(edges[-1])
    inner = cuts[(cuts > 0) & (cuts < t_end)]
    place = np.clip(np.searchsorted(edges, inner), 1, len(edges) - 1)
    away = np.minimum(abs(inner - edges[place]), abs(inner - edges[place - 1]))
    inner = np.unique(inner[away > max(error / 2, 4 * np.spacing(t_end))])
    inner = inner[np.append(True, np.diff(inner) > 4 * np.spacing(t_end))[: len(inner)]]
    return np.union1d(edges, inner)


def _find_cuts(part: Changing, first: float, last: float, error: float) -> Array:
    """Find the times at which steps must end [s].

    They depend on the function of `part`. They lie between `first` and `last` [s]. Each jump lies
    within a very short step of its own, so that no Runge-Kutta stage evaluates it. `error` is the
    rounding error of the clock [s].
    """
    times, function = part.find_breakpoints(first, last), part.changing()
    if function is None or not len(times):
        return times
    before, after = values_at(function, times - 2 * error), values_at(function, times + 2 * error)
    some = values_at(function, sample_times(first, last))
    largest = max(abs(values).max(initial=0.0) for values in (some, before, after))
    jumps = abs(after - before).max(axis=1, initial=0.0) > 1e-6 * largest
    return np.concatenate([times[~jumps], times[jumps] - error, times[jumps] + error])
