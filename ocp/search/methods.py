"""Planning methods: nonlinear programs, phases, and sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ocp.guess.initial_guess import InitialGuess, TrajectoryGuess, evaluate_guess
from ocp.phases.correction import Replay
from ocp.phases.method import solve_phased
from ocp.problem.phase import reject_phases
from ocp.problem.problem import Problem
from ocp.problem.rows import RELIABLE
from ocp.problem.scaling import Scales
from ocp.results.acceptance import describe_growth
from ocp.results.diagnosis import build_interpolant, explain_failure
from ocp.results.result import PlanResult, Replayed
from ocp.sampling.method import solve_sampled
from ocp.sampling.solver import Sampling
from ocp.search.plan_record import record_plan
from ocp.search.policy import Attempt, PlannedGuess, repeat_method
from ocp.search.replays import replay_plan
from ocp.search.rest_lengths import convert_outcome, tighten_limits
from ocp.search.task import PlanningTask, drop_slack, prepare
from ocp.solvers.base import Outcome, Solution, Solver, find_best_iterate
from ocp.solvers.condensed_newton.method import REMARKS
from ocp.solvers.correction import (
    TOO_COARSE,
    Corrected,
    solve_corrected,
)
from ocp.solvers.early_stop import stop_early
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import name_duals, warm_start_program
from ocp.targets.target import Target
from ocp.transcription.assemble import build_program
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Guess, held_values
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.definitions import resolve_names
from tenscasadi.util.validate import Array, instance


def run_attempt(task: PlanningTask, attempt: Attempt) -> tuple[Outcome, Target | None]:
    """Run one attempt at a planning problem.

    Returns its result, and the target of its acceptance test: final state and goal rows. The target
    is None if the attempt stopped before it was found.
    """
    if attempt.twin is not None:
        return _plan_force_densities(task, attempt.twin, attempt)
    problem, target, monitor = task.problem, task.target, task.monitor
    transcription, solver, guess, *_ = attempt
    if isinstance(guess, Attempt):
        raise TypeError("an attempt as initial guess needs plan_guess first")
    monitor.phase = attempt.describe()
    if target is None:
        if not problem.phases:  # the search stopped before it found a target
            return stop_early(problem, transcription, monitor.status()), None
        if isinstance(solver, Sampling):
            raise ValueError(
                "solver is Sampling, which does not support Problem.phases: leave one of them out"
            )
        replay = _build_replay(task, attempt)
        return solve_phased(problem, transcription, solver, guess, monitor, task.tolerance, replay)
    first = None
    if guess is not None or not isinstance(solver, Sampling):
        first = monitor.run(
            lambda: evaluate_guess(guess, problem, target, transcription.count), lambda: None
        )
        if status := monitor.status():
            outcome = stop_early(problem, transcription, status, first)
            return outcome, None if first is None else target
    if isinstance(solver, Sampling):
        known = None if first is None else first.perturb(*problem.control_limits)
        outcome = solve_sampled(
            problem, transcription, target, known, solver, monitor, task.tolerance
        )
        return outcome, target
    if first is None:
        raise TypeError("a program has an initial guess")
    return _solve_program(task, attempt, target, first), target


def _build_replay(task: PlanningTask, attempt: Attempt) -> Replay:
    """Build the replay function that tests plans with phases.

    It is that of the attempt, and maps time, states and force densities to a `Replayed`. The first
    plan decides whether all replays are in open loop or tracked.
    """
    decided: list[bool] = []

    def replay(time: Array, states: Array, gamma: Array) -> Replayed:
        found = Outcome(states, gamma, float(time[-1]), np.nan, True, "", 0, time=time)
        plan = record_plan(task, attempt.transcription, attempt.solver, found)
        if not decided:
            decided.append(task.tracked or bool(describe_growth(plan, task.tolerance)))
        return replay_plan(plan, decided[0])

    return replay


def _plan_force_densities(
    task: PlanningTask, twin: PlanningTask, attempt: Attempt
) -> tuple[Outcome, Target | None]:
    """Run an attempt with force densities as control.

    `twin` is the `task` with force densities as control. The result is converted to rest lengths or
    their rates.
    """
    found, target = _find_force_densities(task.problem, twin, attempt)
    outcome = convert_outcome(task.problem, attempt.transcription.fractions, found)
    return outcome, task.target if task.problem.model.na else target


def _find_force_densities(
    problem: Problem, twin: PlanningTask, attempt: Attempt
) -> tuple[Outcome, Target | None]:
    """Run an attempt in force densities, within rest-length rate limits.

    `twin` is the task with force densities as control, `problem` the one with rest lengths.
    """
    fractions = attempt.transcription.fractions
    found, target = run_attempt(twin, attempt._replace(twin=None))
    iterations = found.iterations
    for _ in range(2):  # a third tightening diverges near the least feasible limit
        tighter = tighten_limits(problem, twin.problem, fractions, found)
        if tighter is None:
            break
        plan = record_plan(twin, attempt.transcription, attempt.solver, found)
        twin = twin._replace(problem=tighter)
        once_more = repeat_method(twin, replace(plan, success=True))
        again, reached = run_attempt(twin, once_more or attempt._replace(twin=None, guess=plan))
        iterations += again.iterations
        if not (again.success or again.coarse):
            break
        found, target = again, reached
    return found._replace(iterations=iterations), target


def plan_guess(task: PlanningTask, attempt: Attempt) -> tuple[Attempt, int]:
    """Replace a guess that is an attempt by its plan.

    The attempt has force densities as control. If it fails, the default guess replaces it. Limits
    of the problem's own control may be violated. Returns the attempt with this guess, and the
    number of iterations.
    """
    first = attempt.guess
    if not isinstance(first, Attempt) or first.twin is None:
        return attempt, 0
    found, _ = _find_force_densities(task.problem, first.twin, first)
    if not (found.success or found.coarse):
        return attempt._replace(guess=None), found.iterations
    own = convert_outcome(task.problem, first.transcription.fractions, found)
    plan = TrajectoryGuess(own.states, own.force_density, own.duration)
    return attempt._replace(guess=PlannedGuess(plan)), found.iterations


def program_of(
    problem: Problem, transcription: Transcription, guess: InitialGuess | None = None
) -> Program:
    """Build the nonlinear program that `solve` passes to its solver.

    Errors are those of `solve`. Without a guess, the default guess is used.
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    reject_phases(problem.phases, "export_program")
    instance(
        "transcription",
        transcription,
        Transcription,
        "a transcription, such as ocp.MultipleShooting()",
    )
    transcription = resolve_names(transcription, problem.model.scene.structure.names)
    task = prepare(problem, transcription.control, RELIABLE * Scales.of(problem).length)
    if task.target is None:
        raise TypeError("Problem.phases are no part of one program: leave them out")
    first = evaluate_guess(guess, problem, task.target, transcription.count).perturb(
        *problem.control_limits
    )
    return build_program(transcription, drop_slack(problem), task.target, task.scales, first)


def _solve_program(task: PlanningTask, attempt: Attempt, target: Target, guess: Guess) -> Outcome:
    """Transcribe a problem, and solve the nonlinear program.

    `guess` is the initial guess on equal intervals; `target` has the final state and the goal rows.
    """
    transcription, solver, origin, *_ = attempt
    problem, monitor = drop_slack(task.problem), task.monitor
    if isinstance(solver, Sampling):
        raise TypeError("Sampling solves no programs")
    if not isinstance(solver, Ipopt) or problem.free_start:
        guess = guess.perturb(*problem.control_limits)

    def build() -> Program | None:
        program = build_program(transcription, problem, target, task.scales, guess)
        if isinstance(origin, PlanResult) and origin.duals is not None:
            program = warm_start_program(program, target, origin.duals)
        return program

    program = monitor.run(build, lambda: None)
    if program is None:
        return stop_early(problem, transcription, monitor.status(), guess)
    found = monitor.run(
        lambda: _run_solver(problem, transcription, solver, program, monitor),
        lambda: Corrected(find_best_iterate(program, monitor), None, 0.0),
    )
    return _read_outcome(problem, transcription, target, program, found)


def _run_solver(
    problem: Problem,
    transcription: Transcription,
    solver: Solver,
    program: Program,
    monitor: Monitor,
) -> Corrected:
    """Solve the nonlinear program, then correct it.

    Deferred correction increases the accuracy.
    """
    accuracy = transcription.accuracy
    if accuracy is None:
        return Corrected(solver.solve(program, monitor), None, 0.0)
    measure = transcription.measure_residual(program, problem.model)
    return solve_corrected(program, solver, measure, accuracy, monitor)


def _read_outcome(
    problem: Problem,
    transcription: Transcription,
    target: Target,
    program: Program,
    found: Corrected,
) -> Outcome:
    """Convert a solution to a result, and diagnose a failure.

    `found` is the solution of the program, `target` has its goal rows.
    """
    solution: Solution = found.solution
    states, controls, duration = (value.full() for value in program.unpack(solution.w))
    # interior-point methods violate bounds by their tolerance
    time = float(np.clip(duration.squeeze(), problem.shortest, problem.longest))
    accuracy = transcription.accuracy
    coarse = solution.success and accuracy is not None and found.error > accuracy
    planned = states.T if found.states is None else found.states
    own = Guess(planned, np.clip(controls.T, *problem.control_limits), time)
    why = TOO_COARSE.format(found.error, accuracy) if coarse else ""
    if not solution.success:
        held = replace(own, force_density=held_values(own.force_density, transcription.count))
        state_at = build_interpolant(problem.model, own.states, time, transcription.fractions)
        step = transcription.longest_step(time)
        begun = target.begin_at(own.states[0])
        why = explain_failure(problem, begun, state_at, program, solution, held, step)
    cost, _ = program.derivatives()["nlp_grad_f"](solution.w, [])
    duals = None
    if solution.success and solution.multipliers:
        duals = name_duals(program, target, solution.w, *solution.multipliers)
    return Outcome(
        states=own.states,
        force_density=own.force_density,
        duration=time,
        objective=float(cost) * program.objective,
        success=not why,
        status=solution.status,
        iterations=solution.iterations,
        duals=duals,
        gap=found.error,
        why=why,
        imposed=target.begin_at(own.states[0]).describe() + REMARKS.get(solution.status, ""),
        coarse=coarse,
    )
