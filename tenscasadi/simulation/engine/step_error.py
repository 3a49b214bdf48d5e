"""Step-size error of a run, estimated by repeating it.

The run is repeated with longer steps or a looser tolerance. If that differs too much, it is
repeated with shorter steps or a tighter tolerance.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.engine.engine import Request, Run, make_kernel
from tenscasadi.simulation.engine.kernel import Watch
from tenscasadi.simulation.engine.request import Intervals, RunPiece
from tenscasadi.util.compile import Single
from tenscasadi.util.validate import Array

_LOOSER = 10.0  # tolerance factor of the first repetition


class StepError(NamedTuple):
    """Estimated error of the node positions [m], NaN if unknown.

    `reported`: the error is large enough for the message.
    """

    error: float
    reported: bool


def estimate_error(request: Request, run: Run, nodes: Array, deadline: float = np.inf) -> StepError:
    """Estimate the step-size error of a finished run.

    `nodes` (T, n, 3) are its node positions. The repetitions differ in their steps alone.
    """
    again = _Repetition(request, run, nodes, deadline)
    if not run.pieces or sum(int(piece.intervals.steps.sum()) for piece in run.pieces) < (
        request.inputs.steps
    ):
        return StepError(np.nan, False)
    coarse = again.compare(2)
    if coarse <= again.least:
        if request.scheme.adaptive:
            return StepError(coarse / (_LOOSER - 1), False)
        coarser = again.compare(4)
        # With an error ∝ step^q, the two differences have the ratio (4^q − 1)/(2^q − 1).
        factor = np.clip(coarser / max(coarse, 1e-300) - 1, 2.0, 2.0**request.scheme.order)
        return StepError(coarse / (factor - 1), False)
    fine = again.compare(0.5)
    if not np.isfinite(fine):
        return StepError(np.nan, False)
    return StepError(fine, fine > again.least)


class _Repetition:
    def __init__(self, request: Request, run: Run, nodes: Array, deadline: float) -> None:
        self._request, self._run, self._nodes, self._deadline = request, run, nodes, deadline
        self.motion = float(np.ptp(nodes, axis=0).max(initial=0.0))
        rounding = 1e-5 if isinstance(request.compiled, Single) else 1e-9  # × extent of the model
        # The message reports errors above 1 % of the motion.
        self.least = max(0.01 * self.motion, rounding * extent(request.model))

    def compare(self, times: float) -> float:
        """Compute the distance to a coarser or finer run [m].

        Steps are `times` as long. Schemes with error control change their tolerance instead.
        Returns inf if the two runs diverge.
        """
        if self._request.scheme.adaptive:
            return self._compare_tolerance(_LOOSER ** (1 if times > 1 else -1))
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
        return self._difference(self._request, RunPiece(intervals, piece.inputs), every)

    def _compare_tolerance(self, factor: float) -> float:
        scheme: Any = self._request.scheme
        rtol = float(np.clip(factor * scheme.rtol, 1e-15, 0.5))
        if rtol == scheme.rtol:
            return np.inf
        atol = None if scheme.atol is None else factor * scheme.atol
        looser = self._request._replace(scheme=replace(scheme, rtol=rtol, atol=atol))
        return self._difference(looser, _join(self._run.pieces), self._request.every)

    def _difference(self, request: Request, piece: RunPiece, every: int) -> float:
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
        distance = np.linalg.norm(other - self._nodes[common], axis=-1).max(initial=0.0)
        return float(distance) if distance < max(self.motion, self.least) else np.inf


def _spans(piece: RunPiece) -> Array:
    return np.asarray(piece.intervals.steps * piece.intervals.length)


def _join(pieces: list[RunPiece]) -> RunPiece:
    """Concatenate the pieces of a run."""
    if len(pieces) == 1:
        return pieces[0]
    offsets = np.cumsum([0, *(piece.inputs.shape[1] for piece in pieces[:-1])])
    rows = [piece.intervals.row + first for piece, first in zip(pieces, offsets, strict=True)]
    columns = zip(*(piece.intervals[1:] for piece in pieces), strict=True)
    intervals = Intervals(np.concatenate(rows), *map(np.concatenate, columns))
    return RunPiece(intervals, np.concatenate([piece.inputs for piece in pieces], axis=1))


def _merge(piece: RunPiece, longest: float) -> RunPiece:
    """Merge intervals of equal control and nearly equal steps.

    Step lengths may differ by rounding.
    """
    row, steps, length = piece.intervals
    held = piece.inputs[0][row]
    other = (held[1:] != held[:-1]).any(axis=1) | (np.abs(np.diff(length)) > 1e-6 * longest)
    begins = np.flatnonzero(np.append(True, other))
    merged = np.add.reduceat(steps, begins)
    spans = np.add.reduceat(steps * length, begins)
    return RunPiece(Intervals(row[begins], merged, spans / merged), piece.inputs)
