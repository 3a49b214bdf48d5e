"""Linearized path constraints over the prediction horizon."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from tenscasadi.util.validate import TOLERANCE

NO_LIMIT = 1 / TOLERANCE  # scaled distance that stands for no limit


class Horizon(NamedTuple):
    """Predicted states on a horizon of K intervals, with sensitivities.

    Sensitivities are derivatives with respect to the changes ΔU of all controls so far. They are
    transposed.

    Attributes
    ----------
    states, state_effects : list
        States and their sensitivities in the previous sampling period, now, and at the ends of the
        intervals.
    controls, control_effects : list
        Controls and their sensitivities in the previous sampling period, and in the intervals.
    """

    states: list[Any]
    state_effects: list[Any]
    controls: list[Any]
    control_effects: list[Any]

    @property
    def intervals(self) -> int:
        """Number K of intervals."""
        return len(self.controls) - 1


class HorizonLimits:
    """Linearized path constraints over the prediction horizon.

    Limits of the control itself are not included. Constraints on one instant hold at the end of
    each interval, and terminal constraints at the end of the horizon. Rate limits hold between the
    starts of neighboring intervals, and from the previous sampling period to the present one.

    Parameters
    ----------
    scales : Scales
        Typical sizes of the quantities.
    strength : float
        Typical force density [N/m].
    period : float
        Length of an interval [s].
    """

    def __init__(self, problem: Problem, scales: Scales, strength: float, period: float) -> None:
        self._period = period
        self._instants = [
            (_one_sided(rows), rows.ends == ("last",))
            for rows in scaled_rows(problem, PathBound, scales, strength)
        ]
        self._rates = [
            _one_sided(rows) for rows in scaled_rows(problem, RateBound, scales, strength)
        ]

    @property
    def from_last_decision(self) -> bool:
        """Whether the constraints depend on the previous sampling period."""
        return bool(self._rates)

    def rows(self, horizon: Horizon, time: Any, begun: Any) -> tuple[Any, Any]:
        """Build aᵀ (K nu, m) and b (m,) of the constraints a ΔU ≤ b.

        `begun` is whether there was a previous sampling period. `time` is the start of the horizon
        [s], as an expression. ΔU is the change of the K nu controls.
        """
        count = horizon.control_effects[-1].shape[0]
        a, b = [ca.DM(count, 0)], [ca.DM(0, 1)]
        x, dx, u, du = horizon
        for limit, last in self._instants:
            for k in range(horizon.intervals - 1 if last else 0, horizon.intervals):
                room, by_state, by_control, _ = limit(
                    x[k + 2], u[k + 1], time + (k + 1) * self._period
                )
                a.append(_combine(count, (by_state, by_control), (dx[k + 2], du[k + 1])))
                b.append(room)
        for limit in self._rates:
            for k in range(horizon.intervals):
                room, *slopes, _ = limit(x[k], u[k], x[k + 1], u[k + 1], self._period)
                a.append(_combine(count, slopes, (dx[k], du[k], dx[k + 1], du[k + 1])))
                b.append(room if k else ca.if_else(begun, room, NO_LIMIT))
        return ca.horzcat(*a), ca.vertcat(*b)


def _combine(count: int, slopes: Any, effects: Any) -> Any:
    """Compute Σ effect Jᵀ (count, m).

    `slopes` are the Jacobians J of a constraint. `effects` are the sensitivities of their arguments
    to the first controls or to all `count`.
    """
    parts = [effect @ J.T for J, effect in zip(slopes, effects, strict=True)]
    return sum(ca.vertcat(part, ca.DM(count - part.shape[0], part.shape[1])) for part in parts)


def _one_sided(bound: ScaledRows) -> ca.Function:
    """Build the distances from all finite limits, and their negative Jacobians.

    The Function has the arguments of the constraints `bound`. Jacobians are those with respect to
    each argument.
    """
    inputs = [ca.MX.sym("z", bound.function.size1_in(k)) for k in range(bound.function.n_in())]
    value = bound.function(*inputs)
    upper, lower = (
        np.flatnonzero(np.isfinite(limit)).tolist() for limit in (bound.upper, bound.lower)
    )
    room = ca.vertcat(
        ca.DM(bound.upper)[upper, :] - value[upper, :],
        value[lower, :] - ca.DM(bound.lower)[lower, :],
    )
    return ca.Function("room", inputs, [room, *(-ca.jacobian(room, z) for z in inputs)])
