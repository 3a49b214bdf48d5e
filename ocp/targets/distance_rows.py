"""Distances between nodes that replace singular length constraints.

At a prestressed equilibrium, string lengths determine the shape only to second order. Other
distances determine it to first order.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.problem.rows import RESOLUTION
from tenscasadi.structure.body_assembly import connected_pairs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices


def list_neighbors(structure: Structure) -> Indices:
    """List the pairs (m, 2) of nodes connected by up to two members."""
    n, members = len(structure.nodes), connected_pairs(structure)
    one = sp.coo_array((np.ones(len(members)), (members[:, 0], members[:, 1])), shape=(n, n))
    steps = sp.csr_array(one + one.T)
    return np.argwhere(np.triu((steps + steps @ steps).toarray(), 1) > 0)


def squared_distances(nodes: Any, pairs: Indices) -> Any:
    """Compute the squared distances (m,) of pairs of nodes.

    Pairs are (m, 2), nodes (n, 3).
    """
    apart = nodes[pairs[:, 0].tolist(), :] - nodes[pairs[:, 1].tolist(), :]
    return ca.sum2(apart * apart) if isinstance(apart, ca.SX) else (apart * apart).sum(axis=1)


def find_distance_rows(
    nodes: Array, moves: sp.csr_array, directions: Array, pairs: Indices
) -> tuple[Array, Array, Indices]:
    """Find distances that change along given directions (ny, k).

    Distances are invariant to rigid-body motions. They are those of pairs (m, 2) of nodes, or of
    all pairs if these are not sufficient. `moves` is the Jacobian (3n, ny) of the nodes (n, 3).
    Returns combinations (j, m) of squared distances, their gradients (j, ny), and the pairs.
    """
    moved = (moves @ directions).reshape(len(nodes), 3, -1)
    every = np.column_stack(np.triu_indices(len(nodes), 1))
    apart, weights = _differentiate(nodes, moved, pairs)
    if len(pairs) < len(every) and _rank(weights) < len(weights):
        more, others = _differentiate(nodes, moved, every)
        if _rank(weights) < _rank(others):
            pairs, apart, weights = every, more, others
    norms = np.linalg.norm(weights, axis=1, keepdims=True)
    weights = (weights / np.maximum(norms, 1e-12))[norms.ravel() > RESOLUTION * norms.max()]
    ends = sp.csr_array(
        (np.tile([1.0, -1.0], len(pairs)), (np.repeat(np.arange(len(pairs)), 2), pairs.ravel())),
        shape=(len(pairs), len(nodes)),
    )
    forces = np.stack([(ends.T @ (weights * along).T).T for along in apart.T], axis=2)
    return weights, (moves.T @ forces.reshape(len(weights), -1).T).T, pairs


def _differentiate(nodes: Array, moved: Array, pairs: Indices) -> tuple[Array, Array]:
    """Compute the derivatives of squared distances along directions.

    Returns twice the vectors (m, 3) between pairs of nodes, and the derivatives (k, m). `moved` (n,
    3, k) are the directions.
    """
    apart = 2 * (nodes[pairs[:, 0]] - nodes[pairs[:, 1]])
    return apart, np.einsum("ma,mak->km", apart, moved[pairs[:, 0]] - moved[pairs[:, 1]])


def _rank(weights: Array) -> int:
    values = np.linalg.svd(weights, compute_uv=False)
    return int(np.sum(values > RESOLUTION * values[0]))
