"""Integration loop of `engine.hpp` in Python and CasADi's virtual machine.

Its results equal those of the compiled loop to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any

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
from tenscasadi.util.validate import Array

_FOLDED = 32  # steps per call: a call from Python costs as much as a step of a ball
_REST, _NEXT = (Memory._fields.index(name) for name in ("rest", "step"))
Values = Mapping[str, Any]


class Interpreted:
    """Backend that calls CasADi's virtual machine."""

    lanes = 0

    def __init__(self, program: KernelFunctions) -> None:
        functions, self.sizes = dict(program.functions), program.sizes
        self.together = 1 if program.adaptive else 256
        if program.adaptive and program.tableau is not None:
            control = ErrorControl(*(functions.pop(name) for name in ErrorControl._fields))
            functions["attempt"] = build_attempt(control, program.tableau)
        elif program.tableau is not None:
            functions["step"] = build_step(program.tableau, functions.pop("ode"))
        if "step" in functions:
            functions["folded"] = _fold(functions["step"])
        self._functions = functions
        self._mapped: dict[tuple[str, int], ArrayFunction] = {}

    def __call__(self, values: Values) -> None:
        """Fill the result arrays of a request."""
        with np.errstate(all="ignore"):
            for first in range(0, values["motions"], self.together):
                last = min(first + self.together, values["motions"])
                Loop(self, values, np.arange(first, last)).roll()

    def has(self, name: str) -> bool:
        """Return whether the kernel has the Function `name`."""
        return name in self._functions

    def evaluate(self, name: str, *inputs: Array) -> list[Array]:
        """Evaluate a Function at rows of inputs (n, size)."""
        key = name, len(inputs[0])
        if key not in self._mapped:
            function = self._functions[name]
            self._mapped[key] = ArrayFunction(function if key[1] == 1 else function.map(key[1]))
        return self._mapped[key](*inputs)

    def observe(self, states: Array, inputs: Array) -> Array:
        """Compute the measures (T, M).

        States are (T, nx), inputs (T, nw).
        """
        return self.evaluate("measure", states, inputs)[0]

    def steps(self, loop: Loop, interval: int) -> Iterator[tuple[int, int]]:
        """Take the steps of an interval.

        Yields a status code and the number of steps taken.
        """
        q, sizes = loop.q, self.sizes
        length = float(q["length"][interval])
        n, numbers = len(loop.z), np.tile(q["numbers"], (len(loop.z), 1))
        h, left = np.full((n, 1), length), int(q["count"][interval])
        while left:
            if self.has("attempt"):
                left -= 1
                yield self._control_error(loop, length), 1
                continue
            fold = not self.has("project") and min(left, loop.unobserved) >= _FOLDED
            taken = _FOLDED if fold else 1
            left -= taken
            given = [loop.z, loop.w, h, numbers][: self._functions["step"].n_in()]
            loop.z = self.evaluate("folded" if fold else "step", *given)[0]
            if self.has("project") and (loop.step + 1) % q["correct_every"] == 0:
                x = loop.x
                corrected = self.evaluate("project", x, loop.w)[0]
                if q["corrected"] is not None and loop.pending is not None:
                    effect = self.evaluate("effect", x, corrected, loop.w)[0]
                    q["corrected"][loop.motions, loop.pending] = effect
                    loop.pending = None
                loop.z = np.hstack([corrected, loop.z[:, sizes["nx"] :]])
            yield FINISHED, taken

    def _control_error(self, loop: Loop, length: float) -> int:
        """Take trial steps to the end of a grid step.

        A failure leaves z at the start of the grid step.
        """
        q, z, memory = loop.q, loop.z, loop.memory
        memory[0, _REST] = length
        for trial in range(1, int(q["trials"]) + 1):
            z, memory = self.evaluate("attempt", z, memory, loop.w, q["numbers"])
            loop.memory = memory
            if not np.all(np.isfinite(memory)):
                return NOT_FINITE
            if memory[0, _REST] <= 0:
                loop.z = z
                return FINISHED
            if q["stop"][0]:
                return STOPPED
            if trial % 64 == 0 and memory[0, _NEXT] < q["shortest"] * length:
                return STUCK
        return TIRED


class Loop:
    """Integration loop over a block of runs.

    `backend.steps` advances z, the states (n, nx) and the work, through an interval.
    """

    def __init__(self, backend: Any, q: Values, motions: Any) -> None:
        self.backend, self.q, self.motions, self.sizes = backend, q, motions, backend.sizes
        n, nx = len(motions), self.sizes["nx"]
        self.step = int(q["begin"])
        self.pending: int | None = None
        self.z = np.zeros((n, nx + self.sizes["work"]))
        self.z[:, :nx] = q["states"][motions if q["state_stride"] else np.zeros(n, int)]
        carry, known = q["carry"][motions], len(CARRIED)
        self.energy, self.bars, work, self.jumped = carry[:, :4].T.copy()
        self.z[:, nx:] = work[:, None]
        self.memory, self.w, self.u = (
            carry[:, 4:known].copy(),
            carry[:, known:].copy(),
            carry[:, :0],
        )
        self.status, self.fault = np.full(n, FINISHED), np.full(n, -1)
        self.good = q["good"][motions] if self.step else np.zeros(n, int)
        self.worst = q["worst"][motions] if self.step and self.measures else np.zeros((n, 0))
        self.cost = np.zeros(n)

    @property
    def measures(self) -> bool:
        """Whether runs are measured."""
        return bool(self.sizes["measures"])

    @property
    def x(self) -> Array:
        """States (n, nx)."""
        return np.ascontiguousarray(self.z[:, : self.sizes["nx"]])

    @property
    def unobserved(self) -> int:
        """Number of steps to the next saved or checked one."""
        q = self.q
        periods = [period for period in (q["save_every"], q["look_every"]) if period]
        return int(min([q["total"] - self.step, *(each - self.step % each for each in periods)]))

    @property
    def supplied(self) -> Array:
        """Energy supplied (n,), J."""
        nx = self.sizes["nx"]
        return np.asarray(self.jumped + self.z[:, nx] if self.sizes["work"] else self.jumped)

    def roll(self) -> None:
        """Integrate all intervals and store the final states."""
        q = self.q
        for interval in range(q["intervals"]):
            if self.status.all():
                break
            changed = interval == 0 or q["row"][interval] != q["row"][interval - 1]
            if changed or q.get("gains") is not None:
                self._hold(interval)
            if self.step == 0:
                self._look()
                self._keep(0)
            self._march(interval)
            if self.backend.has("stage"):
                rate = self.backend.evaluate("stage", self.x, self.w)[0][:, 0]
                self.cost += rate * (q["length"][interval] * q["count"][interval])
            q["done"][0] += len(self.z) * q["count"][interval]
        if self.backend.has("final"):
            self.cost += self.backend.evaluate("final", self.x, self.w)[0][:, 0]
        if q["save_every"] and self.status.all():
            left = slice(self.step // q["save_every"] + 1, None)
            for rows in (q["saved"], q["measured"]):
                if rows is not None:
                    rows[self.motions, left] = np.nan
        self._leave()

    def _march(self, interval: int) -> None:
        q, steps = self.q, self.backend.steps(self, interval)
        for code, taken in _until_failure(steps):
            if code:
                self._mark(np.full(len(self.z), code))
                return
            self.step += taken
            last = self.step == q["total"]
            save = q["save_every"] and (self.step % q["save_every"] == 0 or last)
            if save or last or (q["look_every"] and self.step % q["look_every"] == 0):
                self._look()
            if save:
                self._keep(q["rows"] - 1 if last else self.step // q["save_every"])
            if q["stop"][0] and not last:
                self._mark(np.full(len(self.z), STOPPED))
            if self.status.all():
                return

    def _hold(self, interval: int) -> None:
        q, own, shared = self.q, self.motions, np.zeros(len(self.z), dtype=int)
        account = self.backend.has("energy") and self.step > 0
        before = self.backend.evaluate("energy", self.x, self.w)[0] if account else None
        self.w = q["inputs"][own if q["input_stride"] else shared, q["row"][interval]]
        if q["parameters"].shape[1]:
            self.w = np.hstack([self.w, q["parameters"][own if q["parameter_stride"] else shared]])
        if q.get("gains") is not None:
            if q["decides"][interval]:
                k = q["decision"][interval]
                away = self.z[:, : q["referred"]] - q["reference"][k]
                self.u = np.clip(q["given"][k] - away @ q["gains"][k].T, q["lower"], q["upper"])
            self.w[:, : self.u.shape[1]] = self.u
        if before is not None:
            self.jumped += (self.backend.evaluate("energy", self.x, self.w)[0] - before)[:, 0]

    def _mark(self, codes: Any) -> None:
        new = (self.status == FINISHED) & (codes != FINISHED)
        self.status[new], self.fault[new] = codes[new], self.step

    def _look(self) -> None:
        q, x, first = self.q, self.x, self.step == 0
        bad = np.full(len(x), FINISHED)
        if self.measures:
            self.measure = self.backend.evaluate("measure", x, self.w)[0]
            bars = self.measure[:, 0]
            if first:
                self.bars = bars.copy()
            bad[~(bars <= q["broken"] + self.bars)] = BROKEN
            bad[np.isnan(bars)] = NOT_FINITE
        bad[np.any(np.abs(x) > q["largest" if first else "beyond"], axis=1)] = BEYOND
        bad[~np.all(np.isfinite(x), axis=1)] = NOT_FINITE
        self._mark(bad)
        fine = self.status == FINISHED
        self.good[fine] = self.step
        if self.measures:
            self._weigh(fine)

    def _weigh(self, fine: Any) -> None:
        """Update the extremes of the measures."""
        bars, joints, kinetic, elastic, gravity = self.measure[:, :5].T
        energy = kinetic + elastic + gravity
        if self.step == 0:
            self.energy = energy
        error = np.abs(energy - self.energy - self.supplied)
        now = np.stack([bars, joints, error, kinetic, elastic, elastic, gravity, gravity], axis=1)
        if self.step == 0:
            self.worst = np.where(fine[:, None], now, np.nan)
        new = np.maximum(self.worst, now)
        minima = [4, 6]  # columns of `WORST`
        new[:, minima] = np.minimum(self.worst, now)[:, minima]
        self.worst = np.where(fine[:, None], new, self.worst)

    def _keep(self, row: int) -> None:
        q, self.pending = self.q, row
        if not q["save_every"]:
            return
        lost = (self.status != FINISHED)[:, None]
        q["saved"][self.motions, row] = np.where(lost, np.nan, self.x)
        if q["measured"] is not None:
            told = np.hstack([self.measure[:, :5], self.supplied[:, None]])
            q["measured"][self.motions, row] = np.where(lost, np.nan, told)

    def _leave(self) -> None:
        q, motions = self.q, self.motions
        lost = (self.status != FINISHED) & (self.status < STOPPED)
        q["last"][motions] = np.where(lost[:, None], np.nan, self.x)
        q["cost"][motions] = np.where(self.status != FINISHED, np.inf, self.cost)
        for name in ("status", "fault", "good"):
            q[name][motions] = getattr(self, name)
        if self.measures:
            q["worst"][motions] = self.worst
        work = self.supplied - self.jumped
        head = np.stack([self.energy, self.bars, work, self.jumped], axis=1)
        q["carry"][motions] = np.hstack([head, self.memory, self.w])


def _fold(step: ca.Function) -> ca.Function:
    """Build a Function of several steps with the same input."""
    given = [ca.MX.sym(step.name_in(k), step.sparsity_in(k)) for k in range(step.n_in())]
    z = reduce(lambda z, _: step.call([z, *given[1:]])[0], range(_FOLDED), given[0])
    return ca.Function("folded", given, [z])


def _until_failure(steps: Iterator[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield the steps, and UNSOLVED if CasADi cannot evaluate one."""
    try:
        yield from steps
    except RuntimeError:
        yield UNSOLVED, 0
