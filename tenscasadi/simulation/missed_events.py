"""How far steps put a run off, through events within them or as they are too long: the run is taken again, in longer and in shorter steps."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_switching, count_switches
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.control_input import SampledControl
from tenscasadi.simulation.steppers import LoopStepper, StepFailure, Stepper
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array, Indices

_FEW, _SHARE = (
    300,
    64,
)  # longer steps that a run is taken again in, at most, or this part of its own
_MORE, _MORE_SHARE = 1600, 32  # the same where these do not follow it
_WHOLE = (
    600,
    1600,
)  # steps of a run that is taken again in halves as a whole: where longer ones do not follow it, where they follow nowhere
_FEWEST, _PIECE = 200, 100  # steps of the piece of a longer one, at least, and as a part of the run
_COMPARED, _LOOKS = 30, 100  # kept rows at which runs are compared, and contacts are looked for
_SPOKEN = 0.01  # of the motion: what the message speaks of
_LOST = 1e-3  # of the energy that moves: where steps lose more, the piece begins
_ROUNDING = 1e-9  # of the structure's size
_BEYOND = 10.0  # of the largest entry of the run's states: steps that lead there have broken down
_FIRST_CALL = 32  # steps: each call takes twice as many
_AT_ONCE, _OFTEN = (
    65536,
    0.1,
)  # steps whose controls are compared at once; of all: controls that change at more steps are taken as smooth
_UNEVEN = 1e-6  # of the longest step: what is shorter by more is cut
_FINER = 0.25  # of the step, as a cure: errors at events fall about like the step


def describe_missed_events(
    model: Model, stepper: Stepper, inputs: SampledControl, rows: Array, run: Trajectory
) -> str:
    """Say how far the steps put a run off that finished, where that shows, and the cure; "" where it does not.

    Steps that do not end where strings go slack or taut and where nodes meet or leave a ground lose
    their order there, others are too long for what vibrates, and motions may let errors grow. The
    run is taken again in steps twice as long, or longer: where these end at the same place, so do
    its own. Elsewhere half as long ones tell, or in long runs what becomes of the difference as
    steps get shorter. rows (R, nz): z at the kept times.
    """
    if not isinstance(stepper, LoopStepper):
        return ""
    again = Repetition(model, stepper, inputs, rows, run)
    off = again.find_error()
    if not off > again.least:
        return ""
    if _first_change(model, run) is None:
        return f"; its steps, too long for the fastest that moves, put it off by some {off:.1g} m: try step={_FINER * run.step:.2g}"
    events = "strings that go slack or taut" + (" and contacts" if model.scene.grounds else "")
    return (
        f"; {events} within its steps put it off by some {off:.1g} m: "
        f"try DormandPrince853(rtol=1e-6), which ends its steps there, or step={_FINER * run.step:.2g}"
    )


class Repetition:
    """A run that is taken again in other steps."""

    def __init__(
        self, model: Model, stepper: Stepper, inputs: SampledControl, rows: Array, run: Trajectory
    ) -> None:
        self.model, self.stepper, self.inputs, self.rows, self.run = (
            model,
            stepper,
            inputs,
            rows,
            run,
        )
        self.times = inputs.times(np.arange(inputs.steps + 1))
        self.kept = np.searchsorted(self.times, run.time)  # steps before each row
        self.motion = float(np.ptp(run.nodes, axis=0).max())
        self.least = max(_SPOKEN * self.motion, _ROUNDING * extent(model))
        self.beyond = _BEYOND * float(np.abs(run.states).max(initial=0.0))
        self.rows_tell = len(self.kept) == inputs.steps + 1
        self.changes = (
            self._find_changes() if inputs.varies and (self.rows_tell or not inputs.asks) else None
        )

    def _window(self, first: int, count: int) -> Array:
        """Return the control (count, nw) of the steps from `first` on, without asking the user's function again."""
        if not self.inputs.asks:
            return self.inputs.window(first, count)
        own = self.run.control[first : first + count]
        return np.hstack(
            [own, np.broadcast_to(self.run.parameters, (len(own), len(self.run.parameters)))]
        )

    def _find_changes(self) -> NDArray[np.bool_]:
        """Tell at which steps the control changes (steps,), where it is held most of the time."""
        steps, parts = self.inputs.steps, [np.zeros(1, dtype=bool)]
        for first in range(0, steps - 1, _AT_ONCE):
            held = self._window(first, min(_AT_ONCE + 1, steps - first))
            parts.append((held[1:] != held[:-1]).any(axis=1))
        changes = np.concatenate(parts)
        return changes & bool(changes.mean() < _OFTEN)

    def find_error(self) -> float:
        """Return how far nodes are off, m, as far as longer and shorter steps tell; 0 where it is less than `least`."""
        if self.inputs.varies and self.changes is None:
            return self.error_of_piece()
        steps, times, least = self.inputs.steps, 2, self.least
        while steps / times > max(_FEW, steps / _SHARE):
            times *= 2
        apart = [np.inf, self.apart(times)]
        most = max(_MORE, steps / _MORE_SHARE)
        while (
            apart[-1] > least
            and times > 2
            and 2 * steps / times <= (most if apart[-2] < np.inf else 2 * most)
        ):
            times //= 2
            apart.append(self.apart(times))
        if apart[-1] <= least:
            return 0.0
        followed = apart[-2] < np.inf
        if steps <= _WHOLE[not followed]:
            return self.apart_in_halves()
        if not followed:
            return self.error_of_piece()
        # Errors are as (length of steps)^q, differences as (2t)^q - 1 to t^q - 1; at events, where
        # they scatter, q is taken as 1 at least.
        factor = max(apart[-2] / apart[-1] - 1.0, 2.0)
        return float(apart[-1] / (factor ** np.log2(times) - 1.0))

    def apart(self, times: int) -> float:
        """Return how far steps so many times as long, cut where the run's are, lead from it, m; ∞ where that is further than it moves."""
        steps = self.inputs.steps
        lengths = self.inputs.lengths(0, steps)
        cut = lengths < (1 - _UNEVEN) * self.inputs.longest
        begin = np.arange(steps) % times == 0
        begin |= cut
        begin[1:] |= cut[:-1]
        if self.changes is not None:
            begin |= self.changes
        begins = np.flatnonzero(begin)
        ends = np.append(begins[1:], steps)
        common = np.flatnonzero(np.isin(self.kept, ends))
        common = common[np.unique(np.linspace(0, len(common) - 1, _COMPARED).astype(np.intp))]
        after = self._march(
            self.rows[0],
            begins,
            np.add.reduceat(lengths, begins),
            steps,
            np.searchsorted(ends, self.kept[common]),
        )
        apart = self._distance(self.rows[common], after)
        return apart if apart < max(self.motion, self.least) else np.inf

    def apart_in_halves(self) -> float:
        """Return how far steps half as long lead from the run, m; 0 where they break down, and nothing is known."""
        steps, begins = self.inputs.steps, np.arange(self.inputs.steps)
        known = np.unique(np.linspace(1, len(self.kept) - 1, _LOOKS).astype(np.intp))
        halves = np.repeat(self.inputs.lengths(0, steps) / 2, 2)
        apart = self._distance(
            self.rows[known],
            self._march(
                self.rows[0], np.repeat(begins, 2), halves, steps, 2 * self.kept[known] - 1
            ),
        )
        return apart if np.isfinite(apart) else 0.0

    def error_of_piece(self) -> float:
        """Return what halves of the steps tell in a piece with its first control held, m, for the whole run; 0 where they break down.

        It begins at the first event that shows, or where most energy is lost; near the end of a
        run, a piece before it.
        """
        run, steps = self.run, self.inputs.steps
        count = min(max(_FEWEST, steps // _PIECE), steps)
        changed = _first_change(self.model, run)
        row = (
            int(np.abs(np.diff(run.energy_error)).argmax())
            if changed is None or _loses_energy(run)
            else changed
        )
        row = max(0, min(row, int(np.searchsorted(self.kept, steps - count, "right")) - 1))
        first, held = int(self.kept[row]), np.append(run.control[row], run.parameters)
        begins, lengths, every = (
            np.arange(first, first + count),
            self.inputs.lengths(first, count),
            np.arange(count),
        )
        whole = self._march(self.rows[row], begins, lengths, first + count, every, held)
        halves = self._march(
            self.rows[row],
            np.repeat(begins, 2),
            np.repeat(lengths / 2, 2),
            first + count,
            2 * every + 1,
            held,
        )
        apart = self._distance(whole, halves)
        return (
            apart
            * float((run.time[-1] - run.time[row]) / (self.times[first + count] - run.time[row]))
            if np.isfinite(apart)
            else 0.0
        )

    def _distance(self, states: Array, others: Array) -> float:
        if len(others) < len(states):
            return np.inf
        nodes = [self.model.nodes(z[:, : self.model.nx]) for z in (states, others)]
        return float(np.linalg.norm(nodes[1] - nodes[0], axis=2).max())

    def _march(
        self,
        z: Array,
        begins: Indices,
        lengths: Array,
        last: int,
        keep: Indices,
        held: Array | None = None,
    ) -> Array:
        """Return z (k, nz) after those of the steps that are to be kept; fewer rows where they break down.

        begins: steps of the run with which they begin, before step `last`; their control is the
        mean of the run's in them, or `held` (nw,). lengths: s.
        """
        found, bounds, begin, most = [], np.append(begins, last), 0, _FIRST_CALL
        while begin < len(begins):
            count = min(most, self.stepper.steps, len(begins) - begin)
            self.stepper.hold(
                self._controls(bounds[begin : begin + count + 1], held),
                np.resize(lengths[begin : begin + count], self.stepper.steps),
            )
            try:
                after = self.stepper(z, count)
            except StepFailure:
                break
            z = after[count - 1].copy()
            if not np.abs(z[: self.model.nx]).max(initial=0.0) <= self.beyond:
                break
            found.append(after[keep[(keep >= begin) & (keep < begin + count)] - begin])
            begin, most = begin + count, 2 * most
        return np.concatenate(found) if found else np.empty((0, len(z)))

    def _controls(self, bounds: Indices, held: Array | None) -> Array:
        """Return the control of steps between these of the run, and the last one again, as many as the stepper holds."""
        most = self.stepper.steps + 1
        if held is None and not self.inputs.varies:
            held = self.inputs.window(0, 1)[0]
        if held is not None:
            return np.tile(held, (most, 1))
        own = self._window(
            int(bounds[0]), int(max(bounds[-1], bounds[-2] + 1) - bounds[0])
        )  # the last may be half of a step
        means = (
            np.add.reduceat(own, bounds[:-1] - bounds[0]) / np.maximum(np.diff(bounds), 1)[:, None]
        )
        return np.concatenate([means, np.repeat(means[-1:], most - len(means), axis=0)])


def _loses_energy(run: Trajectory) -> bool:
    """Return whether more energy is off than steps leave that follow the motion."""
    parts = run.energy_parts
    moved = float(parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum())
    return bool(np.abs(run.energy_error).max() > _LOST * moved)  # NaN: not known


def _first_change(model: Model, run: Trajectory) -> int | None:
    """Return the kept row after which another string pulls, or another node touches a ground, for the first time; None: there is none."""
    rows = np.arange(len(run.time))
    modes: Any = run.tension[:, model.scene.switching_strings] != 0
    if model.scene.grounds and any(count_switches(model)):
        key = ("switching",)
        if key not in model.functions:
            model.functions[key] = build_switching(model) or ca.Function()
        rows = np.unique(np.linspace(0, rows[-1], min(len(rows), _LOOKS)).astype(np.intp))
        held = np.hstack([run.control[rows], np.tile(run.parameters, (len(rows), 1))])
        modes = model.functions[key].map(len(rows))(run.states[rows].T, ca.DM(held.T)).full().T > 0
    changes = np.flatnonzero((modes[1:] != modes[:-1]).any(axis=1))
    return int(rows[changes[0]]) if len(changes) else None
