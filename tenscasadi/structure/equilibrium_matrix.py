"""Equilibrium matrix of a structure.

Column i contains the forces on the free coordinates for a unit force density of member i: strings
first, then bars.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from tenscasadi.structure.class_one import connectivity, member_vectors
from tenscasadi.util.validate import Array, Indices


def member_pairs(structure: Any) -> Indices:
    """Return the end nodes (α + β, 2) of strings, then of bars."""
    return np.concatenate([structure.strings, structure.bars])


def body_pairs(structure: Any) -> Indices:
    """Return the end nodes of the massless bars that keep bodies rigid.

    Bars to auxiliary nodes are omitted.
    """
    if structure._assembly is None:
        return np.zeros((0, 2), dtype=np.intp)
    bars: Indices = structure._assembly.bars
    return bars[(bars < len(structure.nodes)).all(axis=1)]


def equilibrium_matrix(structure: Any) -> Any:
    """Build the equilibrium matrix.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.

    Returns
    -------
    csc_array, shape (free coordinates, α + β)
        Forces N K (3×n) along the free coordinates for a unit force density of each member [m].
    """
    pairs = member_pairs(structure)
    vectors = member_vectors(structure.nodes, pairs)
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
        The structure, evaluated at its nodes.
    gamma : ndarray, shape (α,)
        Force densities γ of the strings [N/m].
    loads : ndarray, shape (n, 3), optional
        Forces on the nodes [N].

    Returns
    -------
    ndarray, shape (β,)
        Least-norm λ among those with the smallest unbalanced forces [N/m]; λ > 0 is compression.
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
    """Build member forces on nodes as columns (3n, members).

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


def free_directions(structure: Any, rigid: bool = True) -> sp.csr_array:
    """Build an orthonormal basis of the admissible displacements.

    Parameters
    ----------
    structure : Structure
        The structure.
    rigid : bool
        Whether bodies are rigid to first order in the structure's nodes. Otherwise only their
        dependent nodes follow the others.

    Returns
    -------
    csr_array, shape (3n, free coordinates)
        The basis, node by node.
    """
    base = support_directions(structure)
    bodies = structure._assembly
    if bodies is None:
        return base
    count = len(structure.nodes)
    moves = sp.csc_array(sp.kron(bodies.spread[:count, :count], sp.eye_array(3)) @ base)
    moves = moves[
        :, np.flatnonzero(np.diff(moves.indptr))
    ]  # dependent nodes have none of their own
    own = np.unique(np.concatenate([body.nodes for body in structure.bodies]))
    rows = (3 * own[:, None] + np.arange(3)).ravel()
    inside = moves[rows]
    touched = np.flatnonzero(np.diff(inside.indptr))
    block = inside[:, touched].toarray()
    if rigid:
        bars = body_pairs(structure)
        units = member_vectors(structure.nodes, bars)
        units = units / np.linalg.norm(units, axis=1)[:, None]
        lengthening = balance_columns(bars, units, count).T[:, rows] @ block
        _, sizes, right = np.linalg.svd(lengthening)
        block = block @ right[int(np.sum(sizes > 1e-9 * sizes.max(initial=0.0))) :].T
    basis = np.linalg.qr(block)[0]
    select = sp.csr_array(
        (np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(3 * count, len(rows))
    )
    others = np.setdiff1d(np.arange(moves.shape[1]), touched)
    return sp.csr_array(sp.hstack([moves[:, others], select @ sp.csr_array(basis)]))


def support_directions(structure: Any) -> sp.csr_array:
    """Build an orthonormal basis of the displacements that supports allow.

    It has shape (3n, free coordinates), node by node. Bodies are ignored.
    """
    if not structure.rollers:
        return sp.eye_array(structure.fixed.size, format="csr")[:, np.flatnonzero(~structure.fixed)]
    blocks = [np.eye(3)[:, ~fixed] for fixed in structure.fixed]
    for node, normals in structure.rollers.items():
        blocks[node] = np.linalg.svd(np.array(normals))[2][len(normals) :].T
    return sp.csr_array(sp.block_diag(blocks))
