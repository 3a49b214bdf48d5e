"""Mesh refinement: where the mesh of a plan is too coarse, and one that is fine enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.results.result import PlanResult
from ocp.sampling.solver import Sampling
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.validate import Array

DEFECT_STEPS = 10  # steps for one interval of the plan, to tell its defect
LOST = 1e6  # tolerances that a replay which diverges counts as its error
MOST_PARTS = 4  # that an interval is cut into at once
FAR = float(
    MOST_PARTS**4
)  # times the tolerance: a mesh that is cut once, with a method of order 4, does not gain more
CAUTION = 0.3  # of the tolerance is aimed at

Again = Callable[..., PlanResult]  # (plan, changes of its transcription by name)


def refine_until_accurate(
    plan: PlanResult, tolerance: float, attempts: int, find_plan: Callable[..., PlanResult]
) -> PlanResult:
    """Solve again until the replay ends within a tolerance, m, of the goals.

    Each attempt cuts intervals, where one finer mesh cannot do it once with corrections instead.
    find_plan: as `ocp.search.find_plan.find_plan`. Returns the best plan; where that misses the
    tolerance, its message says so. A plan without an optimum is returned as it is. Raises
    ValueError where it is not known how the plan was solved.
    """
    problem, transcription, solver = plan.problem, plan.transcription, plan.solver
    if problem is None or transcription is None or solver is None:
        raise ValueError(
            f"refine needs to know how the plan was solved ({plan.not_restored}): refine solve(problem, ..., guess=plan)"
        )
    if isinstance(solver, Ipopt):
        solver = replace(solver, warm=True)

    def again(known: PlanResult, **changes: Any) -> PlanResult:
        changed = replace(known.transcription or transcription, **changes)
        return find_plan(problem, changed, solver, known, tolerance, tracked=plan.tracked)

    if isinstance(solver, Sampling):
        found, missed = _sample_again(plan, tolerance, again)
    else:
        correctable = isinstance(solver, (Ipopt, CondensedNewton)) and not (
            plan.tracked or problem.phases
        )
        found, missed = _refine(plan, tolerance, attempts, again, correctable)
    if not missed:
        return found
    ends = f"its replay ends {found.replay_error:.2g} m and {found.replay_speed_error:.2g} m/s from the goal"
    told = f"found after {found.iterations} iterations; the tolerance of {tolerance:g} m was not met {missed}; {ends}"
    return replace(found, success=False, message=told)


def _refine(
    plan: PlanResult, tolerance: float, attempts: int, again: Again, correctable: bool
) -> tuple[PlanResult, str]:
    """Return a plan that meets the tolerance and "", or the best and why it does not."""
    why = f"in {attempts} attempts: give more, or substeps"
    for _ in range(attempts):
        error = plan.worst_error
        if error <= tolerance or not (plan.duals or plan.success):
            return plan, ""
        if correctable and np.isfinite(error) and error > FAR * tolerance:
            plan, correctable = _better(plan, again(plan, accuracy=CAUTION * tolerance)), False
            continue
        finest = again(plan, **_finer_mesh(plan, tolerance))
        if finest.duals is not None and not finest.worst_error <= max(tolerance, error / 2):
            why = f"and {len(finest.time) - 1} intervals in place of {len(plan.time) - 1} do not halve the error: give a larger tolerance"
            plan = min(plan, finest, key=lambda one: one.worst_error)
            if correctable:
                plan = _better(plan, again(plan, accuracy=CAUTION * tolerance))
            break
        plan = finest
    met = plan.worst_error <= tolerance or not (plan.duals or plan.success)
    return plan, "" if met else why


def _finer_mesh(plan: PlanResult, tolerance: float) -> dict[str, Any]:
    """Cut the intervals where the motion is least exact; those of phases all in two."""
    error, known = plan.worst_error, plan.transcription
    if known is not None and plan.problem is not None and plan.problem.phases:
        return {"intervals": tuple(np.repeat(known.fractions, 2).tolist())}
    too_large = error / tolerance if np.isfinite(error) else LOST
    model = plan.require_model("refine")
    lengths = finer(model, plan.time, plan.trajectory.states, plan.control, too_large)
    given = None if known is None else known.accuracy
    # The accuracy of the plan's own tolerance would undo what the finer mesh gains.
    accuracy = None if given is None else min(given, CAUTION * tolerance)
    return {"intervals": tuple(lengths.tolist()), "accuracy": accuracy}


def _sample_again(plan: PlanResult, tolerance: float, again: Again) -> tuple[PlanResult, str]:
    """Return a plan of sampled motions that meets the tolerance and "", or the best and why it does not."""
    if not plan.success or plan.worst_error <= tolerance:
        return plan, ""
    found = again(plan)
    if found.success:
        return found, ""
    return plan, "by more samples: give a larger tolerance, or groups or knots of its own"


def _better(plan: PlanResult, other: PlanResult) -> PlanResult:
    return other if other.duals is not None and other.worst_error < plan.worst_error else plan


def finer(
    model: Model, time: Array, states: Array, force_density: Array, too_large: float
) -> Array:
    """Return relative lengths of intervals: those of a plan, each cut into as many parts as its share of an error asks for.

    too_large: how many times the error exceeds what is allowed.
    """
    gap = defects(model, time, states, force_density)
    gap = np.where(np.isfinite(gap), gap, np.nanmax(gap, initial=1.0))
    allowed = CAUTION / max(too_large, 1e-300) * max(float(gap.sum()), 1e-300) / len(gap)
    parts = np.clip(np.ceil((gap / allowed) ** 0.25), 1, MOST_PARTS).astype(
        int
    )  # halving the steps of a method of order 4
    if parts.max() == 1:
        parts[:] = 2
    return np.repeat(np.diff(time) / parts, parts)


def defects(model: Model, time: Array, states: Array, force_density: Array) -> Array:
    """Return how far, m, the planned state at the end of each interval (K,) is from the one that fine steps from its start lead to.

    time (K + 1,), states (K + 1, nx), force_density (K, α) or (K + 1, α). Speeds count with what
    they add up to over the plan.
    """
    count, lengths = len(time) - 1, np.diff(time)
    advance = RungeKutta4().step(model.ode).map(count)
    now = ca.DM(states[:-1].T)
    for k in range(DEFECT_STEPS):
        gamma = profile_at(force_density, time, time[:-1] + (k + 0.5) / DEFECT_STEPS * lengths)
        now = advance(now, gamma.T, lengths[None] / DEFECT_STEPS)
    if model.mechanism.constrained:
        now = build_projection(model, 3).map(count)(now)
    gap = np.asarray(now.full()).T - states[1:]
    places, speeds, _ = model.split(np.abs(gap))
    return np.asarray(np.maximum(places.max(axis=1), speeds.max(axis=1) * float(time[-1])))
