"""Stiffness and stability of structures.

They consist of self-stress, mechanisms, tangent stiffness and its softest modes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.binding import fix
from tenscasadi.scene.failed_strings import describe_overload
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.statics.equilibrium import (
    Equilibrium,
    newton_system,
    read_load,
    read_problem,
)
from tenscasadi.statics.self_stress import mechanisms, self_stress
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.prestressed_state import PrestressedState
from tenscasadi.statics.solver.static_equations import StaticPoint
from tenscasadi.statics.solver.trust_region import allowed_residual
from tenscasadi.statics.super_stability import is_super_stable
from tenscasadi.structure.cables import add_compliances
from tenscasadi.structure.equilibrium_matrix import balance_bars, force_density_matrix
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.prestress import check_cable_tensions, read_force_densities
from tenscasadi.structure.properties import NodalLoads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import ReadOnlyArrays, keep
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, TOLERANCE, Array, instance, whole_number


@dataclass(frozen=True, eq=False)
class Stability(ReadOnlyArrays):
    """Stiffness and stability of a structure at given nodes.

    Displacements, modes and mechanisms are those that pins and rollers allow. Rigid-body motions
    without stiffness are excluded.

    Attributes
    ----------
    structure : Structure
        The structure, evaluated at its nodes, with subdivided strings.
    force_density : ndarray, shape (α + β,)
        Force densities: γ of strings, then λ of bars, positive in compression [N/m].
    residual : float
        Largest unbalanced force on a node [N]. Away from equilibrium the stiffness of rotations is
        meaningless.
    message : str
        Result in one sentence.
    eigenvalues : ndarray, shape (k,)
        Eigenvalues of the tangent stiffness on motions that preserve the lengths of rigid bars,
        ascending [N/m].
    modes : ndarray, shape (k, n, 3)
        Their motions, of unit norm.
    success : bool
        Whether the forces balance.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> st = tc.stability(tc.shapes.prism(prestress=10.0))
    >>> st.stable, st.super_stable, len(st.self_stress), len(st.mechanisms)
    (True, True, 1, 1)
    >>> st.eigenvalues.round(1)[:3].tolist()
    [55.9, 91.5, 91.5]
    """

    structure: Structure
    force_density: Array
    residual: float
    message: str
    eigenvalues: Array
    modes: Array
    success: bool
    _state: PrestressedState = field(repr=False)

    def __repr__(self) -> str:
        return f"Stability({self.message})"

    @cached_property
    def self_stress(self) -> Array:
        """Orthonormal self-stresses (s, α + β) [N/m], see `tenscasadi.self_stress`."""
        return self_stress(self.structure)

    @cached_property
    def mechanisms(self) -> Array:
        """Orthonormal infinitesimal mechanisms (k, n, 3).

        These displacements lengthen no bar, cable, or string in no cable to first order.
        """
        return mechanisms(self.structure)

    @cached_property
    def stable(self) -> bool:
        """Whether the structure is stable.

        All displacements that preserve the lengths of rigid bars then have a positive stiffness.
        """
        return self._state.is_stable

    @cached_property
    def prestress_stable(self) -> bool:
        """Whether the member forces stiffen every mechanism.

        The structure is then stable if its members are stiff enough.
        """
        flat = self.mechanisms.reshape(len(self.mechanisms), self.structure.nodes.size)
        stiffness = np.linalg.eigvalsh(flat @ (self.geometric @ flat.T))
        largest = float(np.abs(self.force_density).max(initial=0.0))
        return bool(np.all(stiffness > ROUNDING * largest))

    @cached_property
    def super_stable(self) -> bool:
        """Whether the structure is super-stable.

        It is then stable for all levels of prestress and all stiffnesses. The force density matrix
        is positive semidefinite, of rank n − d − 1 in d dimensions. No affine motion keeps the
        lengths of all members, except translations and rotations. With supports, the affine motions
        are those that they allow. Structures with rigid bodies are never classified as
        super-stable.
        """
        return is_super_stable(self.structure, self.force_density_matrix)

    @cached_property
    def force_density_matrix(self) -> sp.csr_array:
        """Force density matrix (n, n) [N/m], sparse."""
        density = np.array(self.force_density)
        density[len(self.structure.strings) :] *= -1.0  # λ > 0 is compression
        return sp.csr_array(force_density_matrix(self.structure, density))

    @cached_property
    def tangent(self) -> sp.csr_array:
        """Tangent stiffness (3n, 3n) [N/m] before supports and bars, sparse."""
        return sp.csr_array(self.material + self.geometric)

    @cached_property
    def material(self) -> sp.csr_array:
        """Material stiffness (3n, 3n) [N/m], sparse.

        It is due to the change of member forces: (k − γ) e eᵀ of each member. A cable adds one
        stiffness, not one for each string.
        """
        return self._state.system.nodal_material(self._state.point)

    @cached_property
    def geometric(self) -> sp.csr_array:
        """Geometric stiffness (3n, 3n) [N/m], sparse.

        It is due to the rotation of member forces and to loads that depend on the nodes. Without
        such loads it is the force density matrix in each of the three axes.
        """
        members = sp.kron(self.force_density_matrix, sp.eye_array(3))
        return sp.csr_array(members + self._state.system.nodal_loads(self._state.point))

    def displacement(self, load: NodalLoads | NodalForce) -> Array:
        """Compute the linear displacements under a load.

        Parameters
        ----------
        load : array_like, shape (n, 3), mapping, or NodalForce
            Forces on the nodes, or on some by name or index [N].

        Returns
        -------
        ndarray, shape (n, 3)
            Displacements of least norm [m]. The component of a load that moves the structure freely
            causes none: see `stiffness`.

        Raises
        ------
        TypeError, ValueError
            If the load is wrong.
        """
        state = self._state
        y, _ = state.displace(read_load(state.system, load))
        return np.asarray((state.system.equations.free @ y).reshape(-1, 3))

    def stiffness(self, load: NodalLoads | NodalForce) -> float:
        """Compute the stiffness against a load: |load|²/(load · displacement).

        Parameters
        ----------
        load : array_like, shape (n, 3), mapping, or NodalForce
            Forces on the nodes, or on some by name or index [N].

        Returns
        -------
        float
            Stiffness [N/m]: inf if supports and rigid bars carry the load, 0 if it moves the
            structure freely.

        Raises
        ------
        TypeError, ValueError
            If the load is wrong or zero.
        """
        state = self._state
        forces = read_load(state.system, load)
        size = float(np.linalg.norm(forces))
        if size == 0.0:
            raise ValueError("load is zero: give forces on the nodes")
        unit = forces / size
        f = state.system.equations.in_free_directions(unit)
        if np.linalg.norm(state.flat.T @ f) > NEGLIGIBLE:
            return 0.0
        compliance = float(f @ state.displace(unit)[0])
        return np.inf if abs(compliance) <= NEGLIGIBLE / state.scale else 1.0 / compliance


@name_errors
def stability(
    source: Structure | Scene | Model | Equilibrium,
    force_density: ArrayLike | None = None,
    parameters: Any = None,
    count: int | None = None,
) -> Stability:
    """Compute stiffness and stability.

    Parameters
    ----------
    source : Structure, Scene, Model or Equilibrium
        The structure, evaluated at its nodes, or an equilibrium.
    force_density : array_like, shape (α,) or (α + β,), optional
        Force densities of strings, then of bars, as in `Structure.prestressed`. All strings then
        have their elastic stiffness, for any force density. Default: those of the rest lengths. If
        only those of strings are given, those of bars balance the other forces by least squares.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the parameters of a scene, see `ParameterLayout.values`; nominal if None.
    count : int, optional
        Number of eigenvalues, from the lowest on. Default: all of a structure of up to 600 free
        coordinates, the 20 lowest of a larger one.

    Returns
    -------
    Stability
        Stiffness matrices, softest motions and stability.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong, or the tension of a string reaches its strength.

    See Also
    --------
    modes : Natural frequencies of a model.
    buckling_factor : Least load at which the structure buckles.

    Notes
    -----
    Strings at exactly their rest lengths count as taut. A motion counts as one without stiffness
    below 1e-12 of the largest stiffness. The tangent of loads without an energy, such as pressure
    on a surface with free edges, is symmetrized.

    Super-stability is that of Connelly [1]_, the stiffness that of Guest [2]_.

    References
    ----------
    .. [1] R. Connelly, Rigidity and energy, Inventiones Mathematicae 66 (1982), 11-33.
    .. [2] S. D. Guest, The stiffness of prestressed frameworks: a unifying approach, International
       Journal of Solids and Structures 43 (2006), 842-854.

    Examples
    --------
    The tension T alone resists transverse displacements of a weight on a straight string, with the
    stiffness 2 T/l:

    >>> import tenscasadi as tc
    >>> line = tc.Structure([(-1, 0, 0), (0, 0, 0), (1, 0, 0)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0)
    >>> st = tc.stability(line, force_density=[5.0, 5.0])
    >>> st.eigenvalues.round(6).tolist(), len(st.mechanisms)
    ([10.0, 10.0, 200.0], 2)
    """
    kinds = (Structure, Scene, Model, Equilibrium)
    instance("source", source, kinds, "a tenscasadi.Structure, Scene, Model or Equilibrium")
    number = None if count is None else whole_number("count", count, 1)
    state, structure = read_state(source, force_density, parameters)
    if overload := find_overload(source, state):
        name = "source" if force_density is None else "force_density"
        raise ValueError(
            f"{name} has an overload: {overload}; give a lower tension, or Scene(..., strength=None) "
            "for the stiffness of strings that do not fail"
        )
    return describe_state(state, structure, number)


def read_state(
    source: Structure | Scene | Model | Equilibrium,
    force_density: ArrayLike | None = None,
    parameters: Any = None,
) -> tuple[PrestressedState, Structure]:
    """Read nodes and member forces of a structure, scene or equilibrium.

    The arguments are those of `stability`. Also returns the structure with the modeled nodes.
    Raises TypeError, ValueError.
    """
    scene, start = _read_source(source)
    nodes, given = read_problem(scene, start, None, parameters)
    bare = scene if isinstance(scene, Scene) else scene.scene
    system = newton_system(bare)
    equations = system.equations
    fixed = fix(bare, given.inputs[bare.nu :]).modelled
    structure = fixed if np.array_equal(nodes, fixed.nodes) else fixed.replace(nodes=nodes)
    point = equations.at(nodes, given._replace(pressing=nodes))
    if force_density is not None:
        point, tension = _impose(system, point, structure, force_density)
    else:
        force = equations.in_free_directions(point.applied)
        tension = system.factor_bars(point.bars).solve(force)[1]
    return PrestressedState(system, point, tension), structure


def find_overload(source: Structure | Scene | Model | Equilibrium, state: PrestressedState) -> str:
    """Describe the most overloaded string of a prestressed state.

    Returns "" if there is none.
    """
    scene, _ = _read_source(source)
    bare, point = scene if isinstance(scene, Scene) else scene.scene, state.point
    strings = slice(len(state.system.equations.structure.strings))
    lengths = np.linalg.norm(point.springs[strings], axis=1)
    return describe_overload(bare, point.gamma[strings] * lengths)


def _read_source(source: Any) -> tuple[Any, Any]:
    """Return the scene or model of a source, and its initial nodes.

    These are an equilibrium, or None for the nodes of the scene.
    """
    if isinstance(source, Equilibrium):
        return source.source, source
    if isinstance(source, Structure):
        return keep(source, "scene", lambda: Scene(source)), None
    return source, None


def _impose(
    system: NewtonSystem, point: StaticPoint, structure: Structure, force_density: Any
) -> tuple[StaticPoint, Array]:
    """Prescribe force densities of members that keep their elastic stiffness.

    `force_density` is the argument of `stability`. Returns the point with these. Also returns the
    tensions of rigid bars [N].
    """
    equations = system.equations
    gamma, lam = read_force_densities(structure, force_density)
    check_cable_tensions(structure, gamma)
    if lam is None:
        lam = balance_bars(structure, gamma, point.loads)
    density = np.concatenate([gamma, -lam[equations.elastic]])
    strings = add_compliances(structure.cable_of, structure.stiffness)[structure.cable_of]
    own = strings if structure.cables else structure.stiffness
    stiffness = np.concatenate([own, structure.bar_stiffness[equations.elastic]])
    squared = np.einsum("ij,ij->i", point.springs, point.springs)
    one, other = equations.coupled.T
    coupling = stiffness[one] / (2 * np.sqrt(squared[one] * squared[other]))
    along = (stiffness - density) / (2 * squared)
    pull = np.zeros_like(point.nodes)
    for end, sign in ((0, 1.0), (1, -1.0)):
        np.add.at(pull, equations.spring_pairs[:, end], sign * density[:, None] * point.springs)
    applied = point.loads + pull
    tension = np.zeros(system.rigid)
    tension[: len(equations.rigid)] = -(lam * structure.bar_lengths)[equations.rigid]
    if structure.bodies:  # the bars of bodies balance the rest
        rest = equations.in_free_directions(applied + equations.bar_forces(point, tension))
        pulls = system.lengthening(point)[len(equations.rigid) :].T.toarray()
        tension[len(equations.rigid) :] = np.linalg.lstsq(pulls, rest, rcond=None)[0]
    return point._replace(gamma=density, slope=along, coupling=coupling, applied=applied), tension


def describe_state(
    state: PrestressedState, structure: Structure, count: int | None = None
) -> Stability:
    """Compute a state's softest modes and a message about stability.

    `count` is the number of modes; None means all of a small structure, otherwise a few.
    """
    system, point, equations = state.system, state.point, state.system.equations
    values, vectors = state.lowest if count is None else state.softest(count)
    modes = (equations.free @ vectors).T.reshape(-1, *point.nodes.shape)
    strings = len(structure.strings)
    density = np.zeros(strings + len(structure.bars))
    density[:strings] = point.gamma[:strings]
    density[strings + equations.elastic] = -point.gamma[strings:]
    own = len(equations.rigid)
    density[strings + equations.rigid] = -(state.tension / equations.lengths)[:own]
    bars = equations.bar_forces(point, state.tension)
    unbalanced = equations.in_free_directions(point.applied + bars)
    residual = float(
        np.linalg.norm((equations.free @ unbalanced).reshape(-1, 3), axis=1).max(initial=0.0)
    )
    balanced = residual <= allowed_residual(system, point, state.tension, TOLERANCE)
    softest = state.describe_softest(values)
    message = softest if balanced else f"not in equilibrium, {residual:.3g} N stay unbalanced"
    return Stability(structure, density, residual, message, values, modes, balanced, state)
