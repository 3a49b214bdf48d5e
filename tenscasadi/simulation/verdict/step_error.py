"""Step-size error of runs, estimated by repeating them.

Runs with fixed steps h are repeated with 2 h and 4 h, unless the time loop has already computed
them in unused SIMD lanes. If those differ too much, they are repeated with h/2. Runs with error
control are repeated with another tolerance if it determines their steps.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.engine.request import FINISHED
from tenscasadi.simulation.engine.roll import COMPARED, Request, Runs, roll
from tenscasadi.simulation.verdict.thresholds import THRESHOLDS
from tenscasadi.util.validate import Array, Indices

CLEAR = 0.3  # × reported error: larger differences need finer steps for an estimate


class StepErrors(NamedTuple):
    """Estimated step-size errors of n runs.

    Attributes
    ----------
    error : ndarray, shape (n,)
        Largest error of the node positions [m]; NaN if unknown, inf if the repetitions do not agree at all.
    motion : ndarray, shape (n,)
        Largest displacement of a coordinate during the run [m].
    factor : ndarray, shape (n,)
        Factor by which half the step reduces the error, from 2 to 2^order.
    """

    error: Array
    motion: Array
    factor: Array

    def refinement(self, share: float) -> Array:
        """Compute the step refinement (n,) required for a relative error.

        The error `share` is relative to the displacements. The factors are between 1 and 1000. They
        are those of the step, or of the tolerance for schemes with error control.
        """
        excess = self.error / (share * np.maximum(self.motion, 1e-300))
        return np.asarray(np.clip(excess, 1.0, 1e3) ** (1 / np.log2(self.factor)))


def estimate_errors(runs: Runs) -> StepErrors:
    """Estimate the step-size errors of finished runs.

    The repetitions differ only in their steps.
    """
    found = np.full((3, len(runs.rolled.status)), np.nan)
    which = np.flatnonzero(runs.rolled.status == FINISHED)
    if not len(which):
        return StepErrors(*found)
    again = _Repetition(runs, which)
    least = np.maximum(THRESHOLDS["position"].reported * again.motion, again.rounding)
    estimate = _from_tolerances if runs.request.scheme.adaptive else _from_steps
    found[:, which] = *estimate(again, least), again.motion
    return StepErrors(found[0], found[2], found[1])


def _from_steps(again: _Repetition, least: Array) -> tuple[Array, Array]:
    """Estimate errors [m] and factors (m,) from runs with other steps.

    A factor is the ratio by which half the step length reduces the error. With an error e ∝ step^q,
    the distances to 4 h, 2 h and h/2 are (4^q − 1) e, (2^q − 1) e and (1 − 2^−q) e. Errors above a
    multiple of `least` (m,) [m] are computed again with h/2.
    """
    double = again.compare_steps(2.0)
    factor = _clip_factor(_ratio(again.compare_steps(4.0), double) - 1, again.order)
    largest = _largest(double)
    error = largest / (factor - 1)
    unclear = np.flatnonzero(~(largest <= CLEAR * least))
    if len(unclear):
        half = again.select(unclear).compare_steps(0.5)
        own = _clip_factor(_ratio(double[unclear], half), again.order)
        error[unclear], factor[unclear] = _largest(half) * own / (own - 1), own
    return error, factor


def _from_tolerances(again: _Repetition, least: Array) -> tuple[Array, Array]:
    """Estimate errors [m] and factors (m,) from runs with other tolerances.

    Errors above a multiple of `least` (m,) [m] are computed again with a smaller tolerance. If
    another tolerance does not change a run, its output times determine the steps.
    """
    looser = 10.0
    largest = _largest(again.compare_tolerance(looser))
    error = largest / (looser - 1)
    unclear = np.flatnonzero(~(largest <= CLEAR * least))
    if len(unclear):
        error[unclear] = _largest(again.select(unclear).compare_tolerance(0.01))
    factor = np.full(len(error), 2.0)
    same = np.flatnonzero(largest == 0.0)
    if len(same):
        error[same], factor[same] = _from_steps(again.select(same), least[same])
    return error, factor


def _largest(distances: Array) -> Array:
    """Find the largest distance (m,) over the T times of (m, T).

    It is NaN for runs without a common time.
    """
    return np.asarray(np.fmax.reduce(distances, axis=1, initial=np.nan))


def _ratio(longer: Array, shorter: Array) -> Array:
    """Find the smallest ratio `longer`/`shorter` (m,) over saved times.

    Both are distances (m, T) of m runs from their repetitions with other steps, at T times. Times
    of small distances are ignored. It is NaN if unknown. Runs with steps across events agree only
    by chance: the smallest ratio is then small.
    """
    used = np.isfinite(longer) & (longer >= 0.1 * _largest(longer)[:, None])
    with np.errstate(all="ignore"):
        return np.asarray(
            np.fmin.reduce(np.where(used, longer / shorter, np.nan), axis=1, initial=np.nan)
        )


def _clip_factor(factor: Array, order: int) -> Array:
    """Clip error factors to the range of convergence orders.

    The factors (m,) are those of half the step. Orders are between 1 and `order`.
    """
    return np.clip(np.nan_to_num(factor, nan=2.0), 2.0, 2.0**order)


def _largest_movement(model: Model, changes: Array) -> Array:
    """Compute the largest nodal displacement (m, T) [m].

    `changes` (m, T, nq) are those of positions in the state.
    """
    if model.mechanism.spread is not None:
        entries, free = model.entries, model.entries >= 0
        moved = np.zeros((*changes.shape[:2], *entries.shape))
        moved[..., free] = changes[..., entries[free]]
        return np.asarray(np.linalg.norm(model.place_dependent(moved), axis=3).max(axis=2))
    squares = np.zeros((model.nq + 1, *changes.shape[:2]))  # the last one for prescribed ones
    squares[:-1] = np.moveaxis(changes * changes, 2, 0)
    x, y, z = (squares[column] for column in model.entries.T)
    return np.asarray(np.sqrt(np.max(x + y + z, axis=0, initial=0.0)))


class _Repetition:
    def __init__(self, runs: Runs, which: Indices) -> None:
        self._runs, self._which, self._stopped = runs, which, False
        request, model = runs.request, runs.request.inputs.model
        self.order, self._every = request.scheme.order, request.every
        grid = request.inputs.grid
        self._compared = runs.rolled.compared
        if self._compared is not None:
            self._every = request.compare_every
        elif not (grid.counts % 4).any():  # steps of 4 h end at every fourth one
            self._every *= 4 * (grid.steps // (4 * COMPARED * request.every)) or 1
        steps = np.append(np.arange(0, grid.steps, self._every), grid.steps)
        self._times = runs.times(steps)
        if self._compared is None:
            self._places = runs.saved[which[:, None], -(-steps // request.every), : model.nq]
        else:
            self._places = self._compared[None, :, 0, : model.nq]
        self.motion = np.ptp(self._places, axis=1).max(axis=1, initial=0.0)
        self.rounding = request.rounding

    def select(self, places: Indices) -> _Repetition:
        """Select runs by their indices `places` in this set of repeated runs."""
        chosen = _Repetition(self._runs, self._which[places])
        chosen._stopped = self._stopped
        return chosen

    def compare_steps(self, factor: float) -> Array:
        """Compute displacements (m, T) [m] from runs of another step.

        They are the largest ones of a node. The other step is `factor` times the run's step. They
        are NaN at rows without a common time, and inf if a run has diverged.
        """
        request, nq = self._runs.request, self._places.shape[2]
        if self._compared is not None and factor > 1:
            places = self._compared[:, int(factor) // 2, :nq]
            distances = _largest_movement(request.inputs.model, places[None] - self._places)
            return np.where(np.isfinite(distances), distances, np.inf)
        grid, every = request.inputs.grid, self._every
        other = grid.scale_steps(factor)
        if factor > 1 and other.step < 0.75 * factor * grid.step:
            return np.full(self._places.shape[:2], np.nan)  # breakpoints and controls set the steps
        every = int(every / factor) if every % factor == 0 else every
        return self._compare(
            request._replace(inputs=request.inputs._replace(grid=other), every=every)
        )

    def compare_tolerance(self, factor: float) -> Array:
        """Compute displacements (m, T) [m] from runs of another tolerance.

        They are the largest ones of a node. The other tolerance is `factor` times the run's
        tolerance.
        """
        scheme: Any = self._runs.request.scheme
        rtol = float(np.clip(factor * scheme.rtol, 1e-15, 0.5))
        atol = None if scheme.atol is None else factor * scheme.atol
        other = replace(scheme, rtol=rtol, atol=atol)
        return self._compare(self._runs.request._replace(scheme=other, every=self._every))

    def _compare(self, request: Request) -> Array:
        inputs = request.inputs.select(self._which)
        if self._stopped:
            return np.full(self._places.shape[:2], np.nan)
        other = roll(request._replace(inputs=inputs))
        self._stopped = other.stopped
        steps = np.append(np.arange(0, inputs.grid.steps, request.every), inputs.grid.steps)
        times, model = other.times(steps), inputs.model
        place = np.clip(np.searchsorted(times, self._times), 1, len(times) - 1)
        place = place - (self._times - times[place - 1] < times[place] - self._times)
        common = abs(times[place] - self._times) <= 1e-6 * inputs.grid.longest
        changes = other.saved[:, place[common], : model.nq] - self._places[:, common]
        distances = np.full(self._places.shape[:2], np.nan)
        distances[:, common] = _largest_movement(model, changes)
        distances[other.rolled.status != FINISHED] = np.nan if self._stopped else np.inf
        return distances
