"""Runge-Kutta methods whose stages are decision variables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.base import Defects, Transcription
from ocp.transcription.equations import (
    build_constraints,
    build_residuals,
    constraint_names,
    evaluate_multipliers,
)
from ocp.transcription.mesh import held_values
from ocp.transcription.sparse_nlp import Block, Kind, expand, split_symbol
from ocp.transcription.variables import Variables, name_states
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.validate import Array, Indices

_Rows = tuple[Any, float, Sequence[str]]  # expressions, their scale and names


class RungeKuttaTranscription(Transcription):
    """Base class of transcriptions by Runge-Kutta methods.

    Accelerations and multipliers of each stage are decision variables. They satisfy the equations
    of motion, in which no matrix is inverted. At the ends of intervals, two multipliers for each
    bar keep its length and rate, in the sense of Gear, Leimkuhler and Gupta (J. Comput. Appl. Math.
    1985, 12-13, 77). They vanish with the interval, and the order of accuracy is kept.
    """

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (s, s) and b (s,) of the method."""
        raise NotImplementedError

    @property
    def steps(self) -> int:
        """Number of steps in each interval."""
        return 1

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Build the equations of stages and of step ends.

        Parameters
        ----------
        variables : Variables
            States at the mesh points, controls and duration; further unknowns are added to them.
        used : ndarray of bool
            Whether limits, costs or goals depend on each entry.

        Returns
        -------
        Defects
            The blocks.
        """
        steps = _Steps(variables, *self.coefficients, self.steps)
        blocks = [steps.build_stage(j) for j in range(len(steps.b))]
        if self.steps > 1:
            blocks.append(steps.build_ends(closing=False))
        return Defects([*blocks, steps.build_ends(closing=True)])


class _Steps:
    """Equations of the steps of an s-stage Runge-Kutta method.

    A (s, s) and b (s,) are the coefficients of the method, and `v` the variables of the plan. Each
    interval has `substeps` steps.

    Attributes
    ----------
    interval, step : ndarray of int, shape (S,)
        Interval of each step, and its number there.
    states : ndarray of int, shape (S + 1, nx)
        Variable indices of the states at the ends of steps.
    rates, multipliers : ndarray of int, shape (S, s, nq + na) and (S, s, c)
        Variable indices of the stages: accelerations with the rates of internal states, and multipliers.
    """

    def __init__(self, v: Variables, A: Array, b: Array, substeps: int) -> None:
        self.v, self.model, self.A, self.b, self.substeps = v, v.model, A, b, substeps
        self.interval, self.step = np.indices((v.count, substeps), dtype=np.intp).reshape(2, -1)
        self.constraints = constraint_names(v.model)
        self.states = self._add_states()
        nq, scales, moving = v.model.nq, v.scales, v.model.moving
        self.acceleration = scales.length / scales.time**2
        names: Sequence[str] = name_states(v.model)
        self.coordinates, self.internal = names[:nq], names[2 * nq : moving.stop]
        self.internal_scale = scales.state[2 * nq : moving.stop]
        own = slice(nq, moving.stop)
        rates = np.diff(v.guess.states[:, own], axis=0) / v.guess.duration
        self.rates = self._add_stages(
            [f"{name} acceleration" for name in self.coordinates]
            + [f"{name} rate" for name in self.internal],
            rates / v.fractions[:, None],
            scales.state[own] / scales.time,
        )
        middle = (v.guess.states[1:] + v.guess.states[:-1]) / 2
        forces = evaluate_multipliers(v.model, middle, held_values(v.guess.force_density, v.count))
        force = scales.mass * self.acceleration
        names = [f"{name} force" for name in self.constraints]
        self.multipliers = self._add_stages(names, forces, force)

    def _add_states(self) -> Indices:
        """Add the states within intervals as decision variables.

        Their initial guess is linear between the ends.
        """
        v, within = self.v, np.arange(1, self.substeps)
        share = (within / self.substeps)[:, None]
        first = (1 - share) * v.guess.states[:-1, None] + share * v.guess.states[1:, None]
        at = [f"interval {k}, step {i}" for k in range(v.count) for i in within]
        inner = v.entries.unknowns(
            [f"{name}, {place}" for place in at for name in name_states(v.model)],
            first,
            v.scales.state,
            interval=np.arange(v.count)[:, None, None],
        )
        rows = np.concatenate([v.states[:-1, None], inner], axis=1)
        return np.vstack([rows.reshape(-1, v.model.nx), v.states[-1:]])

    def _add_stages(self, names: Sequence[str], first: Array, scale: Any) -> Indices:
        """Add decision variables for all stages.

        Their initial guesses are the values `first` (K, n) of the intervals, their names the n
        `names`. `scale` is their typical size.
        """
        stages = range(len(self.b))
        at = [f"{place}, stage {j}" for place in self._places(slice(None)) for j in stages]
        return self.v.entries.unknowns(
            [f"{name}, {place}" for place in at for name in names],
            np.repeat(first[self.interval, None], len(self.b), axis=1),
            scale,
            interval=self.interval[:, None, None],
        )

    def _add_moves(self, what: str, scale: float) -> Indices:
        """Add the multipliers (K, c) of the constraint projection.

        They project the states at the ends of intervals onto the bar and joint constraints. `what`
        ends their names. `scale` is their typical size.
        """
        count = self.v.count
        return self.v.entries.unknowns(
            [f"{name} {what}, interval {k}" for k in range(count) for name in self.constraints],
            np.zeros((count, len(self.constraints))),
            scale,
            interval=np.arange(count)[:, None],
        )

    def _places(self, steps: Any) -> list[str]:
        pairs = zip(self.interval[steps], self.step[steps], strict=True)
        return [f"interval {k}" + f", step {i}" * (self.substeps > 1) for k, i in pairs]

    def _lengths(self) -> list[Indices]:
        """Return variable indices of the duration and relative step lengths."""
        share = self.v.fractions[self.interval, None] / self.substeps
        return [self.v.repeat(self.v.duration, len(share)), self.v.entries.constants(share)]

    def _symbols(self, columns: Sequence[Indices]) -> tuple[Any, tuple[Any, ...]]:
        sizes = [column.shape[1] for column in columns]
        return split_symbol(symbol_kind(self.model.ode), *sizes)

    def _block(
        self, kind: Kind, z: Any, columns: Sequence[Indices], steps: Any, rows: Sequence[_Rows]
    ) -> Block:
        scale = np.concatenate([np.full(len(names), size) for _, size, names in rows])
        value = ca.vertcat(*(row for row, _, _ in rows)) / ca.DM(scale)
        names = [name for _, _, own in rows for name in own]
        return Block(
            expand(ca.Function(kind, [z], [value])),
            np.hstack(columns),
            tuple(f"dynamics of {at}, {name}" for at in self._places(steps) for name in names),
            scale=scale,
            kind=kind,
        )

    def build_stage(self, j: int) -> Block:
        """Build the equations of motion of stage j of all steps."""
        model, v, a, early = self.model, self.v, self.A[j], (self.A @ self.A)[j]
        seen = [k for k in range(len(a)) if k == j or a[k] or early[k]]
        begin = v.entries.constants(self.step[:, None] / self.substeps)
        columns = [self.states[:-1], v.interval_controls[self.interval], begin, *self._lengths()]
        columns += [self.multipliers[:, j], *(self.rates[:, k] for k in seen)]
        z, (x, controls, before, T, share, mu, *rates) = self._symbols(columns)
        weights = [(early[k], a[k]) for k in seen]
        place = float(a.sum())
        state = self._advance(x, T * share, place, weights, rates)
        control = v.gamma(controls, before + place / self.substeps)
        own = rates[seen.index(j)]
        forces, bends, changes = build_residuals(model)(state, control, own, mu)
        rows = [
            (forces, v.scales.mass * self.acceleration, self.coordinates),
            (bends, self.acceleration, self.constraints),
            (changes / self.internal_scale, 1 / v.scales.time, self.internal),
        ]
        stage = [(row, size, [f"{name}, stage {j}" for name in own]) for row, size, own in rows]
        return self._block("stage", z, columns, slice(None), stage)

    def build_ends(self, closing: bool) -> Block:
        """Build the equations for the states at step ends.

        With `closing`, they are those at the ends of intervals, otherwise those of steps that end
        within.
        """
        model, v, nq, names = self.model, self.v, self.model.nq, name_states(self.model)
        steps = np.flatnonzero((self.step == self.substeps - 1) == closing)
        columns = [self.states[:-1], self.states[1:], *self._lengths()]
        columns += list(np.moveaxis(self.rates, 1, 0))
        columns = [column[steps] for column in columns]
        size, time, length = v.scales.mass * v.scales.length, v.scales.time, v.scales.length
        if closing:
            columns += [self._add_moves("shift", size), self._add_moves("impulse", size / time)]
        z, (x, after, T, share, *rates) = self._symbols(columns)
        rates, moves = rates[: len(self.b)], rates[len(self.b) :]
        weights = list(zip(self.b @ self.A, self.b, strict=True))
        gap = model.split(after - self._advance(x, T * share, 1.0, weights, rates))
        M = sparse(model.mechanism.free_mass)
        momenta = [ca.mtimes(M, part) for part in gap[:2]]
        rows: list[_Rows] = []
        if closing:
            found = [build_constraints(model)(after, push) for push in moves]
            momenta = [own - push for own, (*_, push) in zip(momenta, found, strict=True)]
            places, speeds, _ = found[0]
            rates_of = [f"{name} rate" for name in self.constraints]
            rows = [(places, length, self.constraints), (speeds, length / time, rates_of)]
        ends: list[_Rows] = [
            (momenta[0], size, names[:nq]),
            (momenta[1], size / time, names[nq : 2 * nq]),
            (gap.internal / self.internal_scale, 1.0, self.internal),
            (gap.clock, time, names[model.moving.stop :]),
        ]
        return self._block("defect" if closing else "stage", z, columns, steps, [*ends, *rows])

    def _advance(
        self, x: Any, h: Any, place: float, weights: Sequence[tuple[float, float]], rates: Any
    ) -> Any:
        """Compute the state at a fraction `place` of a step.

        The accelerations and internal rates of the stages are `rates`. `weights` are two for each
        stage, for positions and for velocities. The step has the length h [s] and the initial state
        x.
        """
        q, speed, own, clock = self.model.split(x)
        q, clock = q + place * h * speed, clock + place * h
        moved = ca.vertcat(speed, own)
        for (early, weight), rate in zip(weights, rates, strict=True):
            q, moved = q + h**2 * early * rate[: self.model.nq], moved + h * weight * rate
        return ca.vertcat(q, moved, clock)
