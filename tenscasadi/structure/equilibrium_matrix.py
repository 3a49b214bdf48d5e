"""Equilibrium matrix of a structure.

Column i contains the forces on the free coordinates for a unit force density of member i: strings
first, then bars.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from tenscasadi.structure.class_one import connectivity
from tenscasadi.util.validate import Array, Indices


def member_pairs(structure: Any) -> Indices:
    """Return the end nodes of strings and bars."""
    return np.concatenate([structure.strings, structure.bars])


def equilibrium_matrix(structure: Any) -> Any:
    """Build the equilibrium matrix.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.

    Returns
    -------
    csc_array, shape (free coordinates, α + β)
        N K for a unit force density of each member [m].
    """
    pairs = member_pairs(structure)
    vectors = structure.nodes[pairs[:, 1]] - structure.nodes[pairs[:, 0]]
    vectors[len(structure.strings) :] *= -1  # λ > 0 is compression
    return sp.csc_array(
        free_directions(structure).T @ balance_columns(pairs, vectors, len(structure.nodes))
    )


def force_density_matrix(structure: Any, q: Array) -> Any:
    """Compute the force density matrix Cᵀ q̂ C (n, n) [N/m].

    The force densities q (α + β,) are positive in tension.
    """
    C = connectivity(member_pairs(structure), len(structure.nodes))
    return sp.csc_array(C.T @ sp.diags_array(q) @ C)


def balance_bars(structure: Any, gamma: Array, loads: Array | None = None) -> Array:
    """Compute the least-squares bar force densities.

    They balance the given string force densities and loads.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.
    gamma : ndarray, shape (α,)
        Force densities γ of the strings [N/m].
    loads : ndarray, shape (n, 3), optional
        Forces on the nodes [N].

    Returns
    -------
    ndarray, shape (β,)
        λ of least norm among those of the least unbalanced forces [N/m]; λ > 0 is compression.
    """
    from scipy.sparse.linalg import lsqr  # takes a while to load

    strings, bars = np.split(np.arange(len(gamma) + len(structure.bars)), [len(gamma)])
    matrix = equilibrium_matrix(structure)
    load = -(matrix[:, strings] @ gamma)
    if loads is not None:  # N K = W
        load = load + free_directions(structure).T @ loads.ravel()
    limit = 20 * (len(bars) + 10)
    return np.asarray(lsqr(matrix[:, bars], load, atol=1e-15, btol=1e-15, iter_lim=limit)[0])


def balance_columns(pairs: Indices, vectors: Array, count: int) -> sp.csc_array:
    """Build columns of vectors at the ends of members.

    They have −vector at the first node and +vector at the second.

    Parameters
    ----------
    pairs : ndarray of int, shape (m, 2)
        End nodes of the members.
    vectors : ndarray, shape (m, 3)
        Vector of each member.
    count : int
        Number n of nodes.

    Returns
    -------
    csc_array, shape (3n, m)
        The columns.
    """
    rows = 3 * pairs[:, :, None] + np.arange(3)
    values = np.stack([-vectors, vectors], axis=1)
    columns = np.repeat(np.arange(len(pairs)), 6)
    return sp.csc_array((values.ravel(), (rows.ravel(), columns)), shape=(3 * count, len(pairs)))


def free_directions(structure: Any) -> sp.csr_array:
    """Build an orthonormal basis of the admissible displacements.

    Parameters
    ----------
    structure : Structure
        The structure.

    Returns
    -------
    csr_array, shape (3n, free coordinates)
        The basis, node by node.

    Raises
    ------
    ValueError
        If the structure has bodies.
    """
    if structure.bodies:
        raise ValueError("bodies: statics and design have no rigid bodies: use tc.simulate")
    if not structure.rollers:
        return sp.eye_array(structure.fixed.size, format="csr")[:, np.flatnonzero(~structure.fixed)]
    blocks = [np.eye(3)[:, ~fixed] for fixed in structure.fixed]
    for node, normals in structure.rollers.items():
        blocks[node] = np.linalg.svd(np.array(normals))[2][len(normals) :].T
    return sp.csr_array(sp.block_diag(blocks))
