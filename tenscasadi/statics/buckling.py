"""Linear buckling of a prestressed structure.

The buckling factor is the smallest factor of a load at which the tangent stiffness is singular.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.statics.equilibrium import Equilibrium, find_equilibrium, read_load
from tenscasadi.statics.solver.motions import motion_basis
from tenscasadi.statics.solver.prestressed_state import PrestressedState
from tenscasadi.statics.stability import describe_state, find_overload, read_state
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.properties import NodalLoads
from tenscasadi.util.linear_algebra import DENSE
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, Array, instance


class BucklingFactor(NamedTuple):
    """Smallest load factor at which a structure buckles.

    Attributes
    ----------
    factor : float
        Least factor of the load, greater than 0; inf if the load never buckles the structure.
    mode : ndarray, shape (n, 3)
        Displacements of the nodes, of unit norm; zero if there is no mode.
    success : bool
        Whether the scene has a stable equilibrium under its own loads and small factors of the load.
    message : str
        Result in one sentence; the reason of a failure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(prestress=30.0)
    >>> found = tc.buckling_factor(tc.Scene(prism), [(0, 0, 1)] * 3 + [(0, 0, -1)] * 3)
    >>> found.success, found.mode.shape
    (True, (6, 3))
    """

    factor: float
    mode: Array
    success: bool
    message: str


@name_errors
def buckling_factor(
    scene: Scene | Model | Equilibrium,
    load: NodalLoads | NodalForce,
    control: Any = None,
    parameters: Any = None,
) -> BucklingFactor:
    """Compute the linear buckling factor of a load.

    It is the least factor at which the scene buckles. The load is added to those of the scene. The
    nodes are those of the equilibrium without it, and member forces grow in proportion to it.

    Parameters
    ----------
    scene : Scene, Model or Equilibrium
        The scene, or its equilibrium.
    load : array_like, shape (n, 3), mapping of int or str to array_like, or NodalForce
        Forces on the nodes [N].
    control : array_like, shape (nu,), optional
        Control; by default the initial control of the scene.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    BucklingFactor
        Factor and mode. Without a stable equilibrium, `success` is False and the factor is 0. The
        factor is also 0 if the load tips the structure over on its supports. Loads that balance
        each other without reactions rotate with the structure.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong.

    See Also
    --------
    load_path : Equilibria under growing loads, with large displacements.

    Notes
    -----
    (K + f ΔK) v = 0 on motions that preserve the lengths of rigid bars, with the tangent stiffness
    K and its change ΔK = Σ Δt/l (I − e eᵀ) by the member forces Δt that the load adds.

    Examples
    --------
    Two rigid bars in line, with a spring of 100 N/m across the joint, buckle at k l/2:

    >>> import tenscasadi as tc
    >>> column = tc.Structure(
    ...     [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0)], bars=[(0, 1), (1, 2)],
    ...     strings=[(1, 3), (1, 4)], stiffness=50.0, rest_length=0.5,
    ...     pinned={0: "xyz", 1: "z", 2: "yz", 3: "xyz", 4: "xyz"})
    >>> found = tc.buckling_factor(tc.Scene(column), [(0, 0, 0), (0, 0, 0), (-1, 0, 0), (0, 0, 0), (0, 0, 0)])
    >>> round(found.factor, 6)
    50.0
    """
    kinds = (Scene, Model, Equilibrium)
    instance("scene", scene, kinds, "a tenscasadi.Scene, Model or Equilibrium")
    if isinstance(scene, Equilibrium):
        eq = find_equilibrium(scene.source, scene, control, parameters)
    else:
        eq = find_equilibrium(scene, None, control, parameters)
    state, structure = read_state(eq)
    st = describe_state(state, structure)
    none = np.zeros(eq.nodes.shape)
    size = st.stiffness(load)  # also checks the load
    overload = find_overload(eq, state)
    if overload or not (eq.success and st.stable):
        fault = eq.message
        if eq.success:
            fault = overload or "a motion has no positive stiffness, prestress the structure"
        return BucklingFactor(0.0, none, False, f"no stable equilibrium without the load: {fault}")
    if size == 0.0:
        return BucklingFactor(0.0, none, False, "the load moves the structure freely: support it")
    forces = read_load(state.system, load)
    change = state.force_stiffness(forces)
    tipping = None if _is_balanced(forces, eq.nodes) else _tipping_motion(state, change)
    if tipping is not None:
        mode = _unit_displacement(state, tipping)
        reason = "every factor of the load tips the structure over: support it"
        return BucklingFactor(0.0, mode, False, reason)
    ratio, mode = _largest_ratio(state, change)
    if ratio <= ROUNDING:
        return BucklingFactor(np.inf, none, True, "the load never buckles the structure")
    nodal = _unit_displacement(state, mode)
    return BucklingFactor(1.0 / ratio, nodal, True, f"buckles at {1.0 / ratio:.6g} times the load")


def _largest_ratio(state: PrestressedState, change: Any) -> tuple[float, Array]:
    """Solve the buckling eigenproblem for the smallest load factor.

    It is the largest μ with −ΔK v = μ K v, and v (free,), orthogonal to rigid-body motions without
    stiffness. K is the tangent stiffness of `state`, and ΔK = `change` its change per load factor.
    """
    system, K, flat = state.system, state.tangent, state.neutral
    free = system.size - system.rigid - flat.shape[1]
    if system.size > DENSE and free > 2:
        factors = system.factor(state.point, state.tension, state.scale, 0.0)

        def solve(f: Array) -> Array:
            y = factors.solve(f - flat @ (flat.T @ f))[0]
            return np.asarray(y - flat @ (flat.T @ y))

        inverse = LinearOperator(K.shape, matvec=lambda f: solve(f.ravel()), dtype=float)
        start = solve(np.random.default_rng(0).normal(size=system.size))
        with suppress(ArpackError):
            values, vectors = eigsh(-change, 1, K, which="LA", Minv=inverse, v0=start)
            return float(values[0]), vectors[:, 0]
    T = motion_basis(state.lengthening, flat)
    if not T.shape[1]:
        return 0.0, np.zeros(system.size)
    values, vectors = scipy.linalg.eigh(-T.T @ (change @ T), T.T @ (K @ T))
    return float(values[-1]), T @ vectors[:, -1]


def _tipping_motion(state: PrestressedState, change: Any) -> Array | None:
    """Find the rigid-body motion (free,) that a load destabilizes most.

    It is one without stiffness in the prestressed `state`. `change` is the change of the tangent
    stiffness per load factor. Returns None if there is none.
    """
    flat = state.neutral
    if not flat.shape[1]:
        return None
    values, vectors = np.linalg.eigh(flat.T @ (change @ flat))
    if values[0] >= -NEGLIGIBLE * float(np.sqrt((change.data**2).sum())):
        return None
    return np.asarray(flat @ vectors[:, 0])


def _is_balanced(forces: Array, nodes: Array) -> bool:
    """Return whether forces (n, 3) at nodes (n, 3) are in equilibrium.

    Both the sum of the forces and that of their moments are then zero.
    """
    arms = nodes - nodes.mean(axis=0)
    size = float(np.abs(arms).max(initial=0.0)) or 1.0
    net = np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0) / size])
    return bool(np.abs(net).max() <= NEGLIGIBLE * np.abs(forces).max())


def _unit_displacement(state: PrestressedState, motion: Array) -> Array:
    """Compute nodal displacements (n, 3) of unit norm from free coordinates.

    `motion` (free,) is the displacement of the free coordinates.
    """
    nodal = (state.system.equations.free @ motion).reshape(-1, 3)
    return np.asarray(nodal / np.linalg.norm(nodal))
