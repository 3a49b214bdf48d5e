"""Goals for the orientation of bars and node triples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals.goal import Goal
from ocp.problem.goals.rotation import Rotation, rotation_matrix
from ocp.problem.rows import Rows
from tenscasadi.schema.field_types import VECTOR, Index, Members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    Array,
    IndexOrName,
    check_indices,
    format_value,
    index_or_name,
    node_index,
)


@dataclass(frozen=True, eq=False)
class BarOrientation(Goal, kind="BarOrientation"):
    """Goal for the final direction of a bar.

    Parameters
    ----------
    bar : int
        Index of the bar.
    direction : array_like, shape (3,)
        Direction from the first to the second node of the bar, of any length > 0.

    Raises
    ------
    TypeError, ValueError
        If the index is not a whole number, or the direction is zero. In a `Problem`: if there is no
        such bar.

    Examples
    --------
    >>> import ocp
    >>> ocp.BarOrientation(0, (0, 0, 2)).direction.tolist()
    [0.0, 0.0, 1.0]
    """

    bar: Annotated[IndexOrName, Index("bar")]
    direction: Annotated[ArrayLike, VECTOR]

    def __post_init__(self) -> None:
        super().__post_init__()
        given = np.asarray(self.direction)
        length = float(np.linalg.norm(given))
        if not length:
            raise ValueError(
                "BarOrientation.direction is zero: give a direction, such as (0, 0, 1)"
            )
        object.__setattr__(self, "direction", given / length)

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If there is no such bar.
        """
        node_index("BarOrientation.bar", self.bar, len(structure.bars), "bar")

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the vector along the bar minus the desired one.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        first, second = structure.bars[self.bar].tolist()
        wanted = structure.bar_lengths[self.bar] * np.asarray(self.direction)
        value = nodes[:, second] - nodes[:, first] - ca.DM(wanted)
        names = tuple(f"BarOrientation: {axis} of bar {self.bar}" for axis in "xyz")
        return Rows(value, names, ("m",) * 3)

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Rotate the bar about its center to the desired direction.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], with the nodes inside strings last.

        Returns
        -------
        ndarray, shape (n, 3)
            Nodes with the bar in its direction.
        """
        ends, moved = structure.bars[self.bar].tolist(), np.array(nodes)
        half = structure.bar_lengths[self.bar] * np.asarray(self.direction) / 2
        moved[ends] = nodes[ends].mean(axis=0) + np.array([-half, half])
        return moved


@dataclass(frozen=True, eq=False)
class NodeTripleOrientation(Goal, kind="NodeTripleOrientation"):
    """Goal for the final orientation of three nodes.

    The orientation is that of the direction from the first to the second node, and of the normal of
    the plane through all three. Distances between the nodes may change.

    Parameters
    ----------
    nodes : sequence of int or str, length 3
        Three nodes.
    rotation : array_like, shape (3, 3) or (3,)
        Rotation from the orientation of the structure's nodes to the final one: a matrix, or a
        rotation vector [rad]. Its axes are x, y, z.

    Raises
    ------
    TypeError, ValueError
        If the nodes are not three different ones, or the matrix is not a rotation. In a `Problem`:
        if a node does not exist, or the nodes lie on a line.

    See Also
    --------
    BodyOrientation : Orientation of a rigid body.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodeTripleOrientation((3, 4, 5), (0, 0, 0.5)).nodes
    (3, 4, 5)
    """

    nodes: Annotated[Sequence[IndexOrName], Members("node")]
    rotation: Rotation

    def __post_init__(self) -> None:
        super().__post_init__()
        nodes = self.nodes
        for node in nodes:
            index_or_name("NodeTripleOrientation.nodes", node)
        if len(set(nodes)) != 3 or len(nodes) != 3:
            raise ValueError(
                f"NodeTripleOrientation.nodes is {format_value(nodes)}: give three different nodes"
            )

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or the nodes lie on a line.
        """
        check_indices("NodeTripleOrientation.nodes", self.nodes, len(structure.nodes))
        first, second = _edges(structure.nodes.T, self.nodes)
        size = np.linalg.norm(first) * np.linalg.norm(second)
        if np.linalg.norm(np.cross(first, second)) <= NEGLIGIBLE * size:
            raise ValueError(
                f"NodeTripleOrientation.nodes is {format_value(self.nodes)}, three nodes on a line: "
                "give nodes that span a plane"
            )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the deviations of first edge and normal.

        Both are unit vectors, multiplied by the initial length of the edge.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        start = _edges(structure.nodes.T, self.nodes)
        size = float(np.linalg.norm(start[0]))
        wanted = rotation_matrix(self.rotation) @ _frame(*start)
        edge, other = _edges(nodes, self.nodes)
        normal = ca.cross(edge, other)
        value = size * ca.vertcat(
            edge / ca.norm_2(edge) - ca.DM(wanted[:, 0]),
            normal / ca.norm_2(normal) - ca.DM(wanted[:, 2]),
        )
        across, along = ca.DM(wanted[:, 1:]), ca.DM(wanted[:, 2])
        linear = ca.vertcat(  # zero if the orientation is the desired one, or turned by π
            ca.mtimes(across, ca.mtimes(across.T, edge)),
            ca.dot(along, edge),
            ca.dot(along, other),
            0,
        )
        label = "nodes " + ", ".join(map(str, self.nodes))
        names = tuple(
            f"NodeTripleOrientation: {axis} of {part} of {label}"
            for part in ("the first edge", "the normal")
            for axis in "xyz"
        )
        return Rows(value, names, ("m",) * 6, quadratic=linear)

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Rotate the three nodes about their mean into the goal.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], with the nodes inside strings last.

        Returns
        -------
        ndarray, shape (n, 3)
            Nodes with the triple in its orientation.
        """
        own, moved = list(self.nodes), np.array(nodes)
        wanted = rotation_matrix(self.rotation) @ _frame(*_edges(structure.nodes.T, self.nodes))
        turn = wanted @ _frame(*_edges(nodes.T, self.nodes)).T
        center = nodes[own].mean(axis=0)
        moved[own] = (nodes[own] - center) @ turn.T + center
        return moved


def _edges(nodes: Any, triple: Sequence[int]) -> tuple[Any, Any]:
    """Compute vectors from a triple's first node to the others.

    Nodes are 3×n.
    """
    first, second, third = triple
    return nodes[:, second] - nodes[:, first], nodes[:, third] - nodes[:, first]


def _frame(edge: Array, other: Array) -> Array:
    """Build the orthonormal frame (3, 3) of two vectors in a plane.

    Its columns are the direction of `edge`, the perpendicular in the plane, and the normal.
    """
    first, normal = edge / np.linalg.norm(edge), np.cross(edge, other)
    normal = normal / np.linalg.norm(normal)
    return np.column_stack([first, np.cross(normal, first), normal])
