"""Multistart from several initial guesses."""

from __future__ import annotations

from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.guess.initial_guess import InitialGuess, InverseDynamics
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from ocp.sampling.solver import Sampling
from ocp.search.find_plan import find_plan
from ocp.solvers.monitor import Monitor

_Options = tuple[Any, ...]  # arguments of `find_plan` before the monitor, from problem to tolerance


def find_best_plan(
    problem: Problem,
    *options: Any,
    monitor: Monitor,
    tracked: bool,
    count: int,
    executor: Executor | None,
) -> PlanResult:
    """Find the best plan from `count` initial guesses.

    The plan has the objectives of all starts. `options` are transcription, solver, guess and
    tolerance, and `tracked` a flag, as in `ocp.solve`. The starts run in parallel if there is an
    `executor`. Raises ValueError if neither guess nor solver has a seed.
    """
    transcription, solver, guess, tolerance = options
    automatic = transcription is None and solver is None
    each = [
        (problem, transcription, own_solver, own_guess, tolerance)
        for own_guess, own_solver in _vary_seeds(problem, guess, solver, automatic, count)
    ]
    if executor is None:
        plans = _solve_in_order(each, monitor, tracked)
    else:
        plans = _solve_in_parallel(each, monitor, tracked, executor)
    costs = np.full(count, np.nan)
    for k, plan in plans.items():
        costs[k] = plan.objective if plan.success else np.nan
    best = _find_best(plans)
    return replace(
        best,
        message=f"{best.message}; best of {count} starts, {np.isfinite(costs).sum()} of which found a plan",
        start_objectives=costs,
        seconds=monitor.elapsed,
    )


def _solve_in_order(each: list[_Options], monitor: Monitor, tracked: bool) -> dict[int, PlanResult]:
    """Solve one start after the other.

    Each has an equal part of the remaining time. Returns the plans by number of the start.
    """
    plans: dict[int, PlanResult] = {}
    for k, one in enumerate(each):
        if plans and monitor.status():
            break
        monitor.phase = _describe_progress(plans, len(each))
        part = monitor.limit(None if np.isinf(monitor.left) else monitor.left / (len(each) - k))
        plans[k] = find_plan(*one, monitor=part, tracked=tracked)
        if part.interrupted:
            monitor.stop()
    return plans


def _solve_in_parallel(
    each: list[_Options], monitor: Monitor, tracked: bool, executor: Executor
) -> dict[int, PlanResult]:
    """Solve all starts in an executor.

    After the time limit or a stop request, the plans that exist are returned, at least one. They
    are ordered by number of the start.
    """
    limit = None if np.isinf(monitor.left) else max(1e-3, monitor.left)
    running = [executor.submit(find_limited_plan, one, limit, tracked) for one in each]
    done: set[Future[PlanResult]] = set()
    with monitor.catching_interrupts():
        while len(done) < len(running) and not (done and monitor.status()):
            plans = {k: one.result() for k, one in enumerate(running) if one in done}
            monitor.phase = _describe_progress(plans, len(each))
            monitor.show_line()
            done |= wait(set(running) - done, 0.1, FIRST_COMPLETED).done
    for future in running:
        future.cancel()
    return {k: one.result() for k, one in enumerate(running) if one in done}


def _find_best(plans: dict[int, PlanResult]) -> PlanResult:
    """Find the plan with the smallest objective, or the failed plan with the smallest error."""
    return min(
        plans.values(),
        key=lambda plan: (not plan.success, plan.objective if plan.success else plan.worst_error),
    )


def _describe_progress(plans: dict[int, PlanResult], count: int) -> str:
    """Describe how many of `count` starts have finished, and the best plan so far."""
    text = f"{len(plans)} of {count} starts finished"
    if not plans:
        return text
    best = _find_best(plans)
    return (
        f"{text}, the best with objective {best.objective:.5g} and error {best.worst_error:.1e} m"
    )


def find_limited_plan(options: _Options, time_limit: float | None, tracked: bool) -> PlanResult:
    """Find a plan in another process, within a time limit.

    `time_limit` is in seconds; None is no limit. With `tracked`, the replay under the feedback of
    `ocp.track` decides on success.
    """
    return find_plan(*options, monitor=Monitor(time_limit), tracked=tracked)


def _vary_seeds(
    problem: Problem, guess: InitialGuess | None, solver: Any, automatic: bool, count: int
) -> list[tuple[Any, Any]]:
    """List `count` initial guesses and solvers with different seeds.

    `automatic` tells that the user gave neither transcription nor solver. The default may then be
    `Sampling`. Raises ValueError if neither guess nor solver has a seed.
    """
    grounds = problem.model.scene.grounds and not problem.phases and not problem.free_start
    if isinstance(solver, Sampling) or (automatic and grounds):
        own = solver if isinstance(solver, Sampling) else Sampling()
        return [(guess, replace(own, seed=own.seed + k)) for k in range(count)]
    first = InverseDynamics() if guess is None else guess
    if problem.phases or not isinstance(first, InverseDynamics):
        has = "Problem has phases" if problem.phases else f"guess is {type(first).__name__}"
        raise ValueError(
            f"n_starts is {count}, and {has}, whose start has no seed: give n_starts=1, or ocp.InverseDynamics() and no phases"
        )
    return [(replace(first, seed=first.seed + k), solver) for k in range(count)]
