"""Error of a run from its repetition: in coarser steps or at a looser tolerance, and where these do not follow it, in finer ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.engine.engine import Request, Run, make_kernel
from tenscasadi.simulation.engine.kernel import Watch
from tenscasadi.simulation.engine.request import Intervals, Piece
from tenscasadi.util.compile import Single
from tenscasadi.util.validate import Array

_SPOKEN = 0.01  # of the motion: errors that the message speaks of
_LOOSER = 10.0  # tolerance of the first repetition


class StepError(NamedTuple):
    """Error that steps leave in the nodes, m, NaN: not known; `told`: whether it is more than what goes without saying."""

    error: float
    told: bool


def estimate_error(request: Request, run: Run, nodes: Array, deadline: float = np.inf) -> StepError:
    """Estimate how far steps put the nodes (T, n, 3) of a run off that finished, by runs that differ in their steps alone."""
    again = _Repetition(request, run, nodes, deadline)
    if not run.pieces or sum(int(piece.intervals.steps.sum()) for piece in run.pieces) < (
        request.inputs.steps
    ):
        return StepError(np.nan, False)
    coarse = again.apart(2)
    if coarse <= again.least:
        if request.scheme.adaptive:
            return StepError(coarse / (_LOOSER - 1), False)
        coarser = again.apart(4)
        # as (length of steps)^q: differences are as 4^q - 1 to 2^q - 1
        factor = np.clip(coarser / max(coarse, 1e-300) - 1, 2.0, 2.0**request.scheme.order)
        return StepError(coarse / (factor - 1), False)
    fine = again.apart(0.5)
    if not np.isfinite(fine):
        return StepError(np.nan, False)
    return StepError(fine, fine > again.least)


class _Repetition:
    def __init__(self, request: Request, run: Run, nodes: Array, deadline: float) -> None:
        self._request, self._run, self._nodes, self._deadline = request, run, nodes, deadline
        self.motion = float(np.ptp(nodes, axis=0).max(initial=0.0))
        rounding = 1e-5 if isinstance(request.compiled, Single) else 1e-9  # of the size, at rest
        self.least = max(_SPOKEN * self.motion, rounding * extent(request.model))

    def apart(self, times: float) -> float:
        """Return how far steps so many times as long lead from the run, m; inf where they do not follow it.

        Of schemes that control their error it is the tolerance that changes.
        """
        if self._request.scheme.adaptive:
            return self._apart_at(_LOOSER ** (1 if times > 1 else -1))
        piece, every = _join(self._run.pieces), self._request.every
        if times > 1:
            piece = _merge(piece, self._request.inputs.longest)
            if np.sum((piece.intervals.steps >= 2 * times) * _spans(piece)) < 0.5 * np.sum(
                _spans(piece)
            ):
                return np.inf
        steps = np.maximum(1, np.ceil(piece.intervals.steps / times)).astype(np.int64)
        every = max(1, every // int(times)) if times > 1 and every % int(times) == 0 else every
        intervals = Intervals(piece.intervals.row, steps, _spans(piece) / steps)
        return self._compare(self._request, Piece(intervals, piece.inputs), every)

    def _apart_at(self, factor: float) -> float:
        scheme: Any = self._request.scheme
        rtol = float(np.clip(factor * scheme.rtol, 1e-15, 0.5))
        if rtol == scheme.rtol:
            return np.inf
        atol = None if scheme.atol is None else factor * scheme.atol
        looser = self._request._replace(scheme=replace(scheme, rtol=rtol, atol=atol))
        return self._compare(looser, _join(self._run.pieces), self._request.every)

    def _compare(self, request: Request, piece: Piece, every: int) -> float:
        steps, lengths = int(piece.intervals.steps.sum()), piece.intervals.length
        with np.errstate(all="ignore"):
            rolled = make_kernel(request).march(
                request.start[None],
                [piece],
                steps,
                every,
                longest=request.inputs.longest,
                watch=Watch(lambda _: None, self._deadline),
            )
        if rolled.status[0] or rolled.saved is None:
            return np.inf
        ends = np.append(0.0, np.cumsum(np.repeat(lengths, piece.intervals.steps)))
        ends[-1] = self._run.time[-1]
        times = ends[np.append(np.arange(0, steps, every), steps)]
        place = np.minimum(
            np.searchsorted(times, self._run.time - 1e-3 * lengths.min()), len(times) - 1
        )
        common = np.abs(times[place] - self._run.time) <= 1e-6 * lengths.max()
        other = request.model.nodes(rolled.saved[0, place[common]])
        apart = np.linalg.norm(other - self._nodes[common], axis=-1).max(initial=0.0)
        return float(apart) if apart < max(self.motion, self.least) else np.inf


def _spans(piece: Piece) -> Array:
    return np.asarray(piece.intervals.steps * piece.intervals.length)


def _join(pieces: list[Piece]) -> Piece:
    """Return pieces that follow each other as one."""
    if len(pieces) == 1:
        return pieces[0]
    offsets = np.cumsum([0, *(piece.inputs.shape[1] for piece in pieces[:-1])])
    rows = [piece.intervals.row + first for piece, first in zip(pieces, offsets, strict=True)]
    columns = zip(*(piece.intervals[1:] for piece in pieces), strict=True)
    intervals = Intervals(np.concatenate(rows), *map(np.concatenate, columns))
    return Piece(intervals, np.concatenate([piece.inputs for piece in pieces], axis=1))


def _merge(piece: Piece, longest: float) -> Piece:
    """Merge intervals of one control whose steps are equally long but for rounding."""
    row, steps, length = piece.intervals
    held = piece.inputs[0][row]
    other = (held[1:] != held[:-1]).any(axis=1) | (np.abs(np.diff(length)) > 1e-6 * longest)
    begins = np.flatnonzero(np.append(True, other))
    merged = np.add.reduceat(steps, begins)
    spans = np.add.reduceat(steps * length, begins)
    return Piece(Intervals(row[begins], merged, spans / merged), piece.inputs)
