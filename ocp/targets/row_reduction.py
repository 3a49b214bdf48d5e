"""Selection of independent goal rows that a solver can impose.

Let A be the gradients of the invariants at the final state and Z a basis of null(A). A goal with
gradient H can be changed in range(H Z) only. If the other combinations of its rows are imposed, the
constraint gradients of the optimal control problem are linearly dependent and solvers fail. Near
that state the dynamics itself satisfies these combinations; elsewhere it need not, so that goals in
them are also inequalities (`Target.dependent`). Singular lengths are replaced by other distances.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ocp.problem.rows import RESOLUTION
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.linear_algebra import compute_block_svd, null_space
from tenscasadi.util.validate import Array, Indices


class RowFunction:
    """Residuals of y with numerical values, Jacobians and Hessians.

    Residuals are CasADi expressions, scaled. The scaled unknowns are y divided by `scale` (ny,).
    The `groups` of residuals are differentiated one by one, because a few that depend on all
    unknowns would slow down the derivatives of the others.
    """

    def __init__(self, y: Any, groups: Sequence[Any], scale: Array) -> None:
        self.scale, self._code, self._rows = scale, _Code(y, groups), slice(None)

    @property
    def count(self) -> int:
        """Number of selected rows."""
        return len(range(self._code.count)[self._rows])

    def select(self, rows: slice) -> RowFunction:
        """Select the residuals `rows`, without building new code."""
        part = copy.copy(self)
        part._rows = rows
        return part

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Compute scaled residuals (m,) and their Jacobian (m, ny) at y.

        The Jacobian is that with respect to scaled unknowns.
        """
        value, gradient = self._code.first_at(y)
        return value.ravel()[self._rows], gradient.T[self._rows] * self.scale

    def size(self, y: Array) -> float:
        """Compute the norm of the scaled residuals at y."""
        return float(np.linalg.norm(self._code.value(y)[0].ravel()[self._rows]))

    def second_derivatives(self, y: Array) -> tuple[Indices, Indices, Indices, Array]:
        """Compute the nonzero second derivatives of all residuals at y.

        Returns, for each nonzero, the index of the residual, the indices of both unknowns in y, and
        the scaled value.
        """
        code = self._code.second
        entry = np.repeat(np.arange(len(code.row)), np.diff(code.pointers))
        values = code.function(y)[0].ravel()[code.order]
        one, other = code.one[entry], code.other
        return code.row[entry], one, other, values * self.scale[one] * self.scale[other]

    def curvatures(self, y: Array, weights: Array, basis: Array) -> Array:
        """Compute second derivatives (j, k, k) of combined residuals.

        The combinations are wᵀ residuals for each column w of `weights` (m, j). The derivatives are
        along the columns of `basis` (ny, k), in scaled unknowns.
        """
        code, k = self._code.second, basis.shape[1]
        entries = code.function(y)[0].ravel()[code.order] * self.scale[code.other]
        slopes = (
            sp.csr_array((entries, code.other, code.pointers), shape=(len(code.one), len(y)))
            @ basis
        )  # derivatives of the gradient's entries
        along = basis[code.one] * self.scale[code.one, None]
        used = along.any(axis=1) & slopes.any(axis=1)
        along, slopes, row = along[used], slopes[used], code.row[used]
        if not len(row):
            return np.zeros((weights.shape[1], k, k))
        first = np.flatnonzero(np.diff(row, prepend=-1))
        ends = np.append(first, len(row)).tolist()
        # row by row: the products of all rows at once leave the cache
        forms = np.concatenate(
            [
                np.add.reduceat(along[a:b, :, None] * slopes[a:b, None, :], [0], axis=0)
                for a, b in pairwise(ends)
            ]
        )
        every = np.zeros((self._code.count, weights.shape[1]))
        every[self._rows] = weights
        return np.asarray((every[row[first]].T @ forms.reshape(len(forms), -1)).reshape(-1, k, k))


class _Curvature(NamedTuple):
    """Sparse second derivatives of residuals as a CasADi Function.

    The derivatives form a sparse matrix. It has a row for each nonzero ∂r_row/∂y_one of the
    residuals' Jacobian, and a column for the unknown y_other of the second derivative.

    Attributes
    ----------
    function : ArrayFunction
        y → nonzeros of the matrix, column by column.
    order : ndarray of int
        Order that sorts the nonzeros by rows.
    row, one : ndarray of int
        Residual and unknown of each row of the matrix.
    other, pointers : ndarray of int
        Column of each sorted nonzero, and the first nonzero of each row (CSR format).
    """

    function: ArrayFunction
    order: Indices
    row: Indices
    one: Indices
    other: Indices
    pointers: Indices


class _Code:
    """Scaled residuals of y as CasADi Functions.

    `groups` are their expressions, see `RowFunction`.
    """

    def __init__(self, y: Any, groups: Sequence[Any]) -> None:
        self._y, scaled = y, ca.vertcat(*groups)
        self._slopes = [ca.jacobian(group, y) for group in groups]
        self.count = int(scaled.shape[0])
        self._last: tuple[Array, list[Array]] = (np.zeros(0), [])
        self.value = ArrayFunction(ca.Function("rows", [y], [ca.densify(scaled)]))
        self.first = ArrayFunction(
            ca.Function("rows", [y], [ca.densify(scaled), ca.densify(ca.vertcat(*self._slopes))])
        )

    def first_at(self, y: Array) -> list[Array]:
        """Compute the residuals and their Jacobian at y, once for repeated calls."""
        if not np.array_equal(self._last[0], y):
            self._last = y.copy(), self.first(y)
        return self._last[1]

    @cached_property
    def second(self) -> _Curvature:
        """Second derivatives of the residuals."""
        jacobian = ca.vertcat(*self._slopes).T  # by rows
        curvature = ca.vertcat(
            *(ca.jacobian(ca.densify(slopes.T.nz[:]), self._y) for slopes in self._slopes)
        )
        (one, row), (entry, other) = (
            np.array(part.sparsity().get_triplet(), dtype=np.intp).reshape(2, -1)
            for part in (jacobian, curvature)
        )
        order = np.argsort(entry, kind="stable")
        pointers = np.concatenate([[0], np.cumsum(np.bincount(entry, minlength=len(row)))])
        function = ArrayFunction(ca.Function("curvature", [self._y], [ca.densify(curvature.nz[:])]))
        return _Curvature(function, order, row, one, other[order], pointers)


@dataclass(frozen=True, eq=False)
class Reduction:
    """Independent combinations of goal rows.

    There are m rows and `rank` combinations.

    Attributes
    ----------
    combinations : ndarray, shape (rank, m)
        Coefficients of the rows in each combination, after division by their sizes.
    names : tuple of str
        Names of the rows.
    sizes : ndarray, shape (m,)
        Typical sizes of the rows [m or m/s], 1 for distances that replace singular lengths.
    repeated : dict of str to int
        Number of dropped combinations by reason: a kind of invariant, or "another" row.
    """

    combinations: Array
    names: tuple[str, ...] = ()
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    repeated: dict[str, int] = field(default_factory=dict)

    def keep(self, kept: Array, reason: str) -> Reduction:
        """Reduce to the combinations `kept` (k, rank) of the present ones.

        The number of the dropped ones is stored by reason.
        """
        missing = len(self.combinations) - len(kept)
        return replace(
            self, combinations=kept @ self.combinations, repeated={**self.repeated, reason: missing}
        )

    def join(self, other: Reduction) -> Reduction:
        """Join the combinations of two sets of rows."""
        own, more = self.repeated, other.repeated
        return Reduction(
            scipy.linalg.block_diag(self.combinations, other.combinations),
            self.names + other.names,
            np.append(self.sizes, other.sizes),
            {kind: own.get(kind, 0) + more.get(kind, 0) for kind in (*own, *more)},
        )


def reduce_rows(
    H: Array,
    groups: Sequence[tuple[str, Array]],
    names: tuple[str, ...] = (),
    sizes: Array | None = None,
) -> Reduction:
    """Find independent combinations of rows with Jacobian H (m, ny).

    `groups` are the gradients of the invariants by kind, each (·, ny). Combinations do not depend
    on them either. `names` and `sizes` (m,) are those of the rows; sizes are 1 by default.
    """
    norms = np.linalg.norm(H, axis=1)
    rows = H / np.maximum(norms, 1e-12)[:, None]
    left, values, _ = compute_block_svd(rows)
    repeated = {"another": len(H) - int(np.sum(values > RESOLUTION))}
    known = np.zeros((0, H.shape[1]))
    for kind, A in groups:
        before = int(np.sum(values > RESOLUTION))
        known = np.concatenate([known, _normalized(A)])
        left, values, _ = compute_block_svd(rows @ null_space(known, RESOLUTION))
        repeated[kind] = repeated.get(kind, 0) + before - int(np.sum(values > RESOLUTION))
    kept = values > RESOLUTION
    combinations = (left[:, : len(values)][:, kept] / values[kept]).T / np.maximum(norms, 1e-12)
    found = {kind: count for kind, count in repeated.items() if count}
    return Reduction(combinations, names, np.ones(len(H)) if sizes is None else sizes, found)


def soft_directions(
    rows: RowFunction, y: Array, rank_tolerance: float = RESOLUTION
) -> tuple[Array, Array, Array]:
    """Find directions constrained only to second order.

    At a prestressed equilibrium, string lengths determine the shape but their gradients do not.
    Returns scaled unit directions D (ny, k) outside the range of the gradients. Some combination of
    residuals with zero gradient (W (m, j)) has curvature along each of them. Also returns the
    curvatures (j, k, k) of these combinations on D. `rows` are the residuals of y (ny,). Singular
    values of the Jacobian, with rows of unit length, count as zero up to `rank_tolerance`.
    """
    _, J = rows(y)
    norms = np.linalg.norm(J, axis=1)
    used = norms > 1e-12
    left, singular, right = compute_block_svd(J[used] / norms[used, None])
    rank = int(np.sum(singular > rank_tolerance))
    W = np.zeros((len(J), left.shape[1] - rank))
    W[used] = left[:, rank:] / norms[used, None]
    F = right[rank:].T
    if not W.shape[1] or not F.shape[1]:
        return np.zeros((J.shape[1], 0)), W, np.zeros((W.shape[1], 0, 0))
    forms = rows.curvatures(y, W, F)
    stacked = forms.reshape(-1, F.shape[1])
    strength, vectors = np.linalg.eigh(stacked.T @ stacked)
    D = vectors[:, strength > RESOLUTION**2]
    return F @ D, W, np.asarray(D.T @ forms @ D)


def _normalized(A: Array) -> Array:
    norms = np.linalg.norm(A, axis=1, keepdims=True)
    return np.asarray(np.divide(A, norms, out=np.zeros_like(A), where=norms > 1e-9))
