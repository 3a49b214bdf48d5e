"""Deferred correction of phased plans on the compliant ground.

The program of the phases assumes rigid contact. The replay has penalty contact, which is compliant
and stores elastic energy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ocp.results.refinement import CAUTION
from ocp.results.result import Replayed
from ocp.solvers.base import Solution
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Monitor
from ocp.targets.target import Target
from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.validate import Array

MOST_ROUNDS = 8
MOST_LEFT = 0.7  # ratio of successive errors above which a round counts as ineffective

Read = Callable[
    [Array], tuple[Array, Array, Array]
]  # w → time (K + 1,), states (K + 1, nx), force densities (K, α)
Replay = Callable[[Array, Array, Array], Replayed]  # of the values that `Read` returns


def correct(
    program: Program,
    harder: float,
    replay: Replay,
    solver: Ipopt,
    solution: Solution,
    read: Read,
    targets: Sequence[Target],
    tolerance: float,
    monitor: Monitor,
) -> Solution:
    """Correct a solution until its replay meets the goals.

    Each round shifts the goals by the residuals of the replay, and solves again. If the error
    hardly decreases, contact nodes slip in the replay. The minimum normal reaction is then
    increased by `harder`, relative to a typical reaction. Rounds end at a fraction of the tolerance
    [m], where velocities count as velocity × duration. Only bounds of constraints change, so the
    solver is built once. `targets` are the goals of the phases. Returns the solution with the
    smallest error. `read` converts decision variables to the arguments of `replay`.
    """
    again, best = None, solution
    least, residuals = _measure_replay(replay, *read(solution.w), targets)
    pressing = np.array([name.startswith("reaction") for name in program.names])
    shift, missed, pressed, iterations = np.zeros_like(residuals), least, 0.0, solution.iterations
    for _ in range(MOST_ROUNDS):
        if not CAUTION * tolerance < missed < np.inf or not program.rows("end"):
            break
        shift = shift + residuals
        lower, upper = program.lower.copy(), program.upper.copy()
        for rows in program.rows("dependent"):  # the replay judges them
            lower[rows], upper[rows] = -np.inf, np.inf
        for rows, own in zip(
            program.rows("end"),
            np.split(shift, np.cumsum([part.count for part in targets if part.count])[:-1]),
            strict=True,
        ):
            lower[rows] -= own
            upper[rows] -= own
        lower[pressing] += pressed
        moved = replace(
            program, lower=lower, upper=upper, first=solution.w, multipliers=solution.multipliers
        )
        again = again or replace(solver, warm_start=True).build(moved)
        solution = again(moved, monitor)
        iterations += solution.iterations
        if not solution.success:
            break
        before = missed
        missed, residuals = _measure_replay(replay, *read(solution.w), targets)
        if missed < least:
            best, least = solution, missed
        if missed > MOST_LEFT * before:
            pressed += harder
    return best._replace(iterations=iterations)


def _measure_replay(
    replay: Replay, time: Array, states: Array, gamma: Array, targets: Sequence[Target]
) -> tuple[float, Array]:
    """Replay a plan, and compute the goal residuals at the phase ends.

    The plan has mesh times (K + 1,) [s], states (K + 1, nx) and force densities `gamma` (K, α).
    `targets` are the goals of the phases. Returns the largest residual [m], and the residuals of
    all goals. Velocities count as velocity × duration. The largest residual is inf if the replay
    diverges or cannot be tracked.
    """
    count = len(gamma) // len(targets)
    found = replay(time, states, gamma)
    if found.failure:
        return np.inf, np.zeros(0)
    motion = found.motions[-1]
    ends = [
        np.array([np.interp(time[k * count], motion.time, column) for column in motion.states.T])
        for k in range(1, len(targets) + 1)
    ]
    sizes = [
        np.abs(part.misfit(end).full().ravel())
        * [time[-1] if unit == "m/s" else 1.0 for unit in part.units]
        for part, end in zip(targets, ends, strict=True)
    ]
    rows = [part.rows(end).full().ravel() for part, end in zip(targets, ends, strict=True)]
    return float(np.concatenate(sizes).max(initial=0.0)), np.concatenate(rows)
