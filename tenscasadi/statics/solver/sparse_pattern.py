"""Sparse matrices of fixed pattern, linear in given values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from tenscasadi.util.validate import Array, Indices


class MatrixEntries(NamedTuple):
    """Sparse matrix as contributions weight · values[source].

    Each contribution belongs to a row and a column.
    """

    row: Indices
    column: Indices
    source: Indices
    weight: Array

    def transpose(self) -> MatrixEntries:
        """Transpose the matrix."""
        return MatrixEntries(self.column, self.row, self.source, self.weight)

    def shift(self, row: int = 0, column: int = 0, source: int = 0) -> MatrixEntries:
        """Add offsets to rows, columns and sources."""
        return MatrixEntries(
            self.row + row, self.column + column, self.source + source, self.weight
        )

    def scale(self, factor: float) -> MatrixEntries:
        """Multiply all weights by a factor."""
        return self._replace(weight=factor * self.weight)

    def multiply_basis(self, basis: sp.csr_array) -> MatrixEntries:
        """Multiply by a constant sparse matrix from the right.

        `basis` is (columns × new columns).
        """
        counts = np.diff(basis.indptr)[self.column]
        which = np.repeat(np.arange(len(self.column)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        place = basis.indptr[self.column[which]] + np.arange(len(which)) - first
        return MatrixEntries(
            self.row[which],
            basis.indices[place].astype(np.intp),
            self.source[which],
            self.weight[which] * basis.data[place],
        )

    def project(self, basis: sp.csr_array) -> MatrixEntries:
        """Compute basisᵀ · matrix · basis."""
        return self.multiply_basis(basis).transpose().multiply_basis(basis).transpose()


def join_entries(*parts: MatrixEntries) -> MatrixEntries:
    """Add matrices by joining their contributions."""
    return MatrixEntries(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class SparsePattern:
    """Sparse matrix of fixed pattern that is filled from values.

    Parameters
    ----------
    entries : MatrixEntries
        Contributions to the matrix.
    shape : tuple of int
        Rows and columns.
    sources : int
        Number of values.
    """

    def __init__(self, entries: MatrixEntries, shape: tuple[int, int], sources: int) -> None:
        rows = shape[0]
        code, place = np.unique(entries.column * rows + entries.row, return_inverse=True)
        self.shape = shape
        self.indices = (code % max(rows, 1)).astype(np.int32)
        self.indptr = np.searchsorted(code, rows * np.arange(shape[1] + 1)).astype(np.int32)
        self._onto = sp.csr_array(
            (entries.weight, (place, entries.source)), shape=(len(code), sources)
        )

    def fill(self, values: Array) -> Any:
        """Build the matrix from its values.

        Parameters
        ----------
        values : ndarray, shape (sources,)
            Values.

        Returns
        -------
        csc_array
            The matrix.
        """
        return sp.csc_array((self._onto @ values, self.indices, self.indptr), shape=self.shape)


def join_blocks(parts: Sequence[tuple[int, int, Any]], size: int) -> sp.csc_array:
    """Assemble a square sparse matrix from blocks.

    For small blocks it is much faster than `block_array` of SciPy.

    Parameters
    ----------
    parts : sequence of tuple
        First row, first column, and matrix of each block, sparse or dense. Entries add up.
    size : int
        Number of rows.

    Returns
    -------
    csc_array
        The matrix.
    """
    entries = [(row, column, *_find_entries(block)) for row, column, block in parts]
    rows = np.concatenate([row + inside for row, _, inside, _, _ in entries])
    columns = np.concatenate([column + inside for _, column, _, inside, _ in entries])
    values = np.concatenate([entry[-1] for entry in entries])
    return sp.csc_array((values, (rows, columns)), shape=(size, size))


def _find_entries(block: Any) -> tuple[Indices, Indices, Array]:
    """Find rows, columns and values of a matrix's nonzeros.

    The matrix is `block`. Compressed formats are read directly, as their conversion by SciPy takes
    longer.
    """
    if isinstance(block, np.ndarray):
        rows, columns = np.nonzero(block)
        return rows, columns, block[rows, columns]
    if block.format in ("csc", "csr"):
        outer = np.repeat(np.arange(len(block.indptr) - 1), np.diff(block.indptr))
        inner = block.indices
        rows, columns = (inner, outer) if block.format == "csc" else (outer, inner)
        return rows, columns, block.data
    entries = block.tocoo()
    return entries.coords[0], entries.coords[1], entries.data
