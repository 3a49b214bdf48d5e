"""Solution of linear, quadratic and semidefinite programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import clarabel
import numpy as np
import scipy.sparse as sp

from tenscasadi.util.validate import Array

_FACTORIZATION = "qdldl"  # "auto" takes 1.7 times longer for sections of 930 members, 5 load cases
_ACCURATE = ("Solved", "AlmostSolved")
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
_UNBOUNDED = ("DualInfeasible", "AlmostDualInfeasible")


class LinearRows(NamedTuple):
    """Linear constraints with coefficients A and right-hand sides b.

    A x = b or A x ≤ b, or b − A x is the scaled triangle of a semidefinite matrix.

    Attributes
    ----------
    A : sparse array (m, n)
        Coefficients.
    b : ndarray (m,)
        Right-hand sides.
    """

    A: Any
    b: Array


class ConicSolution(NamedTuple):
    """Solution of a linear, quadratic or semidefinite program.

    Attributes
    ----------
    x : ndarray (n,)
        Unknowns; the last iterate if there is no solution.
    status : str
        "solved", "infeasible", "unbounded" or "failed".
    duals : ndarray (rows,)
        Multipliers of all constraints: equal, below, then semidefinite.
    gap : float
        Bound of the relative distance from the optimum, where it exceeds that of the solver.
    """

    x: Array
    status: str
    duals: Array
    gap: float = 0.0


def solve_conic(
    cost: Array,
    equal: LinearRows,
    below: LinearRows,
    quadratic: Any = None,
    semidefinite: Sequence[LinearRows] = (),
    tolerance: float = 1e-10,
) -> ConicSolution:
    """Solve a linear, quadratic or semidefinite program.

    Minimize ½ xᵀ P x + costᵀ x under linear and semidefinite constraints.

    Parameters
    ----------
    cost : ndarray, shape (n,)
        Linear cost.
    equal, below : LinearRows
        Constraints A x = b, and A x ≤ b.
    quadratic : sparse array, shape (n, n), optional
        P, symmetric positive semidefinite.
    semidefinite : sequence of LinearRows
        Constraints that b − A x is the scaled upper triangle of a positive semidefinite matrix, see
        `scaled_triangle`.
    tolerance : float
        Relative tolerance of residuals and of the duality gap.

    Returns
    -------
    ConicSolution
        Unknowns and status.
    """
    count = len(cost)
    parts = [equal, below, *semidefinite]
    A = sp.vstack([sp.csc_array(part.A) for part in parts], format="csc")
    b = np.concatenate([part.b for part in parts])
    cones = [clarabel.ZeroConeT(len(equal.b)), clarabel.NonnegativeConeT(len(below.b))]
    cones += [clarabel.PSDTriangleConeT(_order(len(part.b))) for part in semidefinite]
    kept = [cone for cone, part in zip(cones, parts, strict=True) if len(part.b)]
    P = sp.csc_array((count, count)) if quadratic is None else sp.triu(quadratic, format="csc")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = _FACTORIZATION if count else "auto"  # it cannot be empty
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    solution = clarabel.DefaultSolver(
        sp.csc_matrix(P), cost, sp.csc_matrix(A), b, kept, settings
    ).solve()
    status = _status(str(solution.status))
    return ConicSolution(np.array(solution.x), status, np.array(solution.z))


def scaled_triangle(matrix: Array) -> Array:
    """Stack the scaled upper triangle of a symmetric matrix.

    The matrix is (k, k). The k (k + 1) / 2 entries are ordered by columns. Those off the diagonal
    are multiplied by √2.
    """
    rows, columns = np.tril_indices(len(matrix))  # of the transpose: column by column
    return np.asarray(matrix[columns, rows] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def unscaled_matrix(entries: Array) -> Array:
    """Build the symmetric matrix from its scaled upper triangle.

    `entries` are those of `scaled_triangle`, of which it is the inverse.
    """
    count = _order(len(entries))
    matrix = np.zeros((count, count))
    columns, rows = np.tril_indices(count)
    matrix[rows, columns] = matrix[columns, rows] = entries * np.where(
        rows == columns, 1.0, np.sqrt(0.5)
    )
    return matrix


def _order(entries: int) -> int:
    return int(np.rint((np.sqrt(8 * entries + 1) - 1) / 2))


def _status(text: str) -> str:
    for status, names in (
        ("solved", _ACCURATE),
        ("infeasible", _INFEASIBLE),
        ("unbounded", _UNBOUNDED),
    ):
        if text in names:
            return status
    return "failed"
