"""Singular linear systems: one regularized inverse, null spaces, independent rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.util.casadi_tools import matrix_with_pattern
from tenscasadi.util.validate import Array, Indices

# on a system of unit diagonal: smaller eigenvalues are those of redundant rows
REGULARIZATION = 1e-10


def solve_semidefinite(A: Any, b: Any) -> Any:
    """Solve A x = b of CasADi with a symmetric positive semidefinite A.

    Redundant rows are allowed where b is consistent. The diagonal is scaled to one, the factored
    matrix is A + εI, and two refinements remove ε from all but the null space.
    """
    diagonal = ca.diag(A)
    scale = 1 / ca.sqrt(diagonal + 1e-14 * ca.sum1(diagonal))  # a row of zeros stays zero
    rows, columns = A.sparsity().get_triplet()
    scaled = A * matrix_with_pattern(A.sparsity(), scale[rows] * scale[columns])
    target = b * scale
    shifted = scaled + REGULARIZATION * ca.DM.eye(A.shape[0])
    solve = _unrolled_solver(shifted) if isinstance(A, ca.SX) else _solver(shifted)
    x = solve(target)
    for _ in range(2):
        x = x + solve(target - ca.mtimes(scaled, x))
    return x * scale


def semidefinite_inverse(S: Array) -> Array:
    """Invert symmetric positive semidefinite matrices (K, n, n).

    Where rows are redundant, the pseudoinverse of the matrix of unit diagonal.
    """
    diagonal = np.einsum("kii->ki", S)
    with np.errstate(all="ignore"):  # a matrix that is not finite gets no finite inverse
        scale = 1 / np.sqrt(diagonal + 1e-14 * diagonal.sum(axis=1, keepdims=True))
        scales = scale[:, :, None] * scale[:, None, :]
        unit = S * scales
        eye = np.eye(S.shape[1])
        inverse = np.linalg.inv(unit + REGULARIZATION * eye)
        singular = np.einsum("kii->ki", inverse).max(axis=1, initial=0.0) >= 1e8
        rough = inverse[~singular]
        for _ in range(2):
            inverse[~singular] += rough @ (eye - unit[~singular] @ inverse[~singular])
        inverse[singular] = np.linalg.pinv(unit[singular], rcond=REGULARIZATION, hermitian=True)
        return np.asarray(inverse * scales)


def null_space(A: Array, tolerance: float) -> Array:
    """Compute an orthonormal basis (n, n − rank) of the null space of A (m, n).

    Singular values up to `tolerance` count as zero.
    """
    _, values, right = compute_block_svd(A)
    return np.asarray(right[int(np.sum(values > tolerance)) :].T)


def independent_rows(A: Array, tolerance: float) -> Array:
    """Find orthonormal combinations (rank, m) of the rows of A (m, n) that are independent.

    Singular values up to `tolerance` times the largest count as zero. Where A is not finite or
    empty, all rows count.
    """
    if not np.all(np.isfinite(A)) or not A.size:
        return np.eye(len(A))
    left, values, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(left[:, values > tolerance * values.max(initial=0.0)].T)


def compute_block_svd(A: Array) -> tuple[Array, Array, Array]:
    """Compute U, σ and Vᵀ, of full size, part by part.

    σ is padded with zeros to the number of rows or columns, whichever is smaller.
    """
    m, n = A.shape
    if not A.size:
        return np.eye(m), np.zeros(0), np.eye(n)
    left, values, right = np.zeros((m, m)), np.zeros(min(m, n)), np.zeros((n, n))
    parts = [
        (rows, columns, np.linalg.svd(A[np.ix_(rows, columns)]))
        for rows, columns in separate_parts(A)
    ]
    found = np.concatenate([part[1] for _, _, part in parts]) if parts else np.zeros(0)
    rank = np.argsort(np.argsort(-found, kind="stable"), kind="stable")  # place of each value
    values[rank] = found
    begin, spare = 0, [len(found), len(found)]
    for rows, columns, (U, own, Vt) in parts:
        place, begin = rank[begin : begin + len(own)], begin + len(own)
        for whole, lines, vectors, k in ((left, rows, U, 0), (right, columns, Vt.T, 1)):
            more = vectors.shape[1] - len(own)
            whole[np.ix_(lines, np.append(place, np.arange(spare[k], spare[k] + more)))] = vectors
            spare[k] += more
    for whole, k in ((left, 0), (right, 1)):  # rows and columns of zeros
        empty = np.flatnonzero(~whole.any(axis=1))
        whole[empty, spare[k] + np.arange(len(empty))] = 1.0
    return left, values, right.T


def separate_parts(A: Array) -> list[tuple[Indices, Indices]]:
    """Find the rows and columns of the parts of a matrix that share neither.

    Rows and columns of zeros are left out. A matrix of fewer than 50 rows or columns is one part.
    """
    m, n = A.shape
    if min(m, n) < 50:  # a dense decomposition costs less than the search
        return [(np.arange(m), np.arange(n))] if A.size else []
    row, column = np.nonzero(A)
    links = sp.coo_array((np.ones(len(row)), (row, m + column)), shape=(m + n, m + n))
    _, label = sp.csgraph.connected_components(links, directed=False)
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    return [(group[group < m], group[group >= m] - m) for group in groups if len(group) > 1]


def _solver(A: Any) -> Callable[[Any], Any]:
    return lambda rhs: ca.solve(A, rhs, "ldl")


def _unrolled_solver(A: Any) -> Callable[[Any], Any]:
    D, LT, permutation = ca.ldl(A)
    return lambda rhs: ca.ldl_solve(rhs, D, LT, permutation)
