"""Event location for SUNDIALS' integrators.

The equations are integrated in one mode (of slack strings and contacts) at a time. Each interval
ends shortly after its first event, and the next one starts from there.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.integrators.adaptive import EVENT_SHARE, MAX_INTERPOLATIONS
from tenscasadi.integrators.events import (
    build_hidden,
    build_latch,
    build_mode_ode,
    build_potential,
    build_root,
    count_breakable,
    count_switches,
)
from tenscasadi.integrators.scheme import extent
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.util.casadi_tools import hermite_cubic
from tenscasadi.util.validate import NEGLIGIBLE, Array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

_PARTS = 4  # parts of an interval, each sampled at its ends and its middle


class _ModeInterval(NamedTuple):
    """Trajectory in one mode over h seconds from state z.

    The input u is the control and the parameters, and `mode` has 1 for each taut string and closed
    contact, else 0. `rows` are states at equal times. z has nz entries: the state x, followed by
    the energy supplied [J] if that is computed.
    """

    z: Array
    u: Array
    mode: Array
    rows: Array  # z at equal times (2 * _PARTS, nz)
    h: float

    @property
    def after(self) -> Array:
        """Final state, followed by the energy supplied."""
        last: Array = self.rows[-1]
        return last


class EventSteps:
    """Time steps of SUNDIALS' integrators with located events.

    `events` counts the mode changes, `trials` the integrations to locate them. With `power`, z has
    an entry for the energy supplied [J] below the state. `pause` is called before each integration
    and may raise to end the steps.
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
            model.moving,
        )
        work = build_mode_ode(model, work=True) if power else None
        self._equations = scheme.equations(model, work, held=True)
        self._start, self._power = scheme.algebraic_start(model), power
        self._advance = scheme.advance_in_mode(model, work, 2 * _PARTS)
        self._ode, self._potential = build_mode_ode(model), build_potential(model)
        self._switches = count_switches(model)
        self._latch = build_latch(model, power) if count_breakable(model) else None
        self._look_at = _build_look(
            model, gaps, self._ode, 10.0 * (self._atol + self._rtol * extent(model))
        )
        self._root = build_root(gaps, model)
        self._integrators: dict[
            tuple[int, float], ca.Function
        ] = {}  # by number and length of grid steps
        self._ahead: int | None = (
            None  # grid steps per call, doubled after each one without events; None: all
        )
        self.events = self.trials = 0

    def __call__(self, z: Array, u: Array, lengths: Array) -> Array:
        """Integrate time steps of equal length with constant input u.

        z (nz,) is the initial state, and u (nw,) the control with the parameters. `lengths`
        (steps,) are the equal lengths [s]. Returns z after each step (steps, nz).
        """
        rows: list[Array] = []
        step, z = float(lengths[0]), self._break_strings(z, u)
        while (rest := len(lengths) - len(rows)) > 0:
            many = rest if self._ahead is None else min(rest, self._ahead)
            try:
                found = self._integrate(z, u, step, many)
            except RuntimeError:
                if many == 1:
                    raise
                self._ahead = 1  # a mode extended past its end may fail
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

    def _break_strings(self, z: Array, u: Array) -> Array:
        return z if self._latch is None else np.asarray(self._latch(z, u).full().ravel())

    def _stack(self, u: Array, mode: Array) -> Array:
        """Stack the input u and the modes of strings and contacts.

        Modes of strings that break are not inputs. u (nw,) is the control with the parameters, and
        `mode` the values of all switching functions as 1 or 0.
        """
        return np.concatenate([u, mode[: self._switches]])

    def _integrate(self, z: Array, u: Array, step: float, many: int) -> list[Array]:
        """Integrate `many` time steps up to the first possible event.

        z (nz,) is the initial state, u the control with the parameters, and `step` the length of a
        time step [s]. Returns z after each step without an event.
        """
        self._pause()
        if (many, step) not in self._integrators:
            times = (np.arange(1, 2 * _PARTS * many + 1) * (step / 2 / _PARTS)).tolist()
            self._integrators[many, step] = self._scheme.integrator(
                self._equations, times, self._atol
            )
        mode = self._mode(z, u)
        guess = {} if self._start is None else {"z0": self._start(z[: self._nx], u)}
        rows = self._integrators[many, step](x0=z, u=self._stack(u, mode), **guess)["xf"].full().T
        shares, seen = self._look(z, rows, u, mode, many * step)
        quiet = ((shares == 0).all(axis=0) & seen).reshape(many, _PARTS).all(axis=1)
        smooth = many if quiet.all() else int(np.argmin(quiet))
        return list(
            self._convert_work(z, u, rows)[2 * _PARTS - 1 : 2 * _PARTS * smooth : 2 * _PARTS]
        )

    def _look(self, z: Array, rows: Array, u: Array, mode: Array, h: float) -> tuple[Array, Array]:
        """Detect mode changes in each part of an interval.

        The interval has the length h [s], the initial state z, the input u, the initial `mode`, and
        the states `rows` at equal times, two for each part. Returns the fractions of each part at
        which the mode differs (4, parts), see `_build_look`, and whether the interpolation resolves
        the part (parts,).
        """
        ends, parts = np.vstack([z, rows])[:, : self._nx].T, len(rows) // 2
        held = [np.tile(value[:, None], parts) for value in (u, np.array([h / parts]), mode)]
        shares, seen = self._look_at(ends[:, :-1:2], ends[:, 1::2], ends[:, 2::2], *held)
        return shares.full(), seen.full()[0] == 1

    def _piece(self, z: Array, u: Array, mode: Array, h: float) -> _ModeInterval:
        self._pause()
        return _ModeInterval(
            z,
            u,
            mode,
            self._convert_work(z, u, self._advance(z, self._stack(u, mode), h).full().T),
            h,
        )

    def _convert_work(self, z: Array, u: Array, rows: Array) -> Array:
        """Convert the work of all forces to the energy supplied from outside.

        It adds the increase of the model's stored energy since z to the last entry (the work) of
        each state in `rows`. u is the control with the parameters.
        """
        if self._power:
            rows[:, self._nx] += self._potential(rows[:, : self._nx].T, u).full().ravel() - float(
                self._potential(z[: self._nx], u)
            )
        return rows

    def _cross(self, z: Array, u: Array, step: float) -> Array:
        """Integrate a time step in which events are possible.

        It has the length `step` [s], the initial z, and the input u: control and parameters.
        Returns the final z.
        """
        rest, h, mode = step, step, self._mode(z, u)
        for _ in range(self._scheme.max_steps):
            piece = self._piece(z, u, mode, min(h, rest))
            shares, seen = self._look(z, piece.rows, u, mode, piece.h)
            if not seen.all() and piece.h > NEGLIGIBLE * step:
                h = piece.h / 2
                continue
            for share in (((np.arange(_PARTS) + shares) / _PARTS).T[shares.T > 0]).tolist():
                if share * piece.h > NEGLIGIBLE * step:
                    part = piece if share == 1 else self._piece(z, u, mode, share * piece.h)
                    if (self._mode(part.after, u) != mode).any():
                        piece = self._locate(part, step)
                        break
            rest, h = rest - piece.h, max(h, 2 * piece.h)
            self.events += int((self._mode(piece.after, u) != mode).sum())
            z = self._break_strings(piece.after, u)
            mode = self._mode(z, u)
            if rest <= 0:
                return z
        raise RuntimeError(
            f"{self._scheme.max_steps} pieces from event to event did not reach the end of a grid step of {step:g} s"
        )

    def _locate(self, high: _ModeInterval, step: float) -> _ModeInterval:
        """Shorten an interval to end just after its first event.

        The overshoot is within the tolerance. `high` is an interval that ends after the event, and
        `step` the length of the time step [s].
        """
        low = 0.0
        for trial in count():
            jump = self._jump(high)
            slopes = [
                self._ode(end[: self._nx], self._stack(high.u, high.mode))
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
            if (high.h - root) * jump <= EVENT_SHARE or high.h - low <= 1e-14 * step:
                break
            aim = root + EVENT_SHARE / jump / 2
            if trial >= MAX_INTERPOLATIONS or not low < aim < high.h:
                aim = (low + high.h) / 2
            self.trials += 1
            shorter = self._piece(high.z, high.u, high.mode, aim)
            if (self._mode(shorter.after, high.u) != high.mode).any():
                high = shorter
            else:
                low = aim
        return high

    def _jump(self, piece: _ModeInterval) -> float:
        """Compute the change of ẋ at the final mode change.

        It is relative to the tolerance. `piece` is the interval that ends with the mode change.
        """
        moving, x = self._moving, piece.after[: self._nx]
        later = self._break_strings(piece.after, piece.u)[: self._nx]
        slopes = [
            self._ode(at, self._stack(piece.u, mode)).full().ravel()[moving]
            for at, mode in ((x, piece.mode), (later, self._mode(x, piece.u)))
        ]
        scale = self._atol + self._rtol * np.maximum(abs(piece.z[moving]), abs(x[moving]))
        return float(np.sqrt(np.mean(((slopes[1] - slopes[0]) / scale) ** 2)))


def _build_look(model: Model, gaps: ca.Function, ode: ca.Function, floor: float) -> ca.Function:
    """Build the detection of mode changes within an interval.

    `gaps` are the switching functions of `build_events`, and `ode` is the Function of
    `build_mode_ode`. Function (x before, half-way and after, u, h, mode) → fractions (4,) of the
    interval at which the mode differs, and whether the interpolation resolves the interval.
    Fractions are in order of time, 0 where the mode is the same; two come from interpolation. An
    interval is unresolved if its interpolation differs from the state half-way. `floor` [m] is the
    error of the states themselves.
    """
    before, middle, after = (ca.MX.sym(name, model.nx) for name in ("before", "middle", "after"))
    u, h, mode = ca.MX.sym("u", model.nw), ca.MX.sym("h"), ca.MX.sym("mode", gaps.size1_out(0))
    w, hidden = ca.vertcat(u, mode[: count_switches(model)]), build_hidden(gaps, model)
    slopes = [ode(x, w) for x in (before, middle, after)]
    first = hidden(before, slopes[0], middle, slopes[1], u, h / 2, mode) / 2
    second = hidden(middle, slopes[1], after, slopes[2], u, h / 2, mode)
    changed = [ca.sum1((gaps(x, u) > 0) != mode) > 0 for x in (middle, after)]
    between = gaps(hermite_cubic(before, slopes[0], after, slopes[2], h, 0.5), u)
    largest = ca.fmax(
        ca.fabs(gaps(before, u)), ca.fmax(ca.fabs(gaps(middle, u)), ca.fabs(gaps(after, u)))
    )
    # An interpolation error of 0.1 % of a switching function leaves its sign reliable.
    seen = ca.mmax(ca.fabs(between - gaps(middle, u)) - 1e-3 * largest) <= floor
    times = ca.vertcat(
        first, changed[0] / 2, ca.if_else(second > 0, (1 + second) / 2, 0), changed[1]
    )
    return ca.Function("look", [before, middle, after, u, h, mode], [times, seen])
