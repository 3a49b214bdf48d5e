"""Explanation of plans that fail because limits are too narrow."""

from __future__ import annotations

import warnings
from dataclasses import replace

from ocp.guess.initial_guess import NOISE, InverseDynamics, evaluate_guess
from ocp.phases.method import link_problem
from ocp.problem.control import control_unit
from ocp.problem.costs import Duration
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.problem import Problem
from ocp.search.policy import (
    MIN_INTERVALS,
    PHASE_INTERVALS,
    build_force_density_task,
    is_near_ground,
)
from ocp.search.task import PlanningTask, drop_slack, prepare
from ocp.solvers.ipopt import NOWHERE, Ipopt
from ocp.solvers.relaxation import WiderLimit, relax_limits, solve_relaxed
from ocp.targets.infeasible_goal import InfeasibleGoalError, TargetNotFoundWarning
from ocp.transcription.assemble import build_program
from ocp.transcription.direct_collocation import DirectCollocation
from ocp.transcription.mesh import PiecewiseConstant, PiecewiseLinear, Profile
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variational import Variational
from tenscasadi.structure.names import find_named
from tenscasadi.structure.structure import Structure


def explain_limits(task: PlanningTask) -> str:
    """Explain which limits of a failed plan are too narrow.

    A relaxed program shows which limits must be wider, and whether a longer duration helps. Returns
    "" if limits are not the cause, or the cause is unknown. The stated limits suffice, but may not be
    the narrowest ones, as the relaxed program has its own local solution.
    """
    task.monitor.phase = "limits that are too narrow"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetNotFoundWarning)
        return task.monitor.run(lambda: _explain(task), lambda: "")


def _explain(task: PlanningTask) -> str:
    # each program is searched no longer than the plan, but for short searches
    solver = Ipopt(options={"max_cpu_time": max(10.0, task.monitor.elapsed)})
    problem = task.problem
    control: Profile = PiecewiseConstant()
    # motors have limits of their own
    twin = None if problem.model.has_coupled_rates else build_force_density_task(task)
    if twin is not None:
        task, control = twin, PiecewiseLinear()
    program = _build(task, control)
    if program is None:
        return ""
    relaxed = relax_limits(program, ("path", "rate"), control_unit(task.problem.model))
    found = solve_relaxed(relaxed, solver, task.monitor)
    wider = relaxed.list_wider(found.w) if found.success else []
    if not wider:
        return ""
    needed = " and ".join(_describe(one, problem.model.scene.structure) for one in wider)
    longer = _explain_duration(task, control, solver)
    count = (
        f"{PHASE_INTERVALS} intervals a phase" if problem.phases else f"{MIN_INTERVALS} intervals"
    )
    return f"limits are too narrow: on a mesh of {count} it suffices to {needed}{longer}"


def _describe(one: WiderLimit, structure: Structure) -> str:
    values = f"from {one.limit:.4g} to {one.needed:.4g} {one.unit}".rstrip()
    member = "".join(f" ({name})" for name in find_named(one.name, structure).values())
    verb = "lower" if one.side == "lower" else "raise"
    return f"{verb} the limit of {one.name}{member} {values}"


def _explain_duration(task: PlanningTask, control: Profile, solver: Ipopt) -> str:
    """Explain whether a longer duration satisfies the limits.

    `solver` searches for the shortest one, with the profile `control`. Returns "" if the search is
    impossible or not completed.
    """
    if task.monitor.status():
        return ""
    try:
        free = _free_durations(task.problem)
        program = _build(prepare(free, control, task.tolerance, task.monitor), control)
    except (InfeasibleGoalError, ValueError):  # such as of costs that a free duration excludes
        return ""
    if program is None:
        return ""
    found = solver.solve(program, task.monitor)
    if found.success:
        durations = program.unpack(found.w)[2].full().ravel()
        if len(durations) == 1:
            return f", or to take a duration of {durations[0]:.3g} s"
        return f", or to take phases of {', '.join(f'{one:.3g}' for one in durations)} s"
    longest = free.longest
    return (
        f"; no duration up to {longest:.3g} s was found to help" if found.status in NOWHERE else ""
    )


def _free_durations(problem: Problem) -> Problem:
    """Build the problem of the shortest duration.

    Durations are up to three times as long. Longer ones would be another problem. Waypoints keep
    their fractions of the duration.
    """
    if problem.phases:
        phases = [
            replace(phase, duration=(phase.shortest, 3 * phase.longest), end_time=None)
            for phase in problem.phases
        ]
        return replace(problem, duration=1.0, phases=phases, costs=[Duration()])
    span = problem.shortest, problem.longest
    goals = [
        replace(goal, time=None, share=goal.at(*span)) if isinstance(goal, Waypoint) else goal
        for goal in problem.goals
    ]
    return replace(problem, duration=(span[0], 3 * span[1]), goals=goals, costs=[Duration()])


def _build(task: PlanningTask, control: Profile) -> Program | None:
    """Build a coarse nonlinear program from the default guess.

    `control` is the control profile; phases have one of their own. Returns None if the goals have
    no target state, or if derivatives through contact with a ground mislead the solver.
    """
    problem, target = task.problem, task.target
    if problem.phases:
        return link_problem(problem, Variational(PHASE_INTERVALS), task.tolerance).program
    if target is None or not target.met:
        return None
    guess = evaluate_guess(InverseDynamics(noise=NOISE), problem, target, MIN_INTERVALS)
    if problem.model.scene.grounds and is_near_ground(problem, guess):
        return None
    guess = guess.perturb(*problem.control_limits)
    shape = DirectCollocation if problem.model.has_coupled_rates else Variational
    transcription = shape(MIN_INTERVALS, control=control)
    return build_program(transcription, drop_slack(problem), target, task.scales, guess)
