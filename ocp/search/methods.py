"""The methods that find plans, behind one function: programs, condensed programs, phases, samples."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.phases.method import solve_phased
from ocp.problem.control import stretched, winds
from ocp.problem.phase import refuse_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.explanation import (
    StateAt,
    explain_failure,
    goals_met,
    long_steps,
    measure_misses,
    state_function,
    units_of,
)
from ocp.results.result import PlanResult
from ocp.sampling.method import solve_sampled
from ocp.sampling.solver import Sampling
from ocp.search.presolve import check_freedom
from ocp.search.task import Method, Task, prepare
from ocp.solvers.base import Outcome, Solution, Solver
from ocp.solvers.condensed_newton.method import REMARKS
from ocp.solvers.correction import (
    TOO_COARSE,
    Corrected,
    solve_corrected,
)
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import Duals, name_duals, warm_start_program
from ocp.solvers.relaxation import find_rate_relaxation
from ocp.targets.control_sensitivities import ControlSensitivities
from ocp.targets.controllable_rows import drop_uncontrollable_rows
from ocp.targets.target import Target
from ocp.transcription.assemble import build_program
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess, evaluate_guess
from ocp.transcription.mesh import Guess, group_matrix, held_values, on_mesh, spans
from ocp.transcription.sparse_nlp import Program
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.util.validate import instance

# radians of the fastest vibration in a step that tells how far rest lengths move the goals' rows
GENTLE = 1.0
MOST_SUBSTEPS = 50
TOO_LATE = (
    "no plan: stopped at the time limit before the solver began, with the guess: raise seconds"
)


def run_method(
    task: Task, transcription: Transcription, solver: Method, guess: InitialGuess | None
) -> tuple[Outcome, Target]:
    """Run the method that goes with a solver; return what it found, and what its replay is measured by.

    guess: None for `InverseDynamics()`, and for `Sampling` for none.
    """
    problem, target, scales, tolerance, monitor = task
    if target is None or scales is None:
        if isinstance(solver, Sampling):
            raise ValueError(
                "solver is Sampling, and Problem.phases say when nodes stand: leave one of them out"
            )
        return solve_phased(problem, transcription, solver, guess, monitor, tolerance)
    if isinstance(solver, Sampling):
        known = (
            None
            if guess is None
            else evaluate_guess(guess, problem, target, transcription.count).perturb(
                *problem.control_limits
            )
        )
        return solve_sampled(problem, transcription, known, solver, monitor, tolerance), target
    first = evaluate_guess(guess, problem, target, transcription.count)
    if status := monitor.status():
        own = on_mesh(problem.model, first, transcription.fractions, transcription.control)
        late = Outcome(
            own.states, own.force_density, own.duration, np.nan, False, status, 0, why=TOO_LATE
        )
        return late, target
    duals = guess.duals if isinstance(guess, PlanResult) else None
    return solve_program(
        problem, transcription, target, scales, first, solver, monitor, duals
    ), target


class _Task(NamedTuple):
    """A problem and how it becomes a program, where its goals lead, how far the strings move their rows, and what solves it."""

    problem: Problem
    transcription: Transcription
    target: Target
    scales: Scales
    reach: ControlSensitivities
    solver: Solver


class _Found(NamedTuple):
    """The rows that were imposed, and the solution; `guess` is what it says, to start again from."""

    imposed: Target
    program: Program
    solution: Solution
    guess: Guess
    gap: float  # m, from fine steps, where an accuracy is asked for


def solve_program(
    problem: Problem,
    transcription: Transcription,
    target: Target,
    scales: Scales,
    guess: Guess,
    solver: Solver,
    monitor: Monitor | None = None,
    duals: Duals | None = None,
) -> Outcome:
    """Solve the nonlinear program that a transcription makes of a problem.

    duals: multipliers to start from, where they are known.
    """
    problem = _smooth(problem)
    _check(problem, transcription, target)
    task = _Task(problem, transcription, target, scales, _reach(problem, transcription), solver)
    perturbed = guess.perturb(*problem.control_limits)
    imposed = drop_uncontrollable_rows(target, task.reach, perturbed.force_density, guess.duration)
    guess = guess if isinstance(solver, Ipopt) and not problem.free_start else perturbed
    program = build_program(transcription, problem, imposed, scales, guess)
    known = program if duals is None else warm_start_program(program, imposed, duals)
    return _outcome(task, _solved(task, imposed, known, monitor))


def program_of(
    problem: Problem, transcription: Transcription, guess: InitialGuess | None = None
) -> Program:
    """Return the program that `solve` gives to its solver. Raises as `solve`."""
    instance("problem", problem, Problem, "an ocp.Problem")
    refuse_phases(problem.phases, "export_program")
    instance(
        "transcription",
        transcription,
        Transcription,
        "a transcription, such as ocp.MultipleShooting()",
    )
    _, target, scales, *_ = prepare(problem, transcription.control, np.inf)
    if target is None or scales is None:
        raise TypeError("Problem.phases are no part of one program: leave them out")
    problem = _smooth(problem)
    _check(problem, transcription, target)
    first = evaluate_guess(guess, problem, target, transcription.count).perturb(
        *problem.control_limits
    )
    imposed = drop_uncontrollable_rows(
        target, _reach(problem, transcription), first.force_density, first.duration
    )
    return build_program(transcription, problem, imposed, scales, first)


def _smooth(problem: Problem) -> Problem:
    """Return the problem whose strings do not go slack; see `stretched`."""
    model = stretched(problem.model)
    return problem if model is problem.model else replace(problem, model=model)


def _check(problem: Problem, transcription: Transcription, target: Target) -> None:
    if not problem.free_start:
        check_freedom(problem, target, transcription)


def _reach(problem: Problem, transcription: Transcription) -> ControlSensitivities:
    together = group_matrix(transcription.control, problem.model.nu)
    equal = np.full(transcription.count, 1 / transcription.count)  # as intervals of guesses are
    held = spans(transcription.control, equal)
    substeps = 1
    if winds(problem.model):  # elastic strings vibrate, also where they do not move along the guess
        model = problem.model
        rate = fastest_rate(model, problem.first_state, model.initial_control)
        substeps = int(
            np.clip(
                np.ceil(rate * problem.longest / transcription.count / GENTLE), 1, MOST_SUBSTEPS
            )
        )
    return ControlSensitivities(
        problem.model, problem.shortest < problem.longest, substeps, together, held
    )


def _solved(task: _Task, imposed: Target, program: Program, monitor: Monitor | None) -> _Found:
    """Solve the program; where limits of rates leave no way, find how much wider they have to be."""
    problem, transcription, solver = task.problem, task.transcription, task.solver
    accuracy = transcription.accuracy
    if accuracy is not None:
        measure = transcription.measure_residual(program, problem.model)
        solution, states, gap = solve_corrected(program, solver, measure, accuracy, monitor)
    else:
        solution, states, gap = Corrected(solver.solve(program, monitor), None, 0.0)
    if isinstance(solver, Ipopt):
        solution = find_rate_relaxation(program, solver, solution, monitor) or solution
    planned, controls, duration = (np.asarray(value.full()) for value in program.unpack(solution.w))
    lower, upper = problem.control_limits
    # Interior-point methods overstep limits by their tolerance.
    duration = np.clip(duration.squeeze(), problem.shortest, problem.longest)
    says = Guess(
        planned.T if states is None else states, np.clip(controls.T, lower, upper), float(duration)
    )
    return _Found(imposed, program, solution, says, gap)


def _planned(task: _Task, found: _Found) -> StateAt:
    """Return the planned state (nx,) as a function of the share of the duration, as waypoints see it."""
    return state_function(
        task.problem.model, found.guess.states, found.guess.duration, task.transcription.fractions
    )


def _met(task: _Task, found: _Found) -> bool:
    """Tell whether the rows of all goals vanish, also those that were not imposed; how well bars and momenta are kept is not asked."""
    return goals_met(task.target.begin_at(found.guess.states[0]), _planned(task, found))


def _outcome(task: _Task, found: _Found) -> Outcome:
    """Return what was found, and why where it is no plan."""
    imposed, program, solution, guess, gap = found
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    accuracy = task.transcription.accuracy
    coarse = solution.success and accuracy is not None and gap > accuracy
    why = TOO_COARSE.format(gap, accuracy) if coarse else _why(task, found)
    return Outcome(
        states=guess.states,
        force_density=guess.force_density,
        duration=guess.duration,
        objective=float(cost) * program.objective,
        success=not why,
        status=solution.status,
        iterations=solution.iterations,
        duals=name_duals(program, imposed, solution.w, *solution.multipliers)
        if solution.success and solution.multipliers
        else None,
        gap=gap,
        why=why,
        imposed=imposed.begin_at(guess.states[0]).describe() + REMARKS.get(solution.status, ""),
        coarse=coarse,
    )


def _why(task: _Task, found: _Found) -> str:
    """Tell why what was found is no plan; "" where it is one."""
    transcription, (imposed, program, solution, guess, _) = task.transcription, found
    state_at, target = _planned(task, found), task.target.begin_at(found.guess.states[0])
    if solution.success and not _met(task, found):
        missed = measure_misses(target, state_at).worst()
        return f"no plan: {missed}, and no string moves it there to first order: give a goal that the motion passes"
    if solution.success:
        return ""
    held = replace(guess, force_density=held_values(guess.force_density, transcription.count))
    step = transcription.longest_step(guess.duration)
    too_long = long_steps(
        task.problem.model, guess.states, held.force_density, step, guess.duration
    )
    return explain_failure(
        measure_misses(target, state_at),
        imposed.begin_at(guess.states[0]),
        task.reach,
        program,
        solution,
        held,
        too_long,
        units_of(task.problem),
    )
