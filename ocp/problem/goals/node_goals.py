"""Goals of node positions and velocities, and of the center of mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals.goal import Goal
from ocp.problem.rows import Rows
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.field_types import PER_ITEM, POINT, POINTS
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    Array,
    coordinates,
    finite_array,
    format_value,
    node_index,
    nonnegative,
)

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

_EACH = OfStructure("nodes", Either((dict,), MapOf("node", POINT), POINTS))


@dataclass(frozen=True, eq=False)
class NodePositions(Goal, kind="NodePositions"):
    """Node positions at the end.

    Parameters
    ----------
    positions : mapping of int to sequence of float or None, or array_like of shape (n, 3)
        ``{node: (x, y, z)}``, m, None for an axis that is free; or the places of all nodes.

    Raises
    ------
    TypeError, ValueError
        If a place has not three coordinates, or all are None; with a problem, if a node does not
        exist, or is pinned elsewhere.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodePositions({3: (None, None, 1.0)}).positions
    {3: (None, None, 1.0)}
    """

    positions: Annotated[Mapping[int, Sequence[float | None]] | ArrayLike, _EACH]

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "positions", _read("NodePositions.positions", self.positions, "(x, y, z)")
        )

    def check(self, structure: Structure) -> None:
        """Reject a structure that the goal does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or is pinned elsewhere.
        """
        tolerance = 1e-9 * np.ptp(structure.nodes, axis=0).max()
        for node, axis, value in _entries("NodePositions.positions", self.positions, structure):
            held = structure.nodes[node, axis]
            if structure.fixed[node, axis] and abs(value - held) > tolerance:
                place_text = f"{'xyz'[axis]} = {value:g} m of a node that is pinned at {held:g} m"
                raise ValueError(
                    f"NodePositions.positions[{node}] wants {place_text}: leave that axis None"
                )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build coordinate minus wanted coordinate; pinned ones have no row.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : casadi.SX
            Node positions, 3×n, m.
        velocities : casadi.SX
            Node velocities, 3×n, m/s.

        Returns
        -------
        Rows
            Named rows that vanish where the goal is met.
        """
        return _rows(
            "NodePositions",
            self.places(structure),
            structure,
            nodes,
            "m",
        )

    def places(self, structure: Structure) -> list[tuple[int, int, float]]:
        """List the coordinates that the goal gives.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.

        Returns
        -------
        list of (int, int, float)
            Node, axis and value [m].
        """
        return _entries("NodePositions.positions", self.positions, structure)

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Move nodes to their places, whatever the bars.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], those inside strings last.

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
    """Node velocities at the end.

    Parameters
    ----------
    velocities : mapping of int to sequence of float or None, or array_like of shape (n, 3)
        ``{node: (vx, vy, vz)}``, m/s, None for an axis that is free; or the velocities of all
        nodes.

    Raises
    ------
    TypeError, ValueError
        If a velocity has not three entries, or all are None; with a problem, if a node does not
        exist, or is pinned along an axis with a velocity.

    See Also
    --------
    AtRest : all velocities zero.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodeVelocities({3: (None, None, 0.5)}).velocities
    {3: (None, None, 0.5)}
    """

    velocities: Annotated[Mapping[int, Sequence[float | None]] | ArrayLike, _EACH]

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "velocities", _read("NodeVelocities.velocities", self.velocities, "(vx, vy, vz)")
        )

    def check(self, structure: Structure) -> None:
        """Reject a structure that the goal does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or is pinned along an axis with a velocity.
        """
        for node, axis, value in _entries("NodeVelocities.velocities", self.velocities, structure):
            if structure.fixed[node, axis] and value:
                wanted = f"{'xyz'[axis]} = {value:g} m/s of a node that is pinned along it"
                raise ValueError(
                    f"NodeVelocities.velocities[{node}] wants {wanted}: leave that axis None"
                )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build velocity minus wanted velocity; pinned axes have no row.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : casadi.SX
            Node positions, 3×n, m.
        velocities : casadi.SX
            Node velocities, 3×n, m/s.

        Returns
        -------
        Rows
            Named rows that vanish where the goal is met.
        """
        return _rows(
            "NodeVelocities",
            _entries("NodeVelocities.velocities", self.velocities, structure),
            structure,
            velocities,
            "m/s",
        )


@dataclass(frozen=True)
class AtRest(Goal, kind="AtRest"):
    """All velocities are zero at the end.

    Examples
    --------
    >>> import ocp
    >>> ocp.AtRest()
    AtRest()
    """

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the velocities of all modelled nodes.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : casadi.SX
            Node positions, 3×n, m.
        velocities : casadi.SX
            Node velocities, 3×n, m/s.

        Returns
        -------
        Rows
            Named rows that vanish where the goal is met.
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
    """Position of the center of mass at the end.

    All mass of the model counts: of bars, nodes and strings, also of those that are pinned.

    Parameters
    ----------
    position : sequence of float or None, length 3
        (x, y, z), m, None for an axis that is free.
    masses : array_like of shape (n,), optional
        Mass of each node of the model [kg], those inside strings last; None for the masses of the
        problem's model.

    Raises
    ------
    TypeError, ValueError
        If the position has not three coordinates, or all are None; or masses are no numbers,
        negative, or all zero.

    Examples
    --------
    >>> import ocp
    >>> ocp.CenterOfMass((None, None, 1.2)).position
    (None, None, 1.2)
    """

    position: Annotated[Sequence[float | None], POINT]
    masses: Annotated[ArrayLike | None, PER_ITEM] = None

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "position",
            coordinates("CenterOfMass.position", self.position, "an axis that is free", some=True),
        )
        if self.masses is not None:
            masses = nonnegative(
                "CenterOfMass.masses",
                finite_array("CenterOfMass.masses", self.masses, (None,)),
                "node",
            )
            if not masses.any():
                raise ValueError(
                    "CenterOfMass.masses are all 0: give those of the nodes, or None for those of the model"
                )
            object.__setattr__(self, "masses", masses)

    def check(self, structure: Structure) -> None:
        """Reject a structure that the goal does not fit.

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
        """Complete the goal.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Its start; None where it is free.

        Returns
        -------
        Goal
            The same goal, with the masses of the model where it has none.

        Raises
        ------
        ValueError
            If the masses are not one for each node of the model.
        """
        count = len(model.structure.nodes)
        if self.masses is None:
            mechanism = model.mechanism
            return replace(
                self, masses=np.bincount(mechanism.physical, mechanism.node_weight, count)
            )
        finite_array("CenterOfMass.masses", self.masses, (count,))
        return self

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build coordinate minus wanted coordinate of the center of mass.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : casadi.SX
            Node positions, 3×n, m.
        velocities : casadi.SX
            Node velocities, 3×n, m/s.

        Returns
        -------
        Rows
            Named rows that vanish where the goal is met.

        Raises
        ------
        ValueError
            If the masses are not known: a `Problem` knows them.
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


def _read(field: str, given: Any, example: str) -> Any:
    """Read three numbers or None for each node of a mapping, or an array (n, 3)."""
    if not isinstance(given, Mapping):
        return finite_array(field, given, (None, 3))
    if not given:
        raise ValueError(f"{field} is empty: give {{node: {example}}}")
    return {
        node: coordinates(
            f"{field}[{format_value(node)}]", entry, "an axis that is free", some=True
        )
        for node, entry in given.items()
    }


def _entries(field: str, given: Any, structure: Structure) -> list[tuple[int, int, float]]:
    """List node, axis and value of all entries."""
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
    goal: str, entries: list[tuple[int, int, float]], structure: Structure, columns: Any, unit: str
) -> Rows:
    """Build entry minus wanted entry of columns (3×n), but for pinned axes."""
    free = [(node, axis, value) for node, axis, value in entries if not structure.fixed[node, axis]]
    value = ca.vertcat(*(columns[axis, node] - wanted for node, axis, wanted in free))
    return Rows(
        value,
        tuple(f"{goal}: node {node} {'xyz'[axis]}" for node, axis, _ in free),
        (unit,) * len(free),
    )
