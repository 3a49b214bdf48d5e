"""What the strings can still change: sensitivities of the end of a motion to all that is planned, along a real motion."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.sensitivities import Motion
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

REACHED = 1e-5  # of the strongest direction: below it a row of the goal is not controlled to first order, or by errors of the scheme only
HARDLY_REACHED = 1e-9  # the same, for a second attempt


class Reach:
    """Sensitivities of a motion to its controls over `count` intervals, in steps of Runge and Kutta.

    spread: E (nu, groups) of ones, γ of all strings from those of groups that pull alike (`ocp.grid.spread`); None: each pulls on its own.
    Controls that are given are evened out within groups.
    """

    def __init__(self, model: Model, count: int, free_duration: bool, substeps: int = 1, spread: Array | None = None) -> None:
        self._motion, self._free_duration = Motion(model, count, substeps), free_duration
        self._spread = np.eye(model.nu) if spread is None else spread
        self._evened = self._spread / self._spread.sum(axis=0) @ self._spread.T

    def rollout(self, start: Array, controls: Array, duration: float) -> Array:
        """States (count + 1, nx) of the motion under controls (count, nu)."""
        return self._motion.states(start, controls @ self._evened, duration / len(controls))[0]

    def of_rows(self, rows: ca.Function, weights: Array, start: Array, controls: Array, duration: float, at: int | None = None) -> Array:
        """Gradient (m, count·groups [+ 1]) of weights (m, ·) @ rows(x) after `at` intervals (None: all) from `start` by all controls (and the
        duration); NaN where the motion diverges."""
        controls, count, length = controls @ self._evened, len(controls), duration / len(controls)
        end = count if at is None else at
        strings, groups = self._spread.shape
        states, points = self._motion.states(start, controls, length)
        if not np.all(np.isfinite(states)):
            return np.full((len(weights), count * groups + self._free_duration), np.nan)
        x: Any = (ca.SX if rows.is_a("SXFunction") else ca.MX).sym("x", len(start))
        last = weights @ np.asarray(ca.Function("last", [x], [ca.densify(ca.jacobian(rows(x), x))])(states[end]).full())
        by_control, by_length = self._motion.gradient(last, points, controls, length, end)
        by_group = by_control.reshape(len(last), count, strings) @ self._spread
        parts = [by_group.reshape(len(last), count * groups), by_length[:, None] / count]
        return np.concatenate(parts[: 1 + self._free_duration], axis=1)


def controlled(sensitivity: Array, least: float = REACHED) -> Array:
    """Orthonormal combinations (rank, m) of rows that the controls can move, given their gradient; all of them where it is not finite."""
    if not np.all(np.isfinite(sensitivity)) or not sensitivity.size:
        return np.eye(len(sensitivity))
    left, values, _ = np.linalg.svd(sensitivity, full_matrices=False)
    return np.asarray(left[:, values > least * values.max(initial=0.0)].T)
