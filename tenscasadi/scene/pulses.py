"""Pulses of functions of time: where a function does more within a step than its stages see, and how to cut the steps there."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.scene.over_time import OverTime
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.scene.time_functions import expand, trace
from tenscasadi.util.interval_arithmetic import Flags, UnknownOperation, bound
from tenscasadi.util.validate import Array, Indices

_ORDER = 4  # of the derivative that bounds what a cubic leaves of a function
_LONGEST = 20_000  # instructions of a derivative that are worth bounding
_MOST_PIECES = 200_000  # pieces of a run that are looked at
_MOST_CUTS = 20_000  # besides as many as there are steps
_GROUPS = 64  # parts of a run that are looked at first
_FEWEST = 12  # parts of a piece at whose ends a function is sampled, where no bounds are known
_SAMPLES = 2**14  # parts of a run, at least
_JUMP = 1e-6  # share of the largest value: less is a slope


class Pulses(NamedTuple):
    """Times, s, at which steps are to be cut so that each sees what a function does in it.

    unresolved: time, s, at which that would take too many cuts; None: nowhere.
    """

    cuts: Array
    unresolved: float | None


def is_bounded(load: OverTime | SupportMotion) -> bool:
    """Return whether a pulse of a load is found however short it is; False where functions of time are known by samples alone."""
    functions = _derivatives(load)
    return functions is None or functions.derivative is not None


def find_pulses(load: OverTime | SupportMotion, ends: Callable[[Indices], Array], steps: int, least: float, resolution: float) -> Pulses:
    """Find where a load that is a function of time changes within steps so that they do not see it.

    A step sees a cubic, but for a share of the function's largest value: what the fourth derivative leaves of the function, bounded by
    interval arithmetic over the whole of the step, or how much the function changes at all. Steps that see less are halved until they do.

    Parameters
    ----------
    load : OverTime or SupportMotion
        What changes over time; of supports the acceleration counts.
    ends : callable
        Times, s, at which steps begin, of their numbers from 0 on; at `steps` the last ends.
    steps : int
        Number of steps.
    least : float
        Length of a piece, s, that is not halved any more.
    resolution : float
        Share of the largest value that a step may leave unseen.

    Returns
    -------
    Pulses
        The cuts; none for tables, whose times cut steps already.
    """
    functions = _derivatives(load)
    if functions is None:
        return Pulses(np.empty(0), None)
    edges = np.unique(np.linspace(0, steps, _GROUPS + 1).round().astype(np.intp))
    finest = float(np.ptp(ends(edges[[0, -1]]))) / _SAMPLES
    scale = float(abs(functions.samples(ends(edges))).max(initial=0.0))
    first, last = edges[:-1], edges[1:]  # pieces of several steps
    low, high = np.empty(0), np.empty(0)  # pieces of one step, or of less
    cuts: list[Array] = [np.empty(0)]
    seen = made = 0
    while len(first) or len(low):
        starts, stops = np.concatenate([ends(first), low]), np.concatenate([ends(last), high])
        scale = max(scale, float(abs(functions.samples((starts + stops) / 2)).max(initial=0.0)))
        coarse = (functions.leaves(starts, stops, finest) > resolution * scale) & (stops - starts > least)
        seen += len(starts)
        pieces = coarse[len(first) :]
        middle = (low[pieces] + high[pieces]) / 2
        cuts.append(middle)
        made += len(middle)
        if seen > _MOST_PIECES or made > _MOST_CUTS + steps:
            return Pulses(np.empty(0), float(starts[coarse][0]))
        a, b = first[coarse[: len(first)]], last[coarse[: len(first)]]
        single, half = b - a == 1, (a + b) // 2
        low = np.concatenate([low[pieces], middle, ends(a[single])])
        high = np.concatenate([middle, high[pieces], ends(b[single])])
        first = np.concatenate([a[~single], half[~single]])
        last = np.concatenate([half[~single], b[~single]])
    return Pulses(np.unique(np.concatenate(cuts)), None)


def find_jumps(load: OverTime | SupportMotion, times: Array, around: float, first: float, last: float) -> Flags:
    """Return whether a load jumps within `around` s of each of `times` (k,) in a run from `first` to `last`, s; a kink is no jump."""
    functions = _derivatives(load)
    if functions is None:
        return np.zeros(len(times), dtype=bool)
    before, after = functions.samples(times - around), functions.samples(times + around)
    some = functions.samples(np.linspace(first, last, _GROUPS + 1))
    return np.asarray(abs(after - before).max(axis=0) > _JUMP * max(abs(values).max(initial=0.0) for values in (some, before, after)))


class _Functions(NamedTuple):
    """A function of time as a column of m entries, and the derivative of it that is bounded; None: of no order."""

    value: ca.Function
    derivative: ca.Function | None
    order: int

    def samples(self, times: Array) -> Array:
        """Return the values (m, k) at times (k,), s."""
        return np.asarray(self.value(times[None]).full()).reshape(-1, len(times), order="F") if len(times) else np.empty((1, 0))

    def leaves(self, starts: Array, stops: Array, finest: float) -> Array:
        """Return how much at most a polynomial of lower order leaves of the function in each piece, or how far its values are apart (k,).

        finest: distance of samples, s, where no bounds are known.
        """
        half = (stops - starts) / 2
        if self.derivative is None:
            places = np.linspace(0, 1, max(_FEWEST, int(2 * half.max() / finest)) + 1)
            times = starts + 2 * half * places[:, None]
            values = self.samples(times.ravel()).reshape(-1, *times.shape)  # m × samples × pieces
            powers = np.vander(2 * places - 1, _ORDER)
            fitted = np.einsum("sp,mpk->msk", powers, np.einsum("ps,msk->mpk", np.linalg.pinv(powers), values))
            return np.asarray(np.minimum(abs(values - fitted).max(axis=(0, 1)), np.ptp(values, axis=1).max(axis=0)))
        changes, slopes = bound(self.value, starts, stops), bound(self.derivative, starts, stops)
        reach = np.maximum(abs(slopes.low), abs(slopes.high)).max(axis=0)
        with np.errstate(over="ignore", invalid="ignore"):
            remainder = np.where(changes.switches, np.inf, reach * half**self.order / factorial(self.order))
        return np.asarray(np.fmin(remainder, (changes.high - changes.low).max(axis=0)))


@lru_cache(maxsize=32)  # many runs of one scene look once
def _derivatives(load: OverTime | SupportMotion) -> _Functions | None:
    if isinstance(load, OverTime) and not load.is_function:
        return None
    traced = trace(load.at) if isinstance(load, OverTime) else load.accelerations()
    t = ca.SX.sym("t")
    column = expand(traced, t)
    if column is None:  # what cannot be expanded is sampled
        return _Functions(_of_column(traced), None, 0)
    column = column[[k for k in range(column.numel()) if ca.depends_on(column[k], t)]]
    if not column.numel():
        return None
    value = ca.Function("value", [t], [column])
    derivative, order = value, 0
    while order < _ORDER:
        try:
            further = ca.Function("derivative", [t], [ca.densify(ca.cse(ca.jacobian(derivative(t), t)))])
        except RuntimeError:  # of splines CasADi has few derivatives
            break
        if further.n_instructions() > _LONGEST:
            break
        derivative, order = further, order + 1
    try:
        bound(value, np.zeros(1), np.ones(1))
        bound(derivative, np.zeros(1), np.ones(1))
    except UnknownOperation:
        return _Functions(value, None, 0)
    return _Functions(value, derivative, order)


def _of_column(function: ca.Function) -> ca.Function:
    t = ca.MX.sym("t")
    return ca.Function("value", [t], [ca.vec(function(t))])
