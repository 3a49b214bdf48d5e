"""Sparse matrices in CasADi and SciPy, and array Functions."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import reduce
from operator import matmul
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.util.validate import Array


def call_as_sx(
    large: bool, function: Callable[..., tuple[Any, ...]], *arguments: Any
) -> tuple[Any, ...]:
    """Call a function on scalar expressions (SX), unless `large`.

    MX arguments then become one call of an SX Function, which has fewer instructions.
    """
    if large or not any(isinstance(argument, ca.MX) for argument in arguments):
        return function(*arguments)
    inputs = [ca.MX(argument) for argument in arguments]
    symbols = [ca.SX.sym(f"a{k}", value.sparsity()) for k, value in enumerate(inputs)]
    return tuple(
        ca.Function("scalar", symbols, ca.cse([ca.SX(value) for value in function(*symbols)])).call(
            inputs
        )
    )


def symbol_kind(function: ca.Function) -> Any:
    """Return CasADi's SX for a Function of scalar code, else MX."""
    return ca.SX if function.is_a("SXFunction") else ca.MX


def is_expression(value: Any) -> bool:
    """Return whether a value is a CasADi matrix."""
    return isinstance(value, (ca.SX, ca.MX, ca.DM))


def product(*factors: Any) -> Any:
    """Multiply sparse matrices of CasADi or SciPy.

    The result is a CasADi matrix if a factor is one. Otherwise it is a SciPy matrix without
    entries at rounding level.
    """
    if not any(is_expression(factor) for factor in factors):
        return drop_rounding(reduce(matmul, factors))
    return reduce(ca.mtimes, map(sparse, factors))


def sparse(matrix: Any) -> Any:
    """Convert a matrix to a sparse CasADi matrix."""
    if is_expression(matrix):
        return matrix
    csc = matrix.tocsc() if sp.issparse(matrix) else sp.csc_array(matrix)
    csc = csc if csc.has_sorted_indices else csc.sorted_indices()
    rows, columns = csc.shape
    return ca.DM(ca.Sparsity(rows, columns, csc.indptr.tolist(), csc.indices.tolist()), csc.data)


def constant_row(values: Any) -> Any:
    """Convert constants `values` (k,) to a CasADi row (1×k).

    Equal constants become 1×1. Expressions are returned unchanged.
    """
    if is_expression(values):
        return values
    return ca.DM(values[0]) if len(values) and np.ptp(values) == 0 else ca.DM(values).T


def scale_and_multiply(Z: Any, weights: Any, C: Any) -> Any:
    """Compute Z ŵ C (3×n) with the diagonal matrix ŵ.

    Z is 3×k, `weights` are w (1×k), and C (k×n) is constant.
    """
    constant = sparse(C)
    if not isinstance(Z, ca.MX):
        return ca.mtimes(Z * ca.repmat(weights, 3, 1), constant)
    # in vector operations one pass over C costs less than three over Z
    rows, _ = constant.sparsity().get_triplet()
    return ca.mtimes(
        Z,
        matrix_with_pattern(
            constant.sparsity(), ca.vec(weights.T[rows]) * ca.DM(constant.nonzeros())
        ),
    )


def column_norms(vectors: Any) -> Any:
    """Compute the norms (m,) of the columns of 3×m vectors."""
    return ca.sqrt(ca.sum1(vectors * vectors)).T


def matrix_with_pattern(sparsity: ca.Sparsity, values: Any) -> Any:
    """Build a matrix from its sparsity and its nonzeros, `values` (nnz).

    It has the CasADi type of the nonzeros.
    """
    values = ca.densify(values)
    kind: Any = type(values) if is_expression(values) else ca.DM
    return kind(sparsity, values)


def hermite_cubic(
    left: Any, left_slope: Any, right: Any, right_slope: Any, length: Any, share: Any
) -> Any:
    """Evaluate a cubic Hermite interpolant.

    It has the values `left` and `right` at the ends of an interval of the given length, and there
    the derivatives `left_slope` and `right_slope`. `share` is the fraction of the interval at which
    it is evaluated.

    Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, (II.6.7).
    """
    s = share
    return (
        (1 + 2 * s) * (1 - s) ** 2 * left
        + s**2 * (3 - 2 * s) * right
        + length * s * (1 - s) * ((1 - s) * left_slope - s * right_slope)
    )


def drop_rounding(matrix: Any) -> sp.csr_array:
    """Remove entries at rounding level from a sparse matrix.

    They are below 1e-14 of the largest entry.
    """
    result = sp.csr_array(matrix)
    if result.nnz:
        result.data[abs(result.data) < 1e-14 * abs(result.data).max()] = 0
        result.eliminate_zeros()
    return result


def number_nonzeros(matrix: Any) -> sp.csr_array:
    """Replace the nonzeros of a CasADi matrix by 1, 2, 3, ….

    The result is a SciPy matrix. A SciPy matrix keeps its values.
    """
    if not is_expression(matrix):
        return sp.csr_array(matrix)
    row, column = matrix.sparsity().get_triplet()
    return sp.csr_array((np.arange(1, len(row) + 1), (row, column)), shape=matrix.shape)


def entries_at(matrix: Any, rows: Any, columns: Any) -> Any:
    """Select entries of a sparse matrix as a CasADi column.

    Entry k is at (rows[k], columns[k]). Entries that are not stored are 0.
    """
    found = np.asarray(number_nonzeros(matrix)[rows, columns]).ravel()
    if not is_expression(matrix):
        return ca.DM(found)
    return ca.vertcat(0, matrix.nz[:])[found.tolist()]


def multiply_rows(matrix: Any, one: Any, other: Any) -> Any:
    """Multiply rows of a sparse matrix entry by entry.

    Row `one[k]` times row `other[k]` is row k of the sparse CasADi result.
    """
    index = number_nonzeros(matrix)
    if not is_expression(matrix):
        return sparse(index[one, :].multiply(index[other, :]))
    both = sp.csc_array(index[one, :].multiply(index[other, :]))
    both.sort_indices()
    if not both.nnz:
        return type(matrix)(*both.shape)
    row, column = both.indices, np.repeat(np.arange(both.shape[1]), np.diff(both.indptr))
    factors = [
        matrix.nz[:][(np.asarray(index[np.asarray(rows)[row], column]).ravel() - 1).tolist()]
        for rows in (one, other)
    ]
    pattern = ca.Sparsity(both.shape[0], both.shape[1], both.indptr.tolist(), both.indices.tolist())
    return matrix_with_pattern(pattern, factors[0] * factors[1])


def diagonal_row(matrix: Any) -> Any:
    """Return the diagonal of a matrix as a CasADi row.

    See `constant_row`.
    """
    return ca.diag(matrix).T if is_expression(matrix) else constant_row(matrix.diagonal())


def is_diagonal(matrix: Any) -> bool:
    """Return whether all stored entries are on the diagonal."""
    if is_expression(matrix):
        return bool(matrix.sparsity().is_diag())
    coo = sp.coo_array(matrix)
    return bool(np.all(coo.row == coo.col))


def block_inverse(M: sp.csr_array, free: Any) -> sp.csr_array:
    """Invert M (n×n) on the free coordinates, block by block.

    `free` (n,) flags these coordinates. Other entries are zero.
    """
    n = M.shape[0]
    index = np.flatnonzero(free)
    if not len(index):
        return sp.csr_array((n, n))
    inner = sp.csr_array(M)[index][:, index].tocoo()
    inner.sum_duplicates()
    _, label = sp.csgraph.connected_components(inner, directed=False)
    order, sizes = np.argsort(label, kind="stable"), np.bincount(label)
    first = np.cumsum(sizes) - sizes
    place = np.empty(len(index), dtype=np.intp)  # in the block
    place[order] = np.arange(len(index)) - first[label[order]]
    rows, columns, data = [], [], []
    for size in np.unique(sizes):
        blocks, inside = np.flatnonzero(sizes == size), sizes[label[inner.row]] == size
        row, column, number = inner.row[inside], inner.col[inside], np.cumsum(sizes == size) - 1
        dense = np.zeros((len(blocks), size, size))
        dense[number[label[row]], place[row], place[column]] = inner.data[inside]
        inverse = np.linalg.inv(dense)
        nodes = index[order[first[blocks, None] + np.arange(size)]]
        rows.append(np.repeat(nodes, size, axis=1).ravel())
        columns.append(np.tile(nodes, size).ravel())
        data.append(((inverse + inverse.transpose(0, 2, 1)) / 2).ravel())
    return sp.csr_array(
        (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    )


class ArrayFunction:
    """CasADi Function that takes and returns NumPy arrays without copies.

    Copies take longer than small functions. The memory of each argument holds the input column by
    column. Results are an array (columns, rows) for each dense output, and the nonzeros of each
    sparse one.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer: Any
        self._buffer, self._evaluate = function.buffer()
        self._lock = threading.Lock()  # threads share the functions that a model keeps
        self._shapes = [
            (function.size2_out(k), function.size1_out(k))
            if function.sparsity_out(k).is_dense()
            else (function.nnz_out(k),)
            for k in range(function.n_out())
        ]

    def __call__(self, *inputs: Array) -> list[Array]:
        """Evaluate the Function.

        Raises RuntimeError if it fails.
        """
        arrays = [np.ascontiguousarray(value, dtype=float) for value in inputs]
        results = [np.empty(shape) for shape in self._shapes]
        with self._lock:
            for k, array in enumerate(arrays):
                if array.size:
                    self._buffer.set_arg(k, array.data)
            for k, result in enumerate(results):
                if result.size:
                    self._buffer.set_res(k, result.data)
            self._evaluate()
            if self._buffer.ret():
                raise RuntimeError("CasADi failed to evaluate a function")
        return results

    def stats(self) -> dict[str, Any]:
        """Return the statistics of a solver's last call."""
        return dict(self._buffer.stats())


def generate_code(generator: ca.CodeGenerator, name: str) -> dict[str, str]:
    """Generate C code and header, by file name.

    `name` is that of the files, without ending.
    """
    with TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        code, header = (
            Path(folder, f"{name}.{suffix}").read_text(encoding="utf-8") for suffix in "ch"
        )
    return {f"{name}.c": unroll_products(code), f"{name}.h": header}


def unroll_products(code: str) -> str:
    """Replace CasADi's product of a dense and a sparse matrix, if the code has it.

    It adds four columns a pass, with fewer loads and stores and the same rounding.
    """
    begin = code.find("void casadi_mtimes_dense_sparse(")
    return code if begin < 0 else code[:begin] + _PRODUCT + code[code.index("\n}\n", begin) + 3 :]


_PRODUCT = """void casadi_mtimes_dense_sparse(const casadi_real* x, casadi_int nrow_x,
    const casadi_real* y, const casadi_int* sp_y, casadi_real* z) {
  const casadi_int *colind = sp_y + 2, *row = colind + sp_y[1] + 1;
  casadi_int i, j, k;
  for (j = 0; j < sp_y[1]; ++j, z += nrow_x) {
    for (k = colind[j]; k + 4 <= colind[j + 1]; k += 4) {
      const casadi_real *x0 = x + row[k] * nrow_x, *x1 = x + row[k + 1] * nrow_x;
      const casadi_real *x2 = x + row[k + 2] * nrow_x, *x3 = x + row[k + 3] * nrow_x;
      const casadi_real y0 = y[k], y1 = y[k + 1], y2 = y[k + 2], y3 = y[k + 3];
      for (i = 0; i < nrow_x; ++i) z[i] = z[i] + x0[i] * y0 + x1[i] * y1 + x2[i] * y2 + x3[i] * y3;
    }
    for (; k < colind[j + 1]; ++k) {
      const casadi_real* x0 = x + row[k] * nrow_x;
      for (i = 0; i < nrow_x; ++i) z[i] += x0[i] * y[k];
    }
  }
}
"""
