"""Singular linear systems, null spaces, and block decompositions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.util.casadi_tools import matrix_with_pattern
from tenscasadi.util.validate import Array, Indices

DENSE = 600  # unknowns up to which all eigenvalues are computed, by dense matrices
# eigenvalues of a matrix of unit diagonal below this belong to redundant rows
REGULARIZATION = 1e-10


def solve_semidefinite(A: Any, b: Any) -> Any:
    """Solve A x = b with a positive semidefinite A.

    Redundant rows are allowed if b is consistent. A is scaled to unit diagonal, and A + εI is
    factorized. Two refinements remove the effect of ε outside the null space.
    """
    diagonal = ca.diag(A)
    scale = 1 / ca.sqrt(diagonal + 1e-14 * ca.sum1(diagonal))  # a row of zeros stays zero
    rows, columns = A.sparsity().get_triplet()
    scaled = A * matrix_with_pattern(A.sparsity(), scale[rows] * scale[columns])
    target = b * scale
    shifted = scaled + REGULARIZATION * ca.DM.eye(A.shape[0])
    solve = _build_sx_solver(shifted) if isinstance(A, ca.SX) else _build_mx_solver(shifted)
    x = solve(target)
    for _ in range(2):
        x = x + solve(target - ca.mtimes(scaled, x))
    return x * scale


def semidefinite_inverse(S: Array) -> Array:
    """Invert K symmetric positive semidefinite matrices S (K, n, n).

    Singular matrices are scaled to unit diagonal and replaced by their pseudoinverse.
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


def fit_rotation(vectors: Array, others: Array) -> Array:
    """Find the rotation (…, 3, 3) that best fits vectors to others.

    It rotates vectors (n, 3) to others (…, n, 3) in the least-squares sense. Kabsch, Acta
    Crystallographica A32 (1976), 922.
    """
    left, _, right = np.linalg.svd(np.swapaxes(others, -1, -2) @ vectors)
    handed = np.ones(left.shape[:-1])
    handed[..., 2] = np.where(np.linalg.det(left @ right) < 0.0, -1.0, 1.0)
    return np.asarray((left * handed[..., None, :]) @ right)


def fit_velocities(places: Array, velocities: Array) -> tuple[Array, Array]:
    """Fit a mean and an angular velocity (…, 3) to node velocities.

    The velocities are (…, n, 3). The angular velocity is the least-squares one about the mean of
    the places (…, n, 3). Returns the mean velocity and the angular velocity.
    """
    arms = places - places.mean(axis=-2, keepdims=True)
    drift = velocities.mean(axis=-2)
    squares = np.swapaxes(arms, -1, -2) @ arms
    inertia = np.trace(squares, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - squares
    momentum = np.cross(arms, velocities - drift[..., None, :]).sum(axis=-2)
    spin = np.linalg.pinv(inertia, hermitian=True) @ momentum[..., None]
    return drift, np.asarray(spin[..., 0])


def null_space(A: Array, tolerance: float) -> Array:
    """Compute an orthonormal basis of a null space.

    The matrix A is (m, n) and the basis (n, n − rank). Singular values up to `tolerance` count as
    zero.
    """
    _, values, right = compute_block_svd(A)
    return np.asarray(right[int(np.sum(values > tolerance)) :].T)


def compute_block_svd(A: Array) -> tuple[Array, Array, Array]:
    """Compute the full singular value decomposition by blocks.

    Returns U, σ and Vᵀ. σ has as many entries as A has rows or columns, whichever is fewer. U is
    (m, m) and Vᵀ (n, n) for A (m, n).
    """
    m, n = A.shape
    if not A.size:
        return np.eye(m), np.zeros(0), np.eye(n)
    left, values, right = np.zeros((m, m)), np.zeros(min(m, n)), np.zeros((n, n))
    parts = [
        (rows, columns, np.linalg.svd(A[np.ix_(rows, columns)])) for rows, columns in find_blocks(A)
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


def find_blocks(A: Array) -> list[tuple[Indices, Indices]]:
    """Find the diagonal blocks of a matrix up to permutations.

    Each block is its rows and its columns. Rows and columns of zeros are omitted. A matrix of fewer
    than 50 rows or columns is one block.
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


def _build_mx_solver(A: Any) -> Callable[[Any], Any]:
    return lambda rhs: ca.solve(A, rhs, "ldl")


def _build_sx_solver(A: Any) -> Callable[[Any], Any]:
    D, LT, permutation = ca.ldl(A)
    return lambda rhs: ca.ldl_solve(rhs, D, LT, permutation)


class AndersonMixing:
    """Acceleration of a fixed-point iteration x ← x + f(x).

    The next step is that of a secant model of f from the last few steps (D. G. Anderson, J. ACM
    1965, 12, 547).
    """

    def __init__(self) -> None:
        self._last: tuple[Array, Array] | None = None
        self._pairs: list[tuple[Array, Array]] = []

    def step(self, change: Array) -> Array:
        """Compute the step of x from the change f(x) of the plain iteration."""
        step = change
        if self._last is not None:
            moved, before = self._last
            self._pairs = [*self._pairs[-2:], (moved, change - before)]
            steps, slopes = (np.stack(own, axis=-1) for own in zip(*self._pairs, strict=True))
            flat = slopes.reshape(-1, len(self._pairs))
            share = np.linalg.lstsq(flat, change.ravel(), rcond=None)[0]
            step = change - (steps + slopes) @ share
        self._last = step, change
        return step
