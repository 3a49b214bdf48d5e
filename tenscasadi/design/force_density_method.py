"""Force-density method and adaptive force-density method.

The first finds forms of given force densities, the second force densities that have a form.
The equilibrium Cᵀ q̂ C X = P is linear in the nodes X (n, 3) for given force densities q [1]_. A
free-standing structure has a form only if the force-density matrix D = Cᵀ q̂ C has rank n − d − 1,
where d is the dimension of the structure [2]_.

References
----------
.. [1] H.-J. Schek, The force density method for form finding and computation of general networks,
   Computer Methods in Applied Mechanics and Engineering 3 (1974), 115-134.
.. [2] J. Y. Zhang and M. Ohsaki, Adaptive force density method for form-finding problem of
   tensegrity structures, International Journal of Solids and Structures 43 (2006), 5658-5673.
"""

from __future__ import annotations

import warnings

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import MatrixRankWarning, spsolve

from tenscasadi.design.conic import LinearRows, solve_conic
from tenscasadi.design.force_densities import ForceDensities
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.equilibrium_matrix import (
    equilibrium_matrix,
    force_density_matrix,
    free_directions,
    member_pairs,
)
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_ITERATIONS, NEGLIGIBLE, Array

_SMALLEST = 0.05  # lower limit of string force densities in the estimate, relative to their mean
_PULL = 1e-3  # weight of equal force densities in the estimate, relative to that of equilibrium


def solve_form(structure: Structure, q: Array, loads: Array) -> Array | None:
    """Compute the nodes (n, 3) in equilibrium for given force densities.

    `q` (α + β,) are the force densities [N/m], and the loads are (n, 3) [N]. Returns None if
    supports and force densities do not determine the nodes.
    """
    free = free_directions(structure)
    D = sp.kron(force_density_matrix(structure, q), sp.eye_array(3), format="csr")
    held = (structure.nodes.ravel() - free @ (free.T @ structure.nodes.ravel())).ravel()
    matrix = sp.csc_array(free.T @ D @ free)
    if not matrix.shape[0]:
        return np.array(structure.nodes)
    right = free.T @ (loads.ravel() - D @ held)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatrixRankWarning)
        y = spsolve(matrix, right)
    size = float(np.abs(structure.nodes).max(initial=0.0)) + float(np.abs(right).max(initial=0.0))
    if not np.all(np.isfinite(y)) or np.abs(y).max(initial=0.0) > 1e9 * (size or 1.0):
        return None
    return np.asarray((held + free @ y).reshape(-1, 3))


def estimate_force_densities(structure: Structure, densities: ForceDensities) -> Array:
    """Estimate the unknown force densities p (u,).

    They minimize the unbalanced forces at the nodes of the structure, with strings in tension. If
    the minimum is not unique, the estimate is near equal force densities.
    """
    strings, unknown = len(structure.strings), len(densities.lower)
    A = equilibrium_matrix(structure) @ sp.diags_array(
        np.where(np.arange(len(densities.given)) < strings, 1.0, -1.0)
    )
    B = sp.csc_array(A @ densities.basis)
    target = densities.scale * np.where(np.isfinite(densities.lower), 1.0, -1.0)
    weight = _PULL * float(sp.linalg.norm(B)) ** 2 / max(unknown, 1)
    P = sp.csc_array(B.T @ B + weight * sp.eye_array(unknown))
    bounded = np.flatnonzero(np.isfinite(densities.lower))
    below = LinearRows(
        -sp.eye_array(unknown, format="csr")[bounded],
        np.full(len(bounded), -_SMALLEST * densities.scale),
    )
    none = LinearRows(sp.csc_array((0, unknown)), np.zeros(0))
    cost = B.T @ (A @ densities.given) - weight * target
    p = solve_conic(cost, none, below, P).x
    total = densities.of(p)[:strings].sum()
    return np.asarray(p if densities.has_scale or not total else p * (strings / total))


def adapt_force_densities(
    structure: Structure, densities: ForceDensities, start: Array, near: bool
) -> tuple[Array, Array] | None:
    """Find force densities for which an unsupported structure has a form.

    Its force-density matrix D then has rank n − d − 1. In each step, Newton's method makes D vanish
    to first order on d + 1 of its eigenvectors. These are the eigenvectors nearest to the span of
    the structure's coordinates (`near`), or those of the smallest eigenvalues. `start` (u,) is the
    initial guess of the unknown force densities p [N/m].

    Returns
    -------
    tuple of ndarray, or None
        The nodes (n, 3) nearest to those of the structure in the null space of D, and p (u,). None
        if the method does not converge, or a string would be in compression.
    """
    members, strings = len(densities.given), len(structure.strings)
    C = connectivity(member_pairs(structure), len(structure.nodes))
    own = _coordinate_space(structure.nodes)
    count = own.shape[1]
    upper = np.triu_indices(count)
    total = np.asarray(densities.basis.T @ (np.arange(members) < strings))
    p = start
    for _ in range(MAX_ITERATIONS):
        values, vectors = np.linalg.eigh(force_density_matrix(structure, densities.of(p)).toarray())
        chosen = np.arange(count)
        if near:
            chosen = np.sort(np.argsort(-np.linalg.norm(own.T @ vectors, axis=0))[:count])
        modes = C @ vectors[:, chosen]
        by_member = modes[:, upper[0]] * modes[:, upper[1]]
        rows, right = (densities.basis.T @ by_member).T, -np.diag(values[chosen])[upper]
        if not densities.has_scale:
            rows, right = np.vstack([rows, total]), np.append(right, strings - total @ p)
        change = np.linalg.lstsq(rows, right, rcond=1e-9)[0]
        p = p + change
        if np.linalg.norm(change) <= NEGLIGIBLE * (1.0 + np.linalg.norm(p)):
            break
    else:
        return None
    if np.any(p < densities.lower):
        return None
    values, vectors = np.linalg.eigh(force_density_matrix(structure, densities.of(p)).toarray())
    space = vectors[:, np.argsort(np.abs(values))[:count]]
    return np.asarray(space @ (space.T @ structure.nodes)), p


def _coordinate_space(nodes: Array) -> Array:
    """Compute an orthonormal basis of affine functions of the nodes.

    It spans the constant vector and the coordinates of the nodes. Its shape is (n, d + 1).
    """
    centered = nodes - nodes.mean(axis=0)
    left, sizes, _ = np.linalg.svd(centered, full_matrices=False)
    left = left[:, sizes > 1e-9 * sizes.max(initial=1e-300)]
    return np.hstack([np.full((len(nodes), 1), len(nodes) ** -0.5), left])
