"""Deferred correction of the discretization error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.solvers.base import Solution, Solver
from ocp.solvers.monitor import Monitor
from ocp.transcription.fine_steps import Measure, MotionResidual
from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.linear_algebra import AndersonMixing
from tenscasadi.util.validate import Array

TOO_COARSE = (
    "too coarse: corrections end {:.2g} m from fine steps, not {:.2g} m: give more intervals"
)


class Corrected(NamedTuple):
    """Result of deferred correction.

    Attributes
    ----------
    solution : Solution
        Solution with the smallest error.
    states : ndarray or None
        States (K + 1, nx) from an integration in fine steps under its controls; None if they are
        too far from the planned ones, or violate limits.
    error : float
        Largest distance of its states from those [m]; velocities count in m per duration.
    """

    solution: Solution
    states: Array | None
    error: float


def solve_corrected(
    program: Program,
    solver: Solver,
    measure: Measure,
    accuracy: float,
    monitor: Monitor | None = None,
) -> Corrected:
    """Solve a nonlinear program with deferred correction.

    `measure` computes the discretization residual. Rounds end once the error of the states [m] is
    at most `accuracy`, and the states of fine steps satisfy the limits. The discretization residual
    shifts the bounds of the constraints, and the program is solved again (Stetter, Numer. Math.
    1978, 29, 425). Only bounds change, so nothing is built again. Each round leaves a fraction of
    the residual that is about the relative error of the discretization, or less: the shifts
    extrapolate those before. Costs keep the error of the discretization, so the plan is optimal
    only up to it.
    """
    most, left = 20, 0.7  # rounds; a round that leaves a larger share of the residual is the last
    solution = solver.solve(program, monitor)
    best, last, iterations = Corrected(solution, None, np.inf), np.inf, solution.iterations
    correct = solution.correct or solver.solve
    if not solution.success:
        return best
    rest: MotionResidual | None = None
    mixing = AndersonMixing()
    for done in range(most + 1):
        rest = measure(solution.w, rest)
        # along unstable motions, fine steps in open loop do not stay near the plan
        states = rest.states if rest.error <= accuracy and rest.kept else None
        # the first solution has the full error of the discretization, and a round costs little
        met = bool(done) and states is not None
        if met or rest.error < best.error:
            solution = solution._replace(status=best.solution.status, iterations=iterations)
            best = Corrected(solution, states, rest.error)
        late = monitor is not None and bool(monitor.status())
        if met or late or done == most or not rest.shift.size < left * last:
            break
        last, shift = rest.shift.size, mixing.step(rest.shift.bounds)
        program = program.shift_rows(shift, solution.w, solution.multipliers)
        solution = correct(program, monitor)
        iterations += solution.iterations
        if not solution.success:
            break
    return best
