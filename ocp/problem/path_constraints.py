"""Limits and costs along a plan as functions of instants, scaled: what every transcription imposes in the same way."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.boundary.target import Scales, Target
from ocp.problem.bounds import CornerBound, Limited, PathBound
from ocp.problem.costs import ControlCost, FinalCost, RunningCost
from ocp.problem.instant import symbolic
from ocp.problem.limits import Along, limits_along
from ocp.problem.problem import Problem
from tenscasadi.util.validate import Array


class StageRows(NamedTuple):
    """Rows divided by `scale`, to be imposed at these ends ("start", "end") of every interval."""

    function: ca.Function
    lower: Array
    upper: Array
    names: tuple[str, ...]
    ends: tuple[str, ...]
    scale: Array


def stage_rows(problem: Problem, scales: Scales, strength: float) -> list[StageRows]:
    """Rows of all bounds of instants, Functions (x, u, t) → rows: of nodes at the end of every interval, of forces at both its ends.

    strength: a typical γ, N/m.
    """
    return [_rows(one, scales, strength) for one in limits_along(problem, PathBound)]


def corner_rows(problem: Problem, scales: Scales, strength: float) -> list[StageRows]:
    """Rows of all bounds from each time for which a profile has force densities to the next: Functions (x, u, x⁺, u⁺, h) → rows."""
    return [_rows(one, scales, strength) for one in limits_along(problem, CornerBound)]


def typical_cost(problem: Problem, strength: float, states: Array, force_density: Array, duration: float) -> float:
    """The costs of states (K + 1, nx) and force densities (K, α) that swing once about `strength`: what makes the objective of order one.

    Were they to alternate from interval to interval, costs of their rates would grow with the square of the intervals, and the objective
    become small beside the solver's tolerance.
    """
    count = len(force_density)
    string, interval = np.indices(force_density.T.shape)
    pattern = strength * (1 + np.sqrt(0.5) * (-1.0) ** string * np.sin(2 * np.pi * (interval + 0.5) / count))
    total, x = 0.0, states.T
    for cost in problem.costs:
        now = symbolic(problem.model)
        inputs = [now.state, now.control, now.time]
        if isinstance(cost, ControlCost):
            total += float(ca.DM(cost.expression(ca.DM(pattern), duration / count)))
        elif isinstance(cost, RunningCost):
            rate = ca.Function("rate", inputs, [cost.rate(now)]).map(count)
            total += duration / count * float(ca.sum2(rate(x[:, 1:], pattern, np.linspace(0.0, duration, count + 1)[None, 1:])))
        elif isinstance(cost, FinalCost):
            total += float(ca.Function("final", inputs, [cost.final(now)])(x[:, -1], pattern[:, -1], duration))
    return abs(total) if np.isfinite(total) and total else 1.0


def _rows(along: Along, scales: Scales, strength: float) -> StageRows:
    limited = along.limited
    scale = _scale(limited, scales, strength)
    function = ca.Function("bound", along.symbols, [ca.densify(limited.value / ca.DM(scale))])
    return StageRows(function, limited.lower / scale, limited.upper / scale, limited.names, along.ends, scale)


def _scale(limited: Limited, scales: Scales, strength: float) -> Array:
    """What one row of each entry stands for."""
    sizes = {"N": strength * scales.length, "N/m": strength, "m": scales.length, "m/s": scales.length / scales.time}
    if limited.unit:
        return np.full(len(limited.names), sizes[limited.unit])
    ends = np.array([limited.lower, limited.upper])
    largest = np.max(np.where(np.isfinite(ends), np.abs(ends), 0.0), axis=0)
    return np.where(largest > 0, largest, 1.0)


class StopRows(NamedTuple):
    """Rows of a waypoint in interval `interval`: Function (x, x⁺, h) of its two ends and its length → rows, all zero."""

    interval: int
    function: ca.Function
    names: tuple[str, ...]


def stop_rows(target: Target, fractions: Array) -> list[StopRows]:
    """The rows of all waypoints on a grid with these shares of the duration (K,)."""
    result = []
    for number, stop in enumerate(target.stops):
        if not stop.target.count:
            continue
        k, share = within(fractions, stop.share)
        size = len(target.start)
        x, y, h = (ca.MX.sym(name, n) for name, n in (("x", size), ("y", size), ("h", 1)))
        state = y if share == 1.0 else cubic(x, y, h, share, stop.positions)
        names = tuple(f"goal of waypoint {number}, combination {row}" for row in range(stop.target.count))
        result.append(StopRows(k, ca.Function("stop", [x, y, h], [stop.target.rows(state)]), names))
    return result


def within(fractions: Array, share: float) -> tuple[int, float]:
    """The interval in which a share of the duration lies, and the share of that interval: more than 0, up to 1."""
    ends = np.cumsum(fractions)
    k = min(int(np.searchsorted(ends, share - 1e-9)), len(ends) - 1)
    part = float((share - ends[k] + fractions[k]) / fractions[k])
    return k, 1.0 if part > 1 - 1e-9 else part


def cubic(x: Any, y: Any, h: Any, share: float, positions: int) -> Any:
    """The state at a share of an interval of length h between states x and y, along the cubic with their places and velocities."""
    s, nq = share, positions
    q = (1 + 2 * s) * (1 - s) ** 2 * x[:nq] + s**2 * (3 - 2 * s) * y[:nq] + h * s * (1 - s) * ((1 - s) * x[nq : 2 * nq] - s * y[nq : 2 * nq])
    change = (y[:nq] - x[:nq]) / h
    v = 6 * s * (1 - s) * change + (1 - s) * (1 - 3 * s) * x[nq : 2 * nq] + s * (3 * s - 2) * y[nq : 2 * nq]
    return ca.vertcat(q, v, (1 - s) * x[2 * nq :] + s * y[2 * nq :])
