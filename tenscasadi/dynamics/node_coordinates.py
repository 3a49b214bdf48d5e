"""Conversion between states x and nodes N, V (positions, velocities)."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.base_model import BaseModel
from tenscasadi.scene.control_function import ControlSchedule
from tenscasadi.scene.internal_states import join_initial
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.structure.names import name_errors
from tenscasadi.util.immutable import read_only
from tenscasadi.util.validate import FILE_ROUNDING, Array, Indices, finite_array, rows_of_size

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Coordinates, Mechanism
    from tenscasadi.scene.scene import Scene


class StateParts(NamedTuple):
    """Parts of a state.

    Attributes
    ----------
    positions, velocities : array or CasADi rows
        Free coordinates (nq) [m] and their velocities (nq) [m/s].
    internal : array or CasADi rows
        Internal states (na), see `Scene.internal_states`.
    clock : array or CasADi rows
        Time [s], of size 1 or 0.
    """

    positions: Any
    velocities: Any
    internal: Any
    clock: Any


class NodeCoordinates(BaseModel):
    """Base class of `Model` that relates states and node positions.

    A state has positions, velocities, internal states and a clock. Supports can move.

    Attributes
    ----------
    nq, na, nx : int
        Sizes of the positions, of the internal states, and of the state.
    """

    schedule: ControlSchedule | None = None  # control over time that u is added to

    def __init__(self, scene: Scene, coordinates: Coordinates, mechanism: Mechanism) -> None:
        self.scene, self.structure = scene, scene.modelled
        self.coordinates: Coordinates = coordinates
        self.mechanism = mechanism
        self._supports = None if scene.supports is None else scene.supports.rates()
        self._free = mechanism.free_index
        self.nq = len(self._free)
        self.na = len(join_initial(scene.internal_states))
        self.nx = 2 * self.nq + self.na + (1 if self.has_clock else 0)

    @property
    def has_clock(self) -> bool:
        """Whether the state has a clock."""
        return self.scene.has_clock or self.schedule is not None

    @cached_property
    def entries(self) -> Indices:
        """Index in q of each node coordinate (n, 3).

        It is -1 for a prescribed coordinate. Inclined rollers have coordinates along their own
        axes.
        """
        indices = np.full(self.mechanism.N.size, -1, dtype=np.intp)
        indices[self._free] = np.arange(self.nq)
        return read_only(indices.reshape(-1, 3)[self.mechanism.first])  # type: ignore[no-any-return]

    # --- numbers ---

    @property
    def moving(self) -> slice:
        """Entries of the state except the clock."""
        return slice(0, 2 * self.nq + self.na)

    @name_errors
    def state(self, nodes: Any, velocities: Any = None, internal: Any = None) -> Array:
        """Build the state from node positions and velocities.

        Its clock is 0.

        Parameters
        ----------
        nodes : array_like, shape (n, 3)
            Positions of the physical nodes, including those inside subdivided strings [m].
        velocities : array_like, shape (n, 3), optional
            Velocities [m/s]; at rest if None. Moving supports keep their own velocities.
        internal : array_like, shape (na,), optional
            Internal states, such as rest lengths; their initial values if None.

        Returns
        -------
        ndarray, shape (nx,)
            State.

        Raises
        ------
        ValueError
            If a pinned coordinate is displaced or moves, or a node leaves its rigid body.
        """
        n = len(self.structure.nodes)
        positions = finite_array("nodes", nodes, (n, 3))
        speeds = (
            np.zeros((n, 3))
            if velocities is None
            else finite_array("velocities", velocities, (n, 3))
        )
        self._check_dependent_nodes(positions, speeds)
        if self._supports is not None:
            speeds = speeds.copy()
            speeds[self._moved] = self._supports(0.0)[1].full().T  # supports override
        self._check_supports(positions, speeds)
        x = np.zeros(self.nx)
        q, v, own, _ = self.split(x)
        own[:] = (
            join_initial(self.scene.internal_states)
            if internal is None
            else finite_array("internal", internal, (self.na,))
        )
        q[:], v[:] = (
            self.mechanism.local(vectors.ravel())[self._free]
            for vectors in (self.columns(positions), self.columns(positions, speeds))
        )
        return x

    def columns(self, nodes: Array, velocities: Array | None = None) -> Array:
        """Convert node positions or velocities to the columns of N.

        Parameters
        ----------
        nodes : ndarray, shape (n, 3)
            Positions of the physical nodes [m].
        velocities : ndarray, shape (n, 3), optional
            Their velocities [m/s].

        Returns
        -------
        ndarray, shape (columns, 3)
            Velocities if they are given, else positions. Auxiliary nodes move with their bodies.
        """
        own, bodies = nodes if velocities is None else velocities, self.structure._assembly
        found = own[self.mechanism.physical]
        if bodies is not None:
            found[len(nodes) :] = bodies.find_auxiliary(nodes, velocities)
        return found

    def _check_supports(self, positions: Array, speeds: Array) -> None:
        """Check that nodes and velocities (n, 3) satisfy the supports.

        `positions` [m] and `speeds` [m/s] are those of all nodes. Raises ValueError.
        """
        structure, fixed = self.structure, self.structure.fixed.copy()
        fixed[self._moved] = False
        size = measure_extent(structure.nodes)
        moves = {
            "nodes": (positions - structure.nodes, 1e-9 * max(size, 1e-300)),
            "velocities": (speeds, 1e-9 * abs(speeds).max(initial=0.0)),
        }
        for name, (vectors, least) in moves.items():
            for node, axis in np.argwhere((abs(vectors) > least) & fixed)[:1]:
                raise ValueError(
                    f"{name}[{node}, {axis}] moves a pinned coordinate: "
                    f"keep node {node} at {structure.nodes[node]}, at rest"
                )
        for node, normals in structure.rollers.items():
            for name, (vectors, least) in moves.items():
                if np.any(abs(np.array(normals) @ vectors[node]) > least):
                    raise ValueError(
                        f"{name}[{node}] moves node {node} off its roller: "
                        f"do not move it along {normals}"
                    )

    def _check_dependent_nodes(self, positions: Array, speeds: Array) -> None:
        """Check that nodes of rigid bodies move with their body.

        `positions` [m] and `speeds` [m/s] are (n, 3). Raises ValueError.
        """
        if self.mechanism.spread is None:
            return
        size = measure_extent(self.structure.nodes)
        for name, vectors, scale, unit in (
            ("nodes", positions, size, "m"),
            ("velocities", speeds, float(np.abs(speeds).max()), "m/s"),
        ):
            apart = np.abs(vectors - self.place_dependent(np.array(vectors)))
            node = int(apart.max(axis=1).argmax())
            if apart.max() > FILE_ROUNDING * scale:
                raise ValueError(
                    f"{name}[{node}] is {apart.max():.2g} {unit} off its rigid body: "
                    "give all nodes of the body one rigid motion"
                )

    def nodes(self, x: Any) -> Any:
        """Compute the positions of physical nodes.

        Parameters
        ----------
        x : array_like, shape (..., nx), or CasADi column
            States.

        Returns
        -------
        ndarray, shape (..., n, 3), or CasADi matrix, shape (n, 3)
            Positions [m].
        """
        return self._physical(x, 0, self.mechanism.N.T)

    def velocities(self, x: Any) -> Any:
        """Compute the velocities of physical nodes.

        Parameters
        ----------
        x : array_like, shape (..., nx), or CasADi column
            States.

        Returns
        -------
        ndarray, shape (..., n, 3), or CasADi matrix, shape (n, 3)
            Velocities [m/s].
        """
        return self._physical(x, 1, np.zeros_like(self.mechanism.N.T))

    # --- expressions ---

    def split(self, x: Any) -> StateParts:
        """Split states into positions, velocities, internal states and clock.

        The parts are views of arrays (…, nx), or rows of CasADi matrices (nx, …).
        """
        ends = [0, self.nq, 2 * self.nq, 2 * self.nq + self.na, self.nx]
        parts = [slice(*pair) for pair in pairwise(ends)]
        if isinstance(x, np.ndarray):
            return StateParts(*(x[..., part] for part in parts))
        return StateParts(*(x[part, :] for part in parts))

    def unpack(self, x: Any) -> tuple[Any, Any, Any]:
        """Compute N, V (3×n) and the time of a symbolic state.

        Columns are those of `mechanism`. x is a CasADi column (nx).
        """
        start, (q, v, _, clock) = self.mechanism.N.T, self.split(x)
        time = clock if self.has_clock else 0
        N, V = self._place(q, start), self._place(v, np.zeros_like(start))
        if self._supports is not None and self.coordinates == "reduced":
            N[:, self._moved], V[:, self._moved], _ = self._supports(time)
        return self.mechanism.expand(N), self.mechanism.expand(V), time

    def targets(self, time: Any) -> tuple[Any, Any, Any]:
        """Compute D of the joint constraints N P = D, with Ḋ and D̈ (3×c).

        They are the prescribed positions [m], velocities [m/s] and accelerations [m/s²] of joints
        at a time [s]. In full coordinates they include moving supports.
        """
        mech = self.mechanism
        still = ca.DM.zeros(*mech.D.shape)
        if self._supports is None or not mech.joints:
            return ca.DM(mech.D), still, still
        held = mech.P.toarray()
        # columns of P that pin a single copy of a node
        alone = (np.count_nonzero(held, axis=0) == 1) & mech.active.all(axis=0)
        pinned = mech.physical[abs(held).argmax(axis=0)]
        columns = [int(np.flatnonzero(alone & (pinned == node))[0]) for node in self._moved]
        sign = ca.DM(held[:, columns].sum(axis=0)).T
        results = []
        for base, rate in zip((ca.DM(mech.D), still, still), self._supports(time), strict=True):
            D = type(rate)(base)
            D[:, columns] = rate * ca.repmat(sign, 3, 1)
            results.append(D)
        return results[0], results[1], results[2]

    @property
    def _moved(self) -> list[int]:
        return [] if self.scene.supports is None else self.scene.supports.nodes

    def _place(self, free: Any, elsewhere: Array) -> Any:
        if self.nq == elsewhere.size:
            return ca.reshape(free, 3, len(elsewhere))
        vector = type(free)(ca.DM(self.mechanism.local(elsewhere.ravel())))
        vector[self._free.tolist()] = free
        return ca.reshape(self.mechanism.world(vector), 3, len(elsewhere))

    def pack(self, upper: Any, lower: Any, internal: Any, clock: Any) -> Any:
        """Build a state from two matrices (3×n), internal states and clock.

        `upper` are node positions and `lower` velocities, so it is the inverse of `unpack`. For
        time derivatives of a state, they are velocities and accelerations. The internal states are
        ignored if the model has none.
        """
        free = self._free.tolist()
        parts = [
            self.mechanism.local(ca.vec(matrix))[free]
            if self.nq < 3 * matrix.shape[1]
            else ca.vec(matrix)
            for matrix in (upper, lower)
        ]
        own = [internal] if self.na else []
        return ca.densify(ca.vertcat(*parts, *own, *([clock] if self.has_clock else [])))

    def support_accelerations(self, time: Any) -> Any:
        """Compute the accelerations (3×n) of moving supports [m/s²].

        They are zero in full coordinates, where supports are joint constraints.
        """
        if self._supports is None or self.coordinates == "full":
            return ca.DM(*self.mechanism.N.shape)  # sparse zero: adds no instructions
        moved = type(time).zeros(*self.mechanism.N.shape)
        moved[:, self._moved] = self._supports(time)[2]
        return self.mechanism.expand(moved)

    def _physical(self, x: Any, part: int, elsewhere: Array) -> Any:
        if isinstance(x, (ca.SX, ca.MX)):
            columns = self.unpack(check_column("x", x, self.nx))[part]
            return columns[:, self.mechanism.first.tolist()].T
        states = x
        if type(x) is not np.ndarray or x.dtype != float or x.shape[-1:] != (self.nx,):
            states = rows_of_size("x", x, self.nx, "states")
        mech, entries, shape = self.mechanism, self.entries, states.shape[:-1]
        nodes = np.empty((*shape, *entries.shape))
        own = self.split(states)[part]
        if (entries >= 0).all():
            nodes[...] = own[..., entries]
        else:
            nodes[...] = mech.local(elsewhere.ravel()).reshape(-1, 3)[mech.first]
            nodes[..., entries >= 0] = own[..., entries[entries >= 0]]
        if mech.turn is not None:
            nodes = np.einsum("nij,...nj->...ni", mech.frames_of_nodes[mech.first], nodes)
        if self._supports is not None and self.coordinates == "reduced" and states.size:
            times = states[..., -1].ravel()
            moved = self._supports.map(times.size)(times.reshape(1, -1))[part].full().T
            nodes[..., self._moved, :] = moved.reshape(*shape, len(self._moved), 3)
        return self.place_dependent(nodes)

    def place_dependent(self, nodes: Array) -> Array:
        """Set dependent nodes in positions or velocities (…, n, 3).

        Dependent nodes of a rigid body are affine combinations of others.
        """
        spread, n = self.mechanism.spread, nodes.shape[-2]
        if spread is None:
            return nodes
        rows = np.flatnonzero(self.mechanism.dependent[:n])  # auxiliary nodes have no weights
        weights = spread[rows][:, :n].toarray()
        nodes[..., rows, :] = np.einsum("dn,...na->...da", weights, nodes)
        return nodes


def check_column(name: str, value: Any, size: int) -> Any:
    """Check a CasADi column, or convert an array (size,).

    `name` is that of the value in messages. Raises TypeError, ValueError.
    """
    if not isinstance(value, (ca.SX, ca.MX)):
        return ca.DM(finite_array(name, value, (size,)))
    if value.shape != (size, 1):
        raise ValueError(f"{name} has shape {value.shape}: give a column of {size}")
    return value
