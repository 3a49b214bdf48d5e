"""Multistart: one problem from several initial guesses, and the best plan of them."""

from __future__ import annotations

import time
from concurrent.futures import Executor, Future, TimeoutError
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from ocp.sampling.solver import Sampling
from ocp.search.find_plan import find_plan
from ocp.search.task import Method
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess, InverseDynamics


def find_best_plan(
    problem: Problem,
    transcription: Transcription | None,
    solver: Method | None,
    guess: InitialGuess | None,
    tolerance: float | None,
    *,
    seconds: float | None,
    tracked: bool,
    count: int,
    executor: Executor | None,
) -> PlanResult:
    """Find a plan from each of `count` starts, and return the best, which holds the objectives of all.

    Raise ValueError where nothing has a seed.
    """
    began = time.perf_counter()
    automatic = transcription is None and solver is None
    same = {"problem": problem, "transcription": transcription, "tolerance": tolerance}
    each = [
        {**same, "tracked": tracked, **one}
        for one in _seeded(problem, guess, solver, automatic, count)
    ]
    deadline = None if seconds is None else began + seconds
    plans = (
        [find_plan(**one, **_left(deadline, count - k)) for k, one in enumerate(each)]
        if executor is None
        else _collect(
            [executor.submit(find_plan, **one, **_left(deadline)) for one in each], deadline
        )
    )
    best = min(
        (plan for plan in plans if plan is not None),
        key=lambda plan: (not plan.success, plan.objective if plan.success else plan.worst_error),
    )
    costs = np.array(
        [plan.objective if plan is not None and plan.success else np.nan for plan in plans]
    )
    return replace(
        best,
        message=f"{best.message}; best of {count} starts, {np.isfinite(costs).sum()} of which found a plan",
        starts=costs,
        seconds=time.perf_counter() - began,
    )


def _seeded(
    problem: Problem, guess: InitialGuess | None, solver: Any, automatic: bool, count: int
) -> list[dict[str, Any]]:
    """Return guess and solver of each start, which differ by their seeds. Raise ValueError where nothing has one."""
    if isinstance(solver, Sampling) or (
        automatic and problem.model.scene.grounds and not problem.phases and not problem.free_start
    ):
        own = solver if isinstance(solver, Sampling) else Sampling()
        return [{"guess": guess, "solver": replace(own, seed=own.seed + k)} for k in range(count)]
    first = InverseDynamics() if guess is None else guess
    if problem.phases or not isinstance(first, InverseDynamics):
        has = "Problem has phases" if problem.phases else f"guess is {type(first).__name__}"
        raise ValueError(
            f"starts is {count}, and {has}, whose start has no seed: give starts=1, or ocp.InverseDynamics() and no phases"
        )
    return [{"guess": replace(first, seed=first.seed + k), "solver": solver} for k in range(count)]


def _left(deadline: float | None, share: int = 1) -> dict[str, Any]:
    """Return the time limit of one of the starts that are still to come."""
    if deadline is None:
        return {}
    return {"seconds": max(1e-3, deadline - time.perf_counter()) / share}


def _collect(running: list[Future[PlanResult]], deadline: float | None) -> list[PlanResult | None]:
    """Return the plans in the order of the starts: None where the time was over, but for the first."""
    plans: list[PlanResult | None] = [running[0].result()]
    for one in running[1:]:
        try:
            left = None if deadline is None else max(0.0, deadline - time.perf_counter())
            plans.append(one.result(left))
        except TimeoutError:
            one.cancel()
            plans.append(None)
    return plans
