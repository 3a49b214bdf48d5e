"""Mesh refinement: where the mesh of a plan is too coarse, and one that is fine enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import casadi as ca
import numpy as np

from ocp.sampling.solver import Sampling
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.multipliers import Duals
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import projection
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array

DEFECT_STEPS = 10  # steps for one interval of the plan, to tell its defect
LOST = 1e6  # tolerances that a replay which diverges counts as its error
MOST_PARTS = 4  # that an interval is cut into at once
FAR = float(
    MOST_PARTS**4
)  # times the tolerance: a mesh that is cut once, with a method of order 4, does not gain more
CAUTION = 0.3  # of the tolerance is aimed at


class Refinable(Protocol):
    """A plan, as far as refining needs it."""

    @property
    def success(self) -> bool:
        """Whether a plan was found."""

    @property
    def time(self) -> Array:
        """Nodes of the mesh (K + 1,), s."""

    @property
    def control(self) -> Array:
        """γ, N/m, or rest lengths, m, as decided (K, α) or (K + 1, α)."""

    @property
    def trajectory(self) -> Trajectory:
        """The motion at the nodes of the mesh."""

    @property
    def transcription(self) -> Any:
        """How it was made a program."""

    @property
    def duals(self) -> Duals | None:
        """Multipliers; None where no optimum was found."""

    @property
    def worst_error(self) -> float:
        """How far its replay ends from the goals, m."""


P = TypeVar("P", bound=Refinable)


def refine_mesh(
    plan: P,
    model: Model,
    again: Callable[[Array, P], P],
    tolerance: float,
    attempts: int,
    corrected: Callable[[P], P] | None = None,
) -> tuple[P, str]:
    """Return a plan whose replay ends within `tolerance`, m, of the goals, and ""; or the best that was found, and why it does not.

    again: (relative lengths of intervals, plan) → the plan on these intervals, solved from that
    plan. corrected: plan → the plan on the same intervals, solved again until its motion is that of
    fine steps; None: there is no such thing. It is tried once, where one finer mesh cannot do, or
    has not. A plan without optimum is returned as it is.
    """

    def cut(coarse: P, too_large: float) -> Array:
        return finer(model, coarse.time, coarse.trajectory.states, coarse.control, too_large)

    return _refine(plan, cut, again, tolerance, attempts, corrected)


def refine_phases(
    plan: P, again: Callable[[Array, P], P], tolerance: float, attempts: int
) -> tuple[P, str]:
    """As `refine_mesh`, of a plan whose phases have the same relative lengths of intervals: each is cut in two."""
    return _refine(
        plan,
        lambda coarse, _: np.repeat(coarse.transcription.fractions, 2),
        again,
        tolerance,
        attempts,
    )


def _refine(
    plan: P,
    cut: Callable[[P, float], Array],
    again: Callable[[Array, P], P],
    tolerance: float,
    attempts: int,
    corrected: Callable[[P], P] | None = None,
) -> tuple[P, str]:
    why = f"in {attempts} attempts: give more, or substeps"
    for _ in range(attempts):
        error = plan.worst_error
        if error <= tolerance or (plan.duals is None and not plan.success):
            return plan, ""
        if corrected is not None and np.isfinite(error) and error > FAR * tolerance:
            plan, corrected = _better(plan, corrected(plan)), None
            continue
        times_too_large = error / tolerance if np.isfinite(error) else LOST
        finest = again(cut(plan, times_too_large), plan)
        if finest.duals is not None and not finest.worst_error <= max(tolerance, error / 2):
            why = f"and {len(finest.time) - 1} intervals in place of {len(plan.time) - 1} do not halve the error: give a larger tolerance"
            plan = min(plan, finest, key=lambda one: one.worst_error)
            if corrected is not None:
                plan = _better(plan, corrected(plan))
            break
        plan = finest
    return plan, "" if plan.worst_error <= tolerance or (
        plan.duals is None and not plan.success
    ) else why


def refined(plan: Any, tolerance: float, attempts: int, solve: Callable[..., Any]) -> Any:
    """Return a `Plan` of known origin solved again by `solve` until it meets the tolerance, m, or the best, whose message says that it does not."""
    solver = replace(plan.solver, warm=True) if isinstance(plan.solver, Ipopt) else plan.solver
    options = {"tracked": True} if plan.tracked else {}

    def again(intervals: Array, known: Any) -> Any:
        finer_mesh = replace(known.transcription, intervals=tuple(intervals.tolist()))
        if finer_mesh.accuracy is not None:  # of the tolerance that it was found for
            finer_mesh = replace(finer_mesh, accuracy=min(finer_mesh.accuracy, CAUTION * tolerance))
        return solve(plan.problem, finer_mesh, solver, known, tolerance, **options)

    def corrected(known: Any) -> Any:
        return solve(
            plan.problem,
            replace(known.transcription, accuracy=CAUTION * tolerance),
            solver,
            known,
            tolerance,
            **options,
        )

    if isinstance(solver, Sampling):
        found, missed = _sampled_again(
            plan,
            tolerance,
            lambda known: solve(
                plan.problem, known.transcription, solver, known, tolerance, **options
            ),
        )
    elif plan.problem.phases:
        found, missed = refine_phases(plan, again, tolerance, attempts)
    else:
        correctable = isinstance(solver, (Ipopt, CondensedNewton)) and not plan.tracked
        found, missed = refine_mesh(
            plan, plan.model, again, tolerance, attempts, corrected if correctable else None
        )
    if not missed:
        return found
    ends = f"its replay ends {found.replay_error:.2g} m and {found.replay_speed_error:.2g} m/s from the goal"
    told = f"found after {found.iterations} iterations; the tolerance of {tolerance:g} m was not met {missed}; {ends}"
    return replace(found, success=False, message=told)


def _sampled_again(plan: P, tolerance: float, again: Callable[[P], P]) -> tuple[P, str]:
    """Return a plan of sampled motions within `tolerance`, m, of the goals, and ""; or the best, and why it is not. It has no multipliers."""
    if not plan.success or plan.worst_error <= tolerance:
        return plan, ""
    found = again(plan)
    if found.success:
        return found, ""
    return plan, "by more samples: give a larger tolerance, or groups or knots of its own"


def _better(plan: P, other: P) -> P:
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
        now = projection(model, 3).map(count)(now)
    gap = np.asarray(now.full()).T - states[1:]
    places, speeds, _ = model.split(np.abs(gap))
    return np.asarray(np.maximum(places.max(axis=1), speeds.max(axis=1) * float(time[-1])))
