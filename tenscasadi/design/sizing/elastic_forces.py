"""Elastic forces and prestress of members of given areas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tenscasadi.design.conic import LinearRows, solve_conic
from tenscasadi.design.sizing.program import SizingProgram
from tenscasadi.util.linear_algebra import REGULARIZATION
from tenscasadi.util.validate import MAX_ITERATIONS, NEGLIGIBLE, TOLERANCE, Array


def elastic_response(program: SizingProgram, area: Array) -> Array:
    """Compute the linear elastic forces (cases, α + β) [N].

    They are due to the loads of a program and the weight of members with areas (α + β,) [m²].
    Strings do not become slack. Some forces must balance the loads.
    """
    k, solve = _stiffness(program, area)
    motion = solve(program.loads.T + (program.weight @ area)[:, None])
    return np.asarray((k[:, None] * (program.balance.T @ motion)).T)


def response_slopes(program: SizingProgram, area: Array) -> Array:
    """Compute the derivatives of `elastic_response` with respect to the areas.

    Their shape is (cases, α + β, α + β) [N/m²]. Areas are (α + β,) [m²].
    """
    sections, B = program.sections, program.balance
    k, solve = _stiffness(program, area)
    slope = sections.modulus / sections.lengths
    elongation = B.T @ solve(program.loads.T + (program.weight @ area)[:, None])
    flexibility = B.T @ solve(B.toarray())
    weight = k[:, None] * (B.T @ solve(program.weight.toarray()))
    slopes = [
        np.diag(slope * each) - k[:, None] * flexibility * (slope * each) + weight
        for each in elongation.T
    ]
    return np.array(slopes).reshape(len(program.loads), program.members, program.members)


def _stiffness(program: SizingProgram, area: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Compute the member stiffnesses and factorize the matrix K.

    Areas are (α + β,) [m²]. Returns the stiffnesses [N/m], and a function f → x that solves K x =
    f.
    """
    sections, B = program.sections, program.balance
    size = float(area.max(initial=0.0)) or 1.0
    k = sections.modulus * np.maximum(area, NEGLIGIBLE * size) / sections.lengths
    K = sp.csc_array(B @ sp.diags_array(k) @ B.T)
    shift = REGULARIZATION * float(K.diagonal().max(initial=0.0))
    factors = splu(sp.csc_array(K + shift * sp.eye_array(K.shape[0], format="csc")))

    def solve(f: Array) -> Array:
        x = factors.solve(f)
        for _ in range(3):
            x = x + factors.solve(f - K @ x)
        return np.asarray(x)

    return k, solve


def fit_prestress(program: SizingProgram, area: Array, forces: Array) -> Array:
    """Fit a self-stress (α + β,) to given forces [N].

    It is the least-squares fit within the limits of the areas (α + β,) [m²]. `forces` exclude the
    elastic response.
    """
    sections, members = program.sections, program.members
    scale = float(np.abs(forces).max(initial=0.0))
    if scale == 0.0:
        return np.zeros(members)
    high = sections.strength * area / scale
    euler = sections.buckling[program.strings :] * area[program.strings :] ** 2 / scale
    low = np.concatenate([np.zeros(program.strings), np.minimum(high[program.strings :], euler)])
    eye = sp.eye_array(members, format="csc")
    below = LinearRows(sp.vstack([eye, -eye], format="csc"), np.concatenate([high, low]))
    equal = LinearRows(program.balance, np.zeros(program.balance.shape[0]))
    found = solve_conic(-forces.mean(axis=0) / scale, equal, below, eye)
    fitted = found.x * scale
    if found.status != "solved" or np.abs(fitted).max() <= TOLERANCE * scale:
        return np.zeros(members)
    return fitted


def superpose_prestress(
    program: SizingProgram, prestress: Array, area: Array
) -> tuple[Array, Array]:
    """Find areas for the sum of prestress and elastic forces.

    The prestress is (α + β,) [N], and `area` (α + β,) [m²] the initial guess. The stiffness depends
    on the areas. Areas and forces are computed alternately until both agree (fully stressed
    design).

    Returns
    -------
    tuple of ndarray
        Areas (α + β,) [m²] and forces (cases, α + β) [N].
    """
    sections = program.sections
    forces = np.zeros((len(program.loads), program.members))
    for _ in range(MAX_ITERATIONS):
        forces = prestress + elastic_response(program, area)
        needed = sections.needed(np.vstack([forces, prestress]))
        if np.all(np.abs(needed - area) <= 1e-12 * needed.max(initial=0.0)):
            break
        area = needed
    return area, forces
