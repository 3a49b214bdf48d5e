"""Null space of a sparse matrix by orthogonal factorization.

SciPy has no sparse QR factorization. The dense matrix of 2000 bars, 12 006 × 13 998, alone takes 1.3 GB.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr
from scipy.sparse.csgraph import reverse_cuthill_mckee

from tenscasadi.util.validate import Array, Indices

_ROUNDING = 64 * float(np.finfo(float).eps)
_BLOCK_ROWS = 48  # rows eliminated together; times hardly differ from 24 to 96


def sparse_null_space(A: Any, tolerance: float) -> Array:
    """Compute an orthonormal null-space basis of a sparse matrix.

    Parameters
    ----------
    A : sparse array, shape (n, m)
        Matrix.
    tolerance : float
        Rows with a residual below this fraction of the longest row count as dependent.

    Returns
    -------
    ndarray, shape (k, m)
        Orthonormal basis, one vector per row.

    Notes
    -----
    Rows are ordered for a small bandwidth and eliminated in blocks. Each block transforms its
    active columns by a pivoted QR factorization, and drops those that its rows determine. Columns
    that are zero in all later rows are null vectors. The others are passed on to the next block.
    The rank is decided block by block, as in multifrontal QR factorizations [1]_.

    References
    ----------
    .. [1] T. A. Davis, Algorithm 915, SuiteSparseQR, ACM Transactions on Mathematical Software 38,
       2011, 8.
    """
    rows, columns = A.shape
    if not rows:
        return np.eye(columns)
    A, first, end = _reduce_bandwidth(A)
    scale = float(np.sqrt(A.multiply(A).sum(axis=1)).max(initial=0.0))
    passed_on, blocks, last = np.zeros((0, 0)), [], 0
    for start in range(0, rows, _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, rows)
        new = np.flatnonzero((first >= start) & (first < stop))
        last = max(last, stop, int(end[new].max(initial=0)))
        height, width = passed_on.shape
        R = np.zeros((last - start, width + len(new)))
        R[:height, :width] = passed_on
        R[:, width:] = A[start:last, new].toarray()
        free = split_spaces(R[: stop - start], tolerance * scale)[1]
        rest = R[stop - start :] @ free
        kept, null = split_spaces(rest, _ROUNDING * scale)
        blocks.append((new, free @ kept, free @ null))
        passed_on = rest @ kept
    alone = np.flatnonzero(first == rows)
    return _expand(alone, blocks, columns)


def _reduce_bandwidth(A: Any) -> tuple[Any, Indices, Indices]:
    """Order a matrix's rows for a small bandwidth.

    Returns the matrix A in this order. Also returns the first row and the end of the rows of each
    column.
    """
    A = sp.csr_array(A, copy=True)
    A.eliminate_zeros()
    pattern = sp.csr_array((np.ones(A.nnz), A.indices, A.indptr), shape=A.shape)
    order = reverse_cuthill_mckee(sp.csr_matrix(pattern @ pattern.T), symmetric_mode=True)
    A = sp.csc_array(A[order])
    A.sort_indices()
    met = np.flatnonzero(np.diff(A.indptr))
    first, end = np.full(A.shape[1], A.shape[0]), np.zeros(A.shape[1], dtype=int)
    first[met], end[met] = A.indices[A.indptr[met]], A.indices[A.indptr[met + 1] - 1] + 1
    return A, first, end


def split_spaces(R: Array, zero: float) -> tuple[Array, Array]:
    """Compute orthonormal bases of row space and null space of R, as columns.

    The decomposition is a pivoted QR factorization. Pivots up to `zero` count as zero.
    """
    if not R.size:
        return np.zeros((R.shape[1], 0)), np.eye(R.shape[1])
    Q, triangle, _ = qr(R.T, pivoting=True, check_finite=False)
    rank = int(np.count_nonzero(np.abs(triangle.diagonal()) > zero))
    return Q[:, :rank], Q[:, rank:]


def _expand(alone: Indices, blocks: list[tuple[Indices, Array, Array]], columns: int) -> Array:
    """Assemble the null vectors by backward recursion over the blocks.

    They are the rows of the result. A block has its column indices in A, and two matrices: those by
    which the vectors of the next block extend to these columns, and additional null vectors.
    `alone` are the zero columns of A, and `columns` is the number of all its columns.
    """
    begin = len(alone) + sum(null.shape[1] for _, _, null in blocks)
    basis = np.zeros((begin, columns))
    basis[np.arange(len(alone)), alone] = 1.0
    given = np.zeros((0, 0))
    for new, kept, null in reversed(blocks):
        begin -= null.shape[1]
        vectors = np.hstack([null, kept @ given])
        given, own = np.split(vectors, [len(vectors) - len(new)])
        basis[begin:, new] = own.T
    return basis
