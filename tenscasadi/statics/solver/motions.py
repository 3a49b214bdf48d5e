"""Softest displacement modes under rigid-bar constraints.

All modes keep the lengths of rigid bars. Neutral motions are rigid-body motions without stiffness.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from tenscasadi.statics.self_stress import idle_combinations, rigid_body_motions
from tenscasadi.statics.solver.constrained_eigenproblem import lowest_eigenpairs
from tenscasadi.statics.solver.newton_system import NewtonFactors, NewtonSystem
from tenscasadi.statics.solver.static_equations import StaticPoint
from tenscasadi.statics.sparse_null_space import split_spaces
from tenscasadi.util.linear_algebra import DENSE
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, Array


def softest_motions(
    K: Any, J: Any, left_out: Array, count: int | None = None
) -> tuple[Array, Array]:
    """Compute the smallest eigenvalues of the constrained stiffness.

    They are those of K on displacements v with J v = 0. Also returns the modes.

    Parameters
    ----------
    K : sparse array, shape (n, n)
        Symmetric tangent stiffness [N/m].
    J : sparse array, shape (m, n)
        Derivative of the lengths of rigid bars.
    left_out : ndarray, shape (n, r)
        Orthonormal motions with K v = 0 and J v = 0, such as rigid-body motions.
    count : int, optional
        Number of eigenvalues; by default all.

    Returns
    -------
    tuple of ndarray
        Eigenvalues [N/m] in ascending order, and orthonormal motions (n, k).
    """
    size = K.shape[0]
    most = size - J.shape[0] - left_out.shape[1]
    if count is not None and size > DENSE and 2 * count < most:
        with suppress(np.linalg.LinAlgError):  # dense matrices then take more time
            return lowest_eigenpairs(K, sp.eye_array(size, format="csc"), J, left_out, count)
    T = motion_basis(J, left_out)
    few = T.shape[1] if count is None else min(count, T.shape[1])
    if not few:
        return np.zeros(0), T[:, :0]
    values, vectors = scipy.linalg.eigh(T.T @ (K @ T), subset_by_index=(0, few - 1))
    return values, np.asarray(T @ vectors)


def motion_basis(J: Any, left_out: Array) -> Array:
    """Compute a basis of displacements that keep rigid bars' lengths.

    It is an orthonormal basis (n, ·) of all v with J v = 0 that are orthogonal to `left_out`.

    Parameters
    ----------
    J : sparse array, shape (m, n)
        Derivative of the lengths of rigid bars.
    left_out : ndarray, shape (n, r)
        Orthonormal motions to which all are orthogonal.

    Returns
    -------
    ndarray
        The basis, dense.
    """
    rows = np.concatenate([J.toarray(), left_out.T])
    return split_spaces(rows, NEGLIGIBLE * float(np.linalg.norm(rows)))[1]


def neutral_motions(system: NewtonSystem, point: StaticPoint, tension: Array) -> Array:
    """Find the rigid-body motions without stiffness.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    point : StaticPoint
        Forces in the equilibrium.
    tension : ndarray, shape (β_r,)
        Tensions of rigid bars [N].

    Returns
    -------
    ndarray, shape (free, at most 6)
        Orthonormal motions on the free coordinates.
    """
    equations = system.equations
    motions = equations.free.T @ rigid_body_motions(equations.structure, point.nodes)
    # members keep their lengths: only their forces and the loads contribute stiffness
    rigid = point._replace(slope=0 * point.slope, coupling=0 * point.coupling)
    K = system.tangent(rigid, tension) + system.load_tangent(point)
    rounding = ROUNDING * system.stiffness_scale(point, tension)  # of forces by rest lengths
    allowed = NEGLIGIBLE * float(np.sqrt((K.data**2).sum())) + rounding
    return idle_combinations(motions, K @ motions, allowed)


def find_stable_factors(
    system: NewtonSystem, point: StaticPoint, tension: Array, shift: float = -ROUNDING
) -> NewtonFactors | None:
    """Factorize the Newton system if the equilibrium is stable.

    All displacements except free rigid-body motions then have a positive stiffness. Loads without
    an energy count by the symmetric part of their tangent. Returns None if it is not stable.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    point : StaticPoint
        Forces in the equilibrium.
    tension : ndarray, shape (β_r,)
        Tensions of rigid bars [N].
    shift : float
        Shift of K, relative to the largest stiffness. A positive one admits motions without
        stiffness.

    Returns
    -------
    NewtonFactors or None
        Factors of the shifted K; None if a motion has no positive stiffness then.
    """
    scale = system.stiffness_scale(point, tension)
    with suppress(np.linalg.LinAlgError):
        factors = system.factor(point, tension, scale, shift * scale)
        if not factors.count_negative():
            return factors
        if not factors.count_negative(neutral_motions(system, point, tension)):
            return factors
    return None
