"""A motion over several intervals with its exact derivatives, and what the strings can still change of its end."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.tableaux import CLASSICAL
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array

REACHED = 1e-5  # of the strongest direction: below it a row of the goal is not controlled to first order, or by errors of the scheme only
HARDLY_REACHED = 1e-9  # the same, for a second attempt


class Motion:
    """Runge-Kutta steps of order 4 over `count` intervals, `substeps` in each; built once, evaluated along any controls."""

    def __init__(self, model: Model, count: int, substeps: int = 1) -> None:
        self.model, self.count, self._substeps = model, count, substeps
        x, u, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("h", 1)))
        stages: list[Any] = []
        points: list[Any] = []
        for row in CLASSICAL.a:
            points.append(x + sum((h * a * k for a, k in zip(row, stages, strict=True) if a), start=ca.MX(0)))
            stages.append(model.ode(points[-1], u))
        end = x + h * sum((b * k for b, k in zip(CLASSICAL.b, stages, strict=True)), start=ca.MX(0))
        one = ca.Function("step", [x, u, h], [end, ca.horzcat(*points)])
        self._run = one.mapaccum(count * substeps)
        kind: Any = ca.SX if model.ode.is_a("SXFunction") else ca.MX
        sx, su = kind.sym("x", model.nx), kind.sym("u", model.nu)
        rate = model.ode(sx, su)
        slopes = ca.jacobian(rate, ca.vertcat(sx, su))
        self._row, self._column = (np.array(entries, dtype=np.intp) for entries in slopes.sparsity().get_triplet())
        self._slopes = ArrayFunction(ca.Function("slopes", [sx, su], [ca.densify(rate), ca.vec(slopes.nz[:])]).map(count * substeps))

    def states(self, start: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """Return the states (count + 1, nx) under controls (count, nu) in intervals of `length` s.

        And the points (count · substeps, 4, nx) where the derivative is taken.
        """
        n = self._substeps
        ends, points = (np.asarray(value.full()) for value in self._run(start, np.repeat(controls, n, axis=0).T, length / n))
        return np.column_stack([start, ends[:, n - 1 :: n]]).T, points.T.reshape(-1, 4, self.model.nx)

    def derivatives(self, points: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """Return ∂x⁺/∂x (count, nx, nx) and ∂x⁺/∂u (count, nx, nu) of each interval, exact for the steps taken."""
        nx, nu, n, h = self.model.nx, self.model.nu, self._substeps, length / self._substeps
        _, J = self._rates(points, controls)
        eye = np.broadcast_to(np.eye(nx, nx + nu), (len(J), nx, nx + nu))
        stages: list[Array] = []
        for i, row in enumerate(CLASSICAL.a):
            change = eye + h * sum((a * k for a, k in zip(row, stages, strict=True) if a), start=np.zeros_like(eye))
            stage = J[:, i, :, :nx] @ change
            stage[:, :, nx:] += J[:, i, :, nx:]
            stages.append(stage)
        step = eye + h * sum((b * k for b, k in zip(CLASSICAL.b, stages, strict=True)), start=np.zeros_like(eye))
        A, B = step[0::n, :, :nx], step[0::n, :, nx:]
        for k in range(1, n):
            A, B = step[k::n, :, :nx] @ A, step[k::n, :, :nx] @ B + step[k::n, :, nx:]
        return A, B

    def gradient(self, last: Array, points: Array, controls: Array, length: float, end: int) -> tuple[Array, Array]:
        """Return derivatives of rows with gradient `last` (m, nx) after `end` intervals.

        By the controls, (m, count, nu), and by the length of all intervals, (m,).
        """
        nx, n, h = self.model.nx, self._substeps, length / self._substeps
        rates, J = (part[: end * n] for part in self._rates(points, controls))
        turns = h * J[..., :nx]
        pulls = np.zeros((end * n, 4, len(last), nx))  # of the rows on each stage's derivative, divided by h
        for step in reversed(range(end * n)):
            before, pulled = last, np.zeros_like(last)
            for i in reversed(range(4)):
                pulls[step, i] = CLASSICAL.b[i] * last + (
                    CLASSICAL.a[i + 1][i] * pulled if i < 3 else 0.0
                )  # of earlier stages each sees the last one only
                pulled = pulls[step, i] @ turns[step, i]
                before = before + pulled
            last = before
        by_step = np.einsum("siml,sil->m", pulls, rates)
        by_control = np.zeros((len(last), self.count, self.model.nu))
        by_control[:, :end] = h * (pulls @ J[..., nx:]).sum(axis=1).reshape(end, n, *by_control.shape[::2]).sum(axis=1).transpose(1, 0, 2)
        return by_control, by_step / n

    def _rates(self, points: Array, controls: Array) -> tuple[Array, Array]:
        """Return f (steps, 4, nx) and its derivative (steps, 4, nx, nx + nu) with respect to state and control."""
        nx, width = self.model.nx, self.model.nx + self.model.nu
        held = np.repeat(controls, self._substeps, axis=0)
        # stage by stage: to make a map takes as long as its size
        rates, entries = (
            np.stack(parts, axis=1).reshape(4 * len(held), -1) for parts in zip(*(self._slopes(points[:, i], held) for i in range(4)), strict=True)
        )
        J = np.zeros((len(rates), nx * width))
        J[:, self._row * width + self._column] = entries
        return rates.reshape(-1, 4, nx), J.reshape(-1, 4, nx, width)


class Reach:
    """Sensitivities of a motion to its controls over `count` intervals, in steps of Runge and Kutta.

    grouping: E (nu, groups) of ones, γ of all strings from those of groups that pull alike (`ocp.transcription.mesh`); None: each pulls on
    its own. Controls that are given are evened out within groups.
    """

    def __init__(self, model: Model, count: int, free_duration: bool, substeps: int = 1, grouping: Array | None = None) -> None:
        self._motion, self._free_duration = Motion(model, count, substeps), free_duration
        self._grouping = np.eye(model.nu) if grouping is None else grouping
        self._evened = self._grouping / self._grouping.sum(axis=0) @ self._grouping.T

    def rollout(self, start: Array, controls: Array, duration: float) -> Array:
        """Return the states (count + 1, nx) of the motion under controls (count, nu)."""
        return self._motion.states(start, controls @ self._evened, duration / len(controls))[0]

    def of_rows(self, rows: ca.Function, weights: Array, start: Array, controls: Array, duration: float, at: int | None = None) -> Array:
        """Return the gradient (m, count·groups [+ 1]) of weights (m, ·) @ rows(x) by all controls (and the duration).

        rows are taken after `at` intervals from `start`, None: all. NaN where the motion diverges.
        """
        controls, count, length = controls @ self._evened, len(controls), duration / len(controls)
        end = count if at is None else at
        strings, groups = self._grouping.shape
        states, points = self._motion.states(start, controls, length)
        if not np.all(np.isfinite(states)):
            return np.full((len(weights), count * groups + self._free_duration), np.nan)
        x: Any = (ca.SX if rows.is_a("SXFunction") else ca.MX).sym("x", len(start))
        last = weights @ np.asarray(ca.Function("last", [x], [ca.densify(ca.jacobian(rows(x), x))])(states[end]).full())
        by_control, by_length = self._motion.gradient(last, points, controls, length, end)
        by_group = by_control.reshape(len(last), count, strings) @ self._grouping
        parts = [by_group.reshape(len(last), count * groups), by_length[:, None] / count]
        return np.concatenate(parts[: 1 + self._free_duration], axis=1)


def find_controlled(sensitivity: Array, least: float = REACHED) -> Array:
    """Return orthonormal combinations (rank, m) of rows that the controls can move, given their gradient; all of them where it is not finite."""
    if not np.all(np.isfinite(sensitivity)) or not sensitivity.size:
        return np.eye(len(sensitivity))
    left, values, _ = np.linalg.svd(sensitivity, full_matrices=False)
    return np.asarray(left[:, values > least * values.max(initial=0.0)].T)
