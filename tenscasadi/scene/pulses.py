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
_MOST_CUTS = 40_000  # besides as many as there are steps
_GROUPS = 64  # parts of a run that are looked at first
_WORST = 0.01  # of the largest impulse that is left unseen: pieces above are halved at once
_UNBOUNDED = 1e300  # impulse of what has no bounds
_PLACES = np.linspace(0, 1, 5)  # of a step, at which its values are compared
_FEWEST = 12  # parts of a piece at whose ends a function is sampled, where no bounds are known
_SAMPLES = 2**14  # parts of a run, at least
_JUMP = 1e-6  # share of the largest value: less is a slope


class Resolution(NamedTuple):
    """How much a step may leave unseen of a function of time: the larger of two shares.

    of_step: of how far the function's values in the step are apart. of_run: of the function's
    impulse, the integral of its size over the run.
    """

    of_step: float
    of_run: float


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


def find_pulses(
    load: OverTime | SupportMotion,
    ends: Callable[[Indices], Array],
    steps: int,
    least: float,
    resolution: Resolution,
) -> Pulses:
    """Find where a load that is a function of time changes within steps so that they do not see it.

    A step sees a cubic. What the fourth derivative leaves of the function, bounded by interval
    arithmetic over the whole of the step, is to be small against how far its values at five places
    of this very step are apart: what is left out is then not much narrower than the step. Or what
    is left out, or how much the function changes at all, is small as an impulse. Steps of which
    neither holds are halved until one does, the worst first: so that the impulse of the whole is
    known before what is small against it is judged.

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
    resolution : Resolution
        What a step may leave unseen.

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

    def look(first: Indices, last: Indices, starts: Array, stops: Array) -> _Pieces:
        unseen, surely = functions.look(starts, stops, finest, resolution.of_step)
        return _Pieces(
            first, last, starts, stops, np.where(stops - starts > least, unseen, 0.0), surely
        )

    pieces = look(edges[:-1], edges[1:], ends(edges[:-1]), ends(edges[1:]))
    cuts: list[Array] = [np.empty(0)]
    seen, made = len(pieces.first), 0
    while (worst := pieces.unseen.max(initial=0.0)) > (
        enough := resolution.of_run * pieces.surely.sum()
    ):
        halved = pieces.unseen > max(enough, _WORST * worst)
        first, last, starts, stops = (values[halved] for values in pieces[:4])
        inside = last - first <= 1  # of one step, or less: its halves are cut
        middle = (first + last) // 2
        times = np.where(inside, (starts + stops) / 2, ends(middle))
        cuts.append(times[inside])
        seen, made = seen + 2 * len(first), made + int(np.count_nonzero(inside))
        if seen > _MOST_PIECES or made > _MOST_CUTS + steps:
            return Pulses(np.empty(0), float(starts[0]))
        low, high = np.where(inside, first, middle), np.where(inside, last, middle)
        halves = look(
            np.concatenate([first, low]),
            np.concatenate([high, last]),
            np.concatenate([starts, times]),
            np.concatenate([times, stops]),
        )
        pieces = _Pieces(
            *(
                np.concatenate([old[~halved], young])
                for old, young in zip(pieces, halves, strict=True)
            )
        )
    return Pulses(np.unique(np.concatenate(cuts)), None)


class _Pieces(NamedTuple):
    """Parts of a run, each of several steps, of one, or within one: their steps from `first` to `last`, and times, s."""

    first: Indices
    last: Indices
    starts: Array
    stops: Array
    # impulse that a step may leave unseen, at most; 0 where that is little of what it sees
    unseen: Array
    surely: Array  # impulse of the function's size, at least


def find_jumps(
    load: OverTime | SupportMotion, times: Array, around: float, first: float, last: float
) -> Flags:
    """Return whether a load jumps within `around` s of each of `times` (k,) in a run from `first` to `last`, s; a kink is no jump."""
    functions = _derivatives(load)
    if functions is None:
        return np.zeros(len(times), dtype=bool)
    before, after = functions.samples(times - around), functions.samples(times + around)
    some = functions.samples(np.linspace(first, last, _GROUPS + 1))
    return np.asarray(
        abs(after - before).max(axis=0)
        > _JUMP * max(abs(values).max(initial=0.0) for values in (some, before, after))
    )


def is_finite(load: OverTime | SupportMotion, time: float) -> bool:
    """Return whether a load that may be a function of time is finite at a time, s."""
    functions = _derivatives(load)
    return functions is None or bool(np.isfinite(functions.samples(np.array([time]))).all())


class _Functions(NamedTuple):
    """A function of time as a column of m entries, and the derivative of it that is bounded; None: of no order."""

    value: ca.Function
    derivative: ca.Function | None
    order: int

    def samples(self, times: Array) -> Array:
        """Return the values (m, k) at times (k,), s."""
        return (
            np.asarray(self.value(times[None]).full()).reshape(-1, len(times), order="F")
            if len(times)
            else np.empty((1, 0))
        )

    def look(self, starts: Array, stops: Array, finest: float, share: float) -> tuple[Array, Array]:
        """Return the impulse that a step over each piece leaves unseen at most, and that of the function's size at least (k,).

        share: of what the step sees: where less is left, nothing is. finest: distance of samples,
        s, where no bounds are known.
        """
        values = self._across(starts, stops, _PLACES)
        remainder, low, high = self._bounds(starts, stops, finest)
        with np.errstate(invalid="ignore"):
            unseen = np.fmin(remainder, (high - low).max(axis=0))
        visible = remainder <= share * np.ptp(values, axis=1).max(axis=0)
        size = np.maximum(np.maximum(low, -high), 0.0).max(axis=0)
        most = np.nan_to_num(unseen * (stops - starts), nan=_UNBOUNDED, posinf=_UNBOUNDED)
        return np.where(visible, 0.0, most), np.where(np.isfinite(size), size, 0.0) * (
            stops - starts
        )

    def _across(self, starts: Array, stops: Array, places: Array) -> Array:
        """Return the values at `places`, from 0 to 1, of each piece: m × places × k."""
        times = starts + (stops - starts) * places[:, None]
        return self.samples(times.ravel()).reshape(-1, *times.shape)

    def _bounds(self, starts: Array, stops: Array, finest: float) -> tuple[Array, Array, Array]:
        """Return what a polynomial of lower order leaves of the function in each piece at most (k,), and its least and largest values (m, k)."""
        half = (stops - starts) / 2
        if self.derivative is None:
            places = np.linspace(0, 1, max(_FEWEST, int(2 * half.max() / finest)) + 1)
            values = self._across(starts, stops, places)
            powers = np.vander(2 * places - 1, _ORDER)
            fitted = np.einsum(
                "sp,mpk->msk", powers, np.einsum("ps,msk->mpk", np.linalg.pinv(powers), values)
            )
            return abs(values - fitted).max(axis=(0, 1)), values.min(axis=1), values.max(axis=1)
        times = starts + (stops - starts) * _PLACES[:, None]
        parts = (
            times[:-1].ravel(),
            times[1:].ravel(),
        )  # bounds of shorter intervals are closer, but for what switches between them
        changes, slopes = bound(self.value, *parts), bound(self.derivative, *parts)
        low, high, least, most = (
            values.reshape(-1, len(_PLACES) - 1, len(starts))
            for values in (*changes[:2], *slopes[:2])
        )
        reach = np.maximum(abs(least), abs(most)).max(axis=(0, 1))
        with np.errstate(over="ignore", invalid="ignore"):
            remainder = reach * half**self.order / factorial(self.order)
        switches = bound(self.value, starts, stops).switches
        return np.where(switches, np.inf, remainder), low.min(axis=1), high.max(axis=1)


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
            further = ca.Function(
                "derivative", [t], [ca.densify(ca.cse(ca.jacobian(derivative(t), t)))]
            )
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
