"""Solvers of nonlinear programs: what they take and return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import Duals
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, format_value, positive_number, whole_number


class Solution(NamedTuple):
    """Result of a solver.

    w, and whether it is optimal; status: the solver's own word; iterations; multipliers: those of
    rows and of w's limits; last: where the solver stood when it gave up, which is not always its
    best.
    """

    w: Array
    success: bool
    status: str
    iterations: int
    multipliers: tuple[Array, Array] | None = None
    last: Array | None = None


class Outcome(NamedTuple):
    """The result of a method for a problem, before it is replayed; where there is no plan, its best.

    states (K + 1, nx), force_density (K or K + 1, α) and duration, s; objective: sum of the costs;
    success, status, iterations: the method's own word; duals: multipliers, None where no optimum
    was found; gap: m, how far states are from those of fine steps where an accuracy was asked for;
    why: what is to be said of a failure, "" after success; imposed: the rows that were, in words;
    time (K + 1,): the nodes of the mesh, s, None where they are those of the transcription; coarse:
    whether it is a failure only as its motion is less exact than was asked.
    """

    states: Array
    force_density: Array
    duration: float
    objective: float
    success: bool
    status: str
    iterations: int
    duals: Duals | None = None
    gap: float = 0.0
    why: str = ""
    imposed: str = ""
    time: Array | None = None
    coarse: bool = False


class NamedSolver(Value):
    """Solver that files know by its kind."""


class Solver(Protocol):
    """Anything that solves a program."""

    @property
    def tolerance(self) -> float:
        """Of scaled optimality and constraints."""

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """Return the solution; the best iterate with success False if the monitor stops it."""


def check_options(
    name: str, max_iterations: Any, tolerance: Any, verbose: Any, options: Any, example: str
) -> None:
    """Raise TypeError or ValueError, naming the field, for what every solver takes."""
    whole_number(f"{name}.max_iterations", max_iterations, 1)
    positive_number(f"{name}.tolerance", tolerance)
    if not isinstance(verbose, bool):
        raise TypeError(f"{name}.verbose is {format_value(verbose)}: give True or False")
    if not isinstance(options, Mapping) or not all(isinstance(option, str) for option in options):
        raise TypeError(
            f"{name}.options is {format_value(options)}: give a mapping of {name}'s option names, such as {example}"
        )
