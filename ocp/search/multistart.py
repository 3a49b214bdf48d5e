"""Multistart from several initial guesses."""

from __future__ import annotations

from concurrent.futures import Executor, TimeoutError
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.guess.initial_guess import InitialGuess, InverseDynamics
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from ocp.sampling.solver import Sampling
from ocp.search.find_plan import find_plan
from ocp.solvers.monitor import Monitor


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
    plans: list[PlanResult] = []
    if executor is None:
        for k, one in enumerate(each):
            if plans and monitor.status():
                break
            part = monitor.limit(None if np.isinf(monitor.left) else monitor.left / (count - k))
            plans.append(find_plan(*one, monitor=part, tracked=tracked))
            if part.interrupted:
                monitor.stop()
    else:
        limit = None if np.isinf(monitor.left) else max(1e-3, monitor.left)
        running = [executor.submit(find_limited_plan, one, limit, tracked) for one in each]
        with monitor.catching_interrupts():
            for future in running:
                try:
                    left = None if not plans or np.isinf(monitor.left) else max(0.0, monitor.left)
                    plans.append(future.result(left))
                except TimeoutError:
                    future.cancel()
    best = min(
        plans,
        key=lambda plan: (not plan.success, plan.objective if plan.success else plan.worst_error),
    )
    costs = [plan.objective if plan.success else np.nan for plan in plans]
    costs += [np.nan] * (count - len(plans))
    return replace(
        best,
        message=f"{best.message}; best of {count} starts, {np.isfinite(costs).sum()} of which found a plan",
        start_objectives=np.array(costs),
        seconds=monitor.elapsed,
    )


def find_limited_plan(
    options: tuple[Any, ...], time_limit: float | None, tracked: bool
) -> PlanResult:
    """Find a plan in another process, within a time limit.

    `options` are the arguments of `find_plan` before the monitor, from problem to tolerance.
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
