"""Sparse matrices and small linear systems in CasADi."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
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
    """Return `function` of the arguments, unless `large` as one call of an SX Function where these are MX: scalar code is shorter."""
    if large or not any(isinstance(argument, ca.MX) for argument in arguments):
        return function(*arguments)
    inputs = [ca.MX(argument) for argument in arguments]
    symbols = [ca.SX.sym(f"a{k}", value.sparsity()) for k, value in enumerate(inputs)]
    return tuple(
        ca.Function("scalar", symbols, ca.cse([ca.SX(value) for value in function(*symbols)])).call(
            inputs
        )
    )


def is_expression(value: Any) -> bool:
    """Say whether `value` is CasADi's, not an array."""
    return isinstance(value, (ca.SX, ca.MX, ca.DM))


def product(*factors: Any) -> Any:
    """Return the product of sparse matrices: SciPy's without entries that are rounding, CasADi's where one factor is."""
    if not any(is_expression(factor) for factor in factors):
        return drop_rounding(reduce(matmul, factors))
    return reduce(ca.mtimes, map(sparse, factors))


def sparse(matrix: Any) -> Any:
    """Return a matrix of SciPy or NumPy as a sparse one of CasADi; what is CasADi's as it is."""
    if is_expression(matrix):
        return matrix
    csc = matrix.tocsc() if sp.issparse(matrix) else sp.csc_array(matrix)
    csc = csc if csc.has_sorted_indices else csc.sorted_indices()
    rows, columns = csc.shape
    return ca.DM(ca.Sparsity(rows, columns, csc.indptr.tolist(), csc.indices.tolist()), csc.data)


def constant_row(values: Any) -> Any:
    """Return constants (k,) as 1×k, or as 1×1 where all are the same: that is shorter code, and less memory to read. Expressions stay."""
    if is_expression(values):
        return values
    return ca.DM(values[0]) if len(values) and np.ptp(values) == 0 else ca.DM(values).T


def weighted_product(Z: Any, weights: Any, C: Any) -> Any:
    """Compute Z ŵ C (3×n) of columns Z (3×k), their weights (1×k) and a constant matrix C (k×n)."""
    constant = sparse(C)
    if not isinstance(Z, ca.MX):
        return ca.mtimes(Z * ca.repmat(weights, 3, 1), constant)
    rows, _ = (
        constant.sparsity().get_triplet()
    )  # as vector operations: one pass over C is less than three over Z
    return ca.mtimes(
        Z,
        matrix_with_pattern(
            constant.sparsity(), ca.vec(weights.T[rows]) * ca.DM(constant.nonzeros())
        ),
    )


def matrix_with_pattern(sparsity: ca.Sparsity, values: Any) -> Any:
    """Return a matrix of this sparsity with these values (nnz), of their CasADi type."""
    values = ca.densify(values)
    return (
        ca.SX(sparsity, values)
        if isinstance(values, ca.SX)
        else ca.MX(sparsity, values)
        if isinstance(values, ca.MX)
        else ca.DM(sparsity, values)
    )


def hermite_cubic(
    left: Any, left_slope: Any, right: Any, right_slope: Any, length: Any, share: Any
) -> Any:
    """Return the cubic with these values and slopes at the ends of an interval of that length, at a share of it.

    Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, (II.6.7).
    """
    s = share
    return (
        (1 + 2 * s) * (1 - s) ** 2 * left
        + s**2 * (3 - 2 * s) * right
        + length * s * (1 - s) * ((1 - s) * left_slope - s * right_slope)
    )


def drop_rounding(matrix: Any) -> sp.csr_array:
    """Return the matrix without entries that are zero but for rounding."""
    result = sp.csr_array(matrix)
    if result.nnz:
        result.data[abs(result.data) < 1e-14 * abs(result.data).max()] = 0
        result.eliminate_zeros()
    return result


def numbered(matrix: Any) -> sp.csr_array:
    """Return SciPy's sparse matrix as it is, and of a CasADi matrix the pattern: each entry is its place among the nonzeros, from 1 on."""
    if not is_expression(matrix):
        return sp.csr_array(matrix)
    row, column = matrix.sparsity().get_triplet()
    return sp.csr_array((np.arange(1, len(row) + 1), (row, column)), shape=matrix.shape)


def entries_at(matrix: Any, rows: Any, columns: Any) -> Any:
    """Return the entries of a sparse matrix at these places as a CasADi column, 0 where none is stored."""
    found = np.asarray(numbered(matrix)[rows, columns]).ravel()
    if not is_expression(matrix):
        return ca.DM(found)
    return ca.vertcat(0, matrix.nz[:])[found.tolist()]


def multiplied_rows(matrix: Any, one: Any, other: Any) -> Any:
    """Return the products of rows `one` and `other` of a sparse matrix, entry by entry, as a sparse CasADi matrix (rows × columns)."""
    index = numbered(matrix)
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
    """Return the diagonal of a matrix as 1×n, or as 1×1 where it is constant and all the same."""
    return ca.diag(matrix).T if is_expression(matrix) else constant_row(matrix.diagonal())


def is_diagonal(matrix: Any) -> bool:
    """Say whether nothing is stored off the diagonal."""
    if is_expression(matrix):
        return bool(matrix.sparsity().is_diag())
    coo = sp.coo_array(matrix)
    return bool(np.all(coo.row == coo.col))


def block_inverse(M: sp.csr_array, free: Any) -> sp.csr_array:
    """Invert M (n×n) on the free coordinates, block by block, as bars rarely all hang together; zeros elsewhere."""
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
    """A Function on NumPy arrays in place: copies through CasADi's matrices cost several times what small functions take.

    Arrays go in whose memory holds each input column by column. An array (columns, rows) comes out
    for each dense output, and the non-zeros of each sparse one.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer: Any
        self._buffer, self._evaluate = function.buffer()
        self._lock = threading.Lock()  # values kept by a model are shared by threads
        self._shapes = [
            (function.size2_out(k), function.size1_out(k))
            if function.sparsity_out(k).is_dense()
            else (function.nnz_out(k),)
            for k in range(function.n_out())
        ]

    def __call__(self, *inputs: Array) -> list[Array]:
        """Evaluate the Function and return its outputs. Raises RuntimeError where it fails."""
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
                raise RuntimeError("CasADi could not evaluate a function")
        return results

    def stats(self) -> dict[str, Any]:
        """Return what a solver says of its last call."""
        return dict(self._buffer.stats())


class ArrayCallback(ca.Callback):
    """A Function that NumPy evaluates; it lives as long as this object, which whoever uses it in expressions must keep.

    evaluate gets an array (columns, rows) for each of the inputs, whose shapes (rows, columns) are
    given, and returns one for the output.
    """

    def __init__(
        self,
        name: str,
        evaluate: Callable[..., Array],
        inputs: list[tuple[int, int]],
        output: tuple[int, int],
    ) -> None:
        super().__init__()
        self._evaluate, self._inputs, self._output = evaluate, inputs, output
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return how many inputs there are."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Return 1."""
        return 1

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return ca.Sparsity.dense(*self._inputs[k])

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        """Return the shape of the output."""
        return ca.Sparsity.dense(*self._output)

    def has_eval_buffer(self) -> bool:
        """Return that numbers are read and written in place."""
        return True

    def eval_buffer(self, arguments: Sequence[Any], results: Sequence[Any]) -> int:
        """Evaluate in CasADi's memory; what is not finite goes to the solver without a warning."""
        arrays = [
            np.frombuffer(value).reshape(columns, rows)
            for value, (rows, columns) in zip(arguments, self._inputs, strict=True)
        ]
        result = np.frombuffer(results[0])
        try:
            with np.errstate(all="ignore"):
                result[:] = np.ravel(self._evaluate(*arrays))
        except np.linalg.LinAlgError:  # a matrix is singular
            result[:] = np.nan
        return 0


def generated(generator: ca.CodeGenerator, name: str) -> dict[str, str]:
    """Return `name`.c and `name`.h, as CasADi writes them, by name."""
    with TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        return {
            file: Path(folder, file).read_text(encoding="utf-8")
            for file in (f"{name}.c", f"{name}.h")
        }
