"""Equilibrium N K = W with K = C_sᵀ γ̂ C_s − C_bᵀ λ̂ C_b (Eqs. 58, 60 at rest), and self-stress."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import null_space

from tenscasadi.statics.least_force_density import least_force_density
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.sparse_null_space import sparse_null_space
from tenscasadi.util.validate import Array, finite_array, instance, item_mask, nonnegative, per_item

TOLERANCE = 1e-9  # relative: singular values and unbalanced forces below it are rounding


class EquilibriumError(ValueError):
    """No admissible force densities balance the loads.

    Attributes
    ----------
    residual : float
        Least unbalanced force [N], a 2-norm over all free coordinates.
    """

    def __init__(self, message: str, residual: float) -> None:
        super().__init__(message)
        self.residual = residual


def self_stress(structure: Structure) -> Array:
    """Compute a basis of the self-stresses.

    A self-stress is a set of force densities in equilibrium without loads.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.

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
    Equations with a residual below 1e-9 of the largest count as dependent. 2000 bars take a second.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.self_stress(tc.shapes.prism()).shape
    (1, 12)
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    return sparse_null_space(_balance(structure), TOLERANCE)


@rename_keywords(pushing="compression_strings")
def equilibrium_force_density(
    structure: Structure,
    loads: ArrayLike | None = None,
    minimum: ArrayLike = 1.0,
    compression_strings: Iterable[int] = (),
) -> Array:
    """Compute the least force densities that hold a structure in its nodes.

    Bars take any force, and pins any reaction. Of all γ that balance the loads and are at least the
    minimum, the one of least Σγ² is returned.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.
    loads : array_like, shape (n, 3), optional
        Forces on the nodes [N]. Default: none.
    minimum : array_like, shape (α,)
        Smallest force density of each string [N/m], at least 0, or one number for all.
    compression_strings : sequence of int
        Compression-capable strings (law `Linear`), for which there is no minimum.

    Returns
    -------
    ndarray, shape (α,)
        γ of each string [N/m].

    Raises
    ------
    EquilibriumError
        If no such force densities balance the loads.
    TypeError, ValueError
        If an argument does not fit the structure.

    Notes
    -----
    An interior-point method solves the quadratic program [1]_; the active bounds are then equations
    that are solved to rounding.

    References
    ----------
    .. [1] S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM Journal
       on Optimization 2, 1992, 575-601.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.equilibrium_force_density(tc.shapes.prism(), minimum=2.0).round(3).tolist()
    [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 3.464, 3.464, 3.464]
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    alpha = len(structure.strings)
    either = item_mask("compression_strings", compression_strings, alpha, "string")
    least = nonnegative("minimum", per_item("minimum", minimum, alpha), "string")
    least = np.where(either, 0.0, least)
    shape = structure.nodes.shape
    load = np.zeros(shape) if loads is None else finite_array("loads", loads, shape)
    directions = _free_directions(structure)
    w = directions.T @ load.ravel()
    balance = _balance(structure)
    if balance.shape[0] * balance.shape[1] < 1e6:  # dense operations are faster
        balance = balance.toarray()
    strings, bars = balance[:, :alpha], balance[:, alpha:] * (1 / structure.bar_lengths)
    gamma, unbalanced = least_force_density(strings, bars, w, least, ~either)
    residual = float(np.linalg.norm(unbalanced))
    force = max(np.abs(w).max(initial=0.0), abs(strings * least).max() if strings.size else 0.0)
    if residual > TOLERANCE * force:
        size = np.linalg.norm((directions @ unbalanced).reshape(-1, 3), axis=1)
        worst, bounds = int(np.argmax(size)), least[~either]
        bound = f"of at least {bounds.min():g} N/m " if bounds.size else ""
        raise EquilibriumError(
            f"no force densities {bound}hold the structure: {residual:.3g} N stay unbalanced at best, most at node {worst} "
            f"({size[worst]:.3g} N); change the nodes, the loads, what is pinned, or add strings",
            residual,
        )
    if gamma is None:
        raise EquilibriumError(
            "the least force densities were not found, though some balance the loads: give another minimum",
            residual,
        )
    return gamma


def _balance(structure: Structure) -> Any:
    """Build N K of unit force densities, a sparse array (free coordinates, α + β) [m]."""
    pairs = np.concatenate([structure.strings, structure.bars])
    members, coordinates = len(pairs), structure.nodes.size
    vectors = structure.nodes[pairs[:, 1]] - structure.nodes[pairs[:, 0]]
    vectors[len(structure.strings) :] *= -1  # bars push
    rows = 3 * pairs[:, :, None] + np.arange(3)
    values = np.stack(
        [-vectors, vectors], axis=1
    )  # s C_s: what balances the member at its first and its second node
    columns = np.repeat(np.arange(members), 6)
    return sp.csc_array(
        _free_directions(structure).T
        @ sp.csc_array((values.ravel(), (rows.ravel(), columns)), shape=(coordinates, members))
    )


def _free_directions(structure: Structure) -> sp.csr_array:
    """Build an orthonormal basis (3n, free coordinates) of the displacements that supports allow."""
    if not structure.rollers:
        return sp.eye_array(structure.fixed.size, format="csr")[:, np.flatnonzero(~structure.fixed)]
    blocks = [np.eye(3)[:, ~fixed] for fixed in structure.fixed]
    for node, normals in structure.rollers.items():
        blocks[node] = null_space(np.array(normals))
    return sp.csr_array(sp.block_diag(blocks))
