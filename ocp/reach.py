"""What the strings can still change: sensitivities of the end of a motion to all that is planned, along a real motion."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.validate import Array

REACHED = 1e-5  # of the strongest direction: below it a row of the goal is not controlled to first order, or by errors of the scheme only
HARDLY_REACHED = 1e-9  # the same, for a second attempt


class Reach:
    """Sensitivities over `count` intervals of a step (x, u, h) → x_next; built once, evaluated along any controls."""

    def __init__(self, step: ca.Function, count: int, free_duration: bool) -> None:
        x, u, h = (ca.MX.sym(name, step.size1_in(k)) for k, name in enumerate(("x", "u", "h")))
        end = step(x, u, h)
        inputs = ca.vertcat(u, h) if free_duration else u
        slopes = ca.Function("slopes", [x, u, h], [ca.densify(ca.jacobian(end, x)), ca.densify(ca.jacobian(end, inputs))])
        self._count, self._nu = count, step.size1_in(1)
        self._chain, self._slopes = step.mapaccum(count), slopes.map(count)
        self._free_duration = free_duration

    def rollout(self, start: Array, controls: Array, duration: float) -> Array:
        """States (count + 1, nx) of the motion under controls (count, nu)."""
        states = self._chain(start, controls.T, np.full((1, self._count), duration / self._count))
        return np.column_stack([start, np.asarray(states.full())]).T

    def of_rows(self, rows: ca.Function, states: Array, controls: Array, duration: float, at: int | None = None) -> Array:
        """Gradient (m, count·nu [+ 1]) of rows(x) at states[at] (None: the last) with respect to all controls (and the duration)."""
        end = self._count if at is None else at
        before = states[:-1].T
        A, B = (np.asarray(value.full()) for value in self._slopes(before, controls.T, np.full((1, self._count), duration / self._count)))
        nx, width = len(states[0]), B.shape[1] // self._count
        x: Any = ca.SX.sym("x", nx)
        M = np.asarray(ca.Function("gradient", [x], [ca.densify(ca.jacobian(rows(x), x))])(states[end]).full())
        later, last = np.zeros((len(M), self._nu)), np.zeros((len(M), 1))
        columns = [later] * (self._count - end)
        for k in reversed(range(end)):
            effect = M @ B[:, k * width : (k + 1) * width]
            columns.append(effect[:, : self._nu])
            if self._free_duration:
                last += effect[:, self._nu :] / self._count
            M = M @ A[:, k * nx : (k + 1) * nx]
        return np.concatenate([*columns[::-1], last][: self._count + self._free_duration], axis=1)


def controlled(sensitivity: Array, least: float = REACHED) -> Array:
    """Orthonormal combinations (rank, m) of rows that the controls can move, given their gradient; all of them where it is not finite."""
    if not np.all(np.isfinite(sensitivity)) or not sensitivity.size:
        return np.eye(len(sensitivity))
    left, values, _ = np.linalg.svd(sensitivity, full_matrices=False)
    return np.asarray(left[:, values > least * values.max(initial=0.0)].T)
