"""From a problem to a plan: find the target, choose the rows to impose, solve, replay, explain."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.boundary.find_target import find_target
from ocp.boundary.sensitivities import HARDLY_REACHED, REACHED, Reach, find_controlled
from ocp.boundary.target import Target
from ocp.plan.diagnosis import explain_failure, long_steps
from ocp.plan.misses import misses
from ocp.plan.plan import Plan
from ocp.presolve import check_groups, check_start
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.solvers.base import Solution, Solver
from ocp.solvers.deferred_correction import check_correctable, solve_corrected
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.multipliers import Duals, named_duals, warm_started
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess, InitialGuess, evaluate_guess
from ocp.transcription.mesh import group_matrix, held_values, hermite_state, locate_share
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.sparse_nlp import Program
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array, instance, positive_number

MET = 3e-4  # of the structure's size (and of it per duration): goals missed by more are missed
RELIABLE = 1e-2  # of the same: what a replay may miss by, unless a tolerance is stated
LOOSENING = 0.3  # of the strongest force density: disturbs a guess along which some rows are out of control


class _Outcome(NamedTuple):
    program: Program
    solution: Solution
    guess: Guess  # what the solution says, to start again from
    gap: float = 0.0  # m, from fine steps, where an accuracy is asked for


def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Solver | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
) -> Plan:
    """The plan that a solver finds for `problem`; without arguments by MultipleShooting() and Ipopt().

    guess: where the solver starts: `InverseDynamics(path)`, `Equilibrium()`, `Arrays(...)`, another plan; None: InverseDynamics(). From a plan of
    the same grid and constraints the solver starts exactly, with its multipliers (see `Ipopt.warm`). tolerance: m, by how much the
    replay may miss the goals (and as many m per duration in speed) for the plan to be a success; None: 1 % of the structure's size.
    A plan that could not be found, or whose replay misses more, has success False and a message that says why. Raises `UnreachableGoal`
    before solving where no strings can bring the goals about, TypeError and ValueError for arguments.
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    transcription = MultipleShooting() if transcription is None else transcription
    solver = Ipopt() if solver is None else solver
    instance("transcription", transcription, Transcription, "a transcription, such as ocp.MultipleShooting()")
    instance("solver", solver, (Ipopt, Fatrop), "an ocp.Ipopt or ocp.Fatrop")
    check_correctable(transcription, solver)
    limit = None if tolerance is None else positive_number("tolerance", tolerance)
    began = time.perf_counter()
    scales, target, imposed, first, reach = _prepared(problem, transcription, guess)
    outcome = _attempt(problem, transcription, solver, imposed, scales, first, guess.duals if isinstance(guess, Plan) else None)
    if _rows(imposed) < _rows(target) and not (outcome.solution.success and _met(target, _planned(problem, transcription, outcome.guess))):
        # Rows that no string moved along the guess are missed: along a less regular motion they may be within reach.
        first = _loosened(problem, first)
        again = _controlled(target, reach, first, HARDLY_REACHED)
        if _rows(again) > _rows(imposed):
            imposed = again
            outcome = _attempt(problem, transcription, solver, imposed, scales, first)
    seconds = time.perf_counter() - began
    plan = _plan(problem, transcription, target, imposed, reach, outcome, RELIABLE * scales.length if limit is None else limit)

    def once_more(intervals: Array, plan: Plan, tolerance: float) -> Plan:
        near = replace(solver, warm=True) if isinstance(solver, Ipopt) else solver
        return solve(problem, replace(transcription, intervals=tuple(intervals.tolist())), near, plan, tolerance)

    return replace(plan, seconds=seconds, again=once_more)


def program_of(problem: Problem, transcription: Transcription, guess: InitialGuess | None = None) -> Program:
    """The program that `solve` gives to its solver. Raises as `solve`."""
    instance("problem", problem, Problem, "an ocp.Problem")
    instance("transcription", transcription, Transcription, "a transcription, such as ocp.MultipleShooting()")
    scales, _, imposed, first, _ = _prepared(problem, transcription, guess)
    return transcription.program(problem, imposed, scales, first)


def _prepared(problem: Problem, transcription: Transcription, guess: InitialGuess | None) -> tuple[Scales, Target, Target, Guess, Reach]:
    """What is asked, and of that what is to be imposed, with the guess and what tells which rows the strings move along it."""
    check_groups(problem, transcription.control)
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    if not problem.free_start:
        _check_freedom(problem, target, transcription)
        check_start(problem)
    first = evaluate_guess(guess, problem, target, transcription.count)
    together = group_matrix(transcription.control, problem.model.nu)
    reach = Reach(problem.model, transcription.count, problem.shortest < problem.longest, grouping=together)
    return scales, target, _controlled(target, reach, first), first, reach


def _check_freedom(problem: Problem, target: Target, transcription: Transcription) -> None:
    """More goals than force densities before them have no solution."""
    lower, upper = problem.force_density_limits
    free = int(np.sum(lower < upper))
    name = f"{type(transcription).__name__}.intervals is {transcription.count}"
    for share, part, label in target.instants:
        intervals = locate_share(transcription.fractions, share)[0] + 1
        if part.count > intervals * free:
            least = int(np.ceil(np.ceil(part.count / free) / share)) if free else 0
            needed = f"give at least {least} intervals" if free else "allow some more force densities"
            each = "each" if share == 1.0 else f"each of the {intervals} up to there"
            raise ValueError(f"{name}: {label}{free} force densities in {each} cannot meet {part.count} rows of goals, {needed}")


def _controlled(target: Target, reach: Reach, guess: Guess, least: float = REACHED) -> Target:
    """The target without the rows that the strings cannot move, to first order, along the motion that the guess's force densities cause."""
    if not _rows(target) or target.free_start is not None:  # a free start moves them too
        return target
    intervals = len(guess.force_density)

    def reduced(part: Target, share: float) -> Target:
        end = max(1, round(share * intervals))
        kept = find_controlled(reach.of_rows(part.single, part.weights, target.start, guess.force_density, guess.duration, end), least)
        return part if len(kept) == part.count else part.only(kept, "out of control")

    waypoints = tuple(one._replace(target=reduced(one.target, one.share)) for one in target.waypoints)
    return replace(reduced(target, 1.0), waypoints=waypoints)


def _rows(target: Target) -> int:
    """Rows that are imposed at the end and on the way."""
    return sum(part.count for _, part, _ in target.instants)


def _loosened(problem: Problem, guess: Guess) -> Guess:
    """The guess with force densities that differ from string to string and from interval to interval, always in the same way."""
    lower, upper = problem.force_density_limits
    change = np.random.default_rng(0).uniform(size=guess.force_density.shape)
    strength = float(np.abs(guess.force_density).max()) or 1.0
    return replace(guess, force_density=np.clip(guess.force_density + LOOSENING * strength * change, lower, upper))


def _attempt(
    problem: Problem, transcription: Transcription, solver: Solver, target: Target, scales: Scales, guess: Guess, duals: Duals | None = None
) -> _Outcome:
    program = transcription.program(problem, target, scales, guess)
    known = program if duals is None else warm_started(program, target, duals)
    if transcription.accuracy is None or not isinstance(solver, Ipopt):
        solution, states, gap = solver.solve(known), None, 0.0
    else:
        solution, states, gap = solve_corrected(known, solver, problem.model, transcription.fractions, transcription.accuracy)
    planned, controls, duration = (np.asarray(value.full()) for value in program.unpack(solution.w))
    lower, upper = problem.force_density_limits
    # Interior-point methods overstep limits by their tolerance.
    duration = np.clip(duration.squeeze(), problem.shortest, problem.longest)
    return _Outcome(program, solution, Guess(planned.T if states is None else states, np.clip(controls.T, lower, upper), float(duration)), gap)


def _planned(problem: Problem, transcription: Transcription, found: Guess) -> Callable[[float], Array]:
    """The planned state (nx,) at a share of the duration, as waypoints see it."""

    def state_at(share: float) -> Array:
        k, part = locate_share(transcription.fractions, share)
        before, after = found.states[k : k + 2]
        h = found.duration * transcription.fractions[k]
        return after if part == 1.0 else np.asarray(hermite_state(problem.model, ca.DM(before), ca.DM(after), h, part).full()).ravel()

    return state_at


def _met(target: Target, state_at: Callable[[float], Array]) -> bool:
    """Whether the rows of all goals vanish, also those that were not imposed; how well bars and momenta are kept is not asked."""
    for share, part, _ in target.instants:
        residual = np.asarray(part.rows(state_at(share)).full()).ravel()
        if len(residual) and np.abs(np.linalg.lstsq(part.reduction.combinations, residual)[0]).max() > MET:
            return False
    return True


def _plan(problem: Problem, transcription: Transcription, target: Target, imposed: Target, reach: Reach, outcome: _Outcome, tolerance: float) -> Plan:
    program, solution, found, _ = outcome
    duals = named_duals(program, imposed, solution.w, *solution.multipliers) if solution.success and solution.multipliers else None
    target, imposed = (part.begin_at(found.states[0]) for part in (target, imposed))
    model = problem.model
    grid = found.duration * np.append(0.0, np.cumsum(transcription.fractions))
    grid[-1] = found.duration
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    plan = Plan(
        success=False,
        status=solution.status,
        message="",
        objective=float(cost) * program.objective,
        iterations=solution.iterations,
        seconds=0.0,
        time=grid,
        force_density=found.force_density,
        trajectory=_trajectory(problem, grid, found, solution.success),
        replay_error=np.nan,
        replay_speed_error=np.nan,
        structure=model.scene.structure,
        model=model,
        duals=duals,
        problem=problem,
    )
    error, speed_error = _replay_errors(plan, target)
    plan = replace(plan, replay_error=error, replay_speed_error=speed_error)
    success, verdict = _verdict(problem, plan, transcription, target, imposed, reach, outcome, tolerance)
    ends = f"its replay ends {error:.2g} m and {speed_error:.2g} m/s from the goal" if np.isfinite(error) else "its replay diverges"
    return replace(plan, success=success, message=f"{verdict}; {imposed.describe()}; {ends}")


def _verdict(
    problem: Problem, plan: Plan, transcription: Transcription, target: Target, imposed: Target, reach: Reach, outcome: _Outcome, tolerance: float
) -> tuple[bool, str]:
    """Whether the plan is a success, and what is to be said of it."""
    program, solution, found, gap = outcome
    state_at = _planned(problem, transcription, found)
    if solution.success and transcription.accuracy is not None and gap > transcription.accuracy:
        return False, f"too coarse: corrections end {gap:.2g} m from fine steps, not {transcription.accuracy:.2g} m: give more intervals"
    if solution.success and not _met(target, state_at):
        missed = misses(target, state_at).worst()
        return False, f"no plan: {missed}, and no string moves it there to first order: give a goal that the motion passes"
    if solution.success and plan.worst_error <= tolerance:
        return True, f"found after {solution.iterations} iterations"
    held = replace(found, force_density=held_values(found.force_density, transcription.count))
    step = float(np.diff(plan.time).max()) / (transcription.substeps if isinstance(transcription, MultipleShooting) else 1)
    too_long = long_steps(problem.model, found.states, held.force_density, step, found.duration)
    if not solution.success:
        return False, explain_failure(misses(target, state_at), imposed, reach, program, solution, held, too_long)
    cure = too_long or "give more intervals, or substeps"
    beyond = f"its replay misses the goal by more than {tolerance:.2g} m (or {tolerance:.2g} m per duration)"
    return False, f"too coarse: a plan was found after {solution.iterations} iterations, but {beyond}: {cure}, or plan.refine({tolerance:.2g})"


def _replay_errors(plan: Plan, target: Target) -> tuple[float, float]:
    """How far the replay ends from the goals; without goals for the place (or speed) from the plan. NaN where it does not get there."""
    if not np.all(np.isfinite(plan.force_density)) or not plan.time[-1] > 0:
        return np.nan, np.nan
    replayed = plan.replay()
    if not replayed.success:
        return np.nan, np.nan
    times = replayed.time / replayed.time[-1]
    missed = misses(target, lambda share: np.array([np.interp(share, times, column) for column in replayed.states.T]))
    metres, speeds = ([amount for amount, _ in rows] for rows in missed)
    if not metres:
        metres = np.linalg.norm(replayed.nodes[-1] - plan.trajectory.nodes[-1], axis=1).tolist()
    if not speeds:
        speeds = np.linalg.norm(replayed.velocities[-1] - plan.trajectory.velocities[-1], axis=1).tolist()
    return float(max(metres)), float(max(speeds))


def _trajectory(problem: Problem, grid: Array, found: Guess, success: bool) -> Trajectory:
    model = problem.model
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(grid)]
    message = "planned motion at the ends of the intervals"
    with np.errstate(all="ignore"):
        return record_trajectory(model, grid, found.states, controls, step=float(grid[1]), message=message, success=success)
