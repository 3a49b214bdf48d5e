"""Search for the largest step or tolerance with sufficient accuracy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tenscasadi.analysis.reference_solution import GRID, distance, end_nodes
from tenscasadi.analysis.tradeoff import Case
from tenscasadi.integrators.scheme import extent
from tenscasadi.integrators.stability import find_limit
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Single
from tenscasadi.util.validate import MAX_ITERATIONS, Array

_CLOSE = 1.15  # factor between the step found and the largest sufficient one
_REPEATS = 3  # timed runs


@dataclass(eq=False)
class AccuracyTarget:
    """Reference positions, permitted error and deadline of a search.

    The nodes (n, 3) must be reproduced within `wanted` m. The search ends at the time `deadline` of
    the clock [s], `time_limit` after its start, or once it is interrupted. It reports its progress
    to `progress_bar`. `found` is the best sufficient choice so far, which remains known when an
    exception ends the search.
    """

    nodes: Array
    wanted: float
    deadline: float
    time_limit: float
    progress_bar: Any
    interrupted: bool = False
    found: Choice | None = None

    @property
    def late(self) -> bool:
        """Whether the search has to end."""
        return self.interrupted or time.perf_counter() > self.deadline

    def check_time(self, expected: float) -> None:
        """Raise OutOfTime if a run would end after the deadline.

        The run is `expected` to take this time [s].
        """
        self.progress_bar.update(0)  # shows the time
        if self.late or time.perf_counter() + expected > self.deadline:
            raise OutOfTime


class OutOfTime(Exception):
    """Raised when the deadline expires."""


@dataclass(frozen=True)
class Price:
    """Cost of a run in instructions.

    `step` counts for each trial step, `second` for each second of wall time.
    """

    step: float
    second: float


def find_option(case: Case, speed: float, goal: AccuracyTarget, most: float) -> Choice | None:
    """Find about the cheapest step or rtol with sufficient accuracy.

    The accuracy is that of `goal`, for the scheme and the run of `case`. Returns None if no option
    costs less than `most` instructions. If the deadline or Ctrl-C ends the search, the best choice
    so far is `goal.found`. `speed`: instructions in a second, where they are not counted.
    """
    if not case.scheme.implicit:
        # Error control and event location double the work.
        price = Price(case.instructions() * (2.0 if case.scheme.adaptive else 1.0), 0.0)
        return (_find_loosest if case.scheme.adaptive else _find_fewest)(case, price, goal, most)
    clock = Price(0.0, speed)
    if case.scheme.adaptive:
        return _find_loosest(case, clock, goal, most)
    if case.compiled is False:
        return _find_fewest(case, clock, goal, most)
    promising = _find_fewest(
        replace(case, compiled=False), Price(0.0, speed / 6.0), goal, most
    )  # compilation takes seconds and makes the code about 6 times as fast
    if promising is None:
        return None
    goal.check_time(0.0)
    return _measure(case.with_code(), promising.step, clock, goal)


@dataclass(frozen=True, eq=False)
class Choice:
    """Measured error and cost of a scheme with a step or tolerance.

    `case` contains the scheme. It takes `steps` of at most `step` s and ends in the state `end`
    (nx,) with an error of `error` m. It costs `cost` instructions and `seconds` s of wall time.
    """

    case: Case
    step: float
    steps: int
    error: float
    end: Array
    cost: float
    seconds: float

    def time_loop(self) -> float:
        """Measure the wall time of the time loop [s]."""
        case = self.case.with_code()
        if not case.even or self.steps <= 2048:
            return min(case.run(self.step, energy_balance=False).seconds for _ in range(_REPEATS))
        return case.seconds_per_step(self.step, _REPEATS) * self.steps


def _measure(case: Case, step: float, price: Price, goal: AccuracyTarget) -> Choice:
    """Simulate a case once and measure the position error.

    `step` is the step [s] or rtol, and `price` the cost of steps and seconds. The error is infinite
    if the run fails. A sufficient choice becomes `goal.found` before its time is measured.
    """

    def run(**options: Any) -> Trajectory:
        return case.run(step, **options, time_limit=max(0.1, goal.deadline - time.perf_counter()))

    bare = {"energy_balance": False, "save_every": 10**9}
    first = run(**bare)
    error = distance(end_nodes(case.model, first), goal.nodes) if first.success else np.inf
    if error <= goal.wanted and not run().success:  # with its energy, as the user runs it
        error = np.inf
    steps, seconds = first.attempts, first.seconds
    cost = price.step * steps + price.second * seconds
    choice = Choice(case, step, steps, error, first.states[-1], cost, seconds)
    if error > goal.wanted:
        return choice
    goal.found = choice
    if price.second:
        seconds = min(seconds, *(run(**bare).seconds for _ in range(_REPEATS - 1)))
        goal.found = replace(choice, cost=price.step * steps + price.second * seconds)
    return goal.found


def _find_loosest(case: Case, price: Price, goal: AccuracyTarget, most: float) -> Choice | None:
    """Find about the largest rtol with sufficient accuracy.

    The error is at most `goal.wanted`. `price` is the cost of steps and seconds. Returns None if it
    costs `most` instructions or more.
    """
    best: Choice | None = None
    wanted, expected = goal.wanted, 0.0
    least = 1e-6 if isinstance(case.compiled, Single) else 1e-15
    rtol, tight, loose = 0.1 * wanted / extent(case.model), 0.0, 0.1
    for _ in range(MAX_ITERATIONS):
        rtol = min(max(rtol, least), 0.1)
        tried = replace(case, scheme=replace(case.scheme, rtol=rtol, atol=None))  # type: ignore[type-var]
        goal.check_time(expected)
        now = _measure(tried, case.t_end / GRID, price, goal)
        if now.error <= wanted:
            tight, best = rtol, now
        else:
            loose = rtol
            if rtol <= least or (best is None and np.isfinite(now.error) and now.cost >= most):
                break
        if loose <= 4 * tight or (best is now and now.error > wanted / 4):
            break
        ratio = float(np.clip(0.5 * wanted / max(now.error, 1e-300), 1e-3, 1e3))
        before, rtol = (
            rtol,
            rtol * ratio
            if tight < rtol * ratio < loose
            else float(np.sqrt(max(tight, 1e-16) * loose)),
        )
        expected = now.seconds * (before / rtol) ** (1 / case.scheme.order)
    return best


def _find_fewest(case: Case, price: Price, goal: AccuracyTarget, most: float) -> Choice | None:
    """Find about the smallest number of equal steps with sufficient accuracy.

    The steps are those of a case, and the error is at most `goal.wanted`. `price` is the cost of
    steps and seconds. Returns None if they cost `most` instructions or more.
    """
    wanted = goal.wanted
    limit = np.ceil(most / price.step) - 1 if price.step else np.inf
    steps = int(max(1, min(count_coarsest(case), limit)))  # the search goes downward from there
    low, best, each = 0, None, price.step / 1e8
    for _ in range(MAX_ITERATIONS):
        if steps > limit:
            return None
        goal.check_time(each * steps)
        now = _measure(case, case.t_end / steps, price, goal)
        each = now.seconds / max(now.steps, 1)
        if now.error <= wanted:
            best = now
        else:
            low = steps
            if now.cost >= most:
                return None
        if best is None:
            # extrapolation with the order of the scheme
            factor = (
                (now.error / wanted) ** (1 / case.scheme.order) if np.isfinite(now.error) else 2.0
            )
            steps = max(low + 1, int(np.ceil(low * float(np.clip(1.05 * factor, _CLOSE, 8.0)))))
        elif best.steps <= max(_CLOSE * low, low + 1):
            break
        else:
            middle = int(np.sqrt(low * best.steps)) if low else best.steps // 2
            steps = min(max(middle, low + 1), best.steps - 1)
    return best


def count_coarsest(case: Case, state: Array | None = None) -> int:
    """Compute a case's number of steps at the stability limit.

    The limit is the smaller one of those at the initial state and at `state` (nx,).
    """
    if case.scheme.implicit:
        return 8
    states = [case.state] if state is None else [case.state, state]
    limit = min(find_limit(case.model, case.scheme, x, parameters=case.parameters) for x in states)
    return max(1, int(np.ceil(case.t_end / limit))) if np.isfinite(limit) and limit > 0 else 1
