"""Plans by nonlinear programs: what the strings control, the program, its solution, and why there is none."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.plan.diagnosis import (
    StateAt,
    explain_failure,
    goals_met,
    long_steps,
    measure_misses,
    state_function,
    units_of,
)
from ocp.presolve import check_end, check_freedom, check_groups, check_start
from ocp.problem.control import stretched, winds
from ocp.problem.instant import forces_of
from ocp.problem.phase import refuse_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, control_scale
from ocp.solvers.base import Outcome, Solution, Solver
from ocp.solvers.deferred_correction import (
    TOO_COARSE,
    Corrected,
    check_correctable,
    solve_corrected,
)
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import NOWHERE, TIME_UP, Ipopt
from ocp.solvers.multipliers import Duals, named_duals, warm_started
from ocp.solvers.wider_rates import TOO_SLOW, Patience, from_wider
from ocp.targets.control_sensitivities import HARDLY_REACHED, ControlSensitivities
from ocp.targets.controllable_rows import count_rows, drop_uncontrollable_rows
from ocp.targets.find_target import find_target
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess, InitialGuess, evaluate_guess
from ocp.transcription.mesh import Profile, group_matrix, held_values, spans
from ocp.transcription.sparse_nlp import Program
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.util.validate import instance

# radians of the fastest vibration in a step that tells how far rest lengths move the goals' rows
GENTLE = 1.0
MOST_SUBSTEPS = 50
LOOSENING = (
    0.3  # of the strongest force density: disturbs a guess along which some rows are out of control
)


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
    deadline: float | None = None,
    duals: Duals | None = None,
) -> Outcome:
    """Solve the nonlinear program that a transcription makes of a problem.

    duals: multipliers to start from, where they are known. deadline: of `time.perf_counter`, s;
    None: no limit.
    """
    problem = _smooth(problem)
    check_correctable(transcription, solver)
    if isinstance(solver, Fatrop) and transcription.control.changes is not None:
        raise ValueError(
            f"PiecewiseConstant.changes is {transcription.control.changes}, and Fatrop finds no plan of few changes: give ocp.Ipopt()"
        )
    _check(problem, transcription, target)
    task = _Task(problem, transcription, target, scales, _reach(problem, transcription), solver)
    disturbed = guess.disturbed(
        problem
    )  # what strings do not move along a symmetric guess they may move along others
    imposed = drop_uncontrollable_rows(target, task.reach, disturbed.force_density, guess.duration)
    guess = guess if isinstance(solver, Ipopt) and not problem.free_start else disturbed
    found = _attempt(task, imposed, guess, deadline, duals)
    if (
        count_rows(imposed) < count_rows(target)
        and not (found.solution.success and _met(task, found))
        and not _late(deadline)
    ):
        # Rows that no string moved along the guess are missed: along a less regular motion they may
        # be within reach.
        loosened = _loosened(problem, disturbed)
        more = drop_uncontrollable_rows(
            target, task.reach, loosened.force_density, loosened.duration, HARDLY_REACHED
        )
        if count_rows(more) > count_rows(imposed):
            found = _attempt(task, more, loosened, deadline)
    return _outcome(task, found)


def prepare(problem: Problem, control: Profile) -> tuple[Target, Scales]:
    """Return where the goals lead, and scales; refuse what has no solution."""
    check_groups(problem, control)
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    if not problem.free_start:
        check_start(problem)
    check_end(problem, target)
    return target, scales


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
    target, scales = prepare(problem, transcription.control)
    problem = _smooth(problem)
    _check(problem, transcription, target)
    first = evaluate_guess(guess, problem, target, transcription.count).disturbed(problem)
    imposed = drop_uncontrollable_rows(
        target, _reach(problem, transcription), first.force_density, first.duration
    )
    return transcription.program(problem, imposed, scales, first)


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


def _late(deadline: float | None) -> bool:
    return deadline is not None and time.perf_counter() >= deadline


def _loosened(problem: Problem, guess: Guess) -> Guess:
    """Return the guess with force densities that differ from string to string and from interval to interval, always in the same way."""
    lower, upper = problem.control_limits
    change = np.random.default_rng(0).uniform(size=guess.force_density.shape)
    size = control_scale(
        problem,
        float(np.abs(forces_of(problem.model, guess.states[:-1], guess.force_density)).max())
        or 1.0,
    )
    if winds(problem.model):
        size = -size  # shorter is stronger
    return replace(
        guess, force_density=np.clip(guess.force_density + LOOSENING * size * change, lower, upper)
    )


def _attempt(
    task: _Task, imposed: Target, guess: Guess, deadline: float | None, duals: Duals | None = None
) -> _Found:
    """Make the program and solve it, from multipliers where they are known."""
    problem, transcription, solver = task.problem, task.transcription, task.solver
    program = transcription.program(problem, imposed, task.scales, guess)
    known = program if duals is None else warm_started(program, imposed, duals)
    if isinstance(solver, Ipopt) and program.rows("rate"):
        solution, states, gap = _within_rates(task, known, solver, deadline)
    else:
        solution, states, gap = _solved(task, known, solver, deadline)
    planned, controls, duration = (np.asarray(value.full()) for value in program.unpack(solution.w))
    lower, upper = problem.control_limits
    # Interior-point methods overstep limits by their tolerance.
    duration = np.clip(duration.squeeze(), problem.shortest, problem.longest)
    says = Guess(
        planned.T if states is None else states, np.clip(controls.T, lower, upper), float(duration)
    )
    return _Found(imposed, program, solution, says, gap)


def _solved(task: _Task, program: Program, solver: Solver, deadline: float | None) -> Corrected:
    """Solve the program, corrected where an accuracy is asked for."""
    accuracy = task.transcription.accuracy
    if accuracy is not None and isinstance(solver, Ipopt):
        return solve_corrected(
            program, solver, task.problem.model, task.transcription.fractions, accuracy, deadline
        )
    limited = {} if deadline is None else {"deadline": deadline}  # own solvers may know none
    return Corrected(solver.solve(program, **limited), None, 0.0)


def _within_rates(
    task: _Task, program: Program, solver: Ipopt, deadline: float | None
) -> Corrected:
    """Solve a program with limits of rates. Where the solver hardly gets within them, find by how much they have to be wider, or start there."""
    patience = Patience(program, solver, deadline)
    found = _solved(task, program, replace(solver, watch=patience), deadline)
    if (
        found.solution.success
        or (patience.wider is None and found.solution.status not in NOWHERE)
        or found.solution.status == TIME_UP
    ):
        return found
    wider = patience.wider or patience.ask()
    iterations = found.solution.iterations + wider.iterations
    if patience.too_slow:
        return Corrected(Solution(wider.w, False, TOO_SLOW, iterations), None, 0.0)
    solution = from_wider(program, wider, solver, deadline)
    iterations += solution.iterations
    if not solution.success:
        return Corrected(solution._replace(iterations=iterations), None, 0.0)
    known = replace(program, first=solution.w, multipliers=solution.multipliers)
    found = _solved(task, known, replace(solver, warm=True), deadline)
    return found._replace(
        solution=found.solution._replace(iterations=iterations + found.solution.iterations)
    )


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
        duals=named_duals(program, imposed, solution.w, *solution.multipliers)
        if solution.success and solution.multipliers
        else None,
        gap=gap,
        why=why,
        imposed=imposed.begin_at(guess.states[0]).describe(),
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
