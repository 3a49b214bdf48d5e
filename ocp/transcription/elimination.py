"""Block triangular elimination of a sparse square matrix."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.sparse import _sparsetools  # no public call multiplies a range of rows in place

from tenscasadi.util.validate import Array, Booleans, Indices


class Elimination:
    """Direct solver of a sparse linear system and its transpose.

    The systems are A x = b and Aᵀ x = b. A is permuted to its finest block triangular form.
    Diagonal blocks with equal sparsity are inverted in one batch. If a part of a block is constant,
    only its Schur complement is inverted.

    Parameters
    ----------
    rows, columns : ndarray of int
        Row and column indices of the entries of A (n, n).
    size : int
        Number n of rows.
    constant : ndarray of bool
        Whether each entry is constant.
    sample : ndarray
        Values of all entries. Only those of constant entries are used.

    Attributes
    ----------
    by_row, by_column : ndarray of int, shape (n,)
        Order of the rows of A in b, and of its unknowns in x.

    Raises
    ------
    ValueError
        If the pattern is structurally singular.
    """

    def __init__(
        self, rows: Indices, columns: Indices, size: int, constant: Booleans, sample: Array
    ) -> None:
        blocks = _order_blocks(rows, columns, *_find_blocks(rows, columns, size))
        nothing = np.zeros(0, dtype=np.intp)
        self.size = size
        self.by_row = np.concatenate([nothing, *(block.rows for block in blocks)])
        self.by_column = np.concatenate([nothing, *(block.columns for block in blocks)])
        starts = np.cumsum([0, *(len(block.rows) for block in blocks)])
        row, column = np.argsort(self.by_row)[rows], np.argsort(self.by_column)[columns]
        own = np.searchsorted(starts, np.arange(size), side="right") - 1
        inside = own[row] == own[column]
        self._groups = _group_alike(
            starts, own, row, column, np.flatnonzero(inside), constant, sample
        )
        self._steps = _find_steps([block.level for block in blocks], starts, self._groups)
        rest = np.flatnonzero(~inside)
        places = row[rest], column[rest]
        ranges = [(step.start, step.end) for step in self._steps]
        self._forward = _Substitution(*places, rest, size, ranges)
        self._backward = _Substitution(*places[::-1], rest, size, ranges)
        self._backward.steps.reverse()

    def factor(self, values: Array) -> None:
        """Factorize A with new values of its nonzeros."""
        for group in self._groups:
            group.take(values)
        inverses = [step.group.inverse[step.ranks] for step in self._steps]
        self._forward.take(values, inverses)
        self._backward.take(values, [one.transpose(0, 2, 1) for one in inverses])

    def solve(self, b: Array) -> Array:
        """Solve A x = b in place, with b ordered by `by_row`."""
        return self._forward.substitute(b)

    def solve_transposed(self, b: Array) -> Array:
        """Solve Aᵀ x = b in place, with b ordered by `by_column`."""
        return self._backward.substitute(b)


class _DefectBlock(NamedTuple):
    """Diagonal block of the block triangular form.

    Attributes
    ----------
    level : int
        Number of its level. Blocks of one level do not depend on each other.
    rows, columns : ndarray of int
        Its rows and columns in the matrix.
    """

    level: int
    rows: Indices
    columns: Indices


def _find_blocks(rows: Indices, columns: Indices, size: int) -> tuple[Indices, Indices]:
    """Find the finest block triangular form of a sparse matrix.

    The matrix (size, size) has nonzeros at the given rows and columns. Returns the number of the
    block of each row and of each column.
    """
    pattern = ca.Sparsity.triplet(size, size, rows.tolist(), columns.tolist())
    _, row_order, column_order, ends, column_ends, *_ = pattern.btf()
    if list(ends) != list(column_ends) or ends[-1] != size:
        raise ValueError("the rows do not determine the unknowns: the matrix is singular")
    block = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    of_row, of_column = np.empty(size, dtype=np.intp), np.empty(size, dtype=np.intp)
    of_row[list(row_order)], of_column[list(column_order)] = block, block
    return of_row, of_column


def _order_blocks(
    rows: Indices, columns: Indices, of_row: Indices, of_column: Indices
) -> list[_DefectBlock]:
    """Order diagonal blocks by dependence, then by sparsity.

    Nonzeros are at the given rows and columns; `of_row` and `of_column` are the blocks of these.
    Blocks of one level do not depend on each other. Those of equal sparsity become neighbors, which
    one batched product solves.
    """
    widths = np.bincount(of_row)
    count, ends = len(widths), np.append(0, np.cumsum(widths))
    orders = [np.argsort(own, kind="stable") for own in (of_row, of_column)]
    needs, given = np.divmod(np.unique(of_row[rows] * count + of_column[columns]), count)
    level = np.zeros(count, dtype=np.intp)
    while ((higher := np.where(needs != given, level[given] + 1, 0)) > level[needs]).any():
        np.maximum.at(level, needs, higher)
    inside = np.flatnonzero(of_row[rows] == of_column[columns])
    row, column = (
        np.argsort(order)[index[inside]] - ends[of[index[inside]]]
        for order, index, of in zip(orders, (rows, columns), (of_row, of_column), strict=True)
    )
    own = of_row[rows[inside]]
    sorting = np.lexsort((column, row, own))
    cuts = np.searchsorted(own[sorting], np.arange(1, count))
    places = np.split((row * len(of_row) + column)[sorting], cuts)
    found = [
        _DefectBlock(int(level[k]), *(order[ends[k] : ends[k + 1]] for order in orders))
        for k in range(count)
    ]
    keys = [(int(level[k]), int(widths[k]), places[k].tobytes()) for k in range(count)]
    return [found[k] for k in sorted(range(count), key=keys.__getitem__)]


def _group_alike(
    starts: Indices,
    own: Indices,
    row: Indices,
    column: Indices,
    entries: Indices,
    constant: Booleans,
    sample: Array,
) -> list[_Group]:
    """Group the diagonal blocks of equal sparsity.

    `starts` (blocks + 1) are the first row of each block, then the number of rows. `own` (rows) is
    the block of each row. `row` and `column` (nnz) are the places of all nonzeros, and `entries` the
    indices of those inside diagonal blocks. `constant` (nnz) marks nonzeros that do not depend on
    the variables, and `sample` (nnz) has the nonzeros at one point.
    """
    order = entries[np.lexsort((column[entries], row[entries], own[row[entries]]))]
    alike: dict[tuple[int, bytes], tuple[Indices, list[int], list[Indices]]] = {}
    cuts = np.searchsorted(own[row[order]], np.arange(len(starts)))
    for k, (start, end) in enumerate(pairwise(starts)):
        part, width = order[cuts[k] : cuts[k + 1]], int(end - start)
        places = (row[part] - start) * width + column[part] - start
        _, members, found = alike.setdefault((width, places.tobytes()), (places, [], []))
        members.append(k)
        found.append(part)
    return [
        _Group(width, places, members, np.array(found), constant, sample)
        for (width, _), (places, members, found) in alike.items()
    ]


class _Step(NamedTuple):
    """Neighboring diagonal blocks that one batched product solves.

    Attributes
    ----------
    start, end : int
        First row, and the row after the last.
    group : _Group
        Group with the inverses of the blocks, at `ranks`.
    """

    start: int
    end: int
    group: _Group
    ranks: slice


def _find_steps(levels: list[int], starts: Indices, groups: list[_Group]) -> list[_Step]:
    """Find the longest sequences of neighboring blocks.

    Blocks of a sequence have the same level and sparsity. `levels` are those of the blocks,
    `starts` their first rows and the end. `groups` are those of equal sparsity.
    """
    place = {k: (group, rank) for group in groups for rank, k in enumerate(group.members)}
    steps, k = [], 0
    while k < len(levels):
        (group, rank), n = place[k], 1
        while k + n < len(levels) and levels[k + n] == levels[k]:
            if place[k + n] != (group, rank + n):
                break
            n += 1
        steps.append(_Step(int(starts[k]), int(starts[k + n]), group, slice(rank, rank + n)))
        k += n
    return steps


class _Substitution:
    """Substitution with A or Aᵀ, step by step.

    A (`size`, `size`) has its `entries` outside the diagonal blocks at (`row`, `column`). `ranges`
    are the rows of each step.

    Attributes
    ----------
    steps : list of (int, int, int, ndarray or None)
        Index of the inverse, first row and the row after the last, and the places of the rows'
        entries; None without entries.
    """

    def __init__(
        self,
        row: Indices,
        column: Indices,
        entries: Indices,
        size: int,
        ranges: list[tuple[int, int]],
    ) -> None:
        order = np.lexsort((column, row))
        self.size, self.entries = size, entries[order]
        self.columns = column[order].astype(np.int32)
        starts = np.searchsorted(row[order], np.arange(size + 1)).astype(np.int32)
        self.steps = [
            (k, first, last, starts[first : last + 1] if starts[first] < starts[last] else None)
            for k, (first, last) in enumerate(ranges)
        ]

    def take(self, values: Array, inverses: list[Array]) -> None:
        """Store new values of the matrix.

        `values` are all nonzeros; `inverses` are the inverse blocks (count, m, m) of each step.
        """
        self.values, self.inverses = -values[self.entries], inverses

    def substitute(self, b: Array) -> Array:
        """Solve for the right-hand side b (n, r), and overwrite b."""
        r, flat, given = b.shape[1], b.reshape(-1), (self.columns, self.values)
        vectors = () if r == 1 else (r,)
        add = _sparsetools.csr_matvec if r == 1 else _sparsetools.csr_matvecs
        for k, first, last, starts in self.steps:
            own, inverse = flat[first * r : last * r], self.inverses[k]
            if starts is not None:
                add(last - first, self.size, *vectors, starts, *given, flat, own)
            own[:] = np.matmul(inverse, own.reshape(len(inverse), inverse.shape[2], r)).reshape(-1)
        return b


class _Group:
    """Diagonal blocks of equal sparsity, and their inverses.

    `members` are the numbers of the blocks (width, width). `places` are the positions of the
    nonzeros in a block, row by row, and `entries` their indices among all nonzeros. `constant` and
    `sample` are those of `Elimination`. Arrays of blocks have shape (count, m, m) with the width m.
    """

    def __init__(
        self,
        width: int,
        places: Indices,
        members: list[int],
        entries: Indices,
        constant: Booleans,
        sample: Array,
    ) -> None:
        self.places, self.members, self.entries = places, members, entries
        self.inverse: Array = np.empty((len(members), width, width))
        self.fixed: Array | None = None
        filled, given = np.zeros((2, width, width), dtype=bool)
        filled.ravel()[places], given.ravel()[places] = True, constant[entries].all(axis=0)
        one, ones = given.any(axis=1), given.any(axis=0)
        square = one.any() and not one.all() and one.sum() == ones.sum()
        # the constant part: rows and columns whose common entries are all constant
        if square and not (filled & ~given)[np.ix_(one, ones)].any():
            self.one, self.other, self.ones, self.others = map(
                np.flatnonzero, (one, ~one, ones, ~ones)
            )
            part = self._fill(sample)[:, self.one[:, None], self.ones]
            if np.linalg.matrix_rank(part).min() == len(self.one):
                self.fixed = np.asarray(np.linalg.inv(part), dtype=float)

    def _fill(self, values: Array) -> Array:
        dense = np.zeros(self.inverse.shape)
        dense.reshape(len(dense), -1)[:, self.places] = values[self.entries]
        return dense

    def take(self, values: Array) -> None:
        """Invert the blocks with new values of the matrix nonzeros."""
        D = self._fill(values)
        if self.fixed is None:
            self.inverse = np.asarray(np.linalg.inv(D), dtype=float)
            return
        one, other = self.one[:, None], self.other[:, None]
        fixed_B, C_fixed = self.fixed @ D[:, one, self.others], D[:, other, self.ones] @ self.fixed
        schur = np.linalg.inv(D[:, other, self.others] - D[:, other, self.ones] @ fixed_B)
        right = fixed_B @ schur
        self.inverse[:, self.ones[:, None], self.one] = self.fixed + right @ C_fixed
        self.inverse[:, self.ones[:, None], self.other] = -right
        self.inverse[:, self.others[:, None], self.one] = -schur @ C_fixed
        self.inverse[:, self.others[:, None], self.other] = schur
