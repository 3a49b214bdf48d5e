"""A plan on a grid that is refined where its steps are too long, until its replay meets a tolerance."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from ocp.grid import at
from ocp.plan import Plan
from ocp.problem import Problem
from ocp.solve import solve
from ocp.solver import Solver
from ocp.transcription import MultipleShooting, OnGrid
from tenscasadi.correction import projection
from tenscasadi.schemes import RungeKutta4
from tenscasadi.validate import Array, instance, positive_number, whole_number

FINE = 10  # steps for one interval of the plan, to tell its defect
MOST_PARTS = 4  # that an interval is cut into at once
CAUTION = 0.3  # of the tolerance is aimed at


def refine(
    problem: Problem,
    tolerance: float,
    transcription: OnGrid | None = None,
    solver: Solver | None = None,
    plan: Plan | None = None,
    attempts: int = 5,
) -> Plan:
    """The plan whose replay ends within `tolerance`, m, of the goals (and as many m per duration in speed).

    Solves on the transcription's grid (None: MultipleShooting(20)) from `plan`, where there is one; cuts the intervals whose steps go
    wrong, in proportion, and solves again from what was found, at most `attempts` times. A plan that could not be found is returned
    as it is; one that still misses the tolerance says so in its message. Raises as `solve`, and TypeError, ValueError.
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    limit = positive_number("tolerance", tolerance)
    whole_number("attempts", attempts, 1)
    on_grid = MultipleShooting(20) if transcription is None else transcription
    instance("transcription", on_grid, OnGrid, "a transcription, such as ocp.MultipleShooting()")
    found = solve(problem, on_grid, solver, plan)
    for _ in range(attempts - 1):
        error = _error(found)
        if not found.success or error <= limit:
            return found
        on_grid = replace(on_grid, intervals=tuple(finer(found, error, limit).tolist()))
        found = solve(problem, on_grid, solver, found)
    if not found.success or _error(found) <= limit:
        return found
    return replace(found, message=f"{found.message}; the tolerance of {limit:g} m was not met in {attempts} attempts: give more, or substeps")


def _error(plan: Plan) -> float:
    return max(plan.replay_error, plan.replay_speed_error * float(plan.time[-1]))


def finer(plan: Plan, error: float, tolerance: float) -> Array:
    """Relative lengths of intervals: those of the plan, each cut into as many parts as its share of the error asks for."""
    gap = defects(plan)
    gap = np.where(np.isfinite(gap), gap, np.nanmax(gap, initial=1.0))
    allowed = CAUTION * tolerance / max(error, 1e-300) * max(float(gap.sum()), 1e-300) / len(gap)
    parts = np.clip(np.ceil((gap / allowed) ** 0.25), 1, MOST_PARTS).astype(int)  # halving the steps of a method of order 4
    if parts.max() == 1:
        parts[:] = 2
    lengths = np.diff(plan.time)
    return np.repeat(lengths / parts, parts)


def defects(plan: Plan) -> Array:
    """How far, m, the planned state at the end of each interval (K,) is from the one that fine steps from its start lead to."""
    if plan.model is None:
        raise ValueError("plan.model is None: give Plan.load(path, problem=...)")
    model, count = plan.model, len(plan.time) - 1
    states, lengths = plan.trajectory.states, np.diff(plan.time)
    advance = RungeKutta4().step(model.ode).map(count)
    now = ca.DM(states[:-1].T)
    for k in range(FINE):
        gamma = at(plan.force_density, plan.time, plan.time[:-1] + (k + 0.5) / FINE * lengths)
        now = advance(now, gamma.T, lengths[None] / FINE)
    if model.mechanism.constrained:
        now = projection(model, 3).map(count)(now)
    gap = np.asarray(now.full()).T - states[1:]
    places = np.abs(gap[:, : model.nq]).max(axis=1)
    speeds = np.abs(gap[:, model.nq : 2 * model.nq]).max(axis=1) * float(plan.time[-1])
    return np.asarray(np.maximum(places, speeds))
