"""Linear system of Newton's method for static equations.

    [[K + σ I, Jᵀ], [J, 0]] [p, δt] = [f, g]

K is the symmetric tangent stiffness on the free coordinates, with the geometric stiffness of rigid
bars, and J the derivative of their lengths.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tenscasadi.statics.solver.sparse_pattern import MatrixEntries, SparsePattern, join_entries
from tenscasadi.statics.solver.static_equations import StaticEquations, StaticPoint
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import ROUNDING, Array, Indices

COMPLIANCE = 1e-8  # of rigid bars, relative to 1/stiffness: keeps pivots of redundant bars nonzero


class NewtonSystem:
    """Assembly and factorization of Newton's linear systems.

    All have the same sparsity pattern.

    Parameters
    ----------
    equations : StaticEquations
        The static equations.
    """

    def __init__(self, equations: StaticEquations) -> None:
        self.equations = equations
        pairs = np.concatenate([equations.spring_pairs, equations.rigid_pairs])
        self.size, self.rigid = int(equations.free.shape[1]), len(equations.rigid_pairs)
        rows, columns = equations.load_pattern
        self._first_load = 9 * (len(pairs) + len(equations.coupled))
        self._first_direction = self._first_load + len(rows)
        self._sources = self._first_direction + 3 * self.rigid + 2  # then the shift and the slack
        loads = MatrixEntries(rows, columns, np.arange(len(rows)), -np.ones(len(rows)))
        coupling = coupling_entries(equations.spring_pairs, equations.coupled)
        members = join_entries(member_entries(pairs), coupling.shift(source=9 * len(pairs)))
        self._members = members.project(equations.free)
        self._loads = loads.shift(source=self._first_load).project(equations.free)
        lengthening = direction_entries(equations.rigid_pairs).multiply_basis(equations.free)
        self._lengthening = lengthening.shift(source=self._first_direction)

    # --- matrices in numbers ---

    def tangent(self, point: StaticPoint, tension: Array) -> Any:
        """Build the tangent stiffness K (free × free), sparse and symmetric.

        It is that at a point with tensions (rigid bars,) [N].
        """
        return self._tangent.fill(self._values(point, tension))

    def member_matrix(self, gamma: Array, along: Array, vectors: Array) -> Any:
        """Assemble a stiffness matrix (free × free) from member blocks.

        Blocks γ I + c v vᵀ are those of springs (strings and elastic bars), then of rigid bars.
        `gamma` (m,) contains γ, `along` (m,) c, and `vectors` (m, 3) v.
        """
        values = np.zeros(self._first_load)
        values[: 9 * len(gamma)] = member_blocks(gamma, along, vectors).ravel()
        return self._only_members.fill(values)

    def load_tangent(self, point: StaticPoint) -> Any:
        """Build the unsymmetric stiffness matrix due to loads.

        It is (free × free).
        """
        return self._load_tangent.fill(self._values(point, np.zeros(self.rigid)))

    def is_symmetric(self, point: StaticPoint) -> bool:
        """Return whether the stiffness due to loads is symmetric.

        It is symmetric for loads with an energy.
        """
        if not self.equations.follows:
            return True
        part = self.load_tangent(point)
        return bool(abs(part).max() <= 1e-12 * np.abs(point.load_slopes).max(initial=0.0))

    def lengthening(self, point: StaticPoint) -> Any:
        """Build the sparse Jacobian J (rigid bars × free) of bar lengths at a point."""
        return self._jacobian.fill(self._values(point, np.zeros(self.rigid)))

    def nodal_material(self, point: StaticPoint) -> sp.csr_array:
        """Build the material stiffness (3n × 3n) at a point.

        It is due to the change of the magnitude of spring forces.
        """
        pairs = self.equations.spring_pairs
        coupled = self.equations.coupled
        blocks = np.concatenate(
            [
                member_blocks(np.zeros(len(pairs)), 2 * point.slope, point.springs),
                coupling_blocks(point, coupled),
            ]
        )
        size = point.nodes.size
        coupling = coupling_entries(pairs, coupled).shift(source=9 * len(pairs))
        entries = join_entries(member_entries(pairs), coupling)
        pattern = SparsePattern(entries, (size, size), blocks.size)
        return sp.csr_array(pattern.fill(blocks.ravel()))

    def nodal_loads(self, point: StaticPoint) -> sp.csr_array:
        """Build the symmetric load stiffness (3n × 3n).

        It is the symmetric part of the stiffness of loads that depend on the nodes.
        """
        size = point.nodes.size
        rows, columns = self.equations.load_pattern
        slopes = sp.coo_array((-0.5 * point.load_slopes, (rows, columns)), shape=(size, size))
        return sp.csr_array(slopes + slopes.T)

    def stiffness_scale(self, point: StaticPoint, tension: Array) -> float:
        """Estimate the largest stiffness [N/m] at a point.

        `tension` (rigid bars,) is in N.
        """
        squared = np.einsum("ij,ij->i", point.springs, point.springs)
        largest = [
            np.abs(point.gamma) + np.abs(2 * point.slope * squared),
            np.abs(tension / self.equations.lengths),
            np.abs(point.load_slopes),
        ]
        scale = max(float(values.max(initial=0.0)) for values in largest)
        size = measure_extent(point.nodes) or 1.0
        return scale or float(np.abs(point.applied).max(initial=0.0)) / size or 1.0

    def factor(
        self, point: StaticPoint, tension: Array, scale: float, shift: float = 0.0
    ) -> NewtonFactors:
        """Factorize the system with K + σ I.

        Parameters
        ----------
        point : StaticPoint
            Point at which K and J are evaluated.
        tension : ndarray, shape (β_r,)
            Tensions of rigid bars [N].
        scale : float
            The largest stiffness [N/m].
        shift : float
            σ [N/m].

        Returns
        -------
        NewtonFactors
            The factors.

        Raises
        ------
        LinAlgError
            If a pivot is zero.
        """
        values = self._values(point, tension, penalty=scale)
        values[-2:] = shift, -COMPLIANCE / scale
        order, pattern = self._ordered
        return NewtonFactors(pattern.fill(values), order, self.size, scale, COMPLIANCE / scale)

    def solve_unsymmetric(
        self, point: StaticPoint, tension: Array, f: Array, g: Array
    ) -> tuple[Array, Array]:
        """Solve the linear system with an unsymmetric tangent stiffness.

        It is that of loads without an energy.

        Parameters
        ----------
        point : StaticPoint
            Point at which K and J are evaluated.
        tension : ndarray, shape (β_r,)
            Tensions of rigid bars [N].
        f, g : ndarray, shape (free,), (β_r,)
            Forces [N], and lengthening of rigid bars [m].

        Returns
        -------
        tuple of ndarray
            Displacements (free,) [m] and multipliers (β_r,) [N].

        Raises
        ------
        LinAlgError
            If the matrix is singular.
        """
        K = self.tangent(point, tension) + self.load_tangent(point)
        J, scale = self.lengthening(point), self.stiffness_scale(point, tension)
        slack = sp.diags_array(np.full(self.rigid, -COMPLIANCE / scale))
        shift = sp.diags_array(np.full(self.size, ROUNDING * scale))
        try:
            factors = splu(sp.csc_array(sp.block_array([[K + shift, J.T], [J, slack]])))
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from None
        return tuple(np.split(factors.solve(np.concatenate([f, g])), [self.size]))  # type: ignore[return-value]

    def factor_bars(self, bars: Array) -> NewtonFactors:
        """Factorize the system with K = I.

        Its solutions are minimum-norm displacements and least-squares tensions.

        Parameters
        ----------
        bars : ndarray, shape (β_r, 3)
            Vectors of rigid bars [m].

        Returns
        -------
        NewtonFactors
            The factors.
        """
        values = np.zeros(self._sources)
        values[self._first_direction : -2] = (bars / self.equations.lengths[:, None]).ravel()
        values[-2:] = 1.0, -COMPLIANCE
        order, pattern = self._ordered
        return NewtonFactors(pattern.fill(values), order, self.size, 0.0, COMPLIANCE)

    def _values(self, point: StaticPoint, tension: Array, penalty: float = 0.0) -> Array:
        """Stack the values whose linear combinations form all matrices.

        They are those at a point with tensions (rigid bars,) [N]. A penalty on the lengths of rigid
        bars makes pivots larger. It does not change the solutions.
        """
        units = point.bars / self.equations.lengths[:, None]
        gamma = np.concatenate([point.gamma, tension / self.equations.lengths])
        along = np.concatenate([2 * point.slope, np.full(self.rigid, penalty)])
        vectors = np.concatenate([point.springs, units])
        values = np.zeros(self._sources)
        blocks = (
            member_blocks(gamma, along, vectors),
            coupling_blocks(point, self.equations.coupled),
        )
        values[: self._first_load] = np.concatenate(blocks).ravel()
        values[self._first_load : self._first_direction] = point.load_slopes
        values[self._first_direction : -2] = units.ravel()
        return values

    # --- patterns ---

    @cached_property
    def _symmetric(self) -> MatrixEntries:
        half = self._loads.scale(0.5)
        return join_entries(self._members, half, half.transpose())

    @cached_property
    def _tangent(self) -> SparsePattern:
        return SparsePattern(self._symmetric, (self.size, self.size), self._sources)

    @cached_property
    def _only_members(self) -> SparsePattern:
        return SparsePattern(self._members, (self.size, self.size), self._first_load)

    @cached_property
    def _load_tangent(self) -> SparsePattern:
        half = self._loads.scale(0.5)
        entries = join_entries(half, half.transpose().scale(-1.0))
        return SparsePattern(entries, (self.size, self.size), self._sources)

    @cached_property
    def _jacobian(self) -> SparsePattern:
        return SparsePattern(self._lengthening, (self.rigid, self.size), self._sources)

    @cached_property
    def _ordered(self) -> tuple[Indices, SparsePattern]:
        """Order of elimination, and the sparsity pattern in this order.

        The order is the position of each unknown. The pattern has the nonzeros of the Newton matrix
        in this order.
        """
        size, total = self.size, self.size + self.rigid
        bars = self._lengthening.shift(row=size)
        diagonal = np.arange(total)
        source = np.where(diagonal < size, self._sources - 2, self._sources - 1)
        entries = join_entries(
            self._symmetric,
            bars,
            bars.transpose(),
            MatrixEntries(diagonal, diagonal, source, np.ones(total)),
        )
        order = elimination_order(self._tangent, self._jacobian)
        moved = entries._replace(row=order[entries.row], column=order[entries.column])
        return order, SparsePattern(moved, (total, total), self._sources)


class NewtonFactors:
    """Factorization of Newton's linear system.

    Parameters
    ----------
    matrix : csc_array
        The system in the order of elimination, with a penalty and a compliance of rigid bars.
    order : ndarray of int
        Position of each unknown in this order.
    size : int
        Number of free coordinates.
    penalty, slack : float
        Penalty [N/m] and compliance [m/N] of rigid bars in the matrix.
    """

    def __init__(
        self, matrix: Any, order: Indices, size: int, penalty: float, slack: float
    ) -> None:
        self.matrix, self.order, self.size = matrix, order, size
        self.penalty, self.slack = penalty, slack
        try:
            self.factors = splu(matrix, "NATURAL", 0.0, options={"SymmetricMode": True})
        except RuntimeError as error:  # a pivot is zero
            raise np.linalg.LinAlgError(str(error)) from None

    @property
    def rigid(self) -> int:
        """Number of rigid bars."""
        return len(self.order) - self.size

    def count_negative(self, left_out: Array | None = None) -> int:
        """Count the negative eigenvalues of the constrained stiffness.

        It is K + σ I on displacements that preserve the lengths of rigid bars and are orthogonal to
        `left_out` (free, r). By Sylvester's law of inertia, the count is the number of negative
        pivots minus the number of rigid bars. `left_out` are further constraints, by Haynsworth's
        formula. Raises LinAlgError if pivoting moved a pivot off the diagonal.
        """
        if not np.array_equal(self.factors.perm_r, self.factors.perm_c):
            raise np.linalg.LinAlgError("a pivot left the diagonal")
        below = int((self.factors.U.diagonal() < 0.0).sum()) - self.rigid
        if left_out is None or not left_out.size:
            return below
        target = np.zeros((len(self.order), left_out.shape[1]))
        target[self.order[: self.size]] = left_out
        flexibility = target.T @ self.factors.solve(target)
        positive = int((np.linalg.eigvalsh(flexibility) > 0.0).sum())
        return below + positive - int(left_out.shape[1])

    def solve(self, f: Array, g: Array | None = None) -> tuple[Array, Array]:
        """Solve for displacements p (free,) and tensions (β_r,).

        Parameters
        ----------
        f : ndarray, shape (free,)
            Forces [N].
        g : ndarray, shape (β_r,), optional
            Lengthening of rigid bars [m]; by default none.

        Returns
        -------
        tuple of ndarray
            p [m] and the multipliers [N].
        """
        bars = self.order[self.size :]
        target = np.zeros(len(self.order)) if g is None else self._load_bars(g)
        target[self.order[: self.size]] += f
        x = self.factors.solve(target)
        # two refinements leave COMPLIANCE² of its effect, less than rounding
        for _ in range(2 if self.rigid else 0):
            rest = target - self.matrix @ x
            rest[bars] -= self.slack * x[bars]
            x = x + self.factors.solve(rest)
        return x[self.order[: self.size]], x[bars]

    def lengthen(self, g: Array) -> Array:
        """Solve for displacements (free,) that lengthen rigid bars.

        The elongations g are (β_r,) [m]. Without refinement, the relative error is `COMPLIANCE`
        times the condition number. It is meant for iterations that correct their errors.
        """
        return np.asarray(self.factors.solve(self._load_bars(g))[self.order[: self.size]])

    def _load_bars(self, g: Array) -> Array:
        """Build the right-hand side for given elongations of rigid bars.

        They are g (rigid bars,) [m]. The penalty acts on them, too.
        """
        target = self.penalty * (self._bar_columns @ g)
        target[self.order[self.size :]] = g
        return np.asarray(target)

    @cached_property
    def _bar_columns(self) -> Any:
        return self.matrix[:, self.order[self.size :]]


def member_blocks(gamma: Array, along: Array, vectors: Array) -> Array:
    """Compute the stiffness blocks (m, 3, 3) of members.

    A block is γ I + c v vᵀ, with the force density γ = `gamma` (m,), c = `along` (m,) and the
    vector v of the member.
    """
    blocks = (along[:, None] * vectors)[:, :, None] * vectors[:, None, :]
    blocks[:, range(3), range(3)] += gamma[:, None]
    return np.asarray(blocks)


def member_entries(pairs: Indices) -> MatrixEntries:
    """Build the sparse pattern (3n × 3n) of member stiffness blocks.

    `pairs` (m, 2) are the members' nodes. Values are the blocks (3, 3) of the members, one after
    the other.
    """
    first, second = 3 * pairs.T[:, :, None, None]
    a, b = np.arange(3)[:, None], np.arange(3)
    source = np.broadcast_to(np.arange(9 * len(pairs)).reshape(-1, 3, 3), (len(pairs), 3, 3))
    parts = [
        MatrixEntries(
            *(
                np.broadcast_to(value, source.shape).ravel()
                for value in (row + a, column + b, source, np.array(sign))
            )
        )
        for row, column, sign in (
            (first, first, 1.0),
            (second, second, 1.0),
            (first, second, -1.0),
            (second, first, -1.0),
        )
    ]
    return join_entries(*parts)


def coupling_blocks(point: StaticPoint, coupled: Indices) -> Array:
    """Compute stiffness blocks (k, 3, 3) between a cable's strings.

    `coupled` (k, 2) are pairs i, j of strings. A block is 2 (∂γ_i/∂s_j²) s_i s_jᵀ for the string
    vectors s at a point.
    """
    first, second = point.springs[coupled[:, 0]], point.springs[coupled[:, 1]]
    return np.asarray((2 * point.coupling[:, None] * first)[:, :, None] * second[:, None, :])


def coupling_entries(pairs: Indices, coupled: Indices) -> MatrixEntries:
    """Build the sparse pattern (3n × 3n) of blocks between two members.

    `pairs` (m, 2) are the members' nodes, and `coupled` (k, 2) the pairs of members. Values are the
    blocks (3, 3), one after the other. The matrix is symmetric.
    """
    one, other = 3 * pairs[coupled.T]  # (coupled, ends)
    source = np.arange(9 * len(coupled)).reshape(-1, 3, 3)
    a, b = np.arange(3)[:, None], np.arange(3)
    parts = [
        MatrixEntries(
            (one[:, i, None, None] + a + 0 * b + 0 * source).ravel(),
            (other[:, j, None, None] + 0 * a + b + 0 * source).ravel(),
            source.ravel(),
            np.full(source.size, 1.0 if i == j else -1.0),
        )
        for i in (0, 1)
        for j in (0, 1)
    ]
    half = join_entries(*parts)
    return join_entries(half, half.transpose())


def direction_entries(pairs: Indices) -> MatrixEntries:
    """Build the sparse pattern (m × 3n) of member elongations.

    `pairs` (m, 2) are the members' nodes. Values are the unit vectors (3,) of the members.
    """
    item = np.repeat(np.arange(len(pairs)), 3)
    source = np.arange(3 * len(pairs))
    axis = np.tile(np.arange(3), len(pairs))
    return join_entries(
        *(
            MatrixEntries(item, 3 * pairs[item, end] + axis, source, np.full(len(source), sign))
            for end, sign in ((0, -1.0), (1, 1.0))
        )
    )


def elimination_order(tangent: SparsePattern, jacobian: SparsePattern) -> Indices:
    """Compute a fill-reducing order of elimination.

    It is for the tangent stiffness bordered by the `jacobian` of bar lengths. Returns the position
    of each unknown. Each bar follows the coordinates of its ends, as its own pivot is only its
    compliance.
    """
    size = tangent.shape[0]
    values = np.random.default_rng(0).uniform(0.0, 1e-3, size=len(tangent.indices))
    sample = sp.csc_array((values, tangent.indices, tangent.indptr), shape=tangent.shape)
    sample = sp.csc_array(sample + sample.T + sp.eye_array(size))
    place = np.zeros(0)
    if size:
        place = splu(sample, "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True}).perm_c
    columns = np.repeat(np.arange(size), np.diff(jacobian.indptr))
    after = np.zeros(jacobian.shape[0])
    np.maximum.at(after, jacobian.indices, place[columns] + 0.5)
    order = np.empty(size + len(after), dtype=np.intp)
    order[np.argsort(np.concatenate([place, after]), kind="stable")] = np.arange(len(order))
    return order
