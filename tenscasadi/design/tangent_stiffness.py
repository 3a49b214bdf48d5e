"""Tangent stiffness as a linear function of the force densities."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr

from tenscasadi.statics.self_stress import rigid_body_motions
from tenscasadi.statics.solver.constrained_eigenproblem import SaddlePoint
from tenscasadi.statics.solver.motions import softest_motions
from tenscasadi.statics.solver.sparse_pattern import MatrixEntries, SparsePattern
from tenscasadi.structure.cables import add_compliances, find_units
from tenscasadi.structure.class_one import member_vectors
from tenscasadi.structure.equilibrium_matrix import body_pairs, free_directions, member_pairs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import keep
from tenscasadi.util.validate import ROUNDING, Array, Indices

SOFTEST = 12  # softest motions added to a program at once


class TangentStiffness:
    """Tangent stiffness K(q) as a linear function of force densities q.

    K(q) = Σ k e eᵀ + Σ q (I − u uᵀ) over springs, and q I over rigid bars, each between the ends of
    the member. u is the direction of a member, q its force density, k the stiffness and e the
    elongation of a spring. A spring is a string, a cable as a whole, or an elastic bar. Massless
    rigid bars connect the nodes of bodies.

    Attributes
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    lengths : ndarray (μ,)
        Lengths of members [m]: α strings, β bars, and the bars of bodies.
    unit : ndarray of int (μ,)
        Unit of each member: cables and strings in no cable, bars, and the bars of bodies.
    stiffness : ndarray (units,)
        Stiffness k of units [N/m]; 0 for rigid bars, which are constraints J v = 0.
    elongation : csr_array (μ, free coordinates)
        Elongation of members per displacement.
    springs : csr_array (units, free coordinates)
        Elongation of units per displacement.
    J : csr_array (rigid bars, free coordinates)
        Elongation of rigid bars per displacement.
    rigid_body : ndarray (free coordinates, r)
        Orthonormal rigid-body motions that the supports allow.
    """

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        held = body_pairs(structure)
        self.pairs = np.concatenate([member_pairs(structure), held])
        vectors = member_vectors(structure.nodes, self.pairs)
        self.lengths = np.linalg.norm(vectors, axis=1)
        self.directions = vectors / self.lengths[:, None]
        own = find_units(structure)
        inputs = int(own.max(initial=-1)) + 1 - len(structure.bars)
        self.unit = np.append(own, inputs + len(structure.bars) + np.arange(len(held)))
        strings = structure.stiffness
        if structure.cables:
            strings = add_compliances(structure.cable_of, strings)
        elastic = np.where(structure.elastic, structure.bar_stiffness, 0.0)
        self.stiffness = np.concatenate([strings, elastic, np.zeros(len(held))])
        self.free = free_directions(structure, rigid=False)
        ends = (3 * self.pairs[:, :, None] + np.arange(3)).swapaxes(1, 2).reshape(-1)
        rows, count = np.arange(0, len(ends) + 1, 2), len(self.pairs)
        signs = np.tile([-1.0, 1.0], 3 * count)
        difference = sp.csr_array((signs, ends, rows), shape=(3 * count, structure.nodes.size))
        # displacement of the second end relative to the first (3 μ, free coordinates)
        self.relative = sp.csr_array(difference @ self.free)
        along = sp.csr_array(
            (self.directions.ravel(), np.arange(3 * count), 3 * np.arange(count + 1))
        )
        self.elongation = sp.csr_array(along @ self.relative)
        self.springs = self._add_units(self.elongation)
        rigid = np.append(~structure.elastic, np.ones(len(held), dtype=bool))
        self._rigid = inputs + np.flatnonzero(rigid)
        self.J = sp.csr_array(self.springs[self._rigid])
        self.rigid_body = self.free.T @ rigid_body_motions(structure)

    @property
    def held(self) -> int:
        """Number of massless bars that keep bodies rigid."""
        return len(self.pairs) - len(self.structure.strings) - len(self.structure.bars)

    def _add_units(self, rows: Any) -> sp.csr_array:
        """Sum the rows of a matrix (μ, ·) over the strings of each cable."""
        if not self.structure.cables:
            return rows
        each = np.arange(len(self.unit))
        sums = sp.csr_array((np.ones(len(each)), (self.unit, each)))
        return sp.csr_array(sums @ rows)

    def at(self, q: Array, stiffness: Array | None = None) -> Any:
        """Compute the tangent stiffness K for given force densities.

        K (free coordinates, free coordinates) and q (μ,) are in N/m. `stiffness` (units,) [N/m]
        replaces that of all units, which are cables, strings in no cable, and bars.
        """
        k = self.stiffness if stiffness is None else stiffness
        k = np.where(self.stiffness > 0.0, k, 0.0)
        along = np.where(self.stiffness > 0.0, 1.0, 0.0)[self.unit] * q
        return self._pattern.fill(np.concatenate([np.repeat(q, 3), -along, k]))

    @cached_property
    def _pattern(self) -> SparsePattern:
        """Sparsity of K, as a linear function of member weights."""
        rows = sp.csr_array(sp.vstack([self.relative, self.elongation, self.springs]))
        each = np.arange(rows.shape[0])
        squares = MatrixEntries(each, each, each, np.ones(len(each))).project(rows)
        return SparsePattern(squares, (rows.shape[1], rows.shape[1]), len(each))

    def reduce(self, motions: Array) -> tuple[Array, Array]:
        """Project the stiffness of each member onto given modes.

        The modes are columns of `motions` (free coordinates, r).

        Returns
        -------
        tuple of ndarray (units, r, r) and ndarray (μ, r, r)
            Material stiffness of units per stiffness k, and geometric stiffness of members per
            force density.
        """
        moved = (self.free @ motions).reshape(len(self.structure.nodes), 3, motions.shape[1])
        change = moved[self.pairs[:, 1]] - moved[self.pairs[:, 0]]
        along = np.einsum("ki,kij->kj", self.directions, change)
        along = along * (self.stiffness > 0.0)[self.unit, None]
        longer = self.springs @ motions
        material = longer[:, :, None] * longer[:, None, :]
        geometric = np.einsum("kdi,kdj->kij", change, change)
        return material, geometric - along[:, :, None] * along[:, None, :]

    def softest(
        self, q: Array, count: int | None = None, stiffness: Array | None = None
    ) -> tuple[Array, Array]:
        """Compute the softest modes that preserve the lengths of rigid bars.

        Returns the `count` smallest eigenvalues of K(q) [N/m], and their modes as columns; all by
        default. For q and `stiffness` see `at`.
        """
        return softest_motions(self.at(q, stiffness), self.J, self.rigid_body, count)

    def has_stiff_motions(self, q: Array) -> bool:
        """Return whether K is positive definite, by its inertia.

        The inertia, the numbers of positive and negative eigenvalues, follows from a factorization.
        K, at force densities q (μ,) [N/m], acts on displacements that preserve the lengths of rigid
        bars; a few fixed coordinates exclude rigid-body motions. The softest mode decides if
        rounding hides its stiffness from the inertia.
        """
        K, J = self.at(q)[self._others][:, self._others], self.J[:, self._others]
        zero = ROUNDING * float(np.abs(K.data).max(initial=0.0))
        with suppress(np.linalg.LinAlgError):
            shift = sp.diags_array(np.full(K.shape[0], zero))
            if K.nnz and SaddlePoint(K - shift, J).count_negative() == 0:
                return True
        return bool(self.softest(q, 1)[0].min(initial=np.inf) > zero)

    @cached_property
    def _others(self) -> Indices:
        """Indices of the free coordinates except a few.

        Fixing these few excludes rigid-body motions.
        """
        order = qr(self.rigid_body.T, mode="r", pivoting=True)[1]
        return np.sort(order[self.rigid_body.shape[1] :])

    def tension_change(self, q: Array, loads: Array) -> Array:
        """Compute the change of tensions (μ, cases) [N].

        It is the linear response to loads (cases, n, 3) about the state with force densities q.
        Raises LinAlgError if K is singular.
        """
        if not self.free.shape[1]:
            return np.zeros((len(q), len(loads)))
        forces = self.free.T @ loads.reshape(len(loads), -1).T
        held = sp.vstack([self.J, sp.csr_array(self.rigid_body.T)], format="csr")
        motion, pull = SaddlePoint(self.at(q), held).solve(forces)
        change = self.stiffness[:, None] * (self.springs @ motion)
        change[self._rigid] = pull[: len(self._rigid)]
        return np.asarray(change[self.unit])


def tangent_stiffness(structure: Structure) -> TangentStiffness:
    """Return the tangent stiffness of a structure, which caches it."""
    return keep(structure, "tangent_stiffness", lambda: TangentStiffness(structure))


def extend_basis(basis: Array, more: Array) -> Array:
    """Extend an orthonormal basis by further columns, `more`.

    Only their components orthogonal to the basis are added.
    """
    outside = more - basis @ (basis.T @ more)
    left, sizes, _ = np.linalg.svd(outside, full_matrices=False)
    return np.hstack([basis, left[:, sizes > 1e-7]])
