"""From a problem to a plan: target, guess, the method that fits the solver, plan, replay, verdict."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ocp.boundary.target import Target
from ocp.condensed.method import solve_condensed
from ocp.phases.method import solve_phased
from ocp.plan.plan import Plan
from ocp.problem.control import winds
from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.program import prepare, solve_program
from ocp.sampling.method import default_intervals, solve_sampled
from ocp.sampling.solver import Sampling
from ocp.solvers.base import Outcome, Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess, evaluate_guess
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.variational import Variational
from ocp.verdict import judged
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array, flag, instance, positive_number

PHASE_INTERVALS = 20  # of each phase
RELIABLE = 1e-2  # of the structure's size (and of it per duration): what a replay may miss by, unless a tolerance is stated


def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Solver | CondensedNewton | Sampling | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    seconds: float | None = None,
    tracked: bool = False,
) -> Plan:
    """Find a plan of force densities for a problem.

    Parameters
    ----------
    problem : Problem
        What is asked.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational, optional
        How the motion becomes a program. Default: `MultipleShooting()`.
    solver : Ipopt, CondensedNewton, Fatrop or Sampling, optional
        What solves the program, or samples motions instead. Default: `Ipopt()`; `Sampling()` where the scene has a ground and the problem neither
        phases nor a free start, and no transcription is given.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Where the solver starts. From a plan of the same mesh and constraints it starts exactly, with its multipliers (see `Ipopt.warm`).
        Default: `InverseDynamics()`.
    tolerance : float, optional
        How far the replay may end from the goals, m, and as many m per duration in speed, for the plan to be a success. Default: 1 % of the
        structure's size.
    seconds : float, optional
        Wall time, s, that all of it may take: building, solving, replaying. When it is over, the plan is the best so far, without success. By
        default there is no limit.
    tracked : bool
        Whether the replay that decides on success is under `track`, in closed loop: for motions along which errors grow.

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
    flag("tracked", tracked)
    if solver is None:
        solver = Sampling() if transcription is None and problem.model.scene.grounds and not problem.phases and not problem.free_start else Ipopt()
    if transcription is None:
        sampled = isinstance(solver, Sampling) and not problem.phases
        transcription = (
            Variational(PHASE_INTERVALS) if problem.phases else MultipleShooting(default_intervals(problem)) if sampled else MultipleShooting()
        )
    instance("transcription", transcription, Transcription, "a transcription, such as ocp.MultipleShooting()")
    instance("solver", solver, (Ipopt, Fatrop, CondensedNewton, Sampling), "an ocp.Ipopt, ocp.CondensedNewton, ocp.Fatrop or ocp.Sampling")
    limit = RELIABLE * Scales.of(problem).length if tolerance is None else positive_number("tolerance", tolerance)
    began = time.perf_counter()
    deadline = None if seconds is None else began + positive_number("seconds", seconds)
    if problem.phases:
        if isinstance(solver, Sampling):
            raise ValueError("solver is Sampling, and Problem.phases say when nodes stand: leave one of them out")
        outcome, target = solve_phased(problem, transcription, solver, guess, deadline, limit)
    else:
        target, scales = prepare(problem, transcription)
        outcome = _find(problem, transcription, target, scales, guess, solver, deadline, limit)
    plan = _plan(problem, transcription, solver, outcome, time.perf_counter() - began)
    return judged(replace(plan, tracked=tracked), target, outcome, limit)


Plan._solve = staticmethod(solve)


def _find(
    problem: Problem,
    transcription: Transcription,
    target: Target,
    scales: Scales,
    guess: InitialGuess | None,
    solver: Solver | CondensedNewton | Sampling,
    deadline: float | None,
    tolerance: float,
) -> Outcome:
    """Return what the method finds that fits the solver."""
    if isinstance(solver, Sampling):
        known = None if guess is None else evaluate_guess(guess, problem, target, transcription.count)
        return solve_sampled(problem, transcription, known, solver, deadline, tolerance)
    first = evaluate_guess(guess, problem, target, transcription.count)
    if isinstance(solver, CondensedNewton):
        return solve_condensed(problem, transcription, target, scales, first, solver, deadline)
    return solve_program(problem, transcription, target, scales, first, solver, deadline, guess.duals if isinstance(guess, Plan) else None)


def _plan(problem: Problem, transcription: Transcription, solver: Solver | CondensedNewton | Sampling, found: Outcome, seconds: float) -> Plan:
    """Return the plan that was found, not yet replayed."""
    mesh = found.duration * np.append(0.0, np.cumsum(transcription.fractions)) if found.time is None else found.time.copy()
    mesh[-1] = found.duration
    motion = _trajectory(problem, mesh, found)
    wound = found.force_density if winds(problem.model) else None
    forces = found.force_density if wound is None else forces_of(problem.model, motion.states[: len(wound)], wound)
    return Plan(
        success=False,
        status=found.status,
        message="",
        objective=found.objective,
        iterations=found.iterations,
        seconds=seconds,
        time=mesh,
        force_density=forces,
        trajectory=motion,
        replay_error=np.nan,
        replay_speed_error=np.nan,
        structure=problem.model.scene.structure,
        model=problem.model,
        duals=found.duals,
        problem=problem,
        transcription=transcription,
        solver=solver,
        unknown="",
        rest_length=wound,
    )


def _trajectory(problem: Problem, mesh: Array, found: Outcome) -> Trajectory:
    model = problem.model
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(mesh)]
    message = "planned motion at the ends of the intervals"
    with np.errstate(all="ignore"):
        return record_trajectory(model, mesh, found.states, controls, step=float(mesh[1]), message=message, success=found.success)
