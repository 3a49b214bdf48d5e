"""Planes with penalty contact and friction, and the base class of grounds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.bar_points import CapsulePoints
from tenscasadi.scene.contact_law import Contact, compute_forces, find_switching
from tenscasadi.schema.containers import Either
from tenscasadi.schema.field_types import VECTOR, Members, Word
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    Array,
    IndexOrName,
    Indices,
    NonNegative,
    Number,
    Positive,
    as_tuple,
    check_indices,
    format_value,
    index_or_name,
)

BARS = Either((str,), Word(("all",)), Members("bar"))


class Surface(Value, ABC, implied="Ground"):
    """Base class of grounds with penalty contact.

    The normal force on a node at penetration depth d with normal velocity v is k d − c v, and at
    least 0. `stiffness` is k [N/m] and `damping` c [N·s/m]. For `friction`, `slip_speed`, `nodes`
    and `bars` see `Ground`.
    """

    stiffness: float
    damping: float
    friction: float | None
    slip_speed: float
    nodes: Iterable[int] | None
    bars: Iterable[int] | str | None

    @abstractmethod
    def contact(self, N: Any) -> Contact:
        """Compute penetration depths and force directions of nodes.

        N (3×n) are the node positions [m].
        """

    @property
    def conservative(self) -> bool:
        """Whether the ground has neither damping nor friction."""
        return self.damping == 0 and self.friction is None

    def check(self, structure: Any) -> None:
        """Check that a structure has the ground's nodes and bars.

        Parameters
        ----------
        structure : Structure
            Nodes and bars.

        Raises
        ------
        ValueError
            If an index is out of range, or there are no bars.
        """
        name, count = type(self).__name__, len(structure.bars)
        check_indices(f"{name}.nodes", self.nodes or (), len(structure.nodes))
        if isinstance(self.bars, str) and not count:
            raise ValueError(f"{name}.bars is {self.bars!r}, but there are no bars: leave it out")
        check_indices(f"{name}.bars", self._list_bars(structure), count, "bar")

    def select_nodes(self, structure: Any) -> Indices:
        """Select the nodes that contact the ground as points.

        Parameters
        ----------
        structure : Structure
            Nodes and bars.

        Returns
        -------
        ndarray of int, shape (k,)
            The given nodes, or all but the ends of `bars`.
        """
        if self.nodes is not None:
            return np.array(self.nodes, dtype=np.intp)
        ends = structure.bars[self._list_bars(structure)]
        return np.setdiff1d(np.arange(len(structure.nodes)), ends)

    def select_bar_points(self, structure: Any) -> CapsulePoints:
        """Select points on bar axes that contact with the bar radius.

        The bars are those of the field `bars`.

        Parameters
        ----------
        structure : Structure
            Bars and their radii.

        Returns
        -------
        CapsulePoints
            The points.
        """
        bars = np.array(self._list_bars(structure), dtype=np.intp)
        counts = [self._count_points(length) for length in structure.bar_lengths[bars].tolist()]
        which = np.repeat(bars, counts)
        fractions = np.concatenate([np.zeros(0), *(np.linspace(0, 1, n) for n in counts)])
        # Shares of the length (trapezoidal rule): the force does not depend on the number of points.
        weights = np.repeat(2.0 / (np.array(counts, dtype=float) - 1.0), counts)
        weights[(fractions == 0.0) | (fractions == 1.0)] /= 2.0
        return CapsulePoints(which, fractions, structure.bar_radius[which], weights)

    def find_depths(self, structure: Any, nodes: Array) -> tuple[Array, Array]:
        """Compute penetration depths of all nodes and bars.

        Parameters
        ----------
        structure : Structure
            Nodes and bars.
        nodes : ndarray, shape (..., n, 3)
            Positions [m].

        Returns
        -------
        tuple of ndarray
            Depths (..., m) [m], and the two nodes (m, 2) between which each point is, the same one
            for nodes.
        """
        own, points = self.select_nodes(structure), self.select_bar_points(structure)
        ends = np.concatenate([np.column_stack([own, own]), structure.bars[points.bars]])
        share = np.concatenate([np.zeros(len(own)), points.fractions])[:, None]
        first, second = nodes[..., ends[:, 0], :], nodes[..., ends[:, 1], :]
        places = first + share * (second - first)
        depths = np.asarray(ca.DM(self.depth(ca.DM(places.reshape(-1, 3).T)))).ravel()
        return depths.reshape(places.shape[:-1]) + np.concatenate(
            [np.zeros(len(own)), points.radii]
        ), ends

    def _list_bars(self, structure: Any) -> list[int]:
        if isinstance(self.bars, str):
            return list(range(len(structure.bars)))
        return sorted(self.bars or ())

    def _count_points(self, length: float) -> int:
        """Return the number of contact points on a bar of a length [m]."""
        return 2

    def forces(self, N: Any, V: Any, touching: Any = None) -> Any:
        """Build the contact forces on nodes.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].
        V : casadi expression, shape (3, n)
            Velocities [m/s].
        touching : casadi expression, shape (1, n), optional
            Prescribed mode, 1 in contact and 0 off it. Default: as the depths give it.

        Returns
        -------
        casadi expression, shape (3, n)
            Forces W [N].
        """
        return compute_forces(self, self.contact(N), V, touching)

    def energy(self, N: Any) -> Any:
        """Build the energy stored in the ground's springs.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].

        Returns
        -------
        casadi expression
            Energy [J].
        """
        depth = ca.fmax(self.depth(N), 0)
        return self.stiffness * ca.sum2(depth * depth) / 2

    def depth(self, N: Any) -> Any:
        """Build the penetration depths of nodes.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].

        Returns
        -------
        casadi expression, shape (1, n)
            Depths [m], negative above the surface.
        """
        return self.contact(N).depth

    def switching(self, N: Any, V: Any) -> Any:
        """Build functions (1×n) [m] that are positive in contact.

        Nodes N and velocities V are 3×n.
        """
        return find_switching(self, self.contact(N), V)

    def __post_init__(self) -> None:
        super().__post_init__()
        name, nodes = type(self).__name__, self.nodes
        if nodes is not None:
            nodes = _distinct(f"{name}.nodes", nodes, "node", "all", self.bars is not None)
        self.__dict__.update(nodes=nodes, bars=_read_bars(f"{name}.bars", self.bars))


def _distinct(field: str, given: Any, item: str, none: str, empty: bool) -> tuple[int, ...]:
    found = tuple(index_or_name(field, index) for index in as_tuple(field, given, "[0, 3]"))
    if not found and not empty:
        raise ValueError(f"{field} is (): give at least one {item}, or None for {none}")
    if len(set(found)) < len(found):
        raise ValueError(f"{field} is {found}: give each {item} once, or None for {none}")
    return found


def _read_bars(field: str, given: Any) -> tuple[int, ...] | str | None:
    if isinstance(given, str) and given != "all":
        raise ValueError(f'{field} is {format_value(given)}: give indices, "all" or None')
    if given is None or isinstance(given, str):
        return given
    return _distinct(field, given, "bar", "none", False)


@dataclass(frozen=True)
class Ground(Surface, kind="Ground"):
    """Plane with penalty contact and Coulomb friction (Sect. 7.4).

    The plane is normalᵀx = height. The normal force on a node at penetration depth d with normal
    velocity v is k d − c v, and at least 0.

    Parameters
    ----------
    stiffness : float
        Contact stiffness k [N/m].
    damping : float
        Contact damping c [N·s/m].
    friction : float, optional
        Coulomb's friction coefficient μ. Default: no friction.
    height : float
        Distance of the plane from the origin along the normal [m].
    normal : sequence of float, shape (3,)
        Direction away from the ground, of any length.
    slip_speed : float
        Slip velocity v_s over which friction is regularized [m/s].
    nodes : sequence of int or str, optional
        Nodes of the structure that touch the ground as points. Default: all but the ends of `bars`,
        including nodes between the segments of strings. It may be empty if there are `bars`.
    bars : sequence of int or str, or "all", optional
        Bars that touch the ground as capsules of their `bar_radius`. Default: none.

    See Also
    --------
    Terrain : Height field.

    Notes
    -----
    Friction is μ f v_t/√(v_t² + v_s²), with the normal force f and the slip velocity v_t. A sticking
    body therefore creeps. Its velocity is v_s r/√(1 − r²) if it needs the fraction r of the largest
    friction force.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> ground = tc.Ground(stiffness=1e3, height=0.5)
    >>> round(float(ground.forces([0, 0, 0.25], [0, 0, 0])[2]), 6)
    250.0

    A slope of 30° through the origin, and a wall at x = 2 that only node 0 can touch:

    >>> slope = tc.Ground(normal=(-0.5, 0, 0.75**0.5), friction=0.3)
    >>> wall = tc.Ground(normal=(-1, 0, 0), height=-2.0, nodes=[0])
    >>> scene = tc.Scene(tc.shapes.prism(), gravity=tc.Gravity(), ground=[slope, wall])
    """

    stiffness: Positive = 1e4
    damping: NonNegative = 0.0
    friction: Positive | None = None
    height: Number = 0.0
    normal: Annotated[Sequence[float], VECTOR] = (0.0, 0.0, 1.0)
    slip_speed: Positive = 1e-3
    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None
    bars: Annotated[Iterable[IndexOrName] | str | None, BARS] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        normal = np.asarray(self.normal)
        if not normal.any():
            raise ValueError(
                "Ground.normal is (0, 0, 0): give the direction away from the ground, such as (0, 0, 1)"
            )
        size = float(np.linalg.norm(normal))
        if abs(size - 1) >= 1e-15:  # a unit normal stays equal to the last bit
            normal = normal / np.abs(normal).max()  # its square neither vanishes nor overflows
            normal = normal / np.linalg.norm(normal)
        object.__setattr__(self, "normal", tuple(float(v) for v in normal))

    def contact(self, N: Any) -> Contact:
        """Compute penetration depths and force directions of nodes (3×n).

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].

        Returns
        -------
        Contact
            Depths [m] and the normal.
        """
        normal = ca.DM(self.normal)
        return Contact(self.height - ca.mtimes(normal.T, N), normal, None)


Grounds = Surface | Sequence[Surface] | None


def read_grounds(value: Any, field: str = "Scene.ground") -> tuple[Surface, ...]:
    """Convert the field `Scene.ground` to a tuple of grounds.

    `value` is a ground, a sequence of them, or None. Messages name `field`. Raises TypeError.
    """
    if value is None or isinstance(value, Surface):
        return () if value is None else (value,)
    example = "a tenscasadi.Ground or Terrain, a sequence of them, or None"
    if isinstance(value, (list, tuple)) and all(isinstance(item, Surface) for item in value):
        return tuple(value)
    raise TypeError(f"{field} is {format_value(value)}: give {example}")
