"""Costs and constraint penalties as Functions for simulations."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.costs import cost_terms
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.instant import Instant, symbolic
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.rows import goal_rows
from ocp.problem.scaling import Scales
from ocp.problem.start import FreeStart
from tenscasadi.simulation.engine.kernel import BROKEN_BARS

# cost of a scaled violation of a limit; a goal that is off by its tolerance costs 1
OVERSTEP = 1e5


class HorizonCosts(NamedTuple):
    """Terms of the cost of a trajectory over a prediction horizon.

    Attributes
    ----------
    stage : casadi.Function
        (x, w) → running cost per second, with w = [u; time] for the control u; infinite if a bar length
        has a large error.
    final : casadi.Function
        (x, w) → terminal cost.
    control : casadi.Function or None
        u (nu, K) → cost of the controls alone.
    rates : casadi.Function or None
        (x, u, x⁺, u⁺) → cost of violated rate limits from one period to the next.
    """

    stage: ca.Function
    final: ca.Function
    control: ca.Function | None
    rates: ca.Function | None


def build_horizon_costs(
    problem: Problem, scales: Scales, period: float, intervals: int, place: float, strength: float
) -> HorizonCosts:
    """Build the costs of a problem over a horizon.

    Parameters
    ----------
    period : float
        Length of one of the `intervals` periods [s].
    place : float
        Distance from a goal [m] that costs 1. The scale of velocities is 10 · place/duration.
    strength : float
        Typical force density [N/m].

    Raises
    ------
    ValueError
        If the problem has a `Waypoint` or `FreeStart`.
    """
    now, given = _instant(problem)
    length = period * intervals
    instants = cost_terms(problem.costs).instants
    final = sum((value(now) for share, value in instants if share == 1.0), ca.DM(0))
    last = [
        rows for rows in scaled_rows(problem, PathBound, scales, strength) if rows.ends == ("last",)
    ]
    final += OVERSTEP * sum((_excess(rows, *now.symbols) for rows in last), ca.DM(0))
    misses = _misses(problem, now, {"m": place, "m/s": 10 * place / scales.time})
    rate = build_running_cost(problem, scales, length, strength)(now.state, given) + misses / length
    stage = ca.Function("stage", [now.state, given], [rate + ca.if_else(_broken(now), ca.inf, 0.0)])
    ending = ca.Function(
        "final", [now.state, given], [ca.densify(final + misses)], ["x", "w"], ["cost"]
    )
    return HorizonCosts(
        stage,
        ending,
        build_control_cost(problem, period, intervals),
        build_rate_cost(problem, scales, period, intervals, strength),
    )


def build_running_cost(
    problem: Problem, scales: Scales, length: float, strength: float, weight: float = 1.0
) -> ca.Function:
    """Build the running cost per second, with penalties for limits.

    The Function is (x, w) → cost, with w = [u; time]. `weight` multiplies the costs, not the
    penalties. `length` [s] is the duration over which a penalty is averaged, and `strength` a
    typical force density [N/m].
    """
    now, given = _instant(problem)
    running = cost_terms(problem.costs).express(problem.model).running
    stage = weight * sum((rate(now) for rate in running), ca.DM(0))
    along = [
        rows for rows in scaled_rows(problem, PathBound, scales, strength) if rows.ends != ("last",)
    ]
    stage += OVERSTEP / length * sum((_excess(rows, *now.symbols) for rows in along), ca.DM(0))
    return ca.Function("stage", [now.state, given], [ca.densify(stage)], ["x", "w"], ["cost"])


def _instant(problem: Problem) -> tuple[Instant, Any]:
    """Build a symbolic instant, and its input vector w = [u; time]."""
    now = symbolic(problem.model)
    return now, ca.vertcat(now.control, now.time)


def _misses(problem: Problem, now: Instant, sizes: dict[str, float]) -> Any:
    """Sum the squared goal residuals, divided by their sizes.

    `sizes` maps units such as "m/s" to scales. `now` is the symbolic instant.
    """
    asked = [
        type(part).__name__
        for part in (problem.start, *problem.goals)
        if isinstance(part, (FreeStart, Waypoint))
    ]
    asked += ["CostAt before the end"] * any(
        share < 1 for share, _ in cost_terms(problem.costs).instants
    )
    if asked:
        raise ValueError(
            f"problem has {asked[0]}, which Mppi does not support: find a plan, then give ocp.Tracking of its nodes"
        )
    model = problem.model
    x = ca.SX.sym("x", model.nx)
    rows = goal_rows(problem.terminal_goals, model, x)
    misses = ca.Function("misses", [x], [ca.sumsqr(rows.scale(sizes))]) if rows.names else None
    return misses(now.state) if misses is not None else ca.DM(0)


def _broken(now: Instant) -> Any:
    """Build the condition that the length error of a bar is large.

    It is a CasADi expression of the instant `now`.
    """
    structure = now.model.scene.structure
    if not len(structure.bars):
        return ca.DM(0)
    start, end = structure.bars.T
    along = now.nodes[:, end.tolist()] - now.nodes[:, start.tolist()]
    ratio = ca.sum1(along * along) / ca.DM(structure.bar_lengths**2).T
    least, most = (1 + np.array([-BROKEN_BARS, BROKEN_BARS])) ** 2
    return ca.logic_or(ca.mmin(ratio) < least, ca.mmax(ratio) > most)


def _excess(rows: ScaledRows, *given: Any) -> Any:
    """Sum the scaled violations of path constraints.

    `rows` are the constraints, and `given` the arguments of their Function.
    """
    value = rows.function(*given)
    return ca.sum1(ca.fmax(ca.fmax(value - ca.DM(rows.upper), ca.DM(rows.lower) - value), 0))


def build_control_cost(problem: Problem, period: float, intervals: int) -> ca.Function | None:
    """Build the Function u → cost that depends on controls alone.

    u is (nu, intervals), for intervals of length `period` [s]. Returns None if there are no such
    costs.
    """
    terms = cost_terms(problem.costs).express(problem.model)
    gamma = ca.SX.sym("u", problem.model.nu, intervals)
    each = [expression(gamma, period) for expression in (*terms.control, *terms.changes)]
    return ca.Function("control", [gamma], [ca.densify(sum(each, ca.SX(0)))]) if each else None


def build_rate_cost(
    problem: Problem, scales: Scales, period: float, intervals: int, strength: float
) -> ca.Function | None:
    """Build the Function (x, u, x⁺, u⁺) → penalty of rate limits.

    The arguments are state and control in successive periods. `strength` is a typical force density
    [N/m]. Returns None without rate limits. `period` is the length of each of the `intervals`
    periods [s].
    """
    limits = scaled_rows(problem, RateBound, scales, strength)
    symbols = [
        ca.MX.sym(name, size)
        for name, size in (("x", problem.model.nx), ("u", problem.model.nu)) * 2
    ]
    total = sum((_excess(rows, *symbols, period) for rows in limits), ca.DM(0))
    return (
        ca.Function("rates", symbols, [ca.densify(OVERSTEP / intervals * total)])
        if limits
        else None
    )
