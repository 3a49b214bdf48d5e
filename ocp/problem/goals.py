"""What a plan has to reach at its end, as values: each turns a state into rows that are zero there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.rows import Rows
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import coordinates, finite_array, node_index, nonnegative, number_or_vector, per_item, whole_number

OTHER_BAR = 1e-3  # relative: a shape with bars of other lengths is refused, rounded nodes are not


class Goal:
    """Anything that can be asked of the final state."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the goal does not fit the structure."""

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Return the rows that vanish when the goal is met, of nodes and velocities 3×n (CasADi)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class StringLengths(Goal):
    """Strings of given lengths, m: one number for each string, or {string: length} for some of them.

    The length of a string that is modelled in segments is the distance between its ends.
    """

    lengths: ArrayLike | Mapping[int, float]

    def __post_init__(self) -> None:
        values = list(self.lengths.values()) if isinstance(self.lengths, Mapping) else self.lengths
        array = number_or_vector("StringLengths.lengths", values)
        if array.size == 0:
            raise ValueError("StringLengths.lengths is empty: give one length for each string, or {string: length}")
        nonnegative("StringLengths.lengths", array, "entry", strict=True)
        kept: Any = array if array.ndim else float(array)
        object.__setattr__(self, "lengths", dict(zip(self.lengths, array.tolist(), strict=True)) if isinstance(self.lengths, Mapping) else kept)

    def check(self, structure: Structure) -> None:
        """Raise where a string is missing or does not exist."""
        count = len(structure.strings)
        if isinstance(self.lengths, Mapping):
            for string in self.lengths:
                if whole_number("StringLengths.lengths: string", string, 0) >= count:
                    raise ValueError(f"StringLengths.lengths names string {string}: strings run from 0 to {count - 1}")
        else:
            per_item("StringLengths.lengths", self.lengths, count)

    def _wanted(self, structure: Structure) -> dict[int, float]:
        """{string: length}."""
        if isinstance(self.lengths, Mapping):
            return dict(self.lengths)
        return dict(enumerate(per_item("StringLengths.lengths", self.lengths, len(structure.strings)).tolist()))

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Length minus wanted length, m."""
        wanted = self._wanted(structure)
        ends = structure.strings[list(wanted)]
        vectors = nodes[:, ends[:, 1].tolist()] - nodes[:, ends[:, 0].tolist()]
        value = ca.sqrt(ca.sum1(vectors * vectors)).T - ca.DM(list(wanted.values()))
        return Rows(value, tuple(f"StringLengths: string {string}" for string in wanted), ("m",) * len(wanted))


@dataclass(frozen=True, eq=False)
class NodePositions(Goal):
    """Nodes at given places: {node: (x, y, z)}, m, None for an axis that is free; or all nodes (n, 3)."""

    positions: Mapping[int, Sequence[float | None]] | ArrayLike

    def __post_init__(self) -> None:
        if not isinstance(self.positions, Mapping):
            object.__setattr__(self, "positions", finite_array("NodePositions.positions", self.positions, (None, 3)))
            return
        if not self.positions:
            raise ValueError("NodePositions.positions is empty: give {node: (x, y, z)}")
        places = {
            node: coordinates(f"NodePositions.positions[{node}]", place, "an axis that is free", some=True) for node, place in self.positions.items()
        }
        object.__setattr__(self, "positions", places)

    def check(self, structure: Structure) -> None:
        """Raise where a node does not exist or is pinned elsewhere."""
        count = len(structure.nodes)
        if not isinstance(self.positions, Mapping):
            finite_array("NodePositions.positions", self.positions, (count, 3))
        tolerance = 1e-9 * np.ptp(structure.nodes, axis=0).max()
        for node, place in self._wanted().items():
            node_index("NodePositions.positions: node", node, count)
            for axis, value in enumerate(place):
                held = structure.nodes[node, axis]
                if value is not None and structure.fixed[node, axis] and abs(value - held) > tolerance:
                    place_text = f"{'xyz'[axis]} = {value:g} m of a node that is pinned at {held:g} m"
                    raise ValueError(f"NodePositions.positions[{node}] wants {place_text}: leave that axis None")

    def _wanted(self) -> dict[int, tuple[float | None, ...]]:
        """{node: place}."""
        if isinstance(self.positions, Mapping):
            return {node: tuple(place) for node, place in self.positions.items()}
        return {node: tuple(place) for node, place in enumerate(np.asarray(self.positions).tolist())}

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Coordinate minus wanted coordinate, m; pinned coordinates, which are there already, have no row."""
        entries = [
            (node, axis, value)
            for node, place in self._wanted().items()
            for axis, value in enumerate(place)
            if value is not None and not structure.fixed[node, axis]
        ]
        value = ca.vertcat(*(nodes[axis, node] - wanted for node, axis, wanted in entries))
        return Rows(value, tuple(f"NodePositions: node {node} {'xyz'[axis]}" for node, axis, _ in entries), ("m",) * len(entries))


@dataclass(frozen=True)
class AtRest(Goal):
    """No node moves at the end."""

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Velocities of all modelled nodes, m/s."""
        held = {(int(node), int(axis)) for node, axis in np.argwhere(structure.fixed)}
        free = [(node, axis) for node in range(velocities.shape[1]) for axis in range(3) if (node, axis) not in held]
        value = ca.vertcat(*(velocities[axis, node] for node, axis in free))
        return Rows(value, tuple(f"AtRest: node {node} {'xyz'[axis]}" for node, axis in free), ("m/s",) * len(free))


@dataclass(frozen=True, eq=False)
class Shape(Goal):
    """The shape of nodes (n, 3), m, wherever it is and however it is turned: all distances of nodes that no bar keeps.

    A shape and its mirror image have the same distances. For a shape in its place: `NodePositions(nodes)`.
    """

    nodes: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", finite_array("Shape.nodes", self.nodes, (None, 3)))

    def check(self, structure: Structure) -> None:
        """Raise where the number of nodes or the bars differ."""
        nodes = finite_array("Shape.nodes", self.nodes, structure.nodes.shape)
        lengths = np.linalg.norm(nodes[structure.bars[:, 1]] - nodes[structure.bars[:, 0]], axis=1)
        bad = np.flatnonzero(abs(lengths / structure.bar_lengths - 1) > OTHER_BAR)
        if bad.size:
            k = int(bad[0])
            raise ValueError(
                f"Shape.nodes make bar {k} {lengths[k]:g} m long, not {structure.bar_lengths[k]:g} m: give nodes that keep the bars' lengths"
            )
        if len(nodes) < 3:
            raise ValueError(f"Shape.nodes has {len(nodes)} nodes: a shape needs three, use StringLengths or NodePositions")

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Distance minus wanted distance, m."""
        kept = {frozenset(bar) for bar in structure.bars.tolist()}
        pairs = [(a, b) for a, b in combinations(range(len(structure.nodes)), 2) if frozenset((a, b)) not in kept]
        first, second = ([pair[k] for pair in pairs] for k in (0, 1))
        wanted = np.asarray(self.nodes)
        vectors = nodes[:, second] - nodes[:, first]
        value = ca.sqrt(ca.sum1(vectors * vectors)).T - ca.DM(np.linalg.norm(wanted[second] - wanted[first], axis=1))
        return Rows(value, tuple(f"Shape: distance of nodes {a} and {b}" for a, b in pairs), ("m",) * len(pairs))


@dataclass(frozen=True, eq=False)
class Periodic(Goal):
    """The end repeats the start, so that the plan may be run again and again: each node back in its place and at its velocity.

    shift: (x, y, z), m, by which all nodes have moved, as in a gait; None for an axis: as far as the first node has. start: nodes and
    velocities (n, 3) to come back to; None: those of the problem, also where they are sought (`FreeStart`).
    """

    shift: Sequence[float | None] = (0.0, 0.0, 0.0)
    start: tuple[ArrayLike, ArrayLike] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shift", coordinates("Periodic.shift", self.shift, "an axis that is free"))
        if self.start is not None and (not isinstance(self.start, (tuple, list)) or len(self.start) != 2):
            raise TypeError("Periodic.start is no pair: give (nodes, velocities), or None for the start of the problem")

    def check(self, structure: Structure) -> None:
        """Raise where a pinned node would have to move, or `start` does not fit."""
        for name, given in zip(("nodes", "velocities"), self.start or (), strict=False):
            finite_array(f"Periodic.start: {name}", given, structure.nodes.shape)
        for axis, value in enumerate(self.shift):
            if value and structure.fixed[:, axis].any():
                node = int(np.argmax(structure.fixed[:, axis]))
                raise ValueError(f"Periodic.shift moves node {node}, which is pinned along {'xyz'[axis]}: give 0 for that axis")

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Return coordinates and velocities minus those of the start."""
        if self.start is None:
            raise ValueError("Periodic.start is None: give it to a Problem, which knows its start")
        before, speeds = (value if isinstance(value, (ca.SX, ca.MX)) else np.asarray(value) for value in self.start)
        places, rates = [], []
        for node, axis in np.argwhere(~structure.fixed).tolist():
            name, shift = f"Periodic: node {node} {'xyz'[axis]}", self.shift[axis]
            moved = nodes[axis, 0] - before[0, axis] if shift is None else shift
            if shift is not None or node:
                places.append((nodes[axis, node] - before[node, axis] - moved, name))
            rates.append((velocities[axis, node] - speeds[node, axis], f"{name} velocity"))
        values, names = zip(*places, *rates, strict=True)
        return Rows(ca.vertcat(*values), names, ("m",) * len(places) + ("m/s",) * len(rates))
