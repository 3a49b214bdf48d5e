"""Forces and tangent stiffness of a scene at rest.

Unknowns are displacements y along the free directions E of the nodes, and tensions t of rigid bars:

    Eᵀ (W(N) − Cᵀ γ̂ S) − Jᵀ t = 0,    φ(N) = (|b|² − l²)/(2 l) = 0,    J = ∂φ/∂y.

Strings and elastic bars are springs of force density γ(|s|²). Their tangent stiffness consists of a
geometric block γ I and a material block 2 γ' s sᵀ. Rigid bars have the geometric block (t/l) I.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.contacts import BarContacts, ContactElement
from tenscasadi.dynamics.force_element import NodeMotion
from tenscasadi.dynamics.forces import (
    ElasticBars,
    StringForces,
    build_elements,
)
from tenscasadi.dynamics.masses import node_weights
from tenscasadi.scene.binding import bind, with_fields
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.cables import pair_strings
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.equilibrium_matrix import free_directions, support_directions
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices


class Conditions(NamedTuple):
    """Inputs, loads and friction data of a static problem.

    Attributes
    ----------
    inputs : ndarray (nw,)
        Control, then parameters.
    time : float
        Time of the loads and support positions [s].
    anchor : ndarray (n, 3)
        Nodes from which slip in contacts is measured [m].
    pressing : ndarray (n, 3) or None
        Nodes at which the normal forces that limit friction are taken; None: the current nodes.
    slip : float
        Slip distance at which friction reaches its limit [m].
    added : ndarray (n, 3) or float
        Nodal forces in addition to those of the scene [N].
    """

    inputs: Array
    time: float
    anchor: Array
    pressing: Array | None = None
    slip: float = 1.0
    added: Array | float = 0.0

    @property
    def instant(self) -> tuple[Array, Array]:
        """Slip distance and time, as arguments of CasADi Functions.

        They are in m and s.
        """
        return np.array([self.slip]), np.array([self.time])


class NodeColumns(NamedTuple):
    """Substitute for a `Mechanism` in statics.

    It has one column of N per node, and the attributes of a mechanism that force elements use. All
    of these have the meaning that they have there.
    """

    N: Array
    first: Indices
    physical: Indices
    bar_ends: Indices
    node_weight: Any


class StaticPoint(NamedTuple):
    """Forces of a scene at given nodes, with their derivatives.

    Attributes
    ----------
    nodes : ndarray (n, 3)
        Positions [m].
    springs, bars : ndarray (·, 3)
        Vectors of strings and elastic bars, and of rigid bars [m].
    gamma, slope : ndarray (·,)
        Force densities γ of springs [N/m], and their derivatives with respect to the squared
        lengths.
    coupling : ndarray (pairs,)
        Derivative of γ of the first string of a pair with respect to the squared length of the
        second, for pairs of strings in one cable.
    ground : ndarray (n, 3)
        Forces of the grounds on nodes [N].
    loads : ndarray (n, 3)
        Gravity, pressure, nodal forces, and forces of the grounds [N].
    applied : ndarray (n, 3)
        Loads and forces of springs on nodes [N].
    load_slopes : ndarray
        Nonzeros of the Jacobians of the loads with respect to the nodes, then the pressing nodes.
    """

    nodes: Array
    springs: Array
    bars: Array
    gamma: Array
    slope: Array
    coupling: Array
    ground: Array
    loads: Array
    applied: Array
    load_slopes: Array


class StaticEquations:
    """Static equilibrium equations of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Attributes
    ----------
    structure : Structure
        The structure with subdivided strings.
    rigid, elastic : ndarray of int
        Rigid and elastic bars.
    rigid_pairs : ndarray of int (β_r, 2)
        Ends of rigid bars, then of the massless bars of bodies.
    coupled : ndarray of int (pairs, 2)
        Pairs of strings in one cable.
    free : csr_array (3n, free coordinates)
        Displacements that pins and rollers allow.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.structure = scene, scene.modelled
        if scene.structure.cable_friction.any():
            raise ValueError(
                "Structure.cable_friction is not 0: give the result of find_equilibrium, whose cables stick, or structure.replace(cable_friction=0.0)"
            )
        s = self.structure
        self.rigid, self.elastic = np.flatnonzero(~s.elastic), np.flatnonzero(s.elastic)
        count = len(s.nodes)
        self.coupled = pair_strings(s.cables)
        self.spring_pairs = np.concatenate([s.strings, s.bars[self.elastic]])
        pairs, lengths = _find_body_bars(scene)
        self.rigid_pairs: Indices = np.concatenate([s.bars[self.rigid], pairs])
        self.lengths = np.concatenate([s.bar_lengths[self.rigid], lengths])
        self._across = connectivity(self.spring_pairs, count)
        self._across_bars = connectivity(self.rigid_pairs, count)
        self.free = free_directions(s, rigid=False)
        self._onto_free = self.free.T.tocsr()

    @property
    def has_friction(self) -> bool:
        """Whether any contact has friction."""
        return any(law.friction is not None for law in self.scene.contact_laws)

    @property
    def follows(self) -> bool:
        """Whether loads depend on the node positions."""
        return bool(self.scene.contact_laws) or self.scene.pressure is not None

    def place_supports(self, nodes: Array, time: float) -> Array:
        """Move supports to their positions at a time.

        Parameters
        ----------
        nodes : ndarray, shape (n, 3)
            Positions [m].
        time : float
            Time [s].

        Returns
        -------
        ndarray, shape (n, 3)
            A copy with moved supports.
        """
        placed = np.array(nodes)
        supports = self.scene.supports
        if supports is not None:
            placed[supports.nodes] = supports.rates()(time)[0].full().T
        return placed

    def ground_normals(self, nodes: Array) -> Array:
        """Compute the sum of ground normals (n, 3) at each node.

        Grounds that do not act on a node are excluded.
        """
        normals = np.zeros_like(nodes)
        for surface in self.scene.grounds:
            ends = surface.find_depths(self.structure, nodes)[1]
            which = np.concatenate([ends[:, 0], ends[ends[:, 0] != ends[:, 1], 1]])
            np.add.at(normals, which, ca.DM(surface.contact(nodes[which].T).outward).full().T)
        return normals

    def displace(self, nodes: Array, y: Array) -> Array:
        """Displace nodes (n, 3) by free coordinates.

        y (free,) are their changes [m].
        """
        return np.asarray(nodes + (self.free @ y).reshape(nodes.shape))

    def at(self, nodes: Array, given: Conditions) -> StaticPoint:
        """Compute forces at nodes (n, 3) under given inputs."""
        springs, bars = self._across @ nodes, self._across_bars @ nodes
        gamma, slope, coupling = np.zeros(0), np.zeros(0), np.zeros(0)
        if len(springs):
            squared = np.einsum("ij,ij->i", springs, springs)
            gamma, slope, coupling = (part.ravel() for part in self._laws(squared, given.inputs))
        pressing = nodes if given.pressing is None else given.pressing
        loads, ground, *slopes = self._loads(
            nodes, pressing, given.anchor, *given.instant, given.inputs
        )
        if given.pressing is not None:  # the normal forces that limit friction are constant
            slopes[1][:] = 0.0
        loads, ground = loads.reshape(nodes.shape) + given.added, ground.reshape(nodes.shape)
        applied = loads - self._across.T @ (gamma[:, None] * springs)
        entries = np.concatenate([part.ravel() for part in slopes])
        return StaticPoint(
            nodes, springs, bars, gamma, slope, coupling, ground, loads, applied, entries
        )

    def in_free_directions(self, forces: Array) -> Array:
        """Project nodal forces (n, 3) onto the free coordinates."""
        return np.asarray(self._onto_free @ forces.ravel())

    def bar_forces(self, point: StaticPoint, tension: Array) -> Array:
        """Compute the nodal forces (n, 3) of rigid bars [N].

        The tensions (β_r,) are given [N].
        """
        pull = (tension / self.lengths)[:, None] * point.bars
        return np.asarray(-(self._across_bars.T @ pull))

    def support_forces(self, total: Array) -> Array:
        """Compute the reactions (n, 3) of supports [N].

        `total` is the sum of all other forces. Unbalanced forces remain unbalanced.
        """
        bodies, s = self.structure._assembly, self.structure
        if bodies is None:
            return np.asarray(
                (self.free @ (self._onto_free @ total.ravel())) - total.ravel()
            ).reshape(total.shape)
        count = len(s.nodes)
        gathered = (bodies.spread[:count, :count].T @ total).ravel()
        allowed = support_directions(s)
        return np.asarray(allowed @ (allowed.T @ gathered) - gathered).reshape(total.shape)

    def spring_vectors(self, nodes: Array) -> Array:
        """Compute the member vectors (·, 3) of springs [m].

        `nodes` (n, 3) are their positions [m]. Springs are strings, then elastic bars.
        """
        return np.asarray(self._across @ nodes)

    def bar_vectors(self, nodes: Array) -> Array:
        """Compute the vectors (β_r, 3) of rigid bars [m].

        `nodes` (n, 3) are their positions [m].
        """
        return np.asarray(self._across_bars @ nodes)

    def bar_errors(self, nodes: Array) -> Array:
        """Compute the constraint residuals φ (β_r,) of rigid bars [m].

        `nodes` (n, 3) are their positions [m].
        """
        bars = self.bar_vectors(nodes)
        squared = np.einsum("ij,ij->i", bars, bars)
        return np.asarray((squared - self.lengths**2) / (2 * self.lengths))

    # --- derivatives with respect to inputs ---

    def push(self, nodes: Array, given: Conditions, change: Array) -> Array:
        """Compute the directional derivative (n, 3) of applied forces.

        It is that at nodes (n, 3) and `given` inputs. The direction is a change (nw,) of the
        inputs.
        """
        springs = self._across @ nodes
        by_length = np.zeros(len(springs))
        if len(springs):
            squared = np.einsum("ij,ij->i", springs, springs)
            (by_length,) = self._law_changes(squared, given.inputs, change)
        (loads,) = self._load_changes(
            nodes, nodes, given.anchor, *given.instant, given.inputs, change
        )
        return np.asarray(
            loads.reshape(nodes.shape) - self._across.T @ (by_length.reshape(-1, 1) * springs)
        )

    # --- CasADi functions ---

    @cached_property
    def load_pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of the nonzeros in `StaticPoint.load_slopes`.

        Both count coordinates, three for each node.
        """
        patterns = [self._load_function.sparsity_out(k).get_triplet() for k in (2, 3)]
        rows, columns = (
            np.concatenate([np.array(pattern[k], dtype=np.intp) for pattern in patterns])
            for k in (0, 1)
        )
        return rows, columns

    @property
    def inputs(self) -> int:
        """Number of inputs: controls, then parameters."""
        return self.scene.nu + len(self.scene.layout)

    def _densities(self, squared: Any, w: Any, corner: bool) -> Any:
        """Build force densities γ (1×springs) from squared lengths and inputs w.

        With `corner`, strings at their rest lengths count as taut.
        """
        scene, u, internal = bind(self.scene, w)
        columns: Any = self._columns(w)
        count, parts = len(self.structure.strings), []
        if count:
            row = squared[:, :count]
            strings = StringForces(scene, columns, u, internal)
            if corner and strings.switch_count:
                first = scene.first_strings[scene.switching_inputs]
                lengths = ca.sqrt(row[:, first.tolist()])
                taut = strings.excess_lengths(row) >= -NEGLIGIBLE * lengths
                strings = replace(strings, mode=taut)
            parts.append(strings.law_density(row))
        if len(self.elastic):
            parts.append(ElasticBars(scene, columns).law_density(squared[:, count:]))
        return ca.densify(ca.horzcat(*parts))

    def _columns(self, w: Any) -> NodeColumns:
        """Build the substitute for a mechanism, with the masses in w.

        It has a column of N for each node.
        """
        n = len(self.structure.nodes)
        weights = node_weights(self.scene).expression(w[self.scene.nu :, :])  # a column, if empty
        row = ca.repmat(weights.T, 1, n // weights.shape[0])
        every = np.arange(n)
        return NodeColumns(self.structure.nodes.T, every, every, self.structure.bars, row)

    @cached_property
    def _law_symbols(self) -> tuple[Any, Any]:
        return ca.MX.sym("squared", 1, len(self.spring_pairs)), ca.MX.sym("w", self.inputs)

    @cached_property
    def _laws(self) -> ArrayFunction:
        """Function (squared lengths, w) → γ, dγ/d(squared lengths), coupling.

        w are the inputs. The coupling is the derivative between strings of one cable.
        """
        squared, w = self._law_symbols
        gamma, taut = (self._densities(squared, w, corner) for corner in (False, True))
        if not len(self.coupled):
            slope = ca.jtimes(taut, squared, ca.DM.ones(*squared.shape))
            return ArrayFunction(
                ca.Function("laws", [squared, w], [gamma, ca.densify(slope), ca.DM(0, 1)])
            )
        size = squared.shape[1]
        first, second = ([*range(size), *self.coupled[:, side].tolist()] for side in (0, 1))
        pattern, place = ca.Sparsity.triplet(size, size, first, second, False)
        entries = ca.project(ca.jacobian(taut, squared), pattern).nz[:]
        slopes = entries[np.argsort(place).tolist()]
        outputs = [gamma, *ca.vertsplit(ca.densify(slopes), [0, size, slopes.shape[0]])]
        return ArrayFunction(ca.Function("laws", [squared, w], outputs))

    @cached_property
    def _law_changes(self) -> ArrayFunction:
        """Function (squared lengths, w, dw) → directional derivative of γ.

        dw is a change of the inputs w.
        """
        squared, w = self._law_symbols
        dw = ca.MX.sym("dw", self.inputs)
        change = ca.jtimes(self._densities(squared, w, True), w, dw)
        return ArrayFunction(ca.Function("changes", [squared, w, dw], [ca.densify(change)]))

    @cached_property
    def _load_symbols(self) -> tuple[Any, ...]:
        """CasADi symbols of the arguments of load Functions.

        They are the nodes N, C and A (3n), the slip distance, the time and the inputs w.
        """
        size = 3 * len(self.structure.nodes)
        names = {"N": size, "C": size, "A": size, "slip": 1, "time": 1, "w": self.inputs}
        return tuple(ca.MX.sym(name, count) for name, count in names.items())

    @cached_property
    def _load_expressions(self) -> tuple[Any, Any]:
        """Build the sum of loads and ground forces (3n) [N], and the ground forces (3n) [N].

        They act at node positions N. Friction opposes the slip from positions A to N; its limit is
        the normal force at positions C.
        """
        N, C, A = (ca.reshape(nodes, 3, -1) for nodes in self._load_symbols[:3])
        slip, time, w = self._load_symbols[3:]
        mech: Any = self._columns(w)
        at, slipped = NodeMotion(N, ca.DM.zeros(*N.shape), time), (N - A) / slip
        loads = ground = ca.MX(*N.shape)
        for element in build_elements(self.scene, mech, w):
            if isinstance(element, BarContacts):
                loads += _contact_forces(element, at, C, slipped)
            elif isinstance(element, ContactElement):
                ground += _contact_forces(element, at, C, slipped)
            elif not isinstance(element, (StringForces, ElasticBars)):
                loads += element.forces(at)
        return ca.vec(ca.densify(loads + ground)), ca.vec(ca.densify(ground))

    @cached_property
    def _load_function(self) -> ca.Function:
        """Function of the loads and their Jacobians.

        (N, C, A, slip, time, w) → loads, ground forces, Jacobians of loads with respect to N, C.
        """
        loads, ground = self._load_expressions
        none = ca.MX(*[loads.shape[0]] * 2)
        slopes = [
            ca.jacobian(loads, nodes) if self.follows else none for nodes in self._load_symbols[:2]
        ]
        return ca.Function("loads", [*self._load_symbols], [loads, ground, *slopes])

    @cached_property
    def _loads(self) -> ArrayFunction:
        return ArrayFunction(self._load_function)

    @cached_property
    def _load_changes(self) -> ArrayFunction:
        """Function of the directional derivative of the loads.

        (N, C, A, slip, time, w, dw) → change of the loads for a change dw of the inputs.
        """
        loads, _ = self._load_expressions
        dw = ca.MX.sym("dw", self.inputs)
        change = ca.jtimes(loads, self._load_symbols[-1], dw)
        return ArrayFunction(
            ca.Function("load_changes", [*self._load_symbols, dw], [ca.densify(change)])
        )


def _find_body_bars(scene: Scene) -> tuple[Indices, Array]:
    """Find the massless bars of bodies (b, 2) and their lengths.

    Auxiliary nodes are not needed at rest. Raises ValueError if a weight acts on one.
    """
    s, bodies = scene.modelled, scene.modelled._assembly
    if bodies is None:
        return np.zeros((0, 2), dtype=np.intp), np.zeros(0)
    weights = np.asarray(bodies.mass.sum(axis=1)).ravel()
    if scene.gravity is not None and np.any(
        abs(weights[len(s.nodes) :]) > NEGLIGIBLE * weights.sum()
    ):
        raise ValueError(
            "bodies: a center of mass lies off the plane of its body's nodes: add a node off this "
            "plane to the body"
        )
    real = (bodies.bars < len(s.nodes)).all(axis=1)
    return bodies.bars[real], bodies.lengths[real]


def _contact_forces(element: ContactElement, at: NodeMotion, C: Any, slipped: Any) -> Any:
    """Build the contact forces (3×n) on nodes at rest.

    Friction resists `slipped` (3×n), relative to the slip distance. Its limit is given by the
    normal forces at C.
    """
    surface = element.surface
    bare = replace(element, surface=with_fields(surface, friction=None, damping=0.0))
    force = bare.forces(at)
    if surface.friction is None:
        return force
    rough = replace(element, surface=with_fields(surface, damping=0.0))
    pressed = at._replace(N=C, V=surface.slip_speed * slipped)
    return force + rough.forces(pressed) - bare.forces(pressed)
