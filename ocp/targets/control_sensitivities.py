"""A motion over several intervals with its exact derivatives, and what the strings can still change of its end."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.linearization import EquationDerivatives, LinearDynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.tableaux import CLASSICAL
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.linear_algebra import independent_rows
from tenscasadi.util.validate import Array, Indices

# of the strongest direction: below it a row of the goal is not controlled to first order, or by
# errors of the scheme only
REACHED = 1e-5
HARDLY_REACHED = 1e-9  # the same, for a second attempt
SURELY = (
    3.0  # times the share above: rows that the last intervals move by more need no further look
)
LARGEST = 1e20  # state beyond which a motion has diverged
FEW = 50  # rows that are looked at as a whole
PROBES = 8  # random combinations of rows from which the size of a gradient is estimated
# intervals from the end after which it is compared for the first time, then after twice as many
FIRST_COMPARED = 4


class ControlSensitivities:
    """Sensitivities of a motion to its controls over `count` intervals, in steps of Runge and Kutta.

    grouping: E (nu, groups) of ones, γ of all strings from those of groups that pull alike
    (`ocp.transcription.mesh`); None: each pulls on its own. spans (count,): over which intervals
    controls are held, numbered from 0; None: each interval has its own. Controls that are given are
    evened out within groups and spans.
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
        self._evened = self._grouping / self._grouping.sum(axis=0) @ self._grouping.T
        self._spans = None if spans is None or spans[-1] + 1 == len(spans) else spans

    @cached_property
    def _rate(self) -> ArrayFunction:
        return ArrayFunction(self._model.ode)

    def rollout(self, start: Array, controls: Array, duration: float) -> Array:
        """Return the states (count + 1, nx) of the motion under controls (count, nu); NaN from where it diverges."""
        return self._rolled(start, self._even(controls), duration / len(controls))[0]

    def _even(self, controls: Array) -> Array:
        """Return controls (count, nu) that are the same within groups and spans."""
        if self._spans is not None:
            controls = (self._summed(controls) / np.bincount(self._spans)[:, None])[self._spans]
        return np.asarray(controls @ self._evened)

    def _summed(self, values: Array) -> Array:
        """Sum values (…, count, m) over the intervals of each span."""
        return (
            values
            if self._spans is None
            else np.add.reduceat(values, np.unique(self._spans, return_index=True)[1], axis=-2)
        )

    def of_rows(
        self,
        rows: ca.Function,
        weights: Array,
        start: Array,
        controls: Array,
        duration: float,
        at: int | None = None,
    ) -> Array:
        """Return the gradient (m, spans·groups [+ 1]) of weights (m, ·) @ rows(x) by all controls (and the duration).

        rows are taken after `at` intervals from `start`, None: all. NaN where the motion diverges.
        """
        length = duration / len(controls)
        last, motion = self._linearised(rows, weights, start, self._even(controls)[:at], length)
        return self._gradient(last, motion, len(controls), length)

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
        """Return orthonormal combinations (rank, m) of the rows that the controls can move, see `independent_rows`."""
        length = duration / len(controls)
        last, motion = self._linearised(rows, weights, start, self._even(controls)[:at], length)
        if (
            motion is not None
            and self._spans is None
            and self._surely_controlled(last, motion, length, least)
        ):
            return np.eye(len(weights))
        return independent_rows(self._gradient(last, motion, len(controls), length), least)

    def _surely_controlled(
        self, last: Array, motion: LinearDynamics, length: float, least: float
    ) -> bool:
        """Tell whether the controls of the last intervals alone move all rows by more than their share of the size of the whole gradient.

        That size is estimated from a few random combinations of the rows, as E |wᵀ S|² = |S|² for w
        of independent unit variance: the strongest direction grows with it.
        """
        if len(last) < FEW:
            return False
        probes = np.random.default_rng(0).normal(size=(PROBES, len(last))) / np.sqrt(PROBES)
        size = sum(
            float(np.sum(by_control**2))
            for by_control, _ in self._backwards(probes @ last, motion, length)
        )
        gathered, compared = np.zeros((len(last), len(last))), FIRST_COMPARED
        for count, (by_control, _) in enumerate(self._backwards(last, motion, length), 1):
            gathered += by_control @ by_control.T
            if count == compared and np.all(np.isfinite(gathered)):
                compared *= 2
                squares = np.linalg.eigvalsh(gathered)
                if squares[0] > (SURELY * least) ** 2 * squares[-1] * max(
                    1.0, size / squares.sum()
                ):
                    return True
        return False

    def _gradient(
        self, last: Array, motion: LinearDynamics | None, count: int, length: float
    ) -> Array:
        """Return the derivatives of `of_rows` of rows with the gradient `last` (m, nx) at the end of the motion."""
        groups = self._grouping.shape[1]
        result = np.zeros((len(last), count * groups + self._free_duration))
        if motion is None:
            return np.full_like(result, np.nan)
        end = len(motion.rates) // (4 * self._substeps)
        for back, (by_control, by_length) in enumerate(self._backwards(last, motion, length), 1):
            result[:, (end - back) * groups : (end - back + 1) * groups] = by_control
            result[:, count * groups :] += by_length[:, None] / count
        by_span = self._summed(result[:, : count * groups].reshape(len(last), count, groups))
        return np.column_stack(
            [
                by_span.reshape(len(last), np.prod(by_span.shape[1:], dtype=int)),
                result[:, count * groups :],
            ]
        )

    def _linearised(
        self, rows: ca.Function, weights: Array, start: Array, controls: Array, length: float
    ) -> tuple[Array, LinearDynamics | None]:
        """Return the gradient (m, nx) of the rows at the end of the motion under even controls, and the motion; None where it diverges."""
        states, points = self._rolled(start, controls, length)
        if not np.all(np.abs(states) <= LARGEST):
            return np.zeros((len(weights), len(start))), None
        return weights @ _slope(rows, states[-1]), EquationDerivatives.of(self._model).at(
            points, np.repeat(controls, 4 * self._substeps, axis=0)
        )

    def _rolled(self, start: Array, controls: Array, length: float) -> tuple[Array, Array]:
        """Return the states (count + 1, nx) at the ends of intervals, and the points (4 count substeps, nx) at which the rate is taken."""
        h, n = length / self._substeps, self._substeps
        points: list[Array] = []
        rates: list[Array] = []
        states = np.full((len(controls) * n + 1, len(start)), np.nan)
        states[0] = start
        for k, u in enumerate(np.repeat(controls, n, axis=0)):
            x = states[k]
            for stage in range(4):  # each sees the one before it only
                points.append(
                    x if stage == 0 else x + h * CLASSICAL.a[stage][stage - 1] * rates[-1]
                )
                rates.append(self._rate(points[-1], u)[0].ravel())
            states[k + 1] = x + h * (np.array(CLASSICAL.b) @ rates[-4:])
            if not np.all(np.isfinite(states[k + 1])):
                break
        return states[::n], np.array(points)

    def _backwards(
        self, last: Array, motion: LinearDynamics, length: float
    ) -> Iterator[tuple[Array, Array]]:
        """Yield the derivatives of rows with the gradient `last` (m, nx), interval by interval from the last to the first.

        By the controls of each group, (m, groups), and by the length of all intervals, (m,): what
        this interval adds.
        """
        h, nx, stages = length / self._substeps, last.shape[1], 4 * self._substeps
        pulled, later = last.T, np.zeros_like(last.T)
        for end in range(len(motion.rates), 0, -stages):
            by_control, by_length = np.zeros((self._model.nu, len(last))), np.zeros(len(last))
            for k in reversed(range(end - stages, end)):
                i = k % 4
                if i == 3:
                    before, later = pulled, np.zeros_like(pulled)
                pull = CLASSICAL.b[i] * before + (CLASSICAL.a[i + 1][i] * later if i < 3 else 0.0)
                slopes = h * motion.adjoint(k, pull)
                later = slopes[:nx]
                pulled = pulled + later
                by_control += slopes[nx : nx + self._model.nu]
                by_length += motion.rates[k] @ pull / self._substeps
            yield by_control.T @ self._grouping, by_length


def _slope(rows: ca.Function, x: Array) -> Array:
    """Return the gradient (m, nx) of the rows of a Function of x."""
    symbol: Any = (ca.SX if rows.is_a("SXFunction") else ca.MX).sym("x", len(x))
    return np.asarray(ca.Function("slope", [symbol], [ca.jacobian(rows(symbol), symbol)])(x).full())
