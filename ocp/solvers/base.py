"""Interface and results of the solvers of nonlinear programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import Duals
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array


class Solution(NamedTuple):
    """Result of a solver of nonlinear programs.

    Attributes
    ----------
    w : ndarray, shape (n,)
        Scaled decision variables: the optimum, or the best iterate.
    success : bool
        Whether w is optimal.
    status : str
        Return status of the solver.
    iterations : int
        Number of iterations.
    multipliers : tuple of ndarray or None
        Lagrange multipliers of the constraints, and of the bounds on w.
    last : ndarray or None
        Last iterate.
    correct : callable or None
        Function of a `Program` that differs from the solved one only in row limits, initial guess
        and duals, and of a `Monitor`. It returns the solution nearby. None: solve it again.
    """

    w: Array
    success: bool
    status: str
    iterations: int
    multipliers: tuple[Array, Array] | None = None
    last: Array | None = None
    correct: Callable[[Program, Monitor | None], Solution] | None = None


class Outcome(NamedTuple):
    """Result of a planning method, before its replay.

    Attributes
    ----------
    states : ndarray, shape (K + 1, nx)
        States of the plan, or of the best iterate [m, m/s].
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Controls [N/m], or rest lengths [m].
    duration : float
        Duration [s].
    objective : float
        Sum of the costs; NaN if none was computed.
    success, status, iterations
        As in `Solution`.
    duals : Duals or None
        Duals of an optimum.
    gap : float
        Distance of the states from an integration in fine steps [m], if `accuracy` is given.
    why : str
        Reason of a failure; "" after success.
    imposed : str
        Description of the goal constraints that were imposed.
    time : ndarray, shape (K + 1,), or None
        Mesh points [s]; None if they are those of the transcription.
    coarse : bool
        Whether it fails only because the states are less accurate than requested.
    finer : callable or None
        Function that returns the same motion with rest lengths at the most times. In between, rest
        lengths are linear, which makes elastic strings vibrate. None if no other motion is known.
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
    finer: Callable[[], Outcome] | None = None


def find_best_iterate(program: Program, monitor: Monitor) -> Solution:
    """Build the result of a solver that was stopped early.

    It is the best iterate that `monitor` has stored, or the initial guess of the program.
    Relaxation variables, which follow the variables of the program, are removed.
    """
    count, w = monitor.iterate or (0, program.first)
    return Solution(w[: len(program.first)], False, monitor.status(), count)


class NamedSolver(Value):
    """Base class of solvers with a name in files."""


class Solver(Protocol):
    """Interface of solvers of nonlinear programs."""

    @property
    def tolerance(self) -> float:
        """Tolerance of scaled optimality and constraints."""

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """Solve a nonlinear program, until the monitor stops it."""
