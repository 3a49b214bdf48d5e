"""Protocol and results of the solvers of nonlinear programs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import Duals
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array


class Solution(NamedTuple):
    """Result of a solver.

    Attributes
    ----------
    w : ndarray, shape (n,)
        Scaled unknowns: the optimum, or the best iterate.
    success : bool
        Whether w is optimal.
    status : str
        Return status of the solver.
    iterations : int
        Number of iterations.
    multipliers : tuple of ndarray or None
        Duals of the rows and of the limits of w.
    last : ndarray or None
        Last iterate.
    """

    w: Array
    success: bool
    status: str
    iterations: int
    multipliers: tuple[Array, Array] | None = None
    last: Array | None = None


class Outcome(NamedTuple):
    """Result of a method for a problem, before its replay.

    Attributes
    ----------
    states : ndarray, shape (K + 1, nx)
        States of the plan, or of the best iterate [m, m/s].
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Controls [N/m], or rest lengths [m].
    duration : float
        Duration [s].
    objective : float
        Sum of the costs.
    success, status, iterations
        As in `Solution`.
    duals : Duals or None
        Duals of an optimum.
    gap : float
        Distance of the states from those of fine steps, with `accuracy` [m].
    why : str
        Reason of a failure; "" after success.
    imposed : str
        Description of the imposed rows.
    time : ndarray, shape (K + 1,), or None
        Nodes of the mesh [s]; None if they are those of the transcription.
    coarse : bool
        Whether it fails only because the motion is less accurate than requested.
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


def find_best_iterate(program: Program, monitor: Monitor) -> Solution:
    """Build the solution of a solver that was abandoned.

    Relaxed programs have their further unknowns at the end.
    """
    count, w = monitor.iterate or (0, program.first)
    return Solution(w[: len(program.first)], False, monitor.status(), count)


class NamedSolver(Value):
    """Solver with a kind in files."""


class Solver(Protocol):
    """Protocol of solvers of programs."""

    @property
    def tolerance(self) -> float:
        """Tolerance of scaled optimality and constraints."""

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """Solve a program, until the monitor stops it."""
