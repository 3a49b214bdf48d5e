"""Loads on nodes: gravity, pressure and nodal forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from tenscasadi.scene.over_time import OverTime
from tenscasadi.schema.containers import MapOf, NodeForceTable
from tenscasadi.schema.field_types import TIMES, Index, ListOf, Members, varying
from tenscasadi.util.casadi_tools import is_expression
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import RenamedAttribute, rename_fields
from tenscasadi.util.validate import (
    IndexOrName,
    Indices,
    as_tuple,
    finite_array,
    format_value,
    index_or_name,
    node_index,
    number,
)


@rename_fields(breaks="breakpoints")
@dataclass(frozen=True)
class Gravity(OverTime, kind="Gravity", short="acceleration"):
    """Uniform gravity, constant or time-varying.

    A table is linear between its times and constant outside. A function that CasADi cannot trace, as
    with Python's ``if``, is interpolated over each run.

    Parameters
    ----------
    acceleration : sequence of float, shape (3,) or (K, 3), or callable
        Acceleration of a free body [m/s²], a table of it at `times`, or a function of the time [s].
    times : array_like, shape (K,), optional
        Increasing times of a table [s]. Steps of a simulation end there.
    breakpoints : array_like, shape (B,), optional
        Times [s] at which a function jumps or has a kink, or a pulse begins or ends. Jumps of
        comparisons, signs and roundings are found automatically. Steps of a simulation end there.

    Notes
    -----
    Time-varying gravity has no potential energy. Its work is external work.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Gravity((0, 0, -1.62))
    Gravity(acceleration=(0.0, 0.0, -1.62))
    >>> tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity([(0, 0, -9.81), (0, 0, 0)], times=[0.0, 2.0])).has_clock
    True
    """

    _quantity: ClassVar[str] = "acceleration"
    acceleration: Annotated[Any, varying(3)] = (0.0, 0.0, -9.81)
    times: Annotated[Any, TIMES] = field(default=None, repr=False)
    breakpoints: Annotated[Any, TIMES] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        self._read((3,))
        if callable(self.acceleration):
            self._check_function((3,))
        _freeze(self, "acceleration")

    def forces(self, node_weight: Any, time: Any = 0) -> Any:
        """Compute the weights of nodes (3×n) [N].

        Parameters
        ----------
        node_weight : ndarray, shape (n,), or casadi row, shape (1, n)
            Mass that each node carries [kg]: the row sums of the mass matrix.
        time : casadi expression
            Time [s], which constant gravity does not need.

        Returns
        -------
        casadi matrix, shape (3, n)
            Forces W [N].
        """
        row = node_weight if is_expression(node_weight) else ca.DM(node_weight).T
        return ca.mtimes(self.at(time), row)

    def energy(self, N: Any, node_weight: Any) -> Any:
        """Compute the potential energy −Σ mᵢ gᵀnᵢ of constant gravity.

        Parameters
        ----------
        N : casadi matrix, shape (3, n)
            Nodes [m].
        node_weight : ndarray, shape (n,), or casadi row, shape (1, n)
            Mass that each node carries [kg].

        Returns
        -------
        casadi expression
            Energy [J], zero at the origin.
        """
        return ca.DM(0) if self.varies else -ca.sum1(ca.sum2(N * self.forces(node_weight)))


@rename_fields(breaks="breakpoints")
@dataclass(frozen=True)
class Pressure(OverTime, kind="Pressure"):
    """Pressure on triangles that follows their motion.

    Each node a, b, c of a face has the force p/6 (b − a)×(c − a). It points to the side from which
    a, b, c are counterclockwise, which is outwards for a closed surface under inner pressure. The
    pressure is constant or time-varying, as in `NodalForce`.

    Parameters
    ----------
    faces : array_like of int or str, shape (f, 3)
        Nodes of each triangle.
    difference : float, array_like, shape (K,), or callable
        Pressure p [Pa], a table of it at `times`, or a function of the time [s].
    times : array_like, shape (K,), optional
        Increasing times of a table [s]. Steps of a simulation end there.
    breakpoints : array_like, shape (B,), optional
        Times [s] at which a function jumps or has a kink, or a pulse begins or ends. Jumps of
        comparisons, signs and roundings are found automatically. Steps of a simulation end there.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pressure = tc.Pressure(tc.shapes.membrane_faces(p=8, q=5), difference=50.0)
    >>> tc.Scene(tc.shapes.membrane(p=8, q=5), pressure=pressure).pressure.difference
    50.0
    """

    _quantity: ClassVar[str] = "difference"
    faces: Annotated[Sequence[Sequence[IndexOrName]] | Indices, ListOf(Members("node"))]
    difference: Annotated[Any, varying()]
    times: Annotated[Any, TIMES] = field(default=None, repr=False)
    breakpoints: Annotated[Any, TIMES] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        given = as_tuple("Pressure.faces", self.faces, "[(0, 1, 2)] of triangles of node indices")
        faces = tuple(
            as_tuple(f"Pressure.faces[{k}]", face, "(0, 1, 2), three node indices")
            for k, face in enumerate(given)
        )
        for k, face in enumerate(faces):
            for node in face:
                index_or_name(f"Pressure.faces[{k}]", node)
            if len(face) != 3 or len(set(face)) != 3:
                raise ValueError(
                    f"Pressure.faces[{k}] is {face}: give three different node indices"
                )
        object.__setattr__(self, "faces", faces)
        if not self.varies:
            object.__setattr__(self, "difference", number("Pressure.difference", self.difference))
        self._read(())
        if callable(self.difference):
            self._check_function(())
        _freeze(self, "difference")

    def check(self, nodes: int) -> None:
        """Check the node indices of the faces.

        Parameters
        ----------
        nodes : int
            Number of nodes.

        Raises
        ------
        ValueError
            If an index is out of range.
        """
        for k, face in enumerate(self.faces):
            for node in face:
                node_index(f"Pressure.faces[{k}]", node, nodes)

    def forces(self, N: Any, time: Any = 0) -> Any:
        """Build the pressure forces on nodes (3×n) [N].

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].
        time : casadi expression
            Time [s], which a constant pressure does not need.

        Returns
        -------
        casadi expression, shape (3, n)
            Forces W [N].
        """
        a, b, c = ([face[k] for face in self.faces] for k in range(3))
        push = self.at(time) / 6 * ca.cross(N[:, b] - N[:, a], N[:, c] - N[:, a], 1)  # 3×f
        rows = list(range(len(a)))
        spread = ca.DM.triplet(rows * 3, a + b + c, ca.DM.ones(3 * len(a)), len(a), N.shape[1])
        return ca.mtimes(push, spread)


@rename_fields(breaks="breakpoints")
@dataclass(frozen=True, eq=False)
class NodalForce(OverTime, ReadOnlyArrays, kind="NodalForce"):
    """Forces on nodes, constant or time-varying.

    A table is linear between its times and constant outside. A function that CasADi cannot trace, as
    with Python's ``if``, is interpolated over each run.

    Parameters
    ----------
    values : array_like, shape (n, 3) or (K, n, 3), mapping, or callable
        Forces [N], a table of them at `times`, or a function of the time [s]. A mapping has the
        force (3,) or its table (K, 3) by the name or index of a node, until the force is part of a
        scene.
    times : array_like, shape (K,), optional
        Increasing times of a table [s]. Steps of a simulation end there.
    breakpoints : array_like, shape (B,), optional
        Times [s] at which a function jumps or has a kink, or a pulse begins or ends. Jumps of
        comparisons, signs and roundings are found automatically. Steps of a simulation end there.
    bars : mapping of int or str to int or str, optional
        Bar whose end takes the force, by node. Default: the first bar of the node in the columns of
        `Structure.class_one`. The choice changes only the constraint forces in the joint (Ω of
        `Model.multipliers`), not the motion.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> wind = tc.NodalForce(lambda t: [[0, 0, 0], [np.sin(t), 0, 0]])
    >>> tc.Scene(tc.shapes.pendulum(), forces=wind).has_clock
    True
    >>> push = tc.NodalForce({"top[0]": (0, 0, -5)})
    >>> tc.Scene(tc.shapes.prism(), forces=push).forces.values[3].tolist()
    [0.0, 0.0, -5.0]
    """

    _quantity: ClassVar[str] = "values"
    values: Annotated[Any, NodeForceTable()]
    times: Annotated[Any, TIMES] = None
    breakpoints: Annotated[Any, TIMES] = ()
    bars: Annotated[Mapping[IndexOrName, IndexOrName] | None, MapOf("node", Index("bar"))] = None

    def __post_init__(self) -> None:
        self._read((None, 3))
        if self.bars is not None:
            if not isinstance(self.bars, Mapping):
                raise TypeError(
                    f"NodalForce.bars is {format_value(self.bars)}: "
                    "give a mapping from nodes to bars, such as {1: 0}"
                )
            object.__setattr__(self, "bars", dict(self.bars))

    def _read_values(self, value: Any, shape: tuple[int | None, ...]) -> Any:
        if not isinstance(value, Mapping):
            return super()._read_values(value, shape)
        own = (*shape[:-2], 3)
        return {
            index_or_name(self.field, word): finite_array(
                f"{self.field}[{format_value(word)}]", force, own
            )
            for word, force in value.items()
        }

    def at(self, time: Any) -> Any:
        """Compute the forces at a time.

        Parameters
        ----------
        time : casadi expression
            Time [s], which constant forces do not need.

        Returns
        -------
        casadi matrix, shape (3, n)
            Forces [N].

        Raises
        ------
        ValueError
            If the forces are given by node, and are not part of a scene.
        """
        if isinstance(self.values, Mapping):
            raise ValueError(
                f"{self.field} has forces by node: read Scene.forces of a scene with it"
            )
        return super().at(time)

    def check(self, nodes: int, pairs: Indices | None = None) -> None:
        """Check the forces and bars against a structure.

        Parameters
        ----------
        nodes : int
            Number of nodes.
        pairs : ndarray of int, shape (β, 2), optional
            Nodes at the ends of each bar.

        Raises
        ------
        TypeError, ValueError
            If there is not one row of finite numbers for each node, or a bar does not end at its
            node. A function of time is evaluated at t = 0.
        """
        for node, bar in (self.bars or {}).items():
            node_index("NodalForce.bars", node, nodes)
            index_or_name(f"NodalForce.bars[{node}]", bar)
            ends = [] if pairs is None else np.flatnonzero((pairs == node).any(axis=1)).tolist()
            if pairs is not None and bar not in ends:
                raise ValueError(
                    f"NodalForce.bars[{node}] is {format_value(bar)}, which is no bar of node {node}: "
                    f"give one of {ends}, or remove the node"
                )
        if isinstance(self.values, Mapping):
            for node in self.values:
                node_index(self.field, node, nodes)
        elif callable(self.values):
            self._check_function((nodes, 3))
        elif self.values.shape[-2] != nodes:
            raise ValueError(
                f"NodalForce.values has {self.values.shape[-2]} rows: "
                f"give one row for each of the {nodes} nodes"
            )

    forces = RenamedAttribute("at")


def _freeze(load: OverTime, quantity: str) -> None:
    """Convert array fields of a load to hashable tuples, in place.

    They are `times`, `breakpoints` and the field that `quantity` names.
    """
    for name in (quantity, "times", "breakpoints"):
        value = getattr(load, name)
        if isinstance(value, np.ndarray):
            object.__setattr__(load, name, _as_tuple(value.tolist()))


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value
