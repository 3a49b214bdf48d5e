"""Distances of nodes in place of lengths that are singular: they fix the shape of a prestressed structure, which its lengths do to second order."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ocp.targets.row_reduction import RANK
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices


def all_pairs(count: int) -> Indices:
    """Return all pairs (m, 2) of so many nodes."""
    return np.column_stack(np.triu_indices(count, 1))


def neighbours(structure: Structure) -> Indices:
    """Return the pairs (m, 2) of nodes that one member joins, or two in a row."""
    n, members = len(structure.nodes), np.concatenate([structure.bars, structure.strings])
    one = sp.coo_array((np.ones(len(members)), (members[:, 0], members[:, 1])), shape=(n, n))
    steps = sp.csr_array(one + one.T)
    return np.argwhere(np.triu((steps + steps @ steps).toarray(), 1) > 0)


def squared_distances(nodes: Array, pairs: Indices) -> Array:
    """Return the squared distances (m,) of pairs (m, 2) of nodes (n, 3)."""
    apart = nodes[pairs[:, 0]] - nodes[pairs[:, 1]]
    return np.asarray((apart * apart).sum(axis=1))


def feel(
    nodes: Array, moves: sp.csr_array, directions: Array, pairs: Indices
) -> tuple[Array, Array, Indices]:
    """Find rows that feel directions (ny, k) and no rigid motion, from the distances of pairs (m, 2) or, where these do not tell, of all nodes.

    moves: derivative (3n, ny) of the nodes (n, 3). Returns combinations (j, m) of squared
    distances, their gradients (j, ny), and the pairs.
    """
    moved = (moves @ directions).reshape(len(nodes), 3, -1)
    every = all_pairs(len(nodes))
    apart, weights = _felt(nodes, moved, pairs)
    if len(pairs) < len(every) and _rank(weights) < len(weights):
        more, others = _felt(nodes, moved, every)
        if _rank(weights) < _rank(others):
            pairs, apart, weights = every, more, others
    norms = np.linalg.norm(weights, axis=1, keepdims=True)
    weights = (weights / np.maximum(norms, 1e-12))[norms.ravel() > RANK * norms.max()]
    ends = sp.csr_array(
        (np.tile([1.0, -1.0], len(pairs)), (np.repeat(np.arange(len(pairs)), 2), pairs.ravel())),
        shape=(len(pairs), len(nodes)),
    )
    forces = np.stack([(ends.T @ (weights * along).T).T for along in apart.T], axis=2)
    return weights, (moves.T @ forces.reshape(len(weights), -1).T).T, pairs


def _felt(nodes: Array, moved: Array, pairs: Indices) -> tuple[Array, Array]:
    """Return twice the vectors (m, 3) between pairs of nodes, and how fast their squared distances change in each direction (k, m)."""
    apart = 2 * (nodes[pairs[:, 0]] - nodes[pairs[:, 1]])
    return apart, np.einsum("ma,mak->km", apart, moved[pairs[:, 0]] - moved[pairs[:, 1]])


def _rank(weights: Array) -> int:
    values = np.linalg.svd(weights, compute_uv=False)
    return int(np.sum(values > RANK * values[0]))
