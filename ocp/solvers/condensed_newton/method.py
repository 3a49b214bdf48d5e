"""Solver `CondensedNewton` and its options."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from ocp.solvers.base import NamedSolver, Solution
from ocp.solvers.condensed_newton.condensed_program import (
    CondensedProgram,
    Expansion,
    UndeterminedError,
)
from ocp.solvers.condensed_newton.interior_point import InteriorPoint
from ocp.solvers.condensed_newton.iterate import Linearization, evaluate, polish
from ocp.solvers.monitor import Monitor, Progress
from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.validate import NEGLIGIBLE, Boolean, Count, Positive

MAX_GROWTH = 1e8  # of unknowns with defects of one; more multiplies rounding errors as much
NOT_SETTLED = "unsettled"
SOLVED = ("optimal", "settled", "nearly settled", NOT_SETTLED)
REMARKS = {
    "nearly settled": "; the cost is nearly settled, a little less may be possible",
    NOT_SETTLED: "; the cost is not settled: it still fell, but slowly, and less is possible",
}
UNSTABLE, UNDETERMINED = "unstable", "undetermined"


@dataclass(frozen=True)
class CondensedNewton(NamedSolver, kind="CondensedNewton"):
    """Newton method in the controls: the defects eliminate the states.

    It solves the program of any transcription. Its cost grows linearly with the number of
    intervals, and more slowly with the number of bars than that of `Ipopt`. Unstable motions, such
    as those of an upright arm, amplify errors too much for the elimination: use `Ipopt` for them.

    Parameters
    ----------
    max_iterations : int
        Largest number of iterations.
    tolerance : float
        Tolerance of scaled optimality and constraints.
    verbose : bool
        Whether a line is printed for each iteration.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Notes
    -----
    States and bar multipliers are iterates, too. They satisfy the defect constraints only at
    convergence, so a smooth path is a good initial guess. Each iteration linearizes the defects
    about the iterates. An interior-point method with exact second derivatives takes a step of the
    controls, by projected conjugate gradients in a trust region, and the states follow to first
    order. The largest matrix that is factored has a row for each goal, and for each path constraint
    that is near its limit. Path constraints have slacks with barriers, so an initial guess may
    violate them.

    References
    ----------
    .. [1] R. H. Byrd, M. E. Hribar, J. Nocedal, SIAM Journal on Optimization 9, 1999, 877-900.
    .. [2] J. Albersmeyer, M. Diehl, SIAM Journal on Optimization 20, 2010, 1655-1684.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths({6: 0.95}), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=[ocp.Effort()])
    >>> ocp.solve(problem, ocp.Variational(20), ocp.CondensedNewton()).success
    True
    """

    max_iterations: Count = 200
    tolerance: Positive = 1e-6
    verbose: Boolean = False

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """Solve a nonlinear program.

        Parameters
        ----------
        program : Program
            The program.
        monitor : Monitor, optional
            Time limit and stop request of the search, which shows the progress. By default there
            is no limit.

        Returns
        -------
        Solution
            The solution, or the last iterate with the reason for the end.
        """
        unsolved = Solution(program.first, False, UNSTABLE, 0)
        with np.errstate(all="ignore"):
            try:
                of = CondensedProgram(program)
                u, s = program.first[of.u], program.first[of.s]
                # off points without derivatives, such as the center of an obstacle
                s = s + 1e-5 * np.random.default_rng(0).uniform(-1.0, 1.0, len(s))
                first = Expansion(of, u, s)
                if not first.growth() < MAX_GROWTH:
                    return unsolved
                of.keep_independent(first)
                search = InteriorPoint(of, u, s, self.tolerance)
            except UndeterminedError:
                return unsolved._replace(status=UNDETERMINED)
            except np.linalg.LinAlgError:
                return unsolved._replace(status="stuck")
            if monitor is None:
                monitor = Monitor()
                with monitor.catching_interrupts():
                    return self._finish(search, self._run(search, monitor))
            return self._finish(search, self._run(search, monitor))

    def _run(self, search: InteriorPoint, monitor: Monitor) -> str:
        """Iterate until the end, and return the status.

        `search` holds the iterate, which changes. The monitor can stop the iteration.
        """
        while True:
            if status := search.check_end():
                return status
            if search.iterations == self.max_iterations:
                return NOT_SETTLED if search.is_still(20, np.inf) else "iterations"
            point = search.point
            objective = point.cost * search.of.program.objective
            now = Progress(search.iterations, objective, point.worst)
            if status := monitor.follow(now, search.of.join(point.u, point.s)):
                return status
            if not search.advance():
                return "nearly settled" if search.is_still(5, 1e-2) else "stuck"
            if self.verbose:
                sys.stdout.write(search.describe() + "\n")

    def _finish(self, search: InteriorPoint, status: str) -> Solution:
        """Build the solution that satisfies all constraints nearby.

        It is near the last iterate of `search`. `status` is the reason why the iteration ended.
        """
        of, (point, _) = search.of, polish(search.of, search.point, 1e-11)
        goal_duals, path_duals, bound_duals = search.prices
        expansion = Expansion(of, point.u, point.s)
        expansion.weigh(goal_duals, path_duals, np.zeros(len(path_duals)))
        limits = np.zeros(len(of.u) + len(of.s))
        limits[of.u] = bound_duals
        success = point.worst <= NEGLIGIBLE and status in SOLVED
        w, duals = of.join(point.u, point.s), (expansion.duals, limits)
        correct = _Correction(of, self.tolerance)
        return Solution(w, success, status, search.iterations, duals, correct=correct)


class _Correction:
    """Search for the nearest point that satisfies shifted constraint bounds.

    Near an optimum, its cost exceeds the minimum by a term of second order. `of` is the program
    that was solved; its bounds are replaced. `tolerance` is the largest permitted violation. All
    corrections use the same linearization while it serves.
    """

    def __init__(self, of: CondensedProgram, tolerance: float) -> None:
        self._of, self._tolerance = of, tolerance
        self._known: Linearization | None = None

    def __call__(self, moved: Program, monitor: Monitor | None = None) -> Solution:
        """Correct the initial guess of `moved`, the program with these bounds."""
        of = self._of
        of.move_rows(moved)
        u, s = moved.first[of.u], moved.first[of.s]
        with np.errstate(all="ignore"):
            slack = of.path_bounds.inside(of.values(u, s)[3], 1e-12, 0.2)
            start = evaluate(of, u, s, slack)
            point, self._known = polish(of, start, NEGLIGIBLE, self._known)
        # rounding grows along unstable motions, and fine steps measure the rest
        met = point.worst <= self._tolerance
        return Solution(of.join(point.u, point.s), met, "corrected", 1, moved.multipliers)
