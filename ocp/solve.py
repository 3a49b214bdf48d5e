"""From a problem to a plan: target, guess, the method that fits the solver, plan, replay, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ocp.choice import Choice, Method, choose, matching
from ocp.condensed.interior_point import TIME
from ocp.condensed.method import NOT_SETTLED, solve_condensed
from ocp.phases.method import solve_phased
from ocp.plan.diagnosis import StateAt, goals_met, measure_misses, state_function
from ocp.plan.plan import Plan
from ocp.problem.control import winds
from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.program import prepare, solve_program
from ocp.reduced_twin import ReducedTwin, reduced_twin
from ocp.sampling.method import solve_sampled
from ocp.sampling.solver import Sampling
from ocp.solvers.base import Outcome
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import SADDLE, TIME_UP, Ipopt
from ocp.solvers.wider_rates import TOO_SLOW
from ocp.starts import MOST_STARTS, seeded, solve_each
from ocp.targets.find_target import find_target
from ocp.targets.infeasible_goal import InfeasibleGoalError
from ocp.targets.target import Target
from ocp.transcription.base import ReducedOnly, Transcription
from ocp.transcription.initial_guess import InitialGuess, evaluate_guess, on_mesh
from ocp.transcription.mesh import PiecewiseConstant
from ocp.transcription.variational import Variational
from ocp.verdict import judged
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.blas_threads import one_blas_thread
from tenscasadi.util.validate import Array, flag, instance, positive_number, whole_number

PHASE_INTERVALS = 20  # of each phase
MOST_TARGETS = 3  # near the ends of plans
FEW_BARS, FEW_ITERATIONS = (
    12,
    60,
)  # up to so many, IPOPT goes on with a plan whose cost is not settled
_MORE_GOALS = "give goals that tell more of the end, or another guess"
TOO_LATE = (
    "no plan: stopped at the time limit before the solver began, with the guess: raise seconds"
)
# of the structure's size (and of it per duration): what a replay may miss by, unless a tolerance is
# stated
RELIABLE = 1e-2


@one_blas_thread()
def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Method | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    seconds: float | None = None,
    starts: int = 1,
    executor: Executor | None = None,
    tracked: bool = False,
    parameters: Any = None,
) -> Plan:
    """Find a plan of force densities for a problem.

    Parameters
    ----------
    problem : Problem
        What is asked.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational, optional
        How the motion becomes a program. Default, with a solver: `MultipleShooting()`,
        `Variational()` for `CondensedNewton`; without, what suits the problem (see Notes).
    solver : Ipopt, CondensedNewton, Fatrop or Sampling, optional
        What solves the program, or samples motions instead. Default, with a transcription:
        `Ipopt()`; without, what suits the problem.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Where the solver starts. From a plan of the same mesh and constraints it starts exactly,
        with its multipliers (see `Ipopt.warm`). `Sampling` searches where it leads to no plan.
        Default: `InverseDynamics()`.
    tolerance : float, optional
        How far the replay may end from the goals, m, and as many m per duration in speed, for the
        plan to be a success. Default: 1 % of the structure's size.
    seconds : float, optional
        Wall time, s, that all of it may take: building, solving, replaying. When it is over, the
        plan is the best so far, without success. By default there is no limit.
    starts : int
        From how many guesses it is solved, which differ by their seeds (see `InverseDynamics`; with
        `Sampling` its own). The plan is the best of all, and `Plan.starts` the objectives of all.
    executor : concurrent.futures.Executor, optional
        What solves the starts at once, such as a ``ProcessPoolExecutor``. Default: one after the
        other.
    tracked : bool
        Whether the replay that decides on success is under `track`, in closed loop: for motions
        along which errors grow.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the parameters of the problem's model, see `Problem.fixed`. Default: those that
        the problem was made with. They enter as constants; only `Sampling` compiles code, and does
        so again for other values.

    Returns
    -------
    Plan
        The plan. Where none was found, or its replay misses more, `success` is False, and `message`
        says why and what to try.

    Raises
    ------
    InfeasibleGoalError
        No strings can bring the goals about; found before solving.
    TypeError, ValueError
        An argument is wrong, or limits and goals contradict each other; the message names them.

    See Also
    --------
    Plan.refine : Solve again on a finer mesh.

    Notes
    -----
    Where neither transcription nor solver is given, both are chosen, and the number of intervals:
    three for each radian of the fastest vibration, 30 at least. Where nodes may touch a ground,
    `Sampling`; else `Variational`, corrected to a third of the tolerance, from five bars on (nine
    where more than force densities is limited) with `CondensedNewton`, where it takes the costs, or
    with `Ipopt`. Where the first fails, or its replay misses, the next one follows, from its plan:
    where `Ipopt` meets a saddle `CondensedNewton`, for efforts and durations, then
    `MultipleShooting`, the condensed method also from guesses with much noise. Where its costs are
    not settled, `Ipopt` goes on for a while, and the better plan is kept. The message says which
    were tried.

    A problem in full coordinates is planned in reduced ones, as motions do not depend on them, but
    with `MultipleShooting`: the plan, its replay and the verdict are of the model that is given,
    and own expressions get its states. Where constraints are redundant, or bounds and costs are of
    own classes, `MultipleShooting` plans in full coordinates.

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
    began = time.perf_counter()
    instance("problem", problem, Problem, "an ocp.Problem")
    problem = problem if parameters is None else problem.fixed(parameters)
    flag("tracked", tracked)
    count = whole_number("starts", starts, 1, MOST_STARTS)
    if executor is not None:
        instance("executor", executor, Executor, "a concurrent.futures.Executor, or None")
    limit = (
        RELIABLE * Scales.of(problem).length
        if tolerance is None
        else positive_number("tolerance", tolerance)
    )
    deadline = None if seconds is None else began + positive_number("seconds", seconds)
    if count > 1:
        each = seeded(problem, guess, solver, transcription is None and solver is None, count)
        same = {
            "problem": problem,
            "transcription": transcription,
            "tolerance": tolerance,
            "tracked": tracked,
        }
        best = solve_each(solve, [{**same, **one} for one in each], executor, deadline)
        return replace(best, seconds=time.perf_counter() - began)
    asked = _Asked(problem, guess, limit, tracked, began, deadline)
    if transcription is None and solver is None and not problem.phases:
        return _in_reduced(asked._replace(chosen=True), _by_choice)
    if transcription is None:
        transcription = (
            Variational(PHASE_INTERVALS) if problem.phases else matching(solver, problem)
        )
    solver = Ipopt() if solver is None else solver
    instance(
        "transcription",
        transcription,
        Transcription,
        "a transcription, such as ocp.MultipleShooting()",
    )
    instance(
        "solver",
        solver,
        (Ipopt, Fatrop, CondensedNewton, Sampling),
        "an ocp.Ipopt, ocp.CondensedNewton, ocp.Fatrop or ocp.Sampling",
    )
    if problem.phases:
        if isinstance(solver, Sampling):
            raise ValueError(
                "solver is Sampling, and Problem.phases say when nodes stand: leave one of them out"
            )
        outcome, target = solve_phased(problem, transcription, solver, guess, deadline, limit)
        return judged(_plan(asked, transcription, solver, outcome), target, outcome, limit)
    way = Choice(transcription, solver)
    return (
        _in_reduced(asked, partial(_prepared, way))
        if isinstance(transcription, ReducedOnly)
        else _prepared(way, asked)
    )


class _Asked(NamedTuple):
    """Arguments of `solve`. limit: m, that the replay may end from the goals; began, deadline: of `time.perf_counter`, s.

    chosen: whether the package chooses the method. twin: whose problem it is, where another one is
    given.
    """

    problem: Problem
    guess: InitialGuess | None
    limit: float
    tracked: bool
    began: float
    deadline: float | None
    chosen: bool = False
    twin: ReducedTwin | None = None

    def late(self) -> bool:
        """Tell whether the time is over."""
        return self.deadline is not None and time.perf_counter() >= self.deadline


def _in_reduced(asked: _Asked, method: Callable[[_Asked], Plan]) -> Plan:
    """Return the plan that a method finds, in reduced coordinates where there are such; it is judged by the model that is given."""
    twin = reduced_twin(asked.problem, asked.guess)
    if twin is None:
        return method(asked)
    plan = twin.returned(
        method(asked._replace(problem=twin.problem, guess=twin.guess(asked.guess), twin=twin))
    )
    return replace(
        plan,
        message=f"{plan.message}; found in reduced coordinates" if plan.success else plan.message,
    )


def _prepared(way: Choice, asked: _Asked) -> Plan:
    """Return the plan of one method."""
    return _by_method(asked, way, *prepare(asked.problem, way.transcription.control))


def _by_choice(asked: _Asked) -> Plan:
    """Return the plan of the first choice that finds one; else the best of all, which says what was tried."""
    problem = asked.problem
    target, scales = prepare(problem, PiecewiseConstant())
    tried: dict[str, Plan] = {}
    for choice in choose(problem, target, asked.guess, asked.limit):
        best = max(tried.values(), key=_worth, default=None)
        optimal = best is not None and best.duals is not None and best.status != NOT_SETTLED
        saddle = any(plan.status == SADDLE for plan in tried.values())
        if best is not None and (
            asked.late()
            or (choice.finer and not optimal)
            or (choice.noise and optimal)
            or (choice.again and not saddle)
        ):
            continue
        way, own = (
            (choice._replace(guess=None), asked._replace(guess=best))
            if optimal
            else (choice, asked)
        )
        plan = tried[choice.describe()] = _by_method(own, way, target, scales)
        if (
            plan.success
            and plan.status == NOT_SETTLED
            and problem.model.mechanism.bars <= FEW_BARS
            and not asked.late()
        ):
            way = Choice(choice.transcription, Ipopt(max_iterations=FEW_ITERATIONS))
            tried[way.describe()] = _by_method(asked._replace(guess=plan), way, target, scales)
        if plan.success or plan.status in (TIME, TOO_SLOW):
            break
    chosen = max(tried, key=lambda name: _worth(tried[name]))
    best, others = tried[chosen], ", ".join(name for name in tried if name != chosen)
    said = f"chosen: {chosen}" + (f", after {others}" if others else "")
    return replace(
        best,
        solver=replace(best.solver, restart=True)
        if isinstance(best.solver, Ipopt)
        else best.solver,
        message=f"{best.message}; {said if best.success else 'tried: ' + ', '.join(tried)}",
        iterations=sum(plan.iterations for plan in tried.values()),
        seconds=time.perf_counter() - asked.began,
    )


def _worth(plan: Plan) -> tuple[bool, bool, float]:
    """Return what makes one plan better than another: a success, then an optimum, then the lower cost, or without success the smaller error."""
    return (
        plan.success,
        plan.duals is not None,
        -(plan.objective if plan.success else plan.worst_error),
    )


def _by_method(asked: _Asked, way: Choice, target: Target, scales: Scales) -> Plan:
    """Return the plan that the method finds which fits the solver.

    Rows that bars repeat at the target are not imposed. Where a plan ends elsewhere, bars may point
    another way and not repeat them: then it is found again, with the rows of a target near its end.
    """
    plan, iterations = _at_once(asked, way, target, scales), 0
    for left in reversed(range(MOST_TARGETS + 1)):
        missed = (
            ""
            if plan.success or plan.duals is None
            else _missed_elsewhere(plan, target, asked.limit)
        )
        if not missed:
            break
        if not left or asked.late():
            plan = replace(
                plan,
                duals=None,
                message=f"no plan: {missed}, far from where goals were thought to lead: {_MORE_GOALS}; {plan.message}",
            )
            break
        try:
            target = find_target(asked.problem, scales, _motion_of(plan))
        except InfeasibleGoalError:
            break
        iterations += plan.iterations
        plan = _at_once(asked._replace(guess=plan), way._replace(guess=None), target, scales)
    return replace(plan, iterations=plan.iterations + iterations)


def _missed_elsewhere(plan: Plan, target: Target, limit: float) -> str:
    """Tell which goal the planned motion itself misses, though the rows that were imposed are met; "" where none is missed by more than a limit."""
    state_at, duration, target = (
        _motion_of(plan),
        float(plan.time[-1]),
        target.begin_at(plan.trajectory.states[0]),
    )
    missed = measure_misses(target, state_at)
    worst = max(
        [amount for amount, _ in missed.places]
        + [duration * amount for amount, _ in missed.speeds],
        default=0.0,
    )
    return missed.worst() if worst > limit and goals_met(target, state_at) else ""


def _motion_of(plan: Plan) -> StateAt:
    return state_function(
        plan.known_model("solve"),
        plan.trajectory.states,
        float(plan.time[-1]),
        np.diff(plan.time) / plan.time[-1],
    )


def _at_once(asked: _Asked, way: Choice, target: Target, scales: Scales) -> Plan:
    """Return the plan that ends at a target, or near it."""
    problem, guess, transcription, solver, first = (
        asked.problem,
        asked.guess,
        way.transcription,
        way.solver,
        way.guess,
    )
    if isinstance(solver, Sampling):
        known = (
            None
            if guess is None
            else evaluate_guess(guess, problem, target, transcription.count).disturbed(problem)
        )
        outcome = solve_sampled(problem, transcription, known, solver, asked.deadline, asked.limit)
    else:
        first = (
            evaluate_guess(guess, problem, target, transcription.count) if first is None else first
        )
        if asked.late():
            own = on_mesh(problem.model, first, transcription.fractions, transcription.control)
            outcome = Outcome(
                own.states, own.force_density, own.duration, np.nan, False, TIME_UP, 0, why=TOO_LATE
            )
        elif isinstance(solver, CondensedNewton):
            outcome = solve_condensed(
                problem,
                transcription,
                target,
                scales,
                first.disturbed(problem),
                solver,
                asked.deadline,
            )
        else:
            duals = guess.duals if isinstance(guess, Plan) else None
            outcome = solve_program(
                problem, transcription, target, scales, first, solver, asked.deadline, duals
            )
    replay = None if asked.twin is None else asked.twin.replay
    return judged(
        _plan(asked, transcription, solver, outcome),
        target,
        outcome,
        asked.limit,
        asked.chosen,
        replay,
    )


def _plan(asked: _Asked, transcription: Transcription, solver: Method, found: Outcome) -> Plan:
    """Return the plan that was found, not yet replayed."""
    problem = asked.problem
    mesh = (
        found.duration * np.append(0.0, np.cumsum(transcription.fractions))
        if found.time is None
        else found.time.copy()
    )
    mesh[-1] = found.duration
    motion = _trajectory(problem, mesh, found)
    wound = found.force_density if winds(problem.model) else None
    forces = (
        found.force_density
        if wound is None
        else forces_of(problem.model, motion.states[: len(wound)], wound)
    )
    return Plan(
        success=False,
        status=found.status,
        message="",
        objective=found.objective,
        iterations=found.iterations,
        seconds=time.perf_counter() - asked.began,
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
        tracked=asked.tracked,
    )


def _trajectory(problem: Problem, mesh: Array, found: Outcome) -> Trajectory:
    model = problem.model
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(mesh)]
    message = "planned motion at the ends of the intervals"
    with np.errstate(all="ignore"):
        return record_trajectory(
            model,
            mesh,
            found.states,
            controls,
            step=float(mesh[1]),
            message=message,
            success=found.success or found.coarse,
        )
