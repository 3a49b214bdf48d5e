"""A motion over several intervals and its exact derivatives, as arrays: what controllers of a plan work with."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array

_A = ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0))  # Runge and Kutta's method of order 4
_B = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class Motion:
    """Runge-Kutta steps of order 4 over `count` intervals, `substeps` in each; built once, evaluated along any controls."""

    def __init__(self, model: Model, count: int, substeps: int = 1) -> None:
        self.model, self.count, self._substeps = model, count, substeps
        x, u, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("h", 1)))
        stages: list[Any] = []
        points: list[Any] = []
        for row in _A:
            points.append(x + sum((h * a * k for a, k in zip(row, stages, strict=True) if a), start=ca.MX(0)))
            stages.append(model.ode(points[-1], u))
        end = x + h * sum((b * k for b, k in zip(_B, stages, strict=True)), start=ca.MX(0))
        one = ca.Function("step", [x, u, h], [end, ca.horzcat(*points)])
        self._run = one.mapaccum(count * substeps)
        kind: Any = ca.SX if model.ode.is_a("SXFunction") else ca.MX
        sx, su = kind.sym("x", model.nx), kind.sym("u", model.nu)
        rate = model.ode(sx, su)
        slopes = ca.jacobian(rate, ca.vertcat(sx, su))
        self._row, self._column = (np.array(entries, dtype=np.intp) for entries in slopes.sparsity().get_triplet())
        self._slopes = ArrayFunction(ca.Function("slopes", [sx, su], [ca.densify(rate), ca.vec(slopes.nz[:])]).map(count * substeps))

    def states(self, start: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """States (count + 1, nx) under controls (count, nu) in intervals of `length` s, and the points (count · substeps, 4, nx) where the
        derivative is taken."""
        n = self._substeps
        ends, points = (np.asarray(value.full()) for value in self._run(start, np.repeat(controls, n, axis=0).T, length / n))
        return np.column_stack([start, ends[:, n - 1 :: n]]).T, points.T.reshape(-1, 4, self.model.nx)

    def derivatives(self, points: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """∂x⁺/∂x (count, nx, nx) and ∂x⁺/∂u (count, nx, nu) of each interval, exact for the steps taken."""
        nx, nu, n, h = self.model.nx, self.model.nu, self._substeps, length / self._substeps
        _, J = self._rates(points, controls)
        eye = np.broadcast_to(np.eye(nx, nx + nu), (len(J), nx, nx + nu))
        stages: list[Array] = []
        for i, row in enumerate(_A):
            change = eye + h * sum((a * k for a, k in zip(row, stages, strict=True) if a), start=np.zeros_like(eye))
            stage = J[:, i, :, :nx] @ change
            stage[:, :, nx:] += J[:, i, :, nx:]
            stages.append(stage)
        step = eye + h * sum((b * k for b, k in zip(_B, stages, strict=True)), start=np.zeros_like(eye))
        A, B = step[0::n, :, :nx], step[0::n, :, nx:]
        for k in range(1, n):
            A, B = step[k::n, :, :nx] @ A, step[k::n, :, :nx] @ B + step[k::n, :, nx:]
        return A, B

    def gradient(self, last: Array, points: Array, controls: Array, length: float, end: int) -> tuple[Array, Array]:
        """Of rows with gradient `last` (m, nx) after `end` intervals: by the controls, (m, count, nu), and by the length of all intervals, (m,)."""
        nx, n, h = self.model.nx, self._substeps, length / self._substeps
        rates, J = (part[: end * n] for part in self._rates(points, controls))
        turns = h * J[..., :nx]
        pulls = np.zeros((end * n, 4, len(last), nx))  # of the rows on each stage's derivative, divided by h
        for step in reversed(range(end * n)):
            before, pulled = last, np.zeros_like(last)
            for i in reversed(range(4)):
                pulls[step, i] = _B[i] * last + (_A[i + 1][i] * pulled if i < 3 else 0.0)  # of earlier stages each sees the last one only
                pulled = pulls[step, i] @ turns[step, i]
                before = before + pulled
            last = before
        by_step = np.einsum("siml,sil->m", pulls, rates)
        by_control = np.zeros((len(last), self.count, self.model.nu))
        by_control[:, :end] = h * (pulls @ J[..., nx:]).sum(axis=1).reshape(end, n, *by_control.shape[::2]).sum(axis=1).transpose(1, 0, 2)
        return by_control, by_step / n

    def _rates(self, points: Array, controls: Array) -> tuple[Array, Array]:
        """f (steps, 4, nx) and its derivative (steps, 4, nx, nx + nu) with respect to state and control."""
        nx, width = self.model.nx, self.model.nx + self.model.nu
        held = np.repeat(controls, self._substeps, axis=0)
        # stage by stage: to make a map takes as long as its size
        rates, entries = (
            np.stack(parts, axis=1).reshape(4 * len(held), -1) for parts in zip(*(self._slopes(points[:, i], held) for i in range(4)), strict=True)
        )
        J = np.zeros((len(rates), nx * width))
        J[:, self._row * width + self._column] = entries
        return rates.reshape(-1, 4, nx), J.reshape(-1, 4, nx, width)
