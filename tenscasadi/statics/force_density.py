"""Equilibrium and self-stress: N K = W with K = C_sᵀ γ̂ C_s − C_bᵀ λ̂ C_b (Eqs. 58, 60 at rest)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lstsq, null_space
from scipy.optimize import nnls

from tenscasadi.statics.least_force_density import least_force_density
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.sparse_null_space import sparse_null_space
from tenscasadi.util.validate import Array, finite_array, instance, item_mask, nonnegative, per_item

TOLERANCE = 1e-9  # relative: singular values and unbalanced forces below it are rounding
_DENSE = 1e6  # entries of N K up to which it is decomposed as a whole


class EquilibriumError(ValueError):
    """No admissible force densities hold the structure in equilibrium.

    Attributes
    ----------
    residual : float
        Least unbalanced force that any of them leaves, N (2-norm over all free coordinates).
    """

    def __init__(self, message: str, residual: float) -> None:
        super().__init__(message)
        self.residual = residual


def self_stress(structure: Structure) -> Array:
    """Return a basis of the self-stresses: force densities that are in equilibrium without loads.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.

    Returns
    -------
    ndarray, shape (k, α + β)
        One self-stress a row, γ of strings, then λ of bars, N/m, orthonormal; λ > 0 is compression.

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
    """Compute the least force densities that hold a structure at rest in its nodes.

    Bars carry what they must and pins react freely. Among all γ that balance the loads and are
    nowhere below the minimum, that of least Σγ² is returned; it is negative where strings that may
    push do so.

    Parameters
    ----------
    structure : Structure
        The structure in its nodes.
    loads : array_like, shape (n, 3), optional
        Forces on the nodes, N; by default none.
    minimum : array_like, shape (α,)
        Least force density of each string, N/m, at least 0, or one number for all.
    compression_strings : sequence of int
        Compression-capable strings (law `Linear`), for which there is no minimum.

    Returns
    -------
    ndarray, shape (α,)
        γ of each string, N/m.

    Raises
    ------
    EquilibriumError
        Where no such force densities balance the loads.
    TypeError, ValueError
        Where loads or minimum do not fit the structure.

    Notes
    -----
    Beyond a million entries of N K the quadratic program is solved by a sparse interior point
    method [2]_: 2000 bars take seconds.

    References
    ----------
    .. [1] C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, chapter 23: least distance
    programming. .. [2] S. Mehrotra, On the implementation of a primal-dual interior point method,
    SIAM Journal on Optimization 2, 1992, 575-601.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.equilibrium_force_density(tc.shapes.prism(), minimum=2.0).round(3).tolist()
    [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 3.464, 3.464, 3.464]
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    alpha = len(structure.strings)
    pushes = item_mask("compression_strings", compression_strings, alpha, "string")
    least = np.where(
        pushes, 0.0, nonnegative("minimum", per_item("minimum", minimum, alpha), "string")
    )
    load = (
        np.zeros(structure.nodes.shape)
        if loads is None
        else finite_array("loads", loads, structure.nodes.shape)
    )
    directions = _free_directions(structure)
    w = directions.T @ load.ravel()
    balance = _balance(structure)
    program = (
        balance[:, :alpha],
        balance[:, alpha:] * (1 / structure.bar_lengths),
        w,
        least,
        ~pushes,
    )
    force = max(
        float(abs(program[0] * least).max()) if alpha and len(w) else 0.0,
        float(np.abs(w).max(initial=0.0)),
    )
    if not _is_small(balance):
        gamma, unbalanced = least_force_density(*program)
        residual = float(np.linalg.norm(unbalanced))
        if residual > TOLERANCE * force:
            raise _no_equilibrium(
                (directions @ unbalanced).reshape(-1, 3), least[~pushes], residual
            )
        if gamma is None:
            raise EquilibriumError(
                "least force densities were not found, though some hold the structure: give another minimum",
                residual,
            )
        return gamma
    # the bars take whatever acts along them: what is left is balanced by strings alone
    Q = null_space((balance[:, alpha:].toarray() / structure.bar_lengths).T, rcond=TOLERANCE).T
    strings = balance[:, :alpha].toarray()
    E, f = Q @ strings, Q @ w
    E[:, np.linalg.norm(E, axis=0) <= TOLERANCE * np.linalg.norm(strings, axis=0)] = (
        0.0  # a string beside a bar: what is left is rounding
    )

    extra, residual = _balancing(E, f - E @ least, pushes)
    if residual > TOLERANCE * force:
        left = directions @ (Q.T @ (f - E @ (least + extra)))
        raise _no_equilibrium(left.reshape(-1, 3), least[~pushes], residual)
    allowed = max(10.0 * residual, TOLERANCE * force)
    gamma = _least_norm(E, f, least, ~pushes)
    if gamma is None or np.linalg.norm(E @ gamma - f) > allowed:
        gamma, unbalanced = least_force_density(*program)
        if gamma is None or np.linalg.norm(unbalanced) > allowed:
            gamma = least + extra
    return gamma


def _balance(structure: Structure) -> Any:
    """Return N K of one unit of each force density: free coordinates × (α + β), sparse."""
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


def _is_small(balance: Any) -> bool:
    return bool(balance.shape[0] * balance.shape[1] <= _DENSE)


def _free_directions(structure: Structure) -> sp.csr_array:
    """Return an orthonormal basis (3n × free coordinates) of the displacements that pins and rollers allow."""
    if not structure.rollers:
        return sp.eye_array(structure.fixed.size, format="csr")[:, np.flatnonzero(~structure.fixed)]
    blocks = [np.eye(3)[:, ~fixed] for fixed in structure.fixed]
    for node, normals in structure.rollers.items():
        blocks[node] = null_space(np.array(normals))
    return sp.csr_array(sp.block_diag(blocks))


def _balancing(A: Array, b: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return x of least ‖A x − b‖, and that norm: x ≥ 0 but for those that are `free`."""
    x, residual = _nonnegative(np.hstack([A, -A[:, free]]), b)
    count = A.shape[1]
    x[:count][free] -= x[count:]
    return x[:count], residual


def _nonnegative(A: Array, b: Array) -> tuple[Array, float]:
    """Return x ≥ 0 of least ‖A x − b‖, and that norm."""
    if A.shape[1] == 0 or A.shape[0] == 0:
        return np.zeros(A.shape[1]), float(np.linalg.norm(b))
    x, residual = nnls(A, b, maxiter=30 * A.shape[1] + 100)
    return x, float(residual)


def _least_norm(E: Array, f: Array, least: Array, bounded: NDArray[np.bool_]) -> Array | None:
    """Return γ of least ‖γ‖ with E γ = f, γ ≥ `least` where it is `bounded`: least distance programming.

    Lawson and Hanson, Solving Least Squares Problems, ch. 23.
    With γ = γ₀ + Z y, Z a basis of null(E): min ‖y‖ with Z y ≥ least − γ₀. None where rounding
    hides that it is feasible, or which is the least.
    """
    if E.shape[0] == 0:
        return least.copy()  # 0 where there is no bound
    start = np.asarray(lstsq(E, f, cond=TOLERANCE)[0])
    Z = null_space(E, rcond=TOLERANCE)
    short = (least - start)[bounded]
    scale = float(np.abs(short).max(initial=0.0))
    if scale > 0.0 and Z.shape[1]:
        target = np.zeros(Z.shape[1] + 1)
        target[-1] = 1.0
        system = np.vstack([Z[bounded].T, short / scale])
        u, distance = _nonnegative(system, target)
        if distance < TOLERANCE or u.max() > 1 / TOLERANCE:  # what pushes is the rounding of Z
            return None
        r = system @ u - target
        start = start - Z @ (r[:-1] / r[-1]) * scale
    return np.asarray(np.where(bounded, np.maximum(start, least), start))


def _no_equilibrium(left: Array, least: Array, residual: float) -> EquilibriumError:
    size = np.linalg.norm(left, axis=1)
    worst = int(np.argmax(size))
    bound = f"of at least {least.min():g} N/m " if least.size else ""
    return EquilibriumError(
        f"no force densities {bound}hold the structure: {residual:.3g} N stay unbalanced at best, most at node {worst} "
        f"({size[worst]:.3g} N); change the nodes, the loads, what is pinned, or add strings",
        residual,
    )
