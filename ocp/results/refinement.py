"""Mesh refinement of plans where the discretization error is large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.results.result import STEPS, PlanResult
from ocp.sampling.solver import Sampling
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.validate import ROUNDING, Array

MOST_PARTS = 4  # maximum number of parts of an interval in one refinement
FAR = float(
    MOST_PARTS**4
)  # × tolerance: the largest error that one refinement removes, with a method of order 4
CAUTION = 0.3  # safety factor: error that refinement aims at, in units of the tolerance

Again = Callable[..., PlanResult]  # (plan, new options of its transcription) → plan


def refine_until_accurate(
    plan: PlanResult,
    tolerance: float,
    attempts: int,
    find_plan: Callable[..., PlanResult],
    monitor: Any,
) -> PlanResult:
    """Refine the mesh until the replay meets a tolerance [m].

    Each attempt subdivides intervals and solves again, starting from the last plan. Deferred
    correction is tried once, if the error is too large for one finer mesh or if a finer mesh does
    not halve it. `find_plan` has the arguments of `ocp.search.find_plan.find_plan`, one of which is
    the `monitor`. Returns the best plan, whose message reports if it misses the tolerance. A plan
    of a search that did not converge is returned unchanged. Raises ValueError if problem,
    transcription or solver of the plan are unknown. `attempts` is the largest number of attempts.
    """
    problem, transcription, solver = plan.problem, plan.transcription, plan.solver
    if problem is None or transcription is None or solver is None:
        raise ValueError(
            f"refine needs to know how the plan was solved ({plan.not_restored}): refine solve(problem, ..., guess=plan)"
        )
    if isinstance(solver, Ipopt):
        solver = replace(solver, warm_start=True)

    def again(known: PlanResult, **changes: Any) -> PlanResult:
        changed = replace(known.transcription or transcription, **changes)
        options = {"monitor": monitor, "tracked": plan.tracked}
        return find_plan(problem, changed, solver, known, tolerance, **options)

    with monitor.catching_interrupts():
        found, missed = _search(plan, tolerance, attempts, again, monitor)
    if not missed:
        return found
    ends = f"its replay ends {found.replay_error:.2g} m and {found.replay_speed_error:.2g} m/s from the goal"
    told = f"found after {found.iterations} iterations; the tolerance of {tolerance:g} m was not met {missed}; {ends}"
    return replace(found, success=False, message=told)


def _search(
    plan: PlanResult, tolerance: float, attempts: int, again: Again, monitor: Any
) -> tuple[PlanResult, str]:
    """Refine the mesh of a plan in several attempts.

    `again` solves the problem with new options of the transcription. `tolerance` is that of the
    replay [m]. Returns the plan and "", or the best plan and the reason why it misses the
    tolerance.
    """
    solver = plan.solver
    if isinstance(solver, Sampling):
        return _sample_again(plan, tolerance, again)
    phases = plan.problem.phases if plan.problem is not None else ()
    correctable = isinstance(solver, (Ipopt, CondensedNewton)) and not (plan.tracked or phases)
    why = f"in {attempts} attempts: give more, or substeps"
    for _ in range(attempts):
        if monitor.status():
            late = "within the time limit: increase time_limit"
            why = "before the search was stopped" if monitor.interrupted else late
            break
        error = plan.worst_error
        if error <= tolerance or not (plan.duals or plan.success):
            return plan, ""
        rounding = ROUNDING * float(np.abs(plan.trajectory.nodes).max())
        if error <= rounding:
            why = f"because of rounding errors, about {rounding:.1g} m: give a larger tolerance"
            break
        if correctable and np.isfinite(error) and error > FAR * tolerance:
            plan, correctable = _better(plan, again(plan, accuracy=CAUTION * tolerance)), False
            continue
        finest = again(plan, **_finer_mesh(plan, tolerance))
        if monitor.status():
            plan = _better(plan, finest)
            continue
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
    """Build the options of a transcription with a finer mesh.

    Intervals with large defects are subdivided, so that the replay meets the tolerance [m]. With
    phases, all intervals are halved.
    """
    error, known = plan.worst_error, plan.transcription
    if known is not None and plan.problem is not None and plan.problem.phases:
        return {"intervals": tuple(np.repeat(known.fractions, 2).tolist())}
    too_large = error / tolerance if np.isfinite(error) else FAR
    model = plan.require_model("refine")
    lengths = finer(model, plan.time, plan.trajectory.states, plan.control, too_large)
    given = None if known is None else known.accuracy
    # The accuracy for the previous tolerance would cancel the gain of the finer mesh.
    accuracy = None if given is None else min(given, CAUTION * tolerance)
    return {"intervals": tuple(lengths.tolist()), "accuracy": accuracy}


def _sample_again(plan: PlanResult, tolerance: float, again: Again) -> tuple[PlanResult, str]:
    """Repeat the random search for a more accurate plan.

    `again` solves the problem with new options. Returns the plan and "", or the given plan and the
    reason why it misses the tolerance.
    """
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
    """Subdivide the intervals of a plan that have large defects.

    Parameters
    ----------
    model : Model
        Model of the plan.
    time : ndarray, shape (K + 1,)
        Mesh points [s].
    states : ndarray, shape (K + 1, nx)
        States at the mesh points.
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Controls.
    too_large : float
        Error of the replay divided by its tolerance.

    Returns
    -------
    ndarray
        Relative lengths of the new intervals. Each interval has at most 4 parts. If no defect is
        large, all intervals are halved.
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
    """Compute the defects (K,) of the intervals [m].

    The defect is the difference between the planned state at the end of an interval and a fine
    integration from the planned state at its start. It is the larger of the differences of
    positions, and of velocities × duration. Arguments have shapes (K + 1,) for time, (K + 1, nx)
    for states, and (K, α) or (K + 1, α) for force densities.
    """
    count, lengths = len(time) - 1, np.diff(time)
    advance = RungeKutta4().step(model.ode).map(count)
    now = ca.DM(states[:-1].T)
    for k in range(STEPS):
        gamma = profile_at(force_density, time, time[:-1] + (k + 0.5) / STEPS * lengths)
        now = advance(now, gamma.T, lengths[None] / STEPS)
    if model.mechanism.constrained:
        now = build_projection(model, 3).map(count)(now)
    gap = now.full().T - states[1:]
    places, speeds, *_ = model.split(np.abs(gap))
    return np.asarray(np.maximum(places.max(axis=1), speeds.max(axis=1) * float(time[-1])))
