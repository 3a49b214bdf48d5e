"""Steps of SUNDIALS' integrators in one mode at a time: each ends shortly after the first event in it, and the next starts from there."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_held_ode, build_hidden, build_potential, build_root
from tenscasadi.integrators.scheme import extent
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.util.casadi_tools import hermite_cubic
from tenscasadi.util.validate import Array

_EVENT_SHARE = (
    0.1  # of the tolerance that a step may lose by ending after an event instead of at it
)
_SHORTEST = 1e-9  # of a grid step: events that are over after less are not looked for
_HALVING = 6  # trials of a bracket after which it is halved, whatever the interpolation says
_PARTS = 4  # of a piece, each of which is seen at its ends and half-way
_SEEN = (
    1e-3  # of a switching function, by which an interpolation may be off and still tell its sign
)


class _Piece(NamedTuple):
    """Motion over h s in one mode: from z, with control and parameters u."""

    z: Array
    u: Array
    mode: Array
    rows: Array  # z at equal times (2 * _PARTS, nz)
    h: float

    @property
    def after(self) -> Array:
        """State at its end, and the energy supplied below it."""
        last: Array = self.rows[-1]
        return last


class EventSteps:
    """Grid steps with their events located; `events` counts the changes of modes, `trials` the pieces integrated to find them.

    power: whether z has an entry for the energy supplied, J, below the state.
    pause: called before each piece is integrated; what it raises ends the steps.
    """

    def __init__(
        self,
        scheme: Sundials,
        model: Model,
        gaps: ca.Function,
        power: bool,
        pause: Callable[[], None],
    ) -> None:
        self._scheme, self._nx, self._gaps, self._pause = scheme, model.nx, gaps, pause
        self._rtol, self._atol, self._moving = (
            scheme.rtol,
            scheme.absolute(model),
            slice(0, 2 * model.nq),
        )
        work = build_held_ode(model, work=True) if power else None
        self._equations = scheme.equations(model, work, held=True)
        self._start, self._power = scheme.algebraic_start(model), power
        self._advance = scheme.advance_held(model, work, 2 * _PARTS)
        self._ode, self._potential = build_held_ode(model), build_potential(model)
        self._look_at = _build_look(
            model, gaps, self._ode, 10.0 * (self._atol + self._rtol * extent(model))
        )
        self._root = build_root(gaps, model)
        self._integrators: dict[
            tuple[int, float], ca.Function
        ] = {}  # by the number and length of the grid steps of a call
        self._ahead: int | None = (
            None  # grid steps to try at once, more the longer ago the last event is; None: all
        )
        self.events = self.trials = 0

    def __call__(self, z: Array, u: Array, lengths: Array) -> Array:
        """Return z after each of the grid steps of these equal lengths (steps, nz), with u held."""
        rows: list[Array] = []
        step = float(lengths[0])
        while (rest := len(lengths) - len(rows)) > 0:
            many = rest if self._ahead is None else min(rest, self._ahead)
            try:
                found = self._integrate(z, u, step, many)
            except RuntimeError:
                if many == 1:
                    raise
                self._ahead = 1  # a mode that is held beyond its end may break down
                continue
            rows += found
            if len(found) < many:
                rows.append(self._cross(found[-1] if found else z, u, step))
                self._ahead = 1
            elif self._ahead is not None:
                self._ahead = 2 * many
            z = rows[-1]
        return np.array(rows)

    def _mode(self, z: Array, u: Array) -> Array:
        mode: Array = (self._gaps(z[: self._nx], u).full() > 0).astype(float).ravel()
        return mode

    def _integrate(self, z: Array, u: Array, step: float, many: int) -> list[Array]:
        """Return z after each of `many` grid steps, up to the first in which something may happen."""
        self._pause()
        if (many, step) not in self._integrators:
            times = (np.arange(1, 2 * _PARTS * many + 1) * (step / 2 / _PARTS)).tolist()
            self._integrators[many, step] = self._scheme.integrator(
                self._equations, times, self._atol
            )
        mode = self._mode(z, u)
        guess = {} if self._start is None else {"z0": self._start(z[: self._nx], u)}
        rows = (
            self._integrators[many, step](x0=z, u=np.concatenate([u, mode]), **guess)["xf"].full().T
        )
        shares, seen = self._look(z, rows, u, mode, many * step)
        quiet = ((shares == 0).all(axis=0) & seen).reshape(many, _PARTS).all(axis=1)
        smooth = many if quiet.all() else int(np.argmin(quiet))
        return list(self._supplied(z, u, rows)[2 * _PARTS - 1 : 2 * _PARTS * smooth : 2 * _PARTS])

    def _look(self, z: Array, rows: Array, u: Array, mode: Array, h: float) -> tuple[Array, Array]:
        """Return the shares of each part at which it is in another mode (4, parts), see `_build_look`, and whether it is seen well (parts,)."""
        ends, parts = np.vstack([z, rows])[:, : self._nx].T, len(rows) // 2
        held = [np.tile(value[:, None], parts) for value in (u, np.array([h / parts]), mode)]
        shares, seen = self._look_at(ends[:, :-1:2], ends[:, 1::2], ends[:, 2::2], *held)
        return shares.full(), seen.full()[0] == 1

    def _piece(self, z: Array, u: Array, mode: Array, h: float) -> _Piece:
        self._pause()
        return _Piece(
            z,
            u,
            mode,
            self._supplied(z, u, self._advance(z, np.concatenate([u, mode]), h).full().T),
            h,
        )

    def _supplied(self, z: Array, u: Array, rows: Array) -> Array:
        """Make the work of all forces the energy supplied: less what of it came out of the model's own energy."""
        if self._power:
            rows[:, self._nx] += self._potential(rows[:, : self._nx].T, u).full().ravel() - float(
                self._potential(z[: self._nx], u)
            )
        return rows

    def _cross(self, z: Array, u: Array, step: float) -> Array:
        """Return z after a grid step in which something may happen."""
        rest, h, mode = step, step, self._mode(z, u)
        for _ in range(self._scheme.max_steps):
            piece = self._piece(z, u, mode, min(h, rest))
            shares, seen = self._look(z, piece.rows, u, mode, piece.h)
            if not seen.all() and piece.h > _SHORTEST * step:
                h = piece.h / 2
                continue
            for share in (((np.arange(_PARTS) + shares) / _PARTS).T[shares.T > 0]).tolist():
                if share * piece.h > _SHORTEST * step:
                    part = piece if share == 1 else self._piece(z, u, mode, share * piece.h)
                    if (self._mode(part.after, u) != mode).any():
                        piece = self._locate(part, step)
                        break
            z, rest, h = piece.after, rest - piece.h, max(h, 2 * piece.h)
            after = self._mode(z, u)
            self.events += int((after != mode).sum())
            mode = after
            if rest <= 0:
                return z
        raise RuntimeError(
            f"{self._scheme.max_steps} pieces from event to event did not reach the end of a grid step of {step:g} s"
        )

    def _locate(self, high: _Piece, step: float) -> _Piece:
        """Return the piece that ends so shortly after the first event in `high` that nothing is lost."""
        low = 0.0
        for trial in count():
            jump = self._jump(high)
            slopes = [
                self._ode(end[: self._nx], np.concatenate([high.u, high.mode]))
                for end in (high.z, high.after)
            ]
            root = float(
                self._root(
                    high.z[: self._nx],
                    slopes[0],
                    high.after[: self._nx],
                    slopes[1],
                    high.u,
                    high.h,
                    high.mode,
                    low,
                    high.h,
                    1,
                )
            )
            if (high.h - root) * jump <= _EVENT_SHARE or high.h - low <= 1e-14 * step:
                break
            aim = root + _EVENT_SHARE / jump / 2
            if trial >= _HALVING or not low < aim < high.h:
                aim = (low + high.h) / 2
            self.trials += 1
            shorter = self._piece(high.z, high.u, high.mode, aim)
            if (self._mode(shorter.after, high.u) != high.mode).any():
                high = shorter
            else:
                low = aim
        return high

    def _jump(self, piece: _Piece) -> float:
        """Return the change of the slope at the end of a piece, where the mode changes, relative to the tolerance."""
        moving, x = self._moving, piece.after[: self._nx]
        slopes = [
            self._ode(x, np.concatenate([piece.u, mode])).full().ravel()[moving]
            for mode in (piece.mode, self._mode(x, piece.u))
        ]
        scale = self._atol + self._rtol * np.maximum(abs(piece.z[moving]), abs(x[moving]))
        return float(np.sqrt(np.mean(((slopes[1] - slopes[0]) / scale) ** 2)))


def _build_look(model: Model, gaps: ca.Function, ode: ca.Function, floor: float) -> ca.Function:
    """Return (x before, half-way and after, u, h, mode) -> shares of a piece at which it is in another mode (4,), and whether it is seen well.

    Shares are in the order of time, 0 where there is none; two are found by interpolation. What an
    interpolation has far from where the motion goes half-way turns too often for that; `floor`, m,
    is what the states themselves may be off.
    """
    before, middle, after = (ca.MX.sym(name, model.nx) for name in ("before", "middle", "after"))
    u, h, mode = ca.MX.sym("u", model.nw), ca.MX.sym("h"), ca.MX.sym("mode", gaps.size1_out(0))
    w, hidden = ca.vertcat(u, mode), build_hidden(gaps, model)
    slopes = [ode(x, w) for x in (before, middle, after)]
    first = hidden(before, slopes[0], middle, slopes[1], u, h / 2, mode) / 2
    second = hidden(middle, slopes[1], after, slopes[2], u, h / 2, mode)
    changed = [ca.sum1((gaps(x, u) > 0) != mode) > 0 for x in (middle, after)]
    between = gaps(hermite_cubic(before, slopes[0], after, slopes[2], h, 0.5), u)
    largest = ca.fmax(
        ca.fabs(gaps(before, u)), ca.fmax(ca.fabs(gaps(middle, u)), ca.fabs(gaps(after, u)))
    )
    seen = ca.mmax(ca.fabs(between - gaps(middle, u)) - _SEEN * largest) <= floor
    times = ca.vertcat(
        first, changed[0] / 2, ca.if_else(second > 0, (1 + second) / 2, 0), changed[1]
    )
    return ca.Function("look", [before, middle, after, u, h, mode], [times, seen])
