"""Validation of a problem before the search for a plan."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.taut_strings import TautStrings
from ocp.problem.control import (
    TAUT_MARGIN,
    build_smooth_model,
    control_name,
    control_unit,
    slackening_damping,
)
from ocp.problem.limit_conflict import LimitCheck
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.solver import Sampling
from ocp.solvers.base import Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.monitor import Monitor
from ocp.targets.find_target import find_target
from ocp.targets.infeasible_goal import Certificate, InfeasibleGoalError
from ocp.targets.target import StateAt, Target
from ocp.transcription.mesh import Profile, list_groups
from tenscasadi.structure.names import name_errors
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array

Method = Solver | CondensedNewton | Sampling


class PlanningTask(NamedTuple):
    """Validated problem with its final state and search limits.

    Attributes
    ----------
    problem : Problem
        The problem.
    target : Target or None
        Final state and independent goal rows; None with phases, which have targets of their own.
    scales : Scales
        Scale factors of its variables.
    tolerance : float
        Tolerance of the replay [m].
    monitor : Monitor
        Time limit, stop request and progress.
    tracked : bool
        Whether the replay under `track` decides on success, instead of the open-loop replay.
    """

    problem: Problem
    target: Target | None
    scales: Scales
    tolerance: float
    monitor: Monitor
    tracked: bool = False


@name_errors
def prepare(
    problem: Problem,
    control: Profile,
    tolerance: float,
    monitor: Monitor | None = None,
    near: StateAt | None = None,
) -> PlanningTask:
    """Check a problem and find a final state that meets its goals.

    With `near`, a trajectory as a function of time, it is the nearest one to that trajectory; see
    `find_target`. Raises ValueError for conflicting limits, and InfeasibleGoalError for infeasible
    goals. `control` is the control profile, whose groups have to fit the limits. `tolerance` is
    that of the goals [m].
    """
    check_groups(problem, control)
    monitor = Monitor() if monitor is None else monitor
    scales = Scales.of(problem)
    if problem.phases:
        return PlanningTask(problem, None, scales, tolerance, monitor)
    target = find_target(problem, scales, near, tolerance / scales.length)
    if not problem.free_start:
        limits = LimitCheck(problem)
        check_start(limits, np.asarray(problem.start))
        if not problem.periodic_goals:
            check_end(limits, target)
    return PlanningTask(problem, target, scales, tolerance, monitor)


def drop_slack(problem: Problem) -> Problem:
    """Build the problem without slackening of elastic strings.

    Constraints keep the strings in tension instead. See `build_smooth_model`. Damped strings with a
    least force density have to stay taut.
    """
    model, damping = build_smooth_model(problem.model), slackening_damping(problem.model)
    if model is problem.model:
        return problem
    kept = TAUT_MARGIN * damping * (problem.force_density_limits[0] > 0)
    taut = [TautStrings(kept)] if kept.any() else []
    return replace(problem, model=model, bounds=[*problem.bounds, *taut])


def check_groups(problem: Problem, profile: Profile) -> None:
    """Check that limits are consistent within each control group.

    Strings of a group share one control value. Raises ValueError if their limits contradict each
    other. `profile` has the groups.
    """
    lower, upper = problem.control_limits
    name, unit = control_name(problem.model), control_unit(problem.model)
    for strings in list_groups(profile, len(lower)):
        low, high = strings[np.argmax(lower[strings])], strings[np.argmin(upper[strings])]
        if lower[low] > upper[high]:
            raise ValueError(
                f"{type(profile).__name__}.groups: strings {', '.join(map(str, strings))} share a {name}, and Problem.bounds keep "
                f"that of string {low} at {lower[low]:g} {unit} or more and that of string {high} at {upper[high]:g} {unit} or less: "
                "widen one, or take the group apart"
            )


def check_start(limits: LimitCheck, start: Array) -> None:
    """Check that some control satisfies all limits at the start.

    `start` (nx,) is the initial state. Raises ValueError if no control does.
    """
    conflict = limits.find_conflict(start, "start")
    if conflict is not None:
        raise add_address(
            ValueError(
                f"Problem.bounds leave no controls at the start: {conflict.message}: widen one, or start elsewhere"
            )
        )


def check_end(limits: LimitCheck, target: Target) -> None:
    """Check that limits permit the coordinates prescribed by goals.

    `target` has the goals. Raises InfeasibleGoalError if limits do not permit them.
    """
    if target.state is None:
        return
    x = ca.SX.sym("x", len(target.state))
    rows = target.single(x)[: len(target.names)]
    linear = ~np.array(ca.which_depends(rows, x, 2, True), dtype=bool)
    row, column = np.array(ca.jacobian(rows, x).sparsity().get_triplet(), dtype=np.intp)
    alone = linear[row] & (np.bincount(row, minlength=len(target.names))[row] == 1)
    fixed = np.isin(np.arange(len(target.state)), column[alone])
    conflict = limits.find_conflict(target.state, "end", fixed)
    if conflict is None:
        return
    certificate = Certificate({conflict.name: 1.0}, conflict.excess, "linear")
    placed = row[alone & conflict.needed[column]]
    goal = target.names[placed[0]] if placed.size else "the goals"
    if conflict.fixed:
        raise InfeasibleGoalError(
            f"{goal} and {conflict.message} where the goals are met: move the goal, or give another limit",
            certificate,
        )
    raise InfeasibleGoalError(
        f"Problem.bounds leave no controls where the goals are met: {conflict.message}: widen one, or move the goal",
        certificate,
    )
