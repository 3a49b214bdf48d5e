"""Explanation of plans that fail because limits are too narrow."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from ocp.guess.initial_guess import NOISE, InverseDynamics, evaluate_guess
from ocp.problem.control import control_name, control_unit
from ocp.problem.costs import Duration
from ocp.results.diagnosis import list_units
from ocp.search.policy import MIN_INTERVALS
from ocp.search.task import PlanningTask, prepare
from ocp.solvers.ipopt import NOWHERE, Ipopt
from ocp.solvers.relaxation import WiderLimit, relax_limits, solve_relaxed
from ocp.targets.infeasible_goal import InfeasibleGoalError, TargetNotFoundWarning
from ocp.targets.target import Target
from ocp.transcription.assemble import build_program
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variational import Variational
from tenscasadi.structure.names import find_named
from tenscasadi.structure.structure import Structure


def explain_limits(task: PlanningTask) -> str:
    """Explain which limits of a failed plan are too narrow.

    A relaxed program shows which limits must be wider, and whether a longer duration helps. Returns
    "" if limits are not the cause, or the cause is unknown. The relaxed program has its own local
    solution, so that a smaller relaxation may exist.
    """
    target = task.target
    if target is None or not target.met or task.problem.model.scene.grounds:
        return ""
    task.monitor.phase = "limits that are too narrow"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetNotFoundWarning)
        return task.monitor.run(lambda: _explain(task, target), lambda: "")


def _explain(task: PlanningTask, target: Target) -> str:
    problem = task.problem
    # searched no longer than the plan, but for short searches
    limit = max(1.0, task.monitor.elapsed)
    solver = Ipopt(time_limit=limit)
    program = _build(task, target)
    relaxed = relax_limits(program, ("path", "rate"), controls=True)
    found = solve_relaxed(relaxed, solver, task.monitor)
    wider = relaxed.list_wider(found.w[: len(program.first)]) if found.success else []
    if not wider:
        return ""
    units = {**list_units(problem), control_name(problem.model): control_unit(problem.model)}
    needed = " and ".join(_describe(one, units, problem.model.scene.structure) for one in wider)
    longest = 3 * problem.longest  # a longer one would be another problem
    duration = _find_duration(task, longest, solver)
    longer = "" if duration is None else f", or a duration of {duration:.3g} s"
    if duration == np.inf:
        longer = f"; no duration up to {longest:.3g} s was found to help"
    return f"limits are too narrow: on a mesh of {MIN_INTERVALS} intervals there is a motion with {needed}{longer}"


def _describe(one: WiderLimit, units: dict[str, str], structure: Structure) -> str:
    unit = units.get(one.name, units.get(one.name.split(" of ")[0], ""))
    value = f"{one.needed:.4g} {unit}".rstrip()
    member = "".join(f" ({name})" for name in find_named(one.name, structure).values())
    way = "down" if one.side == "lower" else "up"
    return f"{one.name}{member} {way} to {value} (limit {one.limit:.4g})"


def _find_duration(task: PlanningTask, longest: float, solver: Ipopt) -> float | None:
    """Find the shortest duration [s] that satisfies the limits.

    It is inf if there is no such duration up to `longest`, and None if the search is impossible or
    not completed.
    """
    problem = task.problem
    if task.monitor.status() or problem.waypoints:
        return None
    free = replace(problem, duration=(problem.shortest, longest), costs=[Duration()])
    try:
        longer = prepare(free, Variational(MIN_INTERVALS).control, task.tolerance, task.monitor)
        if longer.target is None:
            return None
        program = _build(longer, longer.target)
    except (InfeasibleGoalError, ValueError):  # such as of costs that a free duration excludes
        return None
    found = solver.solve(program, task.monitor)
    if found.success:
        return float(program.unpack(found.w)[2])
    return np.inf if found.status in NOWHERE else None


def _build(task: PlanningTask, target: Target) -> Program:
    """Build a coarse nonlinear program from the default guess.

    `target` has the final state and the goal rows.
    """
    problem = task.problem
    shape = MultipleShooting if problem.model.has_coupled_rates else Variational
    guess = evaluate_guess(InverseDynamics(noise=NOISE), problem, target, MIN_INTERVALS)
    guess = guess.perturb(*problem.control_limits)
    return build_program(shape(MIN_INTERVALS), problem, target, task.scales, guess)
