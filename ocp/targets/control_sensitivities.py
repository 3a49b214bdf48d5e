"""Sensitivities of goal rows to the controls along a trajectory."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.tableaux import CLASSICAL
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.linear_algebra import independent_rows
from tenscasadi.util.validate import Array, Indices

# relative to the strongest direction: below it a goal row is not controllable to first order, or
# only through errors of the scheme. Along unstable trajectories the strongest direction grows large:
# 1e-5 drops a row that stiff strings under rest-length control do move (tests/test_readme.py).
REACHED = 1e-6


class ControlSensitivities:
    """Derivatives of goal rows with respect to piecewise constant controls.

    They are those of steps of the classical Runge-Kutta method.

    Parameters
    ----------
    model : Model
        The model.
    free_duration : bool
        Whether the duration is a decision variable.
    substeps : int
        Steps per interval.
    grouping : ndarray, shape (nu, groups), or None
        Matrix E of ones that maps control groups to strings (`ocp.transcription.mesh`). None: each
        string has its own control.
    spans : ndarray of int, shape (count,), or None
        Number of the span of constant control that contains each interval. None: each interval is a
        span. Given controls are averaged within groups and spans.
    """

    def __init__(
        self,
        model: Model,
        free_duration: bool,
        substeps: int = 1,
        grouping: Array | None = None,
        spans: Indices | None = None,
    ) -> None:
        self._model, self._substeps, self._free_duration = model, substeps, free_duration
        self._grouping = np.eye(model.nu) if grouping is None else grouping
        self._average = self._grouping / self._grouping.sum(axis=0) @ self._grouping.T
        self._spans = None if spans is None or spans[-1] + 1 == len(spans) else spans

    @cached_property
    def _rate(self) -> ArrayFunction:
        return ArrayFunction(self._model.ode)

    def rollout(self, start: Array, controls: Array, duration: float) -> Array:
        """Simulate under controls (count, nu); NaN after divergence.

        Returns the states (count + 1, nx) at the ends of intervals.
        """
        return self._simulate(start, self._averaged(controls), duration / len(controls))[0]

    def gradient(
        self,
        rows: ca.Function,
        weights: Array,
        start: Array,
        controls: Array,
        duration: float,
        at: int | None = None,
    ) -> Array:
        """Compute the gradient of weights @ rows(x).

        Its shape is (m, spans·groups [+ 1]).

        It is with respect to all controls, and to the duration if it is free. weights are (m, ·).
        The rows are evaluated after `at` intervals from `start`, or after all if None. NaN if the
        simulation diverges.
        """
        count, length, groups = len(controls), duration / len(controls), self._grouping.shape[1]
        by_control, by_length = np.zeros((count, len(weights), groups)), np.zeros(len(weights))
        held = self._averaged(controls)[:at]
        states, points = self._simulate(start, held, length)
        if np.all(np.abs(states) <= 1e20):  # otherwise it has diverged
            last = weights @ _jacobian(rows, states[-1])
            own, by_length = self._sweep_back(last, points, held, length)
            by_control[: len(held)] = own @ self._grouping
        else:
            by_control[:] = by_length[:] = np.nan
        spans = by_control.transpose(1, 0, 2)
        if self._spans is not None:
            spans = _sum_spans(spans, self._spans)
        by_span = spans.reshape(len(weights), -1 if spans.size else 0)
        return np.column_stack([by_span, *[by_length / count] * self._free_duration])

    def controllable_rows(
        self,
        rows: ca.Function,
        weights: Array,
        start: Array,
        controls: Array,
        duration: float,
        at: int | None = None,
        least: float = REACHED,
    ) -> Array:
        """Find orthonormal combinations (rank, m) of the controllable rows."""
        return independent_rows(self.gradient(rows, weights, start, controls, duration, at), least)

    def _averaged(self, controls: Array) -> Array:
        """Average controls (count, nu) within groups and spans."""
        if self._spans is not None:
            sums = _sum_spans(controls, self._spans)
            controls = (sums / np.bincount(self._spans)[:, None])[self._spans]
        return np.asarray(controls @ self._average)

    def _simulate(self, start: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """Simulate with `substeps` steps per interval.

        Returns the states (count + 1, nx) at the ends of intervals, and the points (4 count
        substeps, nx) of all stages.
        """
        h, n = length / self._substeps, self._substeps
        points: list[Array] = []
        rates: list[Array] = []
        states = np.full((len(controls) * n + 1, len(start)), np.nan)
        states[0] = start
        for k, u in enumerate(np.repeat(controls, n, axis=0)):
            x = states[k]
            for stage in range(4):  # each stage depends only on the previous one
                points.append(
                    x if stage == 0 else x + h * CLASSICAL.a[stage][stage - 1] * rates[-1]
                )
                rates.append(self._rate(points[-1], u)[0].ravel())
            states[k + 1] = x + h * (np.array(CLASSICAL.b) @ rates[-4:])
            if not np.all(np.isfinite(states[k + 1])):
                break
        return states[::n], np.array(points)

    def _sweep_back(
        self, last: Array, points: Array, controls: Array, length: float
    ) -> tuple[Array, Array]:
        """Propagate the final gradient (m, nx) back to the controls.

        Returns the derivatives (count, m, nu) with respect to the control of each interval, and
        (m,) with respect to the length of all intervals.
        """
        h, nx, nw = length / self._substeps, last.shape[1], self._model.nx + self._model.nu
        stages = 4 * self._substeps
        motion = EquationDerivatives.of(self._model).at(points, np.repeat(controls, stages, axis=0))
        by_control = np.zeros((len(controls), self._model.nu, len(last)))
        by_length, after, later = np.zeros(len(last)), last.T, np.zeros_like(last.T)
        for k in reversed(range(len(points))):
            i = k % 4
            if i == 3:
                before, later = after, np.zeros_like(after)
            seed = CLASSICAL.b[i] * before + (CLASSICAL.a[i + 1][i] * later if i < 3 else 0.0)
            slopes = h * motion.adjoint(k, seed)
            later = slopes[:nx]
            after = after + later
            by_control[k // stages] += slopes[nx:nw]
            by_length += motion.rates[k] @ seed / self._substeps
        return by_control.transpose(0, 2, 1), by_length


def _jacobian(rows: ca.Function, x: Array) -> Array:
    """Compute the Jacobian (m, nx) of a Function of x."""
    symbol: Any = (ca.SX if rows.is_a("SXFunction") else ca.MX).sym("x", len(x))
    return np.asarray(
        ca.Function("jacobian", [symbol], [ca.jacobian(rows(symbol), symbol)])(x).full()
    )


def _sum_spans(values: Array, spans: Indices) -> Array:
    """Sum values (…, count, m) over each span's intervals."""
    first = np.unique(spans, return_index=True)[1]
    return np.asarray(np.add.reduceat(values, first, axis=-2))
