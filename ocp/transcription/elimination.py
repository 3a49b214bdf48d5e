"""Block triangular elimination of a sparse square matrix."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg
from scipy.sparse import _sparsetools  # no public call multiplies in place

from tenscasadi.util.validate import Array, Booleans, Indices


class SparseRows(NamedTuple):
    """Sparse matrix by rows.

    Attributes
    ----------
    values : ndarray
        Non-zeros, row by row.
    columns : ndarray of int
        Their columns.
    starts : ndarray of int
        Place of the first non-zero of each row, and the number of non-zeros.
    shape : tuple of int
        Numbers of rows and columns.
    """

    values: Array
    columns: Any
    starts: Any
    shape: tuple[int, int]

    @classmethod
    def of(cls, matrix: sp.csr_array) -> SparseRows:
        """Convert a matrix of SciPy."""
        return cls(matrix.data, matrix.indices, matrix.indptr, matrix.shape)

    @property
    def matrix(self) -> sp.csr_array:
        """The rows as a SciPy sparse matrix."""
        return sp.csr_array((self.values, self.columns, self.starts), shape=self.shape)

    def squared(self) -> SparseRows:
        """Square each non-zero."""
        return self._replace(values=self.values**2)

    def times(self, x: Array) -> Array:
        """Multiply by x (n,)."""
        result = np.zeros(self.shape[0])
        _sparsetools.csr_matvec(*self.shape, self.starts, self.columns, self.values, x, result)
        return result

    def transposed_times(self, x: Array) -> Array:
        """Multiply the transpose by x (m,)."""
        (m, n), result = self.shape, np.zeros(self.shape[1])
        _sparsetools.csc_matvec(n, m, self.starts, self.columns, self.values, x, result)
        return result


class Elimination:
    """Direct solver of a bordered sparse linear system and its transpose.

    The matrix is [A B; 0 I]. B is the border, and I the identity. A is permuted to its finest
    block triangular form. The constant parts of diagonal blocks are factorized once, by sparse LU.
    Only their Schur complements are inverted again, in one batch for all blocks of equal sparsity.

    Parameters
    ----------
    rows, columns : ndarray of int
        Row and column indices of the entries of A (n, n), and of B in the columns from n on.
    size : int
        Number n of rows.
    constant : ndarray of bool
        Whether each entry is constant.
    sample : ndarray
        Values of all entries. Only those of constant entries are used.
    border : int
        Number of columns of B.

    Attributes
    ----------
    by_row, by_column : ndarray of int, shape (n,)
        Order of the rows of A in the right-hand sides, and of its unknowns in the solutions. The
        entries of the border follow.

    Raises
    ------
    ValueError
        If the pattern is structurally singular.
    """

    def __init__(
        self,
        rows: Indices,
        columns: Indices,
        size: int,
        constant: Booleans,
        sample: Array,
        border: int = 0,
    ) -> None:
        own = columns < size
        of_row, of_column = _find_blocks(rows[own], columns[own], size)
        self.by_row, self.by_column = (
            np.argsort(block, kind="stable") for block in (of_row, of_column)
        )
        row, column = np.argsort(self.by_row)[rows], columns.copy()
        column[own] = np.argsort(self.by_column)[columns[own]]
        self.border = slice(size, size + border)
        block = np.append(np.sort(of_row), np.full(border, -1))  # before all others
        self._groups = _group_alike(block[:size], row, column, constant, sample)
        fixed_row, fixed_column = np.zeros((2, size + border), dtype=bool)
        for group in self._groups:
            fixed_row[group.places[:, group.one]] = True
            fixed_column[group.places[:, group.ones]] = True
        factors = _factorize(block, row, column, sample, fixed_row, fixed_column)
        nothing = np.zeros(0, dtype=np.intp)
        pairs = [(nothing, nothing), *(group.inverse_places() for group in self._groups)]
        unknowns, rows = (np.concatenate(own) for own in zip(*pairs, strict=True))
        self._forward = _Substitution(block, row, column, factors, (unknowns, rows), border)
        back = -block, column, row, factors.transpose(), (rows, unknowns)
        self._backward = _Substitution(*back, border)

    def factor(self, values: Array) -> None:
        """Factorize A with new values of its nonzeros."""
        inverses = [group.invert(values).ravel() for group in self._groups]
        numbers = np.concatenate([np.ones(1), values, *inverses])
        self._forward.take(numbers)
        self._backward.take(numbers)

    def solve(self, b: Array) -> Array:
        """Solve A x + B y = f for b = (f, y) (n + border,).

        Returns (x, y). Rows of f are ordered by `by_row`, those of x by `by_column`.
        """
        return self._forward.substitute(b)

    def solve_transposed(self, b: Array) -> Array:
        """Solve Aᵀ x = f for b = (f, g) (n + border,).

        Returns (x, g − Bᵀ x). Rows of f are ordered by `by_column`, those of x by `by_row`.
        """
        return self._backward.substitute(b)

    def reduce(self, rows: SparseRows, weights: Array) -> Array:
        """Compute g − Bᵀ x of the transposed system for many right-hand sides.

        The right-hand sides (f, g) are the combinations of `rows` (k, n + border) with the columns
        of `weights` (k, r). Returns the results (border, r).
        """
        return self._backward.reduce(rows, weights)


def _find_blocks(rows: Indices, columns: Indices, size: int) -> tuple[Indices, Indices]:
    """Find the finest block triangular form of a sparse matrix.

    The matrix (size, size) has nonzeros at the given rows and columns. Returns the number of the
    block of each row and of each column. Blocks depend on blocks with lower numbers.
    """
    # in this order, the matching of rows with columns rarely has to be changed
    sparse_first = np.argsort(np.bincount(columns, minlength=size), kind="stable")
    place = np.argsort(sparse_first)[columns]
    pattern = ca.Sparsity.triplet(size, size, rows.tolist(), place.tolist())
    _, row_order, column_order, ends, column_ends, *_ = pattern.btf()
    if list(ends) != list(column_ends) or ends[-1] != size:
        raise ValueError("the rows do not determine the unknowns: the matrix is singular")
    count = len(ends) - 1
    block = np.repeat(np.arange(count), np.diff(ends))
    of_row, of_column = np.empty(size, dtype=np.intp), np.empty(size, dtype=np.intp)
    of_row[list(row_order)], of_column[sparse_first[list(column_order)]] = block, block
    later, earlier = np.divmod(np.unique(of_row[rows] * count + of_column[columns]), count)
    later, earlier = later[later != earlier], earlier[later != earlier]
    level = np.zeros(count, dtype=np.intp)
    while (level[later] <= level[earlier]).any():
        np.maximum.at(level, later, level[earlier] + 1)
    rank = np.argsort(np.argsort(level, kind="stable"))
    return rank[of_row], rank[of_column]


class _Group:
    """Diagonal blocks of equal sparsity, with a constant part and its Schur complement.

    `places` (count, m) are the indices of the blocks' rows and columns. `entries` (count, nnz) are
    the indices of their nonzeros in A, which are at (`row`, `column`) (nnz,) in each block.
    `constant` and `sample` are those of `Elimination`.

    Attributes
    ----------
    one, ones : ndarray of bool, shape (m,)
        Rows and columns of the constant part.
    """

    def __init__(
        self,
        places: Indices,
        entries: Indices,
        row: Indices,
        column: Indices,
        constant: Booleans,
        sample: Array,
    ) -> None:
        self.places, self._entries, self._row, self._column = places, entries, row, column
        given = constant[entries].all(axis=0)
        self.one, self.ones = np.zeros((2, places.shape[1]), dtype=bool)
        self.one[row[given]], self.ones[column[given]] = True, True
        # the constant part: rows and columns whose common entries are all constant
        size, sizes = self.one.sum(), self.ones.sum()
        part = self._fill(sample, self.one, self.ones)
        varies = (self.one[row] & self.ones[column] & ~given).any()
        if varies or not 0 < size == sizes < places.shape[1] or _lacks_rank(part):
            self.one[:], self.ones[:], part = False, False, part[:, :0, :0]
        self._fixed = np.linalg.inv(part)

    def inverse_places(self) -> tuple[Indices, Indices]:
        """Find the unknowns and rows of A of all entries that `invert` computes."""
        unknowns, rows = self.places[:, ~self.ones], self.places[:, ~self.one]
        pairs = np.broadcast_arrays(unknowns[:, :, None], rows[:, None, :])
        return pairs[0].ravel(), pairs[1].ravel()

    def _fill(self, values: Array, rows: Booleans, columns: Booleans) -> Array:
        """Build the dense part (count, ·, ·) of the blocks at the given rows and columns."""
        own = np.flatnonzero(rows[self._row] & columns[self._column])
        i, j = np.cumsum(rows)[self._row[own]] - 1, np.cumsum(columns)[self._column[own]] - 1
        dense = np.zeros((len(self.places), rows.sum(), columns.sum()))
        dense[:, i, j] = values[self._entries[:, own]]
        return dense

    def invert(self, values: Array) -> Array:
        """Invert the Schur complements (count, r, r) with new values of the nonzeros of A."""
        B, C, D = (
            self._fill(values, rows, columns)
            for rows, columns in (
                (self.one, ~self.ones),
                (~self.one, self.ones),
                (~self.one, ~self.ones),
            )
        )
        return np.asarray(np.linalg.inv(D - C @ (self._fixed @ B)), dtype=float)


def _lacks_rank(matrices: Array) -> bool:
    return bool((np.linalg.matrix_rank(matrices) < matrices.shape[1]).any())


def _group_alike(
    block: Indices, row: Indices, column: Indices, constant: Booleans, sample: Array
) -> list[_Group]:
    """Group the diagonal blocks of equal sparsity.

    `block` (n,) is the block of each row and column, ascending. `row` and `column` (nnz) are the
    places of all nonzeros. `constant` and `sample` are those of `Elimination`.
    """
    starts = np.searchsorted(block, np.arange(block.max(initial=-1) + 2))
    inside = np.flatnonzero(column < len(block))
    inside = inside[block[row[inside]] == block[column[inside]]]
    order = inside[np.lexsort((column[inside], row[inside]))]
    cuts = np.searchsorted(block[row[order]], np.arange(len(starts)))
    alike: dict[tuple[int, bytes], tuple[Indices, list[int], list[Indices]]] = {}
    for (start, end), (a, b) in zip(pairwise(starts), pairwise(cuts), strict=True):
        width, part = int(end - start), order[a:b]
        places = (row[part] - start) * width + column[part] - start
        _, firsts, found = alike.setdefault((width, places.tobytes()), (places, [], []))
        firsts.append(start)
        found.append(part)
    return [
        _Group(
            np.array(firsts)[:, None] + np.arange(width),
            np.array(found),
            *np.divmod(places, width),
            constant,
            sample,
        )
        for (width, _), (places, firsts, found) in alike.items()
    ]


class _Factors(NamedTuple):
    """Factors L D U of a matrix, with unit triangular L and U.

    Attributes
    ----------
    at_row, at_column : ndarray of int, shape (n,)
        Place of each row and column of A in the factors, −1 for those outside the matrix.
    lower, upper : tuple of ndarray
        Row, column and value of the entries of L and U off the diagonal.
    pivots : ndarray
        Diagonal of D.
    """

    at_row: Indices
    at_column: Indices
    lower: tuple[Indices, Indices, Array]
    pivots: Array
    upper: tuple[Indices, Indices, Array]

    def transpose(self) -> _Factors:
        """Build the factors of the transpose."""
        (i, j, own), (p, q, more) = self.lower, self.upper
        return _Factors(self.at_column, self.at_row, (q, p, more), self.pivots, (j, i, own))


def _factorize(
    block: Indices,
    row: Indices,
    column: Indices,
    values: Array,
    fixed_row: Booleans,
    fixed_column: Booleans,
) -> _Factors:
    """Factorize parts of the diagonal blocks.

    They are at the rows `fixed_row` (n,) and columns `fixed_column` (n,). The nonzeros `values` of
    the whole matrix are at (`row`, `column`), and `block` (n,) is the block of each row and column.
    """
    at_row, at_column = np.full((2, len(block)), -1)
    own = (block[row] == block[column]) & fixed_row[row] & fixed_column[column]
    i, j = np.cumsum(fixed_row)[row[own]] - 1, np.cumsum(fixed_column)[column[own]] - 1
    n = int(fixed_row.sum())
    if not n:
        nothing = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp), np.zeros(0)
        return _Factors(at_row, at_column, nothing, np.zeros(0), nothing)
    found = scipy.sparse.linalg.splu(sp.csc_array((values[own], (i, j)), shape=(n, n)))
    at_row[fixed_row], at_column[fixed_column] = found.perm_r, found.perm_c
    pivots = found.U.diagonal()
    lower, upper = sp.coo_array(sp.tril(found.L, -1)), sp.coo_array(sp.triu(found.U, 1))
    lower.eliminate_zeros()
    upper.eliminate_zeros()
    return _Factors(
        at_row,
        at_column,
        (*lower.coords, lower.data),
        pivots,
        (*upper.coords, upper.data / pivots[upper.coords[0]]),
    )


class _Substitution:
    """Substitution with A, as one product with a unit triangular matrix.

    A diagonal block of A has the constant part M = L D U beside B, above C. S is the Schur
    complement of M. With the right-hand sides f and g of a block, minus the terms of earlier
    blocks, the product computes, row by row,

        a = L⁻¹ f, c = U⁻¹ D⁻¹ a, s = g − C c, y = S⁻¹ s, d = −L⁻¹ B y, x = U⁻¹ D⁻¹ (a + d).

    The unknowns of the block are x and y. `block` (n,) is the rank of the block of each row and
    column. `row` and `column` (nnz,) are the places of the nonzeros, and `factors` those of all M.
    S⁻¹ has entries at the columns and rows `inverse_places` of A. The last `border` rows and
    columns are those of the identity: their s are unknowns already.
    """

    def __init__(
        self,
        block: Indices,
        row: Indices,
        column: Indices,
        factors: _Factors,
        inverse_places: tuple[Indices, Indices],
        border: int,
    ) -> None:
        n, m = len(block), len(factors.pivots)
        at_row, at_column = factors.at_row, factors.at_column
        # numbers of the rows a, c, d, x (m each), s and y (n each)
        given = np.where(at_row >= 0, at_row, 4 * m + np.arange(n))
        found = np.where(at_column >= 0, 3 * m + at_column, 4 * m + n + np.arange(n))
        found[n - border :] = given[n - border :]
        position = _order_rows(block, at_row, at_column, m, border)
        inside = block[row] == block[column]
        of_row, of_column = inside & (at_row[row] >= 0), inside & (at_column[column] >= 0)
        used = np.flatnonzero(~inside | (of_row != of_column))
        to = np.where(of_row, 2 * m + at_row[row], given[row])[used]
        by = np.where(of_column, m + at_column[column], found[column])[used]
        k, (i, j, lower), (p, q, upper) = np.arange(m), factors.lower, factors.upper
        unknowns, rows = inverse_places
        parts = [
            (to, by, np.full(len(used), -1.0)),
            (found[unknowns], given[rows], np.ones(len(rows))),
            *((i + shift, j + shift, -lower) for shift in (0, 2 * m)),
            *((p + shift, q + shift, -upper) for shift in (m, 3 * m)),
            *((k + b * m, k + a * m, 1 / factors.pivots) for a, b in ((0, 1), (0, 3), (2, 3))),
        ]
        rows, columns, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
        sources = np.zeros(len(rows), dtype=np.intp)
        inverse = 1 + len(row) + np.arange(len(unknowns))
        sources[: len(used) + len(unknowns)] = np.append(1 + used, inverse)
        rows, columns = position[rows], position[columns]
        order = np.lexsort((columns, rows))
        self._weights, self._sources = weights[order], sources[order]
        self._columns = columns[order].astype(np.int32)
        self._size = int(position.max(initial=-1)) + 1
        self._starts = np.searchsorted(rows[order], np.arange(self._size + 1)).astype(np.int32)
        self._given, self._found = (position[own].astype(np.int32) for own in (given, found))
        self._border, self._space = border, np.zeros(0)

    def take(self, numbers: Array) -> None:
        """Store new values: 1, the nonzeros of A, and the entries of the inverses."""
        self._values = self._weights * numbers[self._sources]

    def substitute(self, b: Array) -> Array:
        """Solve for the right-hand side b (n,)."""
        rows = np.zeros(self._size)
        rows[self._given] = b
        matrix = self._starts, self._columns, self._values
        # in place: earlier rows are results already
        _sparsetools.csr_matvec(self._size, self._size, *matrix, rows, rows)
        return rows.take(self._found)

    def reduce(self, sides: SparseRows, weights: Array) -> Array:
        """Solve for many right-hand sides; return the unknowns of the border.

        They are the combinations of the rows `sides` (k, n) with the columns of `weights` (k, r).
        """
        result, most = np.empty((self._border, weights.shape[1])), 32  # more leave the cache
        size, matrix = self._size, (self._starts, self._columns, self._values)
        places = self._given[sides.columns]
        if len(self._space) < size * min(most, weights.shape[1]):
            self._space = np.empty(size * most)  # kept, as fresh memory is slow
        for first in range(0, weights.shape[1], most):
            own = weights[:, first : first + most]
            count, used = own.shape[1], np.flatnonzero(own.any(axis=1))
            part = slice(used.min(initial=len(own)), used.max(initial=-1) + 1)
            begun = sides.starts[part.start :], places, sides.values, own[part].ravel()
            rows = self._space[: size * count]
            rows[:] = 0.0
            _sparsetools.csc_matvecs(size, len(own[part]), count, *begun, rows)
            _sparsetools.csr_matvecs(size, size, count, *matrix, rows, rows)
            # the border is last
            result[:, first : first + most] = rows.reshape(size, count)[size - self._border :]
        return result


def _order_rows(
    block: Indices, at_row: Indices, at_column: Indices, count: int, border: int
) -> Indices:
    """Order the rows of a substitution so that each depends on earlier ones.

    `block`, `at_row` and `at_column` (n,) are those of `_Substitution` and `_Factors`, and `count`
    is the number of rows of the constant parts. The last `border` unknowns have no row y. Returns
    the place of each row, −1 for unused ones.
    """
    own, k = np.flatnonzero(at_row >= 0), np.arange(count)
    of_factors = np.empty(count, dtype=np.intp)
    of_factors[at_row[own]] = block[own]
    n = np.arange(len(block))
    blocks = np.concatenate([*[of_factors] * 4, block, block])
    stages = np.repeat([0, 1, 4, 5, 2, 3], [*[count] * 4, len(n), len(n)])
    ranks = np.concatenate([k, -k, k, -k, n, n])
    solved = at_column < 0
    solved[len(n) - border :] = False
    used = np.concatenate([np.ones(4 * count, dtype=bool), at_row < 0, solved])
    order = np.lexsort((ranks, stages, blocks))
    place = np.full(len(order), -1)
    place[order[used[order]]] = np.arange(int(used.sum()))
    return place
