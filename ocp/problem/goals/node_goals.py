"""Goals for nodes and for the center of mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals.goal import FREE_AXIS, FreePoint, Goal
from ocp.problem.rows import RELIABLE, Rows
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.field_types import PER_ITEM, POINT, POINTS
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    Array,
    Check,
    IndexOrName,
    coordinates,
    finite_array,
    format_value,
    node_index,
    positive_each,
)

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


def _read(field: str, given: Any, example: str) -> Any:
    """Read node positions or velocities from a mapping or array.

    ``given`` is the argument ``field`` of a goal. A mapping has three numbers or None for each of
    its nodes; an array is (n, 3). ``example`` is the cure in error messages.
    """
    if not isinstance(given, Mapping):
        return finite_array(field, given, (None, 3))
    if not given:
        raise ValueError(f"{field} is empty: give {{node: {example}}}")
    return {
        node: coordinates(f"{field}[{format_value(node)}]", entry, FREE_AXIS, some=True)
        for node, entry in given.items()
    }


_Given = Mapping[IndexOrName, Sequence[float | None]] | ArrayLike
_EACH = OfStructure("nodes", Either((dict,), MapOf("node", POINT), POINTS))
_Vector = Check(partial(finite_array, shape=(None,)))
_Masses = Annotated[ArrayLike, PER_ITEM, _Vector, positive_each("node", zero=True)]


@dataclass(frozen=True, eq=False)
class NodePositions(Goal, kind="NodePositions"):
    """Goal for the final positions of nodes.

    Parameters
    ----------
    positions : mapping of int or str to sequence of float or None, or array_like of shape (n, 3)
        ``{node: (x, y, z)}`` [m], with None for a free axis; or the positions of all nodes.

    Raises
    ------
    TypeError, ValueError
        If a position is not three numbers or None, or if all are None. In a `Problem`: if a node
        does not exist, or is pinned at another position.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodePositions({3: (None, None, 1.0)}).positions
    {3: (None, None, 1.0)}
    """

    positions: Annotated[_Given, _EACH, Check(partial(_read, example="(x, y, z)"))]

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or is pinned at a position that differs by more than 1 % of
            the structure's size.
        """
        tolerance = RELIABLE * measure_diagonal(structure.nodes)
        for node, axis, value in _entries("NodePositions.positions", self.positions, structure):
            held = structure.nodes[node, axis]
            if structure.fixed[node, axis] and abs(value - held) > tolerance:
                place_text = (
                    f"{'xyz'[axis]} = {value:g} m of node {node}, which is pinned at {held:g} m"
                )
                raise ValueError(
                    f"NodePositions.positions[{node}] wants {place_text}: leave that axis None"
                )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the coordinates minus the desired ones.

        Pinned coordinates at their goals have no residual.

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
        return _rows(
            "NodePositions",
            self.places(structure),
            np.where(structure.fixed, structure.nodes, np.inf),
            nodes,
            "m",
        )

    def places(self, structure: Structure) -> list[tuple[int, int, float]]:
        """List the node coordinates that the goal prescribes.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.

        Returns
        -------
        list of (int, int, float)
            Node, axis and value [m].
        """
        return _entries("NodePositions.positions", self.positions, structure)

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Move nodes (n, 3) to the prescribed positions [m].

        Bars may change their lengths.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], with the nodes inside strings last.

        Returns
        -------
        ndarray, shape (n, 3)
            The nodes with the coordinates of the goal.
        """
        moved = nodes.copy()
        for node, axis, value in self.places(structure):
            moved[node, axis] = value
        return moved


@dataclass(frozen=True, eq=False)
class NodeVelocities(Goal, kind="NodeVelocities"):
    """Goal for the final velocities of nodes.

    Parameters
    ----------
    velocities : mapping of int or str to sequence of float or None, or array_like of shape (n, 3)
        ``{node: (vx, vy, vz)}`` [m/s], with None for a free axis; or the velocities of all nodes.

    Raises
    ------
    TypeError, ValueError
        If a velocity is not three numbers or None, or if all are None. In a `Problem`: if a node
        does not exist, or has a nonzero velocity along a pinned axis.

    See Also
    --------
    AtRest : All velocities zero.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodeVelocities({3: (None, None, 0.5)}).velocities
    {3: (None, None, 0.5)}
    """

    velocities: Annotated[_Given, _EACH, Check(partial(_read, example="(vx, vy, vz)"))]

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or has a nonzero velocity along a pinned axis.
        """
        for node, axis, value in _entries("NodeVelocities.velocities", self.velocities, structure):
            if structure.fixed[node, axis] and value:
                wanted = f"{'xyz'[axis]} = {value:g} m/s of node {node}, which is pinned along it"
                raise ValueError(
                    f"NodeVelocities.velocities[{node}] wants {wanted}: leave that axis None"
                )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the velocities minus the desired ones.

        Pinned axes have no residual.

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
        return _rows(
            "NodeVelocities",
            _entries("NodeVelocities.velocities", self.velocities, structure),
            np.where(structure.fixed, 0.0, np.inf),
            velocities,
            "m/s",
        )


@dataclass(frozen=True)
class AtRest(Goal, kind="AtRest"):
    """Goal of zero final velocities of all nodes.

    Examples
    --------
    >>> import ocp
    >>> ocp.AtRest()
    AtRest()
    """

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the velocities of all nodes of the model.

        Pinned axes have no residual.

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
        held = {(int(node), int(axis)) for node, axis in np.argwhere(structure.fixed)}
        free = [
            (node, axis)
            for node in range(velocities.shape[1])
            for axis in range(3)
            if (node, axis) not in held
        ]
        value = ca.vertcat(*(velocities[axis, node] for node, axis in free))
        return Rows(
            value,
            tuple(f"AtRest: node {node} {'xyz'[axis]}" for node, axis in free),
            ("m/s",) * len(free),
        )


@dataclass(frozen=True, eq=False)
class CenterOfMass(Goal, kind="CenterOfMass", earlier="CentreOfMass"):
    """Goal for the final position of the center of mass.

    It is the center of the whole mass of the model: of bars, nodes and strings, pinned or not.

    Parameters
    ----------
    position : sequence of float or None, length 3
        Position (x, y, z) [m], with None for a free axis.
    masses : array_like of shape (n,), optional
        Mass of each node of the model [kg], with the nodes inside strings last. None for the masses
        of the problem's model.

    Raises
    ------
    TypeError, ValueError
        If the position is not three numbers or None, or if all are None. Also if a mass is negative
        or not a number, or if all are zero.

    Examples
    --------
    >>> import ocp
    >>> ocp.CenterOfMass((None, None, 1.2)).position
    (None, None, 1.2)
    """

    position: FreePoint
    masses: _Masses | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.masses is not None and not np.any(self.masses):
            raise ValueError(
                "CenterOfMass.masses are all 0: give those of the nodes, or None for those of the model"
            )

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        ValueError
            If there are fewer masses than nodes.
        """
        if self.masses is not None and len(np.asarray(self.masses)) < len(structure.nodes):
            given = len(np.asarray(self.masses))
            raise ValueError(
                f"CenterOfMass.masses has {given} entries: give one for each of {len(structure.nodes)} nodes, or None"
            )

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Read the masses of the nodes from the model.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Initial state; None if it is free.

        Returns
        -------
        Goal
            The same goal, with the masses of the model by default.

        Raises
        ------
        ValueError
            If the number of masses differs from that of the model's nodes.
        """
        count = len(model.structure.nodes)
        if self.masses is None:
            mechanism = model.mechanism
            if abs(mechanism.node_weight[count:]).max(initial=0.0) > NEGLIGIBLE * mechanism.M.sum():
                raise ValueError(
                    "CenterOfMass: a body has its center of mass off the plane of its nodes: "
                    "add a node off this plane to the body"
                )
            return replace(
                self, masses=np.bincount(mechanism.physical, mechanism.node_weight, count)
            )
        finite_array("CenterOfMass.masses", self.masses, (count,))
        return self

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the center of mass minus its desired position.

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

        Raises
        ------
        ValueError
            If the masses are None; a `Problem` sets them.
        """
        if self.masses is None:
            raise ValueError(
                "CenterOfMass.masses is None: give it to a Problem, which knows its model"
            )
        masses = np.asarray(self.masses)
        center = ca.mtimes(nodes, ca.DM(masses / masses.sum()))
        wanted = {axis: value for axis, value in enumerate(self.position) if value is not None}
        value = ca.vertcat(*(center[axis] - value for axis, value in wanted.items()))
        return Rows(
            value, tuple(f"CenterOfMass: {'xyz'[axis]}" for axis in wanted), ("m",) * len(wanted)
        )


def _entries(field: str, given: Any, structure: Structure) -> list[tuple[int, int, float]]:
    """List node, axis and value of each prescribed coordinate.

    ``given`` is a mapping by node or an array (n, 3), and ``field`` its name in messages.
    """
    count = len(structure.nodes)
    if not isinstance(given, Mapping):
        given = dict(enumerate(finite_array(field, given, (count, 3)).tolist()))
    for node in given:
        node_index(f"{field}: node", node, count)
    return [
        (node, axis, value)
        for node, entry in given.items()
        for axis, value in enumerate(entry)
        if value is not None
    ]


def _rows(
    goal: str, entries: list[tuple[int, int, float]], pinned: Array, columns: Any, unit: str
) -> Rows:
    """Build the residuals of prescribed coordinates or velocities of nodes.

    ``columns`` (3×n) are the positions or velocities. ``entries`` are node, axis and value of each
    prescribed coordinate. Those that pins satisfy have no residual: ``pinned`` (n, 3) are the
    pinned values, inf along free axes. ``goal`` begins the names of the residuals, and ``unit`` is
    their unit.
    """
    free = [
        (node, axis, value)
        for node, axis, value in entries
        if not abs(value - pinned[node, axis]) <= NEGLIGIBLE * max(abs(value), 1.0)
    ]
    value = ca.vertcat(*(columns[axis, node] - wanted for node, axis, wanted in free))
    return Rows(
        value,
        tuple(f"{goal}: node {node} {'xyz'[axis]}" for node, axis, _ in free),
        (unit,) * len(free),
    )
