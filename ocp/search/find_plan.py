"""Search for a plan by a sequence of attempts.

An attempt is a transcription, a solver and an initial guess. Its replay decides on acceptance.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.guess.initial_guess import InitialGuess
from ocp.problem.problem import Problem
from ocp.problem.rows import RELIABLE
from ocp.problem.scaling import Scales
from ocp.results.acceptance import NO_PLAN, assess_plan
from ocp.results.diagnosis import interpolate_plan
from ocp.results.result import PlanResult, Replayed
from ocp.search.coordinates import ReducedCoordinates, reduce_coordinates
from ocp.search.methods import plan_guess, run_attempt
from ocp.search.narrow_limits import explain_limits
from ocp.search.plan_record import record_plan
from ocp.search.policy import INEXACT, Attempt, attempts, complete, is_inexact
from ocp.search.replays import replay_plan
from ocp.search.task import Method, PlanningTask, prepare
from ocp.solvers.base import Outcome
from ocp.solvers.monitor import REPLAYING, Monitor
from ocp.targets.find_target import find_target
from ocp.targets.infeasible_goal import InfeasibleGoalError, TargetNotFoundWarning
from ocp.targets.target import StateAt, Target
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Profile
from ocp.transcription.multiple_shooting import MultipleShooting
from tenscasadi.structure.names import add_names
from tenscasadi.util.processes import one_blas_thread
from tenscasadi.util.troubleshooting import add_address


class _PlanSearch(NamedTuple):
    """Arguments that all attempts of a search share.

    Attributes
    ----------
    task : PlanningTask
        Problem in the coordinates of the solver.
    reduced : ReducedCoordinates or None
        The problem in full and reduced coordinates; None if it keeps its coordinates.
    """

    task: PlanningTask
    reduced: ReducedCoordinates | None


@one_blas_thread()
def find_plan(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Method | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    monitor: Monitor | None = None,
    tracked: bool = False,
) -> PlanResult:
    """Find a plan by a sequence of methods, of which the first success counts.

    They are those of `policy.attempts`, or the given method. Without a success, the best failed
    plan is returned. Arguments and errors are those of `ocp.solve`; `monitor` has the time limit.
    """
    monitor = Monitor() if monitor is None else monitor
    automatic = transcription is None and solver is None
    given = complete(transcription, solver, guess, problem)
    with monitor.catching_interrupts():
        reduced = None
        shoots = not automatic and isinstance(given.transcription, MultipleShooting)
        if not problem.phases and not shoots:
            reduced = reduce_coordinates(problem, guess)
        profile, stated = given.transcription.control, guess
        if reduced is not None:
            problem, guess = reduced.problem, reduced.guess(guess)
            given = given._replace(guess=guess)
        try:
            task = _prepare(problem, profile, guess, tolerance, monitor)
        except InfeasibleGoalError:
            if reduced is not None:  # its message names the joint or the plane
                _prepare(reduced.given, profile, stated, tolerance, monitor)
            raise
        rows = attempts(task, guess) if automatic else iter([given])
        result = _walk(_PlanSearch(task._replace(tracked=tracked), reduced), rows, given, automatic)
    if reduced is None:
        return result
    note = "; found in reduced coordinates" if result.success else ""
    return reduced.restore(replace(result, message=f"{result.message}{note}"))


def _prepare(
    problem: Problem,
    control: Profile,
    guess: InitialGuess | None,
    tolerance: float | None,
    monitor: Monitor,
) -> PlanningTask:
    """Check a problem and find its final state before the attempts.

    The final state is missing if the search has to stop before. Raises InfeasibleGoalError.
    `control` is the control profile, whose groups have to fit the limits. `guess` can be a plan,
    near which the final state is found. `tolerance` is that of the goals [m]; None for the default.
    """
    scales, near = Scales.of(problem), _interpolate_guess(problem, guess)
    limit = RELIABLE * scales.length if tolerance is None else tolerance
    early = PlanningTask(problem, None, scales, limit, monitor)
    try:
        return monitor.run(lambda: prepare(problem, control, limit, monitor, near), lambda: early)
    except InfeasibleGoalError as error:
        named = add_names(str(error), problem.model.scene.structure)
        raise add_address(InfeasibleGoalError(named, error.certificate)) from None


def _interpolate_guess(problem: Problem, guess: InitialGuess | None) -> StateAt | None:
    """Build the interpolant of a plan that serves as initial guess.

    It maps a fraction of the duration to a state. Returns None for other guesses, and for plans
    with other states.
    """
    if not isinstance(guess, PlanResult) or guess.model is None or problem.phases:
        return None
    states = guess.trajectory.states
    same = states.shape[1] == problem.model.nx and bool(np.isfinite(states).all())
    return interpolate_plan(guess) if same else None


def _walk(
    search: _PlanSearch, rows: Iterator[Attempt], first: Attempt, automatic: bool
) -> PlanResult:
    """Run attempts until the first success.

    `rows` are the attempts. With `automatic`, the user gave no method, and the message names the
    one that was chosen. An attempt is skipped if it does not apply to the kind of the last failure.
    If the search has to stop while an attempt is being built, `first` provides the result.
    """
    tried: list[tuple[str, PlanResult]] = []
    plan: PlanResult | None = None

    def advance() -> Attempt | None:
        otherwise = None if tried else first
        return search.task.monitor.run(lambda: next(rows, None), lambda: otherwise)

    while (attempt := advance()) is not None:
        if not attempt.follows(plan):
            continue
        if plan is not None and attempt.after == INEXACT:
            attempt = attempt.refine(search.task.problem, plan)
        attempt, spent = plan_guess(search.task, attempt)
        plan, target = _try(search, attempt)
        plan = replace(plan, iterations=spent + plan.iterations)
        search = search._replace(task=search.task._replace(target=target))
        tried.append((attempt.describe(), plan))
        if plan.success or search.task.monitor.status():
            break
    if not tried:
        raise ValueError("no method supports the problem: give a transcription and a solver")
    chosen, best = max(tried, key=lambda pair: _worth(pair[1]))
    if not best.success:
        best = replace(best, message=_explain(search.task, best))
    if not automatic:
        return best
    others = [name for name, other in tried if other is not best]
    text = f"chosen: {chosen}" if best.success else f"tried: {', '.join(name for name, _ in tried)}"
    text += f", after {', '.join(others)}" if best.success and others else ""
    return replace(
        best,
        message=f"{best.message}; {text}",
        iterations=sum(other.iterations for _, other in tried),
        seconds=search.task.monitor.elapsed,
    )


def _explain(task: PlanningTask, plan: PlanResult) -> str:
    """Complete the message of a failed plan.

    Names of members are added. Where no method found a motion, limits that are too narrow come
    first, as they are the cause.
    """
    text = add_names(plan.message, task.problem.model.scene.structure)
    if not text.startswith(NO_PLAN) or plan.duals is not None or task.monitor.status():
        return text
    limits = explain_limits(task)
    return f"{NO_PLAN}{limits}; {text.removeprefix(NO_PLAN)}" if limits else text


def _worth(plan: PlanResult) -> tuple[bool, bool, float]:
    """Compute the key that sorts plans by quality.

    Criteria are success, then an optimum, then the smaller error. Better plans have larger keys.
    """
    return plan.success, is_inexact(plan), -plan.worst_error


def _try(search: _PlanSearch, attempt: Attempt) -> tuple[PlanResult, Target | None]:
    """Run one attempt and its acceptance test.

    Goal rows are chosen to be independent at one state. If the optimum violates the other rows, a
    second run has as constraints the rows that are independent near its end. The second run counts
    if it succeeds. Returns the plan, and the final state from which the next attempt starts.
    """
    task = search.task
    outcome, target = run_attempt(task, attempt)
    plan = record_plan(task, attempt.transcription, attempt.solver, outcome)
    if target is None:
        return replace(plan, message=f"{NO_PLAN}{outcome.why}"), task.target
    other = None if attempt.twin else _find_other_target(task, plan, outcome)
    if other is not None:
        again = task._replace(target=other)
        found, reached = run_attempt(again, attempt._replace(guess=replace(plan, duals=None)))
        count = outcome.iterations + found.iterations
        if found.success and reached is not None:
            task, outcome, target = again, found, reached
        outcome = outcome._replace(iterations=count)
        plan = record_plan(task, attempt.transcription, attempt.solver, outcome)

    def replay(plan: PlanResult, tracked: bool) -> Replayed | None:
        reduced = search.reduced
        given = plan if reduced is None else reduced.restore(plan)
        found = task.monitor.run(lambda: replay_plan(given, tracked), lambda: None, REPLAYING)
        if found is None or reduced is None:
            return found
        return found._replace(motions=tuple(reduced.lower(motion) for motion in found.motions))

    given = task.problem if search.reduced is None else search.reduced.given
    options = task.tolerance, replay, task.tracked, given.scene
    plan = assess_plan(plan, target, outcome, *options)
    solved = outcome.success or outcome.coarse
    if solved and not plan.success and outcome.finer and not task.monitor.status():
        outcome = outcome.finer()
        finer = record_plan(task, attempt.transcription, attempt.solver, outcome)
        plan = max(plan, assess_plan(finer, target, outcome, *options), key=_worth)
    if attempt.twin and not plan.success:  # it is an optimum of the twin only
        plan = replace(plan, duals=None)
    return plan, task.target


def _find_other_target(task: PlanningTask, plan: PlanResult, found: Outcome) -> Target | None:
    """Find independent goal rows near the end of an optimum.

    They replace the present ones if the optimum misses goals that seemed dependent, see
    `Target.dependent`. `found` is the result of the attempt. Returns None if the optimum meets the
    goals, or if no other rows are found.
    """
    target, problem, duration = task.target, task.problem, float(plan.time[-1])
    if target is None or not target.met or not found.success or found.duals is None:
        return None
    state_at = interpolate_plan(plan)
    residuals = target.begin_at(found.states[0]).measure(state_at).distances(duration)
    limit = target.adjusted + 0.5 * target.residual * task.scales.length
    if residuals.max(initial=0.0) <= limit or task.monitor.status():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetNotFoundWarning)
        other = task.monitor.run(
            lambda: find_target(problem, task.scales, state_at, target.tolerance), lambda: None
        )
    return other if other is not None and other.met else None
