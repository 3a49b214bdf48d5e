"""Tangent stiffness as a linear function of the force densities."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from tenscasadi.statics.self_stress import rigid_body_motions
from tenscasadi.statics.solver.motions import softest_motions
from tenscasadi.structure.equilibrium_matrix import free_directions, member_pairs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.constrained_eigenproblem import SaddlePoint
from tenscasadi.util.validate import Array


class TangentStiffness:
    """Tangent stiffness of a structure on its free directions.

    K(q) = Σ (k − q) u uᵀ + q I over strings and elastic bars, and q I over rigid bars, each between
    the ends of the member. u is the direction of the member, k its stiffness, q its force density.

    Attributes
    ----------
    structure : Structure
        The structure in its nodes.
    lengths : ndarray (α + β,)
        Lengths of members [m].
    stiffness : ndarray (α + β,)
        Stiffness k of members [N/m]; 0 for rigid bars, which are constraints J v = 0.
    J : csr_array (rigid bars, free coordinates)
        Elongation of rigid bars per displacement.
    rigid_body : ndarray (free coordinates, r)
        Orthonormal rigid-body motions that the supports allow.
    """

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        self.pairs = member_pairs(structure)
        vectors = structure.nodes[self.pairs[:, 1]] - structure.nodes[self.pairs[:, 0]]
        self.lengths = np.linalg.norm(vectors, axis=1)
        self.directions = vectors / self.lengths[:, None]
        self.rigid = len(structure.strings) + np.flatnonzero(~structure.elastic)
        bars = np.where(structure.elastic, structure.bar_stiffness, 0.0)
        self.stiffness = np.concatenate([structure.stiffness, bars])
        self.free = free_directions(structure)
        ends = (3 * self.pairs[:, :, None] + np.arange(3)).swapaxes(1, 2).reshape(-1)
        rows, count = np.arange(0, len(ends) + 1, 2), len(self.pairs)
        signs = np.tile([-1.0, 1.0], 3 * count)
        difference = sp.csr_array((signs, ends, rows), shape=(3 * count, structure.nodes.size))
        # displacement of the second end relative to the first (3 (α + β), free coordinates)
        self.relative = sp.csr_array(difference @ self.free)
        along = sp.csr_array(
            (self.directions.ravel(), np.arange(3 * count), 3 * np.arange(count + 1))
        )
        self.elongation = sp.csr_array(along @ self.relative)  # (α + β, free coordinates)
        self.J = sp.csr_array(self.elongation[self.rigid])
        self.rigid_body = self.free.T @ rigid_body_motions(structure)

    def at(self, q: Array, stiffness: Array | None = None) -> Any:
        """Compute the tangent stiffness K for given force densities.

        K (free coordinates, free coordinates) and q (α + β,) are in N/m. `stiffness` replaces that
        of all members.
        """
        k = self.stiffness if stiffness is None else stiffness
        along = np.where(self.stiffness > 0.0, k - q, 0.0)
        blocks = along[:, None, None] * self.directions[:, :, None] * self.directions[:, None, :]
        blocks = blocks + q[:, None, None] * np.eye(3)
        each = np.arange(len(q))
        members = sp.bsr_array((blocks, each, np.arange(len(q) + 1)))
        return sp.csc_array(self.relative.T @ sp.csr_array(members) @ self.relative)

    def reduce(self, motions: Array) -> tuple[Array, Array]:
        """Project the stiffness of each member onto motions.

        The motions are columns (free coordinates, r).

        Returns
        -------
        tuple of ndarray (α + β, r, r)
            Material stiffness per member stiffness k, and geometric stiffness per force density.
        """
        moved = (self.free @ motions).reshape(len(self.structure.nodes), 3, motions.shape[1])
        change = moved[self.pairs[:, 1]] - moved[self.pairs[:, 0]]
        along = np.einsum("ki,kij->kj", self.directions, change)
        material = along[:, :, None] * along[:, None, :]
        springs = self.stiffness[:, None, None] > 0.0
        return material, np.einsum("kdi,kdj->kij", change, change) - material * springs

    def softest(
        self, q: Array, count: int | None = None, stiffness: Array | None = None
    ) -> tuple[Array, Array]:
        """Compute the softest motions that keep rigid bars.

        Returns the lowest eigenvalues of K [N/m], and their motions.
        """
        return softest_motions(self.at(q, stiffness), self.J, self.rigid_body, count)

    @cached_property
    def freedom(self) -> int:
        """Number of independent motions that keep rigid bars.

        Rigid-body motions are left out.
        """
        held = np.concatenate([self.J.toarray(), self.rigid_body.T])
        return int(self.J.shape[1] - np.linalg.matrix_rank(held, tol=1e-9))

    def tension_change(self, q: Array, loads: Array) -> Array:
        """Compute the change of tensions (α + β, cases) [N].

        It is the linear response to loads (cases, n, 3) about the state with force densities q.
        Raises LinAlgError if K is singular.
        """
        if not self.free.shape[1]:
            return np.zeros((len(q), len(loads)))
        forces = self.free.T @ loads.reshape(len(loads), -1).T
        held = sp.vstack([self.J, sp.csr_array(self.rigid_body.T)], format="csr")
        motion, pull = SaddlePoint(self.at(q), held).solve(forces)
        change = self.stiffness[:, None] * (self.elongation @ motion)
        change[self.rigid] = pull[: len(self.rigid)]
        return np.asarray(change)


def extend_basis(basis: Array, more: Array) -> Array:
    """Extend an orthonormal basis by further columns.

    Only their components orthogonal to the basis are added.
    """
    outside = more - basis @ (basis.T @ more)
    left, sizes, _ = np.linalg.svd(outside, full_matrices=False)
    return np.hstack([basis, left[:, sizes > 1e-7]])
