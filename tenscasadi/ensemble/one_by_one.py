"""The work of `motions.hpp` without C++: each step of all motions by CasADi, one after the other, to the same numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.ensemble.program import Program
from tenscasadi.ensemble.request import BEYOND, BROKEN, FINISHED, NOT_FINITE, STOPPED
from tenscasadi.integrators.runge_kutta import build_step
from tenscasadi.util.compile import CompileError, compile_function
from tenscasadi.util.validate import Array

_BLOCK = 256  # motions that go through time together


class OneByOne:
    """A program without C++; called with the values of a request."""

    def __init__(self, program: Program) -> None:
        functions, sizes = dict(program.functions), program.sizes
        if program.tableau is not None:
            functions["motion_step"] = build_step(program.tableau, functions.pop("motion_ode"))
        self._functions = {name: _compiled(function) for name, function in functions.items()}
        self._sizes = sizes
        self._mapped: dict[tuple[str, int], ca.Function] = {}

    def __call__(self, q: Mapping[str, Any]) -> None:
        """Fill the results of a request."""
        with np.errstate(all="ignore"):
            for first in range(0, q["motions"], _BLOCK):
                _Block(
                    self, q, np.arange(first, min(first + _BLOCK, q["motions"])), self._sizes
                ).roll()

    def has(self, name: str) -> bool:
        """Tell whether there is such a Function."""
        return name in self._functions

    def evaluate(self, name: str, *inputs: Array) -> Array:
        """Return the result (n, size) of a Function for rows of inputs (n, size)."""
        count = len(inputs[0])
        if (name, count) not in self._mapped:
            self._mapped[name, count] = self._functions[name].map(count)
        mapped = self._mapped[name, count]
        values = [ca.DM(value.T) if value.shape[1] else ca.DM(0, count) for value in inputs]
        return np.asarray(mapped(*values).full()).T


class _Block:
    """Some motions on their way."""

    def __init__(
        self,
        engine: OneByOne,
        q: Mapping[str, Any],
        motions: NDArray[np.intp],
        sizes: Mapping[str, int],
    ) -> None:
        self.engine, self.q, self.motions, self.sizes = engine, q, motions, sizes
        n, nx = len(motions), sizes["NX"]
        self.z = np.zeros((n, nx + sizes["WORK"]))
        self.z[:, :nx] = q["states"][motions if q["state_stride"] else np.zeros(n, int)]
        self.status, self.fault, self.good = np.full(n, FINISHED), np.full(n, -1), np.zeros(n, int)
        self.w = self.u = np.zeros((n, 0))
        self.cost = np.zeros(n)

    def roll(self) -> None:
        """Go through all intervals, then write down the ends."""
        q, sizes = self.q, self.sizes
        step, row, total = 0, 0, int(q["count"].sum())
        for interval in range(q["intervals"]):
            if (
                interval == 0
                or q.get("gains") is not None
                or q["row"][interval] != q["row"][interval - 1]
            ):
                self._hold(interval)
            if interval == 0:
                self._look(0)
                row = self._keep(row)
            for _ in range(q["count"][interval]):
                if q["stop"][0]:
                    self._mark(np.full(len(self.z), STOPPED), step)
                    break
                step += 1
                self._advance(q["length"][interval], step)
                save = q["save_every"] and (step % q["save_every"] == 0 or step == total)
                if save or step == total or (q["look_every"] and step % q["look_every"] == 0):
                    self._look(step)
                if save:
                    row = self._keep(row)
            if self.engine.has("motion_stage"):
                rate = self.engine.evaluate("motion_stage", self._x, self.w)[:, 0]
                self.cost += rate * (q["length"][interval] * q["count"][interval])
            q["done"][0] += len(self.z) * q["count"][interval]
            if self.status.all():
                break
        if self.engine.has("motion_final"):
            self.cost += self.engine.evaluate("motion_final", self._x, self.w)[:, 0]
        while q["save_every"] and row < q["rows"]:
            row = self._keep(row)
        lost = self.status != FINISHED
        q["last"][self.motions] = np.where(lost[:, None], np.nan, self._x)
        q["cost"][self.motions] = np.where(lost, np.inf, self.cost)
        for name in ("status", "fault", "good"):
            q[name][self.motions] = getattr(self, name)
        if sizes["M"]:
            q["worst"][self.motions] = self.worst

    @property
    def _x(self) -> Array:
        return self.z[:, : self.sizes["NX"]]

    def _hold(self, interval: int) -> None:
        q, nx = self.q, self.sizes["NX"]
        before = (
            self.engine.evaluate("motion_energy", self._x, self.w)
            if self.sizes["JUMPS"] and interval
            else None
        )
        own, shared = self.motions, np.zeros(len(self.z), dtype=int)
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
            self.z[:, nx] += (self.engine.evaluate("motion_energy", self._x, self.w) - before)[:, 0]

    def _advance(self, length: float, step: int) -> None:
        self.z = self.engine.evaluate(
            "motion_step", self.z, self.w, np.full((len(self.z), 1), length)
        ).copy()
        if self.q["correct_every"] and step % self.q["correct_every"] == 0:
            self.z[:, : self.sizes["NX"]] = self.engine.evaluate("motion_project", self._x, self.w)

    def _mark(self, codes: NDArray[Any], step: int) -> None:
        new = (self.status == FINISHED) & (codes != FINISHED)
        self.status[new], self.fault[new] = codes[new], step

    def _look(self, step: int) -> None:
        q, sizes = self.q, self.sizes
        bad = np.full(len(self.z), FINISHED)
        if sizes["M"]:
            self.measure = self.engine.evaluate("motion_measure", self._x, self.w)
            bars = self.measure[:, 0]
            if step == 0:
                self.bars = bars.copy()
            bad[~(bars <= q["broken"] + self.bars)] = BROKEN
            bad[np.isnan(bars)] = NOT_FINITE
        bad[np.any(np.abs(self._x) > q["beyond" if step else "largest"], axis=1)] = BEYOND
        bad[~np.all(np.isfinite(self._x), axis=1)] = NOT_FINITE
        self._mark(bad, step)
        fine = self.status == FINISHED
        self.good[fine] = step
        if sizes["M"]:
            energy = self.measure[:, 2:5].sum(axis=1)
            if step == 0:
                self.energy = energy
            error = np.abs(
                energy - self.energy - (self.z[:, sizes["NX"]] if sizes["WORK"] else 0.0)
            )
            kinetic, elastic, gravity = self.measure[:, 2:5].T
            now = np.stack(
                [bars, self.measure[:, 1], error, kinetic, elastic, elastic, gravity, gravity],
                axis=1,
            )
            if step == 0:
                self.worst = np.where(fine[:, None], now, np.nan)
            lower = [4, 6]
            new = np.maximum(self.worst, now)
            new[:, lower] = np.minimum(self.worst, now)[:, lower]
            self.worst = np.where(fine[:, None], new, self.worst)

    def _keep(self, row: int) -> int:
        if not self.q["save_every"]:
            return row
        lost = (self.status != FINISHED)[:, None]
        self.q["saved"][self.motions, row] = np.where(lost, np.nan, self._x)
        if self.sizes["M"]:
            supplied = (
                self.z[:, self.sizes["NX"] :] if self.sizes["WORK"] else np.zeros((len(self.z), 1))
            )
            self.q["measured"][self.motions, row] = np.where(
                lost, np.nan, np.hstack([self.measure, supplied])
            )
        return row + 1


def _compiled(function: ca.Function) -> ca.Function:
    try:
        return compile_function(function)
    except CompileError:
        return function
