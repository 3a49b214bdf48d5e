"""A problem that passed the checks, ready for a method."""

from __future__ import annotations

from typing import NamedTuple

from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.solver import Sampling
from ocp.search.presolve import check_end, check_groups, check_start
from ocp.solvers.base import Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.monitor import Monitor
from ocp.targets.find_target import find_target
from ocp.targets.target import Target
from ocp.transcription.mesh import Profile

MOST_STARTS = 1000  # of a multistart
Method = Solver | CondensedNewton | Sampling


class Task(NamedTuple):
    """A problem that passed the checks, where its goals lead, and how long a method may take.

    target, scales: None for problems with phases, each of which has its own. tolerance: m, that the
    replay may end from the goals. monitor: time limit, stop request and progress.
    """

    problem: Problem
    target: Target | None
    scales: Scales | None
    tolerance: float
    monitor: Monitor


def prepare(
    problem: Problem, control: Profile, tolerance: float, monitor: Monitor | None = None
) -> Task:
    """Find where the goals lead. Raises ValueError, InfeasibleGoalError for what has no solution."""
    check_groups(problem, control)
    monitor = Monitor() if monitor is None else monitor
    if problem.phases:
        return Task(problem, None, None, tolerance, monitor)
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    if not problem.free_start:
        check_start(problem)
    check_end(problem, target)
    return Task(problem, target, scales, tolerance, monitor)
