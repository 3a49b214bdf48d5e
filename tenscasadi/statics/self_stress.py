"""Self-stresses, infinitesimal mechanisms and rigid-body motions of a structure.

The null space of the equilibrium matrix contains the self-stresses. The null space of its transpose
contains the displacements that lengthen no member to first order.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.linalg import orth, qr

from tenscasadi.statics.sparse_null_space import sparse_null_space
from tenscasadi.structure.cables import density_basis
from tenscasadi.structure.equilibrium_matrix import equilibrium_matrix, free_directions
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, instance


def self_stress(structure: Structure) -> Array:
    """Compute a basis of the self-stresses.

    A self-stress is a set of force densities in equilibrium without loads. The strings of a cable
    have one tension.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.

    Returns
    -------
    ndarray, shape (k, α + β)
        Orthonormal self-stresses [N/m]: γ of strings, then λ of bars; λ > 0 is compression.

    Raises
    ------
    TypeError
        If `structure` is no Structure.

    Notes
    -----
    N K = 0 at all free coordinates, with K = C_sᵀ γ̂ C_s − C_bᵀ λ̂ C_b (Eqs. 58 and 60 at rest).
    Equations with a residual below 1e-9 of the largest count as dependent.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.self_stress(tc.shapes.prism()).shape
    (1, 12)
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    basis = density_basis(structure)
    balance = sp.csc_array(equilibrium_matrix(structure) @ basis)
    return np.asarray(sparse_null_space(balance, NEGLIGIBLE) @ basis.T)


def mechanisms(structure: Structure) -> Array:
    """Compute a basis of the infinitesimal mechanisms.

    They are displacements that lengthen no bar, cable, or string in no cable to first order,
    whether it is rigid or elastic. Supports do not move. Rigid-body motions that the supports allow
    are excluded.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.

    Returns
    -------
    ndarray, shape (k, n, 3)
        Orthonormal displacements of the nodes.
    """
    basis = density_basis(structure)
    lengths = np.concatenate([structure.string_lengths, structure.bar_lengths])
    sizes = abs(basis.T) @ lengths / np.asarray(abs(basis).sum(axis=0))
    unit = sp.csc_array(equilibrium_matrix(structure) @ basis * (1.0 / sizes))
    free = free_directions(structure)
    still = sparse_null_space(sp.csc_array(unit.T), NEGLIGIBLE)
    motions = still @ (free.T @ rigid_body_motions(structure))
    others = qr(motions)[0][:, motions.shape[1] :].T @ still
    return np.asarray((free @ others.T).T.reshape(-1, *structure.nodes.shape))


def rigid_body_motions(structure: Structure, nodes: Array | None = None) -> Array:
    """Compute a basis of the rigid-body motions allowed by supports.

    Supports are pins and rollers.

    Parameters
    ----------
    structure : Structure
        The structure.
    nodes : ndarray, shape (n, 3), optional
        Positions [m]; by default those of the structure.

    Returns
    -------
    ndarray, shape (3n, at most 6)
        Orthonormal displacements, node by node.
    """
    places = structure.nodes if nodes is None else nodes
    arms = places - places.mean(axis=0)
    arms = arms / (np.abs(arms).max(initial=0.0) or 1.0)
    fields = [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)]
    fields += [np.cross(axis, arms) for axis in np.eye(3)]
    motions = orth(np.stack([field.ravel() for field in fields], axis=1), rcond=NEGLIGIBLE)
    free = free_directions(structure, rigid=False)  # rigid motions keep bodies in all nodes
    return idle_combinations(motions, motions - free @ (free.T @ motions), NEGLIGIBLE)


def idle_combinations(motions: Array, effects: Array, allowed: float) -> Array:
    """Find the linear combinations of displacements with negligible effects.

    Parameters
    ----------
    motions, effects : ndarray, shape (·, r)
        Orthonormal motions, and the effect of each.
    allowed : float
        Largest norm of an effect that counts as none.

    Returns
    -------
    ndarray, shape (·, at most r)
        Orthonormal combinations.
    """
    _, sizes, right = np.linalg.svd(effects, full_matrices=False)
    idle = np.ones(motions.shape[1], dtype=bool)
    idle[: len(sizes)] = sizes <= allowed
    rest = np.linalg.svd(right)[2] if len(sizes) < motions.shape[1] else right
    return np.asarray(motions @ rest.T[:, idle])
