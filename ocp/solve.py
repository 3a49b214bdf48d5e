"""From a problem to a plan: target, presolve, initial guess, program, solution, plan, replay, verdict."""

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
from ocp.plan.diagnosis import explain_failure, long_steps, measure_misses
from ocp.plan.plan import Plan
from ocp.presolve import check_freedom, check_groups, check_start
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


class _Task(NamedTuple):
    """A problem and how it becomes a program, where its goals lead, and how far the strings move their rows."""

    problem: Problem
    transcription: Transcription
    scales: Scales
    target: Target
    reach: Reach


class _Found(NamedTuple):
    """The rows that were imposed, and the solution; `guess` is what it says, to start again from."""

    imposed: Target
    program: Program
    solution: Solution
    guess: Guess
    gap: float  # m, from fine steps, where an accuracy is asked for


def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Solver | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
) -> Plan:
    """Find a plan of force densities for a problem.

    Parameters
    ----------
    problem : Problem
        What is asked.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational, optional
        How the motion becomes a program. Default: `MultipleShooting()`.
    solver : Ipopt or Fatrop, optional
        What solves the program. Default: `Ipopt()`.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Where the solver starts. From a plan of the same mesh and constraints it starts exactly, with its multipliers (see `Ipopt.warm`).
        Default: `InverseDynamics()`.
    tolerance : float, optional
        How far the replay may end from the goals, m, and as many m per duration in speed, for the plan to be a success. Default: 1 % of the
        structure's size.

    Returns
    -------
    Plan
        The plan. Where none was found, or its replay misses more, `success` is False, and `message` says why and what to try.

    Raises
    ------
    UnreachableGoal
        No strings can bring the goals about; found before solving.
    TypeError, ValueError
        An argument is wrong, or limits and goals contradict each other; the message names them.

    See Also
    --------
    Plan.refine : Solve again on a finer mesh.

    Examples
    --------
    The two bars of a planar cross turn against each other within a second, at the least effort:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(model, 1.0, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> plan.success
    True
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    transcription = MultipleShooting() if transcription is None else transcription
    solver = Ipopt() if solver is None else solver
    instance("transcription", transcription, Transcription, "a transcription, such as ocp.MultipleShooting()")
    instance("solver", solver, (Ipopt, Fatrop), "an ocp.Ipopt or ocp.Fatrop")
    check_correctable(transcription, solver)
    limit = None if tolerance is None else positive_number("tolerance", tolerance)
    began = time.perf_counter()
    task = _prepare(problem, transcription)
    first = evaluate_guess(guess, problem, task.target, transcription.count)
    imposed = _controlled(task, first)
    found = _attempt(task, solver, imposed, first, guess.duals if isinstance(guess, Plan) else None)
    if _rows(imposed) < _rows(task.target) and not (found.solution.success and _met(task, found)):
        # Rows that no string moved along the guess are missed: along a less regular motion they may be within reach.
        loosened = _loosened(problem, first)
        more = _controlled(task, loosened, HARDLY_REACHED)
        if _rows(more) > _rows(imposed):
            found = _attempt(task, solver, more, loosened)
    plan = _plan(task, found, solver, time.perf_counter() - began)
    return _judged(plan, task, found, RELIABLE * task.scales.length if limit is None else limit)


Plan._solve = staticmethod(solve)


def program_of(problem: Problem, transcription: Transcription, guess: InitialGuess | None = None) -> Program:
    """Return the program that `solve` gives to its solver. Raises as `solve`."""
    instance("problem", problem, Problem, "an ocp.Problem")
    instance("transcription", transcription, Transcription, "a transcription, such as ocp.MultipleShooting()")
    task = _prepare(problem, transcription)
    first = evaluate_guess(guess, problem, task.target, transcription.count)
    return transcription.program(problem, _controlled(task, first), task.scales, first)


def _prepare(problem: Problem, transcription: Transcription) -> _Task:
    """Find the target; refuse what has no solution."""
    check_groups(problem, transcription.control)
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    if not problem.free_start:
        check_freedom(problem, target, transcription)
        check_start(problem)
    together = group_matrix(transcription.control, problem.model.nu)
    reach = Reach(problem.model, transcription.count, problem.shortest < problem.longest, grouping=together)
    return _Task(problem, transcription, scales, target, reach)


def _controlled(task: _Task, guess: Guess, least: float = REACHED) -> Target:
    """Return the target without the rows that the strings cannot move, to first order, along the motion under the guess's force densities."""
    target = task.target
    if not _rows(target) or target.free_start is not None:  # a free start moves them too
        return target
    intervals = len(guess.force_density)

    def reduced(part: Target, share: float) -> Target:
        end = max(1, round(share * intervals))
        kept = find_controlled(task.reach.of_rows(part.single, part.weights, target.start, guess.force_density, guess.duration, end), least)
        return part if len(kept) == part.count else part.keep(kept, "out of control")

    waypoints = tuple(one._replace(target=reduced(one.target, one.share)) for one in target.waypoints)
    return replace(reduced(target, 1.0), waypoints=waypoints)


def _rows(target: Target) -> int:
    """Count the rows that are imposed at the end and on the way."""
    return sum(part.count for _, part, _ in target.instants)


def _loosened(problem: Problem, guess: Guess) -> Guess:
    """Return the guess with force densities that differ from string to string and from interval to interval, always in the same way."""
    lower, upper = problem.force_density_limits
    change = np.random.default_rng(0).uniform(size=guess.force_density.shape)
    strength = float(np.abs(guess.force_density).max()) or 1.0
    return replace(guess, force_density=np.clip(guess.force_density + LOOSENING * strength * change, lower, upper))


def _attempt(task: _Task, solver: Solver, imposed: Target, guess: Guess, duals: Duals | None = None) -> _Found:
    """Make the program and solve it, from multipliers where they are known."""
    problem, transcription = task.problem, task.transcription
    program = transcription.program(problem, imposed, task.scales, guess)
    known = program if duals is None else warm_started(program, imposed, duals)
    if transcription.accuracy is None or not isinstance(solver, Ipopt):
        solution, states, gap = solver.solve(known), None, 0.0
    else:
        solution, states, gap = solve_corrected(known, solver, problem.model, transcription.fractions, transcription.accuracy)
    planned, controls, duration = (np.asarray(value.full()) for value in program.unpack(solution.w))
    lower, upper = problem.force_density_limits
    # Interior-point methods overstep limits by their tolerance.
    duration = np.clip(duration.squeeze(), problem.shortest, problem.longest)
    says = Guess(planned.T if states is None else states, np.clip(controls.T, lower, upper), float(duration))
    return _Found(imposed, program, solution, says, gap)


def _planned(task: _Task, found: _Found) -> Callable[[float], Array]:
    """Return the planned state (nx,) as a function of the share of the duration, as waypoints see it."""
    shares, guess, model = task.transcription.fractions, found.guess, task.problem.model

    def state_at(share: float) -> Array:
        k, part = locate_share(shares, share)
        (before, after), h = guess.states[k : k + 2], guess.duration * shares[k]
        return after if part == 1.0 else np.asarray(hermite_state(model, ca.DM(before), ca.DM(after), h, part).full()).ravel()

    return state_at


def _met(task: _Task, found: _Found) -> bool:
    """Tell whether the rows of all goals vanish, also those that were not imposed; how well bars and momenta are kept is not asked."""
    state_at = _planned(task, found)
    for share, part, _ in task.target.begin_at(found.guess.states[0]).instants:
        residual = np.asarray(part.rows(state_at(share)).full()).ravel()
        if len(residual) and np.abs(np.linalg.lstsq(part.reduction.combinations, residual)[0]).max() > MET:
            return False
    return True


def _plan(task: _Task, found: _Found, solver: Solver, seconds: float) -> Plan:
    """Return the plan that was found, not yet replayed."""
    problem, (imposed, program, solution, guess, _) = task.problem, found
    time = guess.duration * np.append(0.0, np.cumsum(task.transcription.fractions))
    time[-1] = guess.duration
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    return Plan(
        success=False,
        status=solution.status,
        message="",
        objective=float(cost) * program.objective,
        iterations=solution.iterations,
        seconds=seconds,
        time=time,
        force_density=guess.force_density,
        trajectory=_trajectory(problem, time, guess, solution.success),
        replay_error=np.nan,
        replay_speed_error=np.nan,
        structure=problem.model.scene.structure,
        model=problem.model,
        duals=named_duals(program, imposed, solution.w, *solution.multipliers) if solution.success and solution.multipliers else None,
        problem=problem,
        transcription=task.transcription,
        solver=solver,
        unknown="",
    )


def _judged(plan: Plan, task: _Task, found: _Found, tolerance: float) -> Plan:
    """Return the plan with the errors of its replay, whether it is a success, and what is to be said of it."""
    target, imposed = (part.begin_at(found.guess.states[0]) for part in (task.target, found.imposed))
    error, speed_error = _replay_errors(plan, target)
    plan = replace(plan, replay_error=error, replay_speed_error=speed_error)
    success, verdict = _verdict(plan, task._replace(target=target), found._replace(imposed=imposed), tolerance)
    ends = f"its replay ends {error:.2g} m and {speed_error:.2g} m/s from the goal" if np.isfinite(error) else "its replay diverges"
    return replace(plan, success=success, message=f"{verdict}; {imposed.describe()}; {ends}")


def _verdict(plan: Plan, task: _Task, found: _Found, tolerance: float) -> tuple[bool, str]:
    """Tell whether the plan is a success, and what is to be said of it."""
    transcription, (imposed, program, solution, guess, gap) = task.transcription, found
    state_at = _planned(task, found)
    if solution.success and transcription.accuracy is not None and gap > transcription.accuracy:
        return False, f"too coarse: corrections end {gap:.2g} m from fine steps, not {transcription.accuracy:.2g} m: give more intervals"
    if solution.success and not _met(task, found):
        missed = measure_misses(task.target, state_at).worst()
        return (
            False,
            f"no plan: {missed}, and no string moves it there to first order: give a goal that the motion passes",
        )
    if solution.success and plan.worst_error <= tolerance:
        return True, f"found after {solution.iterations} iterations"
    held = replace(guess, force_density=held_values(guess.force_density, transcription.count))
    step = float(np.diff(plan.time).max()) / (transcription.substeps if isinstance(transcription, MultipleShooting) else 1)
    too_long = long_steps(task.problem.model, guess.states, held.force_density, step, guess.duration)
    if not solution.success:
        return False, explain_failure(measure_misses(task.target, state_at), imposed, task.reach, program, solution, held, too_long)
    cure = too_long or "give more intervals, or substeps"
    beyond = f"its replay misses the goal by more than {tolerance:.2g} m (or {tolerance:.2g} m per duration)"
    return False, f"too coarse: a plan was found after {solution.iterations} iterations, but {beyond}: {cure}, or plan.refine({tolerance:.2g})"


def _replay_errors(plan: Plan, target: Target) -> tuple[float, float]:
    """Measure how far the replay ends from the goals; without goals for the place (or speed) from the plan. NaN where it does not get there."""
    if not np.all(np.isfinite(plan.force_density)) or not plan.time[-1] > 0:
        return np.nan, np.nan
    replayed = plan.replay()
    if not replayed.success:
        return np.nan, np.nan
    times = replayed.time / replayed.time[-1]
    missed = measure_misses(target, lambda share: np.array([np.interp(share, times, column) for column in replayed.states.T]))
    metres, speeds = ([amount for amount, _ in rows] for rows in missed)
    if not metres:
        metres = np.linalg.norm(replayed.nodes[-1] - plan.trajectory.nodes[-1], axis=1).tolist()
    if not speeds:
        speeds = np.linalg.norm(replayed.velocities[-1] - plan.trajectory.velocities[-1], axis=1).tolist()
    return float(max(metres)), float(max(speeds))


def _trajectory(problem: Problem, mesh: Array, found: Guess, success: bool) -> Trajectory:
    model = problem.model
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(mesh)]
    message = "planned motion at the ends of the intervals"
    with np.errstate(all="ignore"):
        return record_trajectory(model, mesh, found.states, controls, step=float(mesh[1]), message=message, success=success)
