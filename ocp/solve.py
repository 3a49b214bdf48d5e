"""From a problem to a plan: find the target, choose the rows to impose, solve, replay, explain."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.explain import explain_failure
from ocp.grid import held_values
from ocp.guess import Guess
from ocp.guesses import GuessValue, guess_of
from ocp.plan import Plan
from ocp.problem import Problem
from ocp.program import Program
from ocp.reach import HARDLY_REACHED, REACHED, Reach, controlled
from ocp.solver import Fatrop, Ipopt, Solution, Solver
from ocp.target import Scales, Target, find_target
from ocp.transcription import MultipleShooting, OnGrid
from tenscasadi.record import record
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array, instance

MET = 3e-4  # of the structure's size (and of it per duration): rows left to bars and momenta hold as exactly as the scheme keeps those
COARSE = 1e-3  # of the same: replay errors beyond are remarked upon
LOOSENING = 0.3  # of the strongest force density: disturbs a guess along which some rows are out of control


class _Outcome(NamedTuple):
    program: Program
    solution: Solution
    guess: Guess  # what the solution says, to start again from


def solve(problem: Problem, transcription: OnGrid | None = None, solver: Solver | None = None, guess: GuessValue | None = None) -> Plan:
    """The plan that a solver finds for `problem`; without arguments by MultipleShooting() and Ipopt().

    guess: where the solver starts: `InverseDynamics(path)`, `Equilibrium()`, `Arrays(...)`, another plan; None: InverseDynamics().
    A plan that could not be found has success False and a message that says why. Raises `UnreachableGoal` before solving where
    no strings can bring the goals about, TypeError and ValueError for arguments.
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    transcription = MultipleShooting() if transcription is None else transcription
    solver = Ipopt() if solver is None else solver
    instance("transcription", transcription, OnGrid, "a transcription, such as ocp.MultipleShooting()")
    instance("solver", solver, (Ipopt, Fatrop), "an ocp.Ipopt or ocp.Fatrop")
    began = time.perf_counter()
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    _check_freedom(problem, target, transcription.count)
    first = guess_of(guess, problem, target, transcription.count)
    reach = Reach(transcription.step(problem.model), transcription.count, problem.shortest < problem.longest)
    imposed = _controlled(target, reach, first)
    outcome = _attempt(problem, transcription, solver, imposed, scales, first)
    if imposed.count < target.count and not (outcome.solution.success and _met(target, outcome.guess, scales)):
        # Rows that no string moved along the guess are missed: along a less regular motion they may be within reach.
        first = _loosened(problem, first)
        again = _controlled(target, reach, first, HARDLY_REACHED)
        if again.count > imposed.count:
            imposed = again
            outcome = _attempt(problem, transcription, solver, imposed, scales, first)
    return _plan(problem, transcription, target, imposed, reach, outcome, scales, time.perf_counter() - began)


def _check_freedom(problem: Problem, target: Target, intervals: int) -> None:
    """More goals than force densities have no solution."""
    lower, upper = problem.force_density_limits
    free = int(np.sum(lower < upper))
    if target.count > intervals * free:
        needed = "allow some more force densities" if not free else f"give at least {-(-target.count // free)}"
        raise ValueError(
            f"MultipleShooting.intervals is {intervals}: {free} force densities in each cannot meet {target.count} rows of goals, {needed}"
        )


def _controlled(target: Target, reach: Reach, guess: Guess, least: float = REACHED) -> Target:
    """The target without the rows that the strings cannot move, to first order, along the motion that the guess's force densities cause."""
    if not target.count:
        return target
    states = reach.rollout(target.start, guess.force_density, guess.duration)
    if not np.all(np.isfinite(states)):
        return target
    kept = controlled(reach.of_rows(target.rows, states, guess.force_density, guess.duration), least)
    missing = target.count - len(kept)
    if not missing:
        return target
    x = ca.SX.sym("x", len(target.start))
    rows = ca.Function("goal", [x], [ca.mtimes(ca.DM(kept), target.rows(x))], ["x"], ["rows"])
    return replace(target, rows=rows, repeated={**target.repeated, "out of control": missing})


def _loosened(problem: Problem, guess: Guess) -> Guess:
    """The guess with force densities that differ from string to string and from interval to interval, always in the same way."""
    lower, upper = problem.force_density_limits
    change = np.random.default_rng(0).uniform(size=guess.force_density.shape)
    strength = float(np.abs(guess.force_density).max()) or 1.0
    return replace(guess, force_density=np.clip(guess.force_density + LOOSENING * strength * change, lower, upper))


def _attempt(problem: Problem, transcription: OnGrid, solver: Solver, target: Target, scales: Scales, guess: Guess) -> _Outcome:
    program = transcription.program(problem, target, scales, guess)
    solution = solver.solve(program)
    states, controls, duration = (np.asarray(value.full()) for value in program.unpack(solution.w))
    lower, upper = problem.force_density_limits
    # Interior-point methods overstep limits by their tolerance.
    duration = np.clip(duration.squeeze(), problem.shortest, problem.longest)
    return _Outcome(program, solution, Guess(states.T, np.clip(controls.T, lower, upper), float(duration)))


def _misfit(target: Target, state: Array) -> tuple[float, float]:
    """The largest distance from a goal, m, and the largest difference of speed, m/s."""
    metres, speeds = (np.abs(np.asarray(value.full())) for value in target.misfit(state))
    return float(metres.max(initial=0.0)), float(speeds.max(initial=0.0))


def _met(target: Target, guess: Guess, scales: Scales) -> bool:
    metres, speeds = _misfit(target, guess.states[-1])
    return metres <= MET * scales.length + target.adjusted and speeds <= MET * scales.length / scales.time


def _plan(
    problem: Problem,
    transcription: OnGrid,
    target: Target,
    imposed: Target,
    reach: Reach,
    outcome: _Outcome,
    scales: Scales,
    seconds: float,
) -> Plan:
    program, solution, found = outcome
    model = problem.model
    grid = found.duration * np.append(0.0, np.cumsum(transcription.fractions))
    grid[-1] = found.duration
    held = replace(found, force_density=held_values(found.force_density, transcription.count))
    success = solution.success and _met(target, found, scales)
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    plan = Plan(
        success=success,
        status=solution.status,
        message="",
        objective=float(cost) * program.objective,
        iterations=solution.iterations,
        seconds=seconds,
        time=grid,
        force_density=found.force_density,
        trajectory=_trajectory(problem, grid, found, seconds, success),
        replay_error=np.nan,
        replay_speed_error=np.nan,
        structure=model.scene.structure,
        model=model,
    )
    error, speed_error = _replay_errors(plan, target)
    verdict = f"found after {solution.iterations} iterations" if success else explain_failure(target, imposed, reach, program, solution, held)
    message = f"{verdict}; {imposed.describe()}; its replay ends {error:.2g} m and {speed_error:.2g} m/s from the goal"
    if success and not (error <= COARSE * scales.length and speed_error <= COARSE * scales.length / scales.time):
        message += ", as the intervals are too long for this motion: give more of them, or substeps"
    return replace(plan, message=message, replay_error=error, replay_speed_error=speed_error)


def _replay_errors(plan: Plan, target: Target) -> tuple[float, float]:
    """How far the replay ends from the goals; without goals for the place (or speed) from the plan. NaN where it does not get there."""
    if not np.all(np.isfinite(plan.force_density)) or not plan.time[-1] > 0:
        return np.nan, np.nan
    replayed = plan.replay()
    if not replayed.success:
        return np.nan, np.nan
    metres, speeds = (np.asarray(value.full()) for value in target.misfit(replayed.states[-1]))
    for share, stop, _ in target.stops:
        state = np.array([np.interp(share * plan.time[-1], replayed.time, column) for column in replayed.states.T])
        metres, speeds = (np.append(before, value.full()) for before, value in zip((metres, speeds), stop.misfit(state), strict=True))
    if not metres.size:
        metres = np.linalg.norm(replayed.nodes[-1] - plan.trajectory.nodes[-1], axis=1)
    if not speeds.size:
        speeds = np.linalg.norm(replayed.velocities[-1] - plan.trajectory.velocities[-1], axis=1)
    return float(np.abs(metres).max()), float(np.abs(speeds).max())


def _trajectory(problem: Problem, grid: Array, found: Guess, seconds: float, success: bool) -> Trajectory:
    model = problem.model
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(grid)]
    message = "planned motion at the ends of the intervals"
    with np.errstate(all="ignore"):
        return record(model, grid, found.states, controls, step=float(grid[1]), message=message, success=success, seconds=seconds)
