"""One problem from several starts at once, and the best plan of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, TimeoutError
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.plan.plan import Plan
from ocp.problem.problem import Problem
from ocp.sampling.solver import Sampling
from ocp.transcription.initial_guess import InitialGuess, InverseDynamics

MOST_STARTS = 1000


def seeded(
    problem: Problem, guess: InitialGuess | None, solver: Any, chosen: bool, count: int
) -> list[dict[str, Any]]:
    """Return guess and solver of each of `count` starts, which differ by their seeds. chosen: whether the package picks the solver.

    Raise ValueError where nothing has a seed.
    """
    if isinstance(solver, Sampling) or (
        chosen and problem.model.scene.grounds and not problem.phases and not problem.free_start
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


def solve_each(
    solve: Callable[..., Plan],
    starts: Sequence[dict[str, Any]],
    executor: Executor | None,
    deadline: float | None,
) -> Plan:
    """Return the best plan of all starts, which holds the objectives of all. deadline: of `time.perf_counter`, s; None: no limit."""

    def left(share: int = 1) -> dict[str, float]:
        return (
            {}
            if deadline is None
            else {"seconds": max(1e-3, deadline - time.perf_counter()) / share}
        )

    plans: list[Plan | None]
    if executor is None:
        plans = [solve(**one, **left(len(starts) - k)) for k, one in enumerate(starts)]
    else:
        running = [executor.submit(solve, **one, **left()) for one in starts]
        plans = [running[0].result()]
        for one in running[1:]:
            try:
                plans.append(
                    one.result(
                        None if deadline is None else max(0.0, deadline - time.perf_counter())
                    )
                )
            except TimeoutError:
                one.cancel()
                plans.append(None)
    found = [plan for plan in plans if plan is not None]
    best = min(
        found,
        key=lambda plan: (not plan.success, plan.objective if plan.success else plan.worst_error),
    )
    costs = np.array(
        [plan.objective if plan is not None and plan.success else np.nan for plan in plans]
    )
    return replace(
        best,
        message=f"{best.message}; best of {len(starts)} starts, {np.isfinite(costs).sum()} of which found a plan",
        starts=costs,
    )
