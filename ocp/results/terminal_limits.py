"""Violation of terminal limits by a replay."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array


class TerminalViolation(NamedTuple):
    """Largest violation of a terminal limit.

    Attributes
    ----------
    distance : float
        Change of the state that removes the violation, to first order [m].
    message : str
        Description; "" if no limit is violated.
    """

    distance: float
    message: str


def measure_terminal_limits(
    problem: Problem, plan: PlanResult, motion: Trajectory
) -> TerminalViolation:
    """Find the terminal limit that a replay violates most.

    `motion` is the replay. The violation divided by the norm of the gradient is the distance from
    states within the limit. The gradient is the larger of those at the planned and at the replayed
    final state, as quadratic functions have none at their minimum. Velocities count as velocity ×
    duration.
    """
    model, duration = problem.model, float(plan.time[-1])
    ends = np.array([plan.trajectory.states[-1], motion.states[-1]])
    controls = np.array([plan.control[-1], motion.control[-1]])
    scale = np.ones(model.nx)
    scale[model.nq : 2 * model.nq] = 1 / duration
    worst = TerminalViolation(0.0, "")
    for limited in path_constraints(problem, PathBound):
        if limited.ends != ("last",):
            continue
        excess, slope = _measure(limited, ends, controls, duration, scale)
        found = excess > 0
        away = np.where(found, np.inf, 0.0)
        np.divide(excess, slope, out=away, where=found & (slope > 0))
        # A function of the controls alone has its planned value.
        away[found & (slope == 0) & np.isfinite(excess)] = 0.0
        k = int(np.argmax(away))
        if away[k] > worst.distance:
            amount = (
                f"violates its limit by {excess[k]:.2g}, as much as {away[k]:.2g} m of motion"
                if np.isfinite(excess[k])
                else "is not a number"
            )
            worst = TerminalViolation(float(away[k]), f"{limited.names[k]} {amount}")
    return worst


def _measure(
    limited: PathConstraint, ends: Array, controls: Array, duration: float, scale: Array
) -> tuple[Array, Array]:
    """Evaluate violations (m,) and gradient norms (m,) of m terminal limits.

    The limits `limited` are evaluated at states `ends` (k, nx) with controls (k, nu) at the time
    `duration`. Violations are those of the last state, inf if undefined. Gradients with respect to
    the state are multiplied by `scale` (nx,), and their norms are the maxima over all states.
    """
    value = ca.densify(limited.value)
    function = ca.Function(
        "end", limited.symbols, [value, ca.densify(ca.jacobian(value, limited.symbols[0]))]
    )
    slopes = np.zeros(len(limited.names))
    entries = slopes
    for state, control in zip(ends, controls, strict=True):
        entries, J = (part.full() for part in function(state, control, duration))
        slopes = np.fmax(slopes, np.linalg.norm(J * scale, axis=1))
    entries = np.ravel(entries)
    excess = np.maximum(np.maximum(limited.lower - entries, entries - limited.upper), 0.0)
    return np.where(np.isfinite(entries), excess, np.inf), slopes
