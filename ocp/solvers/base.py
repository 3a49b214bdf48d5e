"""Solvers of nonlinear programs: what they take and return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.validate import Array, positive_number, shown, whole_number


class Solution(NamedTuple):
    """Result of a solver.

    w, and whether it is optimal; status: the solver's own word; iterations; multipliers: those of rows and of w's limits; last: where the
    solver stood when it gave up, which is not always its best.
    """

    w: Array
    success: bool
    status: str
    iterations: int
    multipliers: tuple[Array, Array] | None = None
    last: Array | None = None


class Solver(Protocol):
    """Anything that solves a program."""

    @property
    def tolerance(self) -> float:
        """Of scaled optimality and constraints."""

    def solve(self, program: Program) -> Solution:
        """Return the solution; where there is none, the best iterate with success False."""


def check_options(name: str, max_iterations: Any, tolerance: Any, verbose: Any, options: Any, example: str) -> None:
    """Raise TypeError or ValueError, naming the field, for what every solver takes."""
    whole_number(f"{name}.max_iterations", max_iterations, 1)
    positive_number(f"{name}.tolerance", tolerance)
    if not isinstance(verbose, bool):
        raise TypeError(f"{name}.verbose is {shown(verbose)}: give True or False")
    if not isinstance(options, Mapping) or not all(isinstance(option, str) for option in options):
        raise TypeError(f"{name}.options is {shown(options)}: give a mapping of {name}'s option names, such as {example}")
