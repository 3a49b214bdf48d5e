"""Smallest force densities in equilibrium with loads.

They satisfy N K = W with K = C_sᵀ γ̂ C_s − C_bᵀ λ̂ C_b (Eqs. 58, 60 at rest).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.statics.least_force_density import least_force_density
from tenscasadi.structure.cables import density_basis
from tenscasadi.structure.equilibrium_matrix import equilibrium_matrix, free_directions
from tenscasadi.structure.names import add_names, name_errors
from tenscasadi.structure.properties import NodalLoads, read_loads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    Array,
    Booleans,
    instance,
    nonnegative,
    per_item,
)


class EquilibriumError(ValueError):
    """Raised if no admissible force densities balance the loads.

    Attributes
    ----------
    residual : float
        Least unbalanced force [N], a 2-norm over all free coordinates.
    """

    def __init__(self, message: str, residual: float) -> None:
        super().__init__(message)
        self.residual = residual


@rename_keywords(pushing="compression_strings")
@name_errors
def equilibrium_force_density(
    structure: Structure,
    loads: NodalLoads | None = None,
    minimum: ArrayLike = 1.0,
    compression_strings: Iterable[int | str] = (),
) -> Array:
    """Compute the smallest string force densities in equilibrium with loads.

    The nodes are given. Bars take any force, and pins any reaction. The strings of a cable have one
    tension. Of all γ that balance the loads and are at least the minimum, the one with the smallest
    Σγ² is returned.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    loads : array_like, shape (n, 3), or mapping, optional
        Forces on the nodes, or on some by name or index [N]. Default: none.
    minimum : array_like, shape (α,)
        Smallest force density of each string [N/m], at least 0, or one number for all.
    compression_strings : sequence of int or str
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
    balance = _Balance.of(structure, loads, minimum, compression_strings)
    gamma, unbalanced = balance.solve()
    rest = unbalanced()
    residual = float(np.linalg.norm(rest))
    if residual > balance.tolerance:
        size = np.linalg.norm((free_directions(structure) @ rest).reshape(-1, 3), axis=1)
        worst, bounds = int(np.argmax(size)), balance.least[balance.bounded]
        bound = f"of at least {bounds.min():g} N/m " if bounds.size else ""
        message = (
            f"no force densities {bound}hold the structure: {residual:.3g} N stay unbalanced at best, most at node {worst} "
            f"with {size[worst]:.3g} N; change the nodes, the loads, what is pinned, or add strings"
        )
        raise add_address(EquilibriumError(add_names(message, structure), residual))
    if gamma is None:
        raise EquilibriumError(
            "the least force densities were not found, though some balance the loads: give another minimum",
            residual,
        )
    return gamma


def find_force_density(structure: Structure, loads: NodalLoads | None = None) -> Array | None:
    """Find the smallest force densities of at least 0 in equilibrium.

    They are those of `equilibrium_force_density`. Returns None if there are none, in less time than
    the error with its residual takes.
    """
    balance = _Balance.of(structure, loads, 0.0, ())
    gamma, unbalanced = balance.solve()
    found = gamma is not None and np.linalg.norm(unbalanced()) <= balance.tolerance
    return gamma if found else None


class _Balance(NamedTuple):
    """Equilibrium equations of the force densities of a structure.

    Attributes
    ----------
    structure : Structure
        The structure.
    strings, bars, w, least, bounded
        Arguments of `least_force_density`.
    """

    structure: Structure
    strings: Any
    bars: Any
    w: Array
    least: Array
    bounded: Booleans

    @staticmethod
    def of(
        structure: Structure,
        loads: NodalLoads | None,
        minimum: ArrayLike,
        compression_strings: Iterable[int | str],
    ) -> _Balance:
        """Build the equations from the arguments of `equilibrium_force_density`."""
        instance("structure", structure, Structure, "a tenscasadi.Structure")
        alpha = len(structure.strings)
        either = structure.names.mask("compression_strings", "string", compression_strings)
        least = nonnegative("minimum", per_item("minimum", minimum, alpha), "string")
        least = np.where(either, 0.0, least)
        shape = structure.nodes.shape
        load = np.zeros(shape) if loads is None else read_loads("loads", loads, structure)
        w = free_directions(structure).T @ load.ravel()
        balance = equilibrium_matrix(structure)
        if balance.shape[0] * balance.shape[1] < 1e6:  # dense operations are faster
            balance = balance.toarray()
        strings, bars = balance[:, :alpha], balance[:, alpha:] * (1 / structure.bar_lengths)
        return _Balance(structure, strings, bars, w, least, ~either)

    @property
    def tolerance(self) -> float:
        """Largest unbalanced force of an equilibrium [N]."""
        force = abs(self.strings * self.least).max() if self.strings.size else 0.0
        return NEGLIGIBLE * float(max(np.abs(self.w).max(initial=0.0), force))

    def solve(self) -> tuple[Array | None, Callable[[], Array]]:
        """Find the smallest force densities, with one tension in each cable.

        The result is that of `least_force_density`.
        """
        structure, strings, bars, w, least, bounded = self
        if not structure.cables:
            return least_force_density(strings, bars, w, least, bounded)
        alpha = len(structure.strings)
        inputs = int(structure.cable_of.max()) + 1
        basis = density_basis(structure)[:alpha, :inputs].toarray()
        size = basis[np.arange(alpha), structure.cable_of]
        own, held = np.zeros(basis.shape[1]), np.zeros(basis.shape[1], dtype=bool)
        np.maximum.at(own, structure.cable_of, least / size)
        np.logical_or.at(held, structure.cable_of, bounded)
        found, unbalanced = least_force_density(strings @ basis, bars, w, own, held)
        return None if found is None else basis @ found, unbalanced
