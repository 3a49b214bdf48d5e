"""Time loop in Python and CasADi's virtual machine.

Its results equal those of the compiled loop `engine.hpp` to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.integrators.adaptive import ErrorControl, Memory, build_attempt
from tenscasadi.integrators.runge_kutta import build_step
from tenscasadi.simulation.engine.request import (
    BEYOND,
    BROKEN,
    CARRIED,
    FINISHED,
    NOT_FINITE,
    STOPPED,
    STUCK,
    TIRED,
    UNSOLVED,
)
from tenscasadi.simulation.engine.step_code import KernelFunctions
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, Indices

_REST, _NEXT = (Memory._fields.index(name) for name in ("rest", "step"))
Values = Mapping[str, Any]


class StepRows(NamedTuple):
    """Results of k time steps of n runs.

    Attributes
    ----------
    z : ndarray, shape (k, n, nz)
        States and external work after each step.
    effects : ndarray, shape (k, n, 2), or None
        Displacement [m] and energy [J] of each constraint correction; None without.
    code : int
        Code of the reason if a step failed.
    """

    z: Array
    effects: Array | None = None
    code: int = FINISHED


class Before(NamedTuple):
    """States before k steps of n runs.

    Attributes
    ----------
    z : ndarray, shape (k, n, nz)
        States and external work.
    w : ndarray, shape (k, n, nw)
        Stacked inputs in these steps.
    jumped : ndarray, shape (k, n)
        Energy that jumps of the inputs have supplied [J].
    """

    z: Array
    w: Array
    jumped: Array

    def select(self, which: Any) -> Before:
        """Select some of the steps.

        `which` is an index array or a mask.
        """
        return Before(*(one[which] for one in self))


class Interpreted:
    """Backend that evaluates steps in CasADi's virtual machine.

    A call of the step Function takes up to `chunk` steps of one run, or one step of several.
    Only `advance` continues over the ends of intervals.
    """

    lanes = 0
    companions = False

    def __init__(self, program: KernelFunctions) -> None:
        functions, self.sizes = dict(program.functions), program.sizes
        self.chunk = 128  # most steps of a call: one from Python costs as much as ten of a ball
        if program.adaptive and program.tableau is not None:
            self.chunk = 1
            control = ErrorControl(*(functions.pop(name) for name in ErrorControl._fields))
            functions["attempt"] = build_attempt(control, program.tableau)
        elif program.tableau is not None:
            functions["step"] = build_step(program.tableau, functions.pop("ode"))
        if "step" in functions:
            functions["advance"] = _append_correction(functions)
        self._functions = functions
        self._mapped: dict[tuple[str, int, int], ArrayFunction] = {}

    def __call__(self, values: Values, first: int, last: int) -> None:
        """Compute the runs `first` to `last` − 1.

        Their result arrays are filled.
        """
        together = 256 if self.has("advance") else 1
        with np.errstate(all="ignore"):
            for begin in range(first, last, together):
                Loop(self, values, np.arange(begin, min(begin + together, last))).roll()

    def has(self, name: str) -> bool:
        """Return whether the model has the Function `name`, such as "step"."""
        return name in self._functions

    def evaluate(self, name: str, *inputs: Array, steps: int = 1) -> list[Array]:
        """Evaluate a Function for each row of its inputs (n, size).

        `name` is that of the Function, see `has`. With several `steps`, the first input is a start
        value of a recursion, and rows belong to steps.
        """
        key = name, len(inputs[-1]), steps
        if key not in self._mapped:
            f = self._functions[name]
            mapped = f.mapaccum(steps) if steps > 1 else f.map(key[1]) if key[1] > 1 else f
            self._mapped[key] = ArrayFunction(mapped)
        return self._mapped[key](*inputs)

    def take(self, loop: Loop, lengths: Array, w: Array) -> StepRows:
        """Advance the runs by at least one of the next steps.

        The steps have `lengths` (k,) [s] and inputs w (k, n, nw). `loop` contains the current
        states.
        """
        if self.has("attempt"):
            code = self._control_error(loop, float(lengths[0]))
            return StepRows(loop.z[None], None, code)
        n, q = len(loop.z), loop.q
        left = len(lengths)  # in equal parts, which share a Function
        steps = -(-left // -(-left // self.chunk)) if n == 1 else 1
        every, places = q["correct_every"], loop.step + 1 + np.arange(steps)
        flags = (places % every == 0) if every else np.zeros(steps)
        rows = [
            np.repeat(value, steps * n // len(value), axis=0)
            for value in (lengths[:steps, None], q["numbers"][None], flags[:, None])
        ]
        w = w[:steps].reshape(steps * n, -1)
        z, effects = self.evaluate("advance", loop.z, w, *rows, steps=steps)
        return StepRows(z.reshape(steps, n, -1), effects.reshape(steps, n, 2) if every else None)

    def _control_error(self, loop: Loop, length: float) -> int:
        """Take steps with error control up to the next output time.

        It is `length` seconds away. A failure leaves the state z of `loop` at the last output time.
        Returns the code of the failure.
        """
        q, z, memory = loop.q, loop.z, loop.memory
        memory[0, _REST] = length
        for trial in range(1, int(q["trials"]) + 1):
            rest = memory[0, _REST]
            z, memory = self.evaluate("attempt", z, memory, loop.w, q["numbers"][None])
            loop.memory = memory
            if not np.all(np.isfinite(memory)):
                return NOT_FINITE
            if memory[0, _REST] <= 0:
                loop.z = z
                return FINISHED
            if memory[0, _REST] < rest:
                loop.weigh(z)
            if q["stop"][0]:
                return STOPPED
            if trial % 64 == 0 and memory[0, _NEXT] < q["shortest"] * length:
                return STUCK
        return TIRED


class Loop:
    """Time loop over a block of runs.

    `backend.take` computes z, the states (n, nx) and the external work, after the next steps.
    """

    def __init__(self, backend: Any, q: Values, motions: Any) -> None:
        self.backend, self.q, self.motions, self.sizes = backend, q, motions, backend.sizes
        n, nx = len(motions), self.sizes["nx"]
        self.step = int(q["begin"])
        self.z = np.zeros((n, nx + self.sizes["work"]))
        self.z[:, :nx] = q["states"][motions if q["state_stride"] else np.zeros(n, int)]
        carry, known = q["carry"][motions], len(CARRIED)
        self.energy, self.bars, work, self.jumped = carry[:, :4].T.copy()
        self.z[:, nx:] = work[:, None]
        self.memory, self.w = carry[:, 4:known].copy(), carry[:, known:].copy()
        self.u = self.w[:, : self.sizes["nu"]]
        if not self.step:
            q["status"][motions], q["fault"][motions], q["good"][motions] = FINISHED, -1, 0
        self.status, self.fault, self.good = (
            q[name][motions] for name in ("status", "fault", "good")
        )
        self.measures = self.sizes["measures"] > 0
        self.worst = q["worst"][motions] if self.measures else np.zeros((n, 0))
        self.cost = np.zeros(n)
        self.pending = self._find_pending()

    def _find_pending(self) -> int | None:
        """Find the saved row whose next correction is still to come, or None.

        Its effect is recorded with the row, also if the row was saved in an earlier time slice.
        """
        every, saved = self.q["correct_every"], self.q["save_every"]
        if not (self.step and every and saved):
            return None
        row = (self.step - 1) // saved
        return int(row) if self.step // every == row * saved // every else None

    def roll(self) -> None:
        """Integrate all intervals and store the final states."""
        q = self.q
        if self.status.all():
            return
        for interval in range(0, q["intervals"], joined := self._count_joined()):
            if self.status.all():
                break
            if q.get("clock") is not None and np.isfinite(q["clock"][interval]):
                self.z = self.z.copy()
                self.z[:, self.sizes["nx"] - 1] = q["clock"][interval]
            changed = interval == 0 or q["row"][interval] != q["row"][interval - 1]
            if changed or q.get("gains") is not None:
                self._hold(interval)
            self._march(interval, interval + joined)
            if self.backend.has("stage"):
                rate = self.backend.evaluate("stage", self._x(self.z), self.w)[0][:, 0]
                self.cost += rate * (q["length"][interval] * q["count"][interval])
        if self.step == q["total"] or self.status.all():
            self._observe(Before(self.z[None], self.w[None], self.jumped[None]), end=True)
        if self.backend.has("final"):
            self.cost += self.backend.evaluate("final", self._x(self.z), self.w)[0][:, 0]
        if q["save_every"] and self.status.all():
            left = slice(-(-self.step // q["save_every"]) + 1, None)
            for rows in (q["saved"], q["measured"]):
                if rows is not None:
                    rows[self.motions, left] = np.nan
        self._leave()

    def _count_joined(self) -> int:
        """Count the intervals that one march can advance through.

        See `_march`. The intervals of one run are all together unless the state is changed or read
        between them.
        """
        q, backend = self.q, self.backend
        reads = backend.has("stage") or q.get("gains") is not None or q.get("clock") is not None
        alone = reads or len(self.z) > 1 or not backend.has("advance")
        return 1 if alone else max(1, q["intervals"])

    def _march(self, first: int, last: int) -> None:
        """Take the steps of intervals `first` to `last` − 1.

        The inputs are those of the first interval if there is only one.
        """
        q, done = self.q, 0
        interval = np.repeat(np.arange(first, last), q["count"][first:last])
        length, row = q["length"][interval], q["row"][interval]
        w = np.broadcast_to(self.w, (len(row), *self.w.shape))
        if last - first > 1:
            w = self._read_inputs(row)
        changed = np.append(False, np.diff(row) != 0)
        while done < len(row) and not self.status.all():
            start = self.z[None]
            try:
                rows = self.backend.take(self, length[done:], w[done:])
            except RuntimeError:  # CasADi could not evaluate a step
                rows = StepRows(start, None, UNSOLVED)
            z = np.concatenate([start, rows.z[:-1]])
            here = slice(done, done + len(z))
            before = Before(z, w[here], self._account_jumps(z, w[here], changed[here]))
            self._observe(before)
            if self.status.all():
                return
            if rows.code:
                self._end(rows.code)
                return
            self._record_effects(rows)
            self.step, self.z, done = self.step + len(z), rows.z[-1], here.stop
            self.w, self.jumped = w[done - 1], before.jumped[-1]

    def _account_jumps(self, z: Array, w: Array, changed: Any) -> Array:
        """Sum the energy of jumps of the inputs before k steps (k, n) [J].

        z (k, n, nz) are the states and w (k, n, nw) the inputs of the steps. `changed` (k,) marks
        the steps at which the inputs jump.
        """
        supplied = np.zeros(z.shape[:2])
        if self.backend.has("energy") and changed.any():
            x = self._x(z[changed].reshape(-1, z.shape[2]))
            before = np.concatenate([self.w[None], w[:-1]])
            old, new = (
                self.backend.evaluate("energy", x, one[changed].reshape(len(x), -1))[0]
                for one in (before, w)
            )
            supplied[changed] = (new - old).reshape(-1, z.shape[1])
        return np.cumsum(np.concatenate([self.jumped[None], supplied]), axis=0)[1:]

    def _read_inputs(self, rows: Indices) -> Array:
        """Read stacked inputs (k, n, nw) by their rows, without feedback."""
        q, own, shared = self.q, self.motions, np.zeros(len(self.z), dtype=int)
        w = q["inputs"][own if q["input_stride"] else shared, rows[:, None]]
        if not q["parameters"].shape[1]:
            return np.asarray(w)
        p = q["parameters"][own if q["parameter_stride"] else shared]
        return np.concatenate([w, np.broadcast_to(p, (len(w), *p.shape))], axis=2)

    def _record_effects(self, rows: StepRows) -> None:
        """Record the effects of constraint corrections with saved rows.

        Only the first correction after each row counts.
        """
        q = self.q
        if rows.effects is None or not q["save_every"]:
            return
        for step, effects in enumerate(rows.effects, self.step):
            if step % q["save_every"] == 0:
                self.pending = step // q["save_every"]
            if self.pending is not None and (step + 1) % q["correct_every"] == 0:
                q["corrected"][self.motions, self.pending], self.pending = effects, None

    def _hold(self, interval: int) -> None:
        q = self.q
        account, x = self.backend.has("energy") and self.step > 0, self._x(self.z)
        before = self.backend.evaluate("energy", x, self.w)[0] if account else None
        self.w = self._read_inputs(q["row"][interval : interval + 1])[0]
        if q.get("gains") is not None:
            if q["decides"][interval]:
                k = q["decision"][interval]
                away = self.z[:, : q["referred"]] - q["reference"][k]
                self.u = np.clip(q["given"][k] - away @ q["gains"][k].T, q["lower"], q["upper"])
            self.w[:, : self.u.shape[1]] = self.u
        if before is not None:
            self.jumped = (
                self.jumped + (self.backend.evaluate("energy", x, self.w)[0] - before)[:, 0]
            )

    def _end(self, code: int) -> None:
        """End all runs before the next step with a failure code."""
        self.fault[self.status == FINISHED] = self.step
        self.status[self.status == FINISHED] = code

    def _observe(self, before: Before, end: bool = False) -> None:
        """Measure errors and energies, and save states before k steps.

        `before` contains these states. With `end`, they are the final ones.
        """
        q, steps = self.q, self.step + np.arange(len(before.z))
        saved = (steps % q["save_every"] == 0) | end if q["save_every"] else steps < 0
        turns = 0.6180339887498949 * steps  # of the golden ratio, see `engine.hpp`
        checked = (turns % 1.0) * q["look_every"] < 1.0 if q["look_every"] else steps < 0
        due = saved | checked | end | (steps == 0)
        if not due.any():
            return
        measure = self._measure(before)
        if steps[0] == 0:
            self.bars = measure[0, :, 0] if self.measures else self.bars
            self.energy, self.worst = self._energy(measure[0]), np.full_like(self.worst, np.nan)
        codes = self._find_faults(before.z, measure, steps) * due[:, None]
        over = (self.status != FINISHED) & (self.status < STOPPED)
        lost = (np.cumsum(codes, axis=0) > 0) | over
        new = lost[-1] & (self.status == FINISHED)
        place = np.argmax(codes != FINISHED, axis=0)
        self.status[new], self.fault[new] = (
            codes[place, np.arange(len(new))][new],
            steps[place][new],
        )
        fine = due[:, None] & ~lost & ((self.status == FINISHED) | new)
        last = np.max(np.where(fine, steps[:, None], -1), axis=0)
        self.good = np.maximum(self.good, last)
        if self.measures:
            self._update_extremes(measure, before, fine)
        if saved.any():
            rows = -(-steps[saved] // q["save_every"])
            self._keep(rows, before.select(saved), measure[saved], lost[saved])
        if self.status.all() and new.any():
            self.step = int(self.fault.max())

    def _measure(self, before: Before) -> Array:
        """Compute errors and energies of states (k, n, nz).

        The results (k, n, ·) are relative errors of bars and joints, then kinetic, elastic and
        gravity energy. The states are `before.z`, with the inputs `before.w`. Without measures
        there are no columns.
        """
        z, shape = before.z, before.z.shape[:2]
        if not self.measures:
            return np.zeros((*shape, 0))
        rows, w = (one.reshape(shape[0] * shape[1], -1) for one in (z, before.w))
        found = self.backend.evaluate("measure", self._x(rows), w)[0]
        return np.asarray(found.reshape(*shape, -1))

    def _find_faults(self, z: Array, measure: Array, steps: Indices) -> Any:
        """Find the failure codes (k, n) of n runs before k steps.

        `measure` are the errors of the states z. A run fails if its state is not finite or if its
        bars have large length errors.
        """
        q, x = self.q, z[:, :, : self.sizes["nx"]]
        codes = np.full(x.shape[:2], FINISHED)
        if self.measures:
            bars = measure[:, :, 0]
            codes[~(bars <= q["broken"] + self.bars)] = BROKEN
            codes[np.isnan(bars)] = NOT_FINITE
        size = np.abs(x).max(axis=2, initial=0.0)
        limits: Any = np.where(steps, q["beyond"], q["largest"])
        codes[size > limits[:, None]] = BEYOND
        codes[~np.isfinite(size)] = NOT_FINITE
        return codes

    def weigh(self, z: Array) -> None:
        """Update the largest errors and energies within a time step.

        `z` (n, nz) are the states of the runs after a substep.
        """
        if self.measures:
            now = Before(z[None], self.w[None], self.jumped[None])
            self._update_extremes(self._measure(now), now, (self.status == FINISHED)[None])

    def _update_extremes(self, measure: Array, before: Before, fine: Any) -> None:
        bars, joints, kinetic, elastic, gravity = np.moveaxis(measure[:, :, :5], 2, 0)
        error = np.abs(self._energy(measure) - self.energy - self._supplied(before))
        now = np.stack([bars, joints, error, kinetic, elastic, elastic, gravity, gravity], axis=2)
        now[~fine] = np.nan
        now = np.concatenate([self.worst[None], now])
        high, low = np.fmax.reduce(now, axis=0), np.fmin.reduce(now, axis=0)
        minima = [4, 6]  # columns of `WORST`
        high[:, minima] = low[:, minima]
        self.worst = high

    def _keep(self, rows: Indices, before: Before, measure: Array, lost: Any) -> None:
        q, self.pending = self.q, int(rows[-1])
        place = np.reshape(self.motions, (-1, 1)), rows
        states = np.where(lost[:, :, None], np.nan, before.z[:, :, : self.sizes["nx"]])
        q["saved"][place] = states.swapaxes(0, 1)
        if q["measured"] is not None:
            measured = np.concatenate([measure, self._supplied(before)[:, :, None]], axis=2)
            measured[lost] = np.nan
            q["measured"][place] = measured.swapaxes(0, 1)

    def _leave(self) -> None:
        q, motions = self.q, self.motions
        lost = (self.status != FINISHED) & (self.status < STOPPED)
        q["last"][motions] = np.where(lost[:, None], np.nan, self._x(self.z))
        q["cost"][motions] = np.where(self.status != FINISHED, np.inf, self.cost)
        for name in ("status", "fault", "good"):
            q[name][motions] = getattr(self, name)
        if self.measures:
            q["worst"][motions] = self.worst
        work = self._supplied(Before(self.z, self.w, self.jumped)) - self.jumped
        head = np.stack([self.energy, self.bars, work, self.jumped], axis=1)
        q["carry"][motions] = np.hstack([head, self.memory, self.w])

    def _x(self, z: Array) -> Array:
        """Select the states (n, nx) from z.

        z (n, nz) also contains external work.
        """
        return np.ascontiguousarray(z[:, : self.sizes["nx"]])

    def _energy(self, measure: Array) -> Array:
        """Compute the energy that external work changes (…, n) [J].

        `measure` (…, n, ·) are the results of `_measure`. The energy is kinetic, elastic and
        gravity energy; under a control schedule it is the kinetic energy alone.
        """
        return np.asarray(measure[..., 2 : 5 if self.sizes["potential"] else 3].sum(axis=-1))

    def _supplied(self, before: Before) -> Array:
        """Compute the external work (…, n) [J].

        It has reached the states `before` the steps.
        """
        nx, jumped = self.sizes["nx"], before.jumped
        return jumped + before.z[..., nx] if self.sizes["work"] else jumped


def _append_correction(functions: Mapping[str, ca.Function]) -> ca.Function:
    """Build a step that is followed by a constraint correction.

    Function (z, w, h, numbers, flag) → z, effect (2). It corrects z if the flag is 1.
    """
    step, project = functions["step"], functions.get("project")
    given = [ca.MX.sym(step.name_in(k), step.sparsity_in(k)) for k in range(step.n_in())]
    numbers, flag = ca.MX.sym("numbers"), ca.MX.sym("flag")
    inputs = [*given[:3], numbers if len(given) == 3 else given[3], flag]
    after, effect = step(*given), ca.MX.zeros(2)
    if project is not None:
        z, w = ca.MX.sym("z", after.shape[0]), given[1]
        x = z[: project.size1_in(0)]
        moved = project(x, w)
        changed = [ca.vertcat(moved, z[x.shape[0] :]), functions["effect"](x, moved, w)]
        correct = ca.Function("correct", [z, w], changed)
        idle = ca.Function("idle", [z, w], [z, effect])
        after, effect = ca.Function.if_else("choice", correct, idle)(flag, after, w)
    return ca.Function("advance", inputs, [after, effect])
