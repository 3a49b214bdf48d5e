"""Super-stability of structures.

Super-stable structures are stable for all levels of prestress and all stiffnesses of members.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import orth
from scipy.sparse.linalg import splu

from tenscasadi.statics.self_stress import idle_combinations, rigid_body_motions
from tenscasadi.structure.cables import density_basis
from tenscasadi.structure.class_one import member_vectors
from tenscasadi.structure.equilibrium_matrix import (
    balance_columns,
    free_directions,
    member_pairs,
)
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, Array


def is_super_stable(structure: Structure, density: Any) -> bool:
    """Return whether a structure is super-stable.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    density : sparse array, shape (n, n)
        Force density matrix [N/m].

    Returns
    -------
    bool
        Whether three conditions hold, and there are no bodies. The matrix is positive semidefinite on the motions that
        supports allow. Its null space contains affine motions only. Among these, only rigid-body
        motions keep all lengths.
    """
    if structure.bodies:
        return False
    free = free_directions(structure)
    K = sp.csc_array(free.T @ sp.kron(density, sp.eye_array(3)) @ free)
    affine = affine_motions(structure)
    pairs = member_pairs(structure)
    vectors = member_vectors(structure.nodes, pairs)
    units = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    lengthening = balance_columns(pairs, units, len(structure.nodes)).T @ affine
    lengthening = abs(density_basis(structure)).sign().T @ lengthening  # of cables as a whole
    if (
        idle_combinations(affine, lengthening, NEGLIGIBLE).shape[1]
        > rigid_body_motions(structure).shape[1]
    ):
        return False
    flat = ROUNDING * (float(np.abs(density.data).max(initial=0.0)) or 1.0)
    return count_below(K, -flat) == 0 and count_below(K, flat) == affine.shape[1]


def affine_motions(structure: Structure) -> Array:
    """Compute a basis (3n, ·) of affine displacements of the nodes.

    They are those that pins and rollers allow.
    """
    arms = structure.nodes - structure.nodes.mean(axis=0)
    arms = np.column_stack([np.ones(len(arms)), arms / (np.abs(arms).max(initial=0.0) or 1.0)])
    fields = orth(np.kron(arms, np.eye(3)), rcond=NEGLIGIBLE)
    free = free_directions(structure)
    return idle_combinations(fields, fields - free @ (free.T @ fields), NEGLIGIBLE)


def count_below(matrix: Any, value: float) -> int:
    """Count the eigenvalues of a sparse symmetric matrix below a value.

    The count is the inertia of the shifted matrix.
    """
    size = matrix.shape[0]
    if not size:
        return 0
    shifted = sp.csc_array(matrix - value * sp.eye_array(size))
    try:
        factors = splu(shifted, "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
        if np.array_equal(factors.perm_r, factors.perm_c):
            return int((factors.U.diagonal() < 0.0).sum())
    except RuntimeError:  # a pivot is zero
        pass
    return int((np.linalg.eigvalsh(shifted.toarray()) < 0.0).sum())
