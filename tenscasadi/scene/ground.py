"""Ground: planes and height fields that push nodes out, with Coulomb's friction along them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.schema.field_types import PAIR, TABLE, VECTOR, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.casadi_tools import is_expression
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import (
    Array,
    as_tuple,
    finite_array,
    format_value,
    node_index,
    number,
    positive_number,
    whole_number,
)


class Contact(NamedTuple):
    """Where nodes are to a surface, and where it pushes them."""

    depth: Any  # 1×n, m, negative above the surface
    outward: Any  # −∂depth/∂n: 3×1 where it is the same for all nodes, else 3×n
    steepness: Any  # length of `outward`, 1×n; None where it is 1


class Surface(Value, ABC, implied="Ground"):
    """A ground of any shape: a push k d − c v on nodes at a depth d, never a pull, and friction."""

    stiffness: float
    damping: float
    friction: float | None
    slip_speed: float
    nodes: Iterable[int] | None

    @abstractmethod
    def contact(self, N: Any) -> Contact:
        """Return depths and directions of nodes (3×n), m."""

    @property
    def conservative(self) -> bool:
        """Whether the ground neither damps nor rubs."""
        return self.damping == 0 and self.friction is None

    def check(self, nodes: int) -> None:
        """Raise ValueError where `nodes` names one that is not there.

        Parameters
        ----------
        nodes : int
            Number of nodes of the structure.
        """
        for node in self.nodes or ():
            node_index(f"{type(self).__name__}.nodes", node, nodes)

    def forces(self, N: Any, V: Any, touching: Any = None) -> Any:
        """Return the ground's forces on nodes.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.
        V : casadi expression, shape (3, n)
            Velocities, m/s.
        touching : casadi expression, shape (1, n), optional
            1 or 0 where nodes are held in contact, or off it; by default as their depths say.

        Returns
        -------
        casadi expression, shape (3, n)
            W, N.
        """
        contact = self.contact(N)
        depth, outward, _ = contact
        push = self.stiffness * depth
        if is_expression(self.damping) or self.damping:
            push = push - self.damping * along(outward, V)
            push = ca.fmax(push, 0) if touching is None else push
        push = ca.if_else(depth > 0, push, 0) if touching is None else touching * push  # 1×n
        W = times(outward, push)
        if self.friction is not None:
            slip, share = slip_velocity(contact, V)
            drag = (
                self.friction
                * (push if share is None else push * share)
                / ca.sqrt(ca.sum1(slip * slip) + self.slip_speed**2)
            )
            W = W - slip * ca.repmat(drag, 3, 1)
        return W

    def energy(self, N: Any) -> Any:
        """Return the energy stored in the ground's springs.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        casadi expression
            Energy, J.
        """
        depth = ca.fmax(self.depth(N), 0)
        return self.stiffness * ca.sum2(depth * depth) / 2

    def depth(self, N: Any) -> Any:
        """Return how deep nodes are below the surface.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        casadi expression, shape (1, n)
            Depths, m, negative above the surface.
        """
        return self.contact(N).depth

    def switching(self, N: Any, V: Any) -> Any:
        """Return lengths (1×n), m, that are positive where nodes (3×n) with velocities (3×n) are pushed."""
        depth, outward, _ = self.contact(N)
        return ca.fmin(depth, depth - self.damping / self.stiffness * along(outward, V))

    def _checked(self, **others: Any) -> None:
        """Set the fields that all surfaces have, once they are checked, and `others`."""
        name = type(self).__name__
        checked = {
            "stiffness": positive_number(f"{name}.stiffness", self.stiffness),
            "damping": positive_number(f"{name}.damping", self.damping, zero=True),
            "friction": None
            if self.friction is None
            else positive_number(f"{name}.friction", self.friction),
            "slip_speed": positive_number(f"{name}.slip_speed", self.slip_speed),
            "nodes": None if self.nodes is None else _distinct(f"{name}.nodes", self.nodes),
            **others,
        }
        for field, value in checked.items():
            object.__setattr__(self, field, value)


def along(outward: Any, V: Any) -> Any:
    """Return the products (1×n) of the columns of V (3×n) with `outward` (3×1 or 3×n)."""
    return ca.mtimes(outward.T, V) if outward.shape[1] == 1 else ca.sum1(outward * V)


def times(outward: Any, row: Any) -> Any:
    """Return the columns of `outward` (3×1 or 3×n) times the entries of a row (1×n)."""
    return ca.mtimes(outward, row) if outward.shape[1] == 1 else outward * ca.repmat(row, 3, 1)


def slip_velocity(contact: Contact, V: Any) -> tuple[Any, Any]:
    """Return the velocities (3×n) along a surface, m/s, and the force on it as a multiple of the push (1×n); None: it is the push."""
    _, outward, steepness = contact
    if steepness is None:
        return V - times(outward, along(outward, V)), None
    return V - times(outward, along(outward, V) / steepness**2), steepness


def _distinct(field: str, nodes: Any) -> tuple[int, ...]:
    found = tuple(whole_number(field, node, 0) for node in as_tuple(field, nodes, "[0, 3]"))
    if not found or len(set(found)) < len(found):
        raise ValueError(f"{field} is {found}: give each node once, or None for all")
    return found


@dataclass(frozen=True)
class Ground(Surface, kind="Ground"):
    """A plane that pushes on nodes below it, and never pulls (Sect. 7.4).

    The plane is normalᵀx = height. A node at depth d that moves along the normal at speed v is
    pushed with k d − c v.

    Parameters
    ----------
    stiffness : float
        k, N/m.
    damping : float
        c, N·s/m.
    friction : float, optional
        Coulomb's coefficient μ; by default the plane is frictionless.
    height : float
        Distance of the plane from the origin along the normal, m.
    normal : sequence of float, shape (3,)
        Direction away from the ground, of any length.
    slip_speed : float
        Speed v_s, m/s, over which friction is regularised.
    nodes : sequence of int, optional
        Nodes of the structure that it acts on; by default on all, also those inside strings that
        are cut into segments.

    See Also
    --------
    Terrain : a height field.

    Notes
    -----
    Friction is μ f v_t/√(v_t² + v_s²) for a push f and a tangential velocity v_t. A body that
    should stick therefore creeps, at v_s r/√(1 − r²) where it needs the share r of the friction
    that there is.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> ground = tc.Ground(stiffness=1e3, height=0.5)
    >>> round(float(ground.forces([0, 0, 0.25], [0, 0, 0])[2]), 6)
    250.0

    A slope of 30° through the origin, and a wall at x = 2 that only node 0 meets:

    >>> slope = tc.Ground(normal=(-0.5, 0, 0.75**0.5), friction=0.3)
    >>> wall = tc.Ground(normal=(-1, 0, 0), height=-2.0, nodes=[0])
    >>> scene = tc.Scene(tc.shapes.prism(), gravity=tc.Gravity(), ground=[slope, wall])
    """

    stiffness: float = 1e4
    damping: float = 0.0
    friction: float | None = None
    height: float = 0.0
    normal: Annotated[Sequence[float], VECTOR] = (0.0, 0.0, 1.0)
    slip_speed: float = 1e-3
    nodes: Annotated[Iterable[int] | None, Members("node")] = None

    def __post_init__(self) -> None:
        normal = finite_array("Ground.normal", self.normal, (3,))
        if not normal.any():
            raise ValueError(
                "Ground.normal is (0, 0, 0): give the direction away from the ground, such as (0, 0, 1)"
            )
        size = float(np.linalg.norm(normal))
        if abs(size - 1) >= 1e-15:  # once normalised it stays as it is
            normal = normal / np.abs(normal).max()  # whose square neither vanishes nor overflows
            normal = normal / np.linalg.norm(normal)
        unit = tuple(float(v) for v in normal)
        self._checked(height=number("Ground.height", self.height), normal=unit)

    def contact(self, N: Any) -> Contact:
        """Return how deep nodes are below the plane, and its normal.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        Contact
            Depths, m, and the normal.
        """
        normal = ca.DM(self.normal)
        return Contact(self.height - ca.mtimes(normal.T, N), normal, None)


@dataclass(frozen=True, eq=False)
class Terrain(ReadOnlyArrays, Surface, kind="Terrain"):
    """A height field z = h(x, y) that pushes on nodes below it, and never pulls.

    Heights are bilinear between the points of a regular grid. A node at depth d that moves out of
    the ground at speed v is pushed with k d − c v, and rubs along the surface where it is.

    Parameters
    ----------
    heights : array_like, shape (K, L)
        Heights z at K equally spaced x and L equally spaced y, m.
    lower, upper : sequence of float, shape (2,)
        The grid's corners (x, y) with the least and the greatest coordinates, m.
    stiffness : float
        k, N/m.
    damping : float
        c, N·s/m.
    friction : float, optional
        Coulomb's coefficient μ; by default the ground is frictionless.
    slip_speed : float
        Speed v_s, m/s, over which friction is regularised, as that of `Ground`.
    nodes : sequence of int, optional
        Nodes of the structure that it acts on; by default on all, also those inside strings that
        are cut into segments.

    See Also
    --------
    Ground : a plane.

    Notes
    -----
    Beyond the grid the ground goes on as it ends: its height is that of the nearest point of the
    grid's border.

    The depth is (h − z) cos θ, with the cosine of the slope bilinear between the grid's points, too
    (there from central differences): exactly the distance to a plane, and elsewhere without jumps.
    The push is the gradient of the energy k d²/2, so that energy is kept. From cell to cell the
    slope jumps, and the push its direction: a node that comes to lie in a groove between two cells
    chatters from one to the other. Fixed steps pass over that; schemes that control their error
    need a tolerance above about 1e-8, or a finer grid.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> x = np.linspace(-1, 1, 21)
    >>> bowl = tc.Terrain(0.5 * (x[:, None] ** 2 + x**2), lower=(-1, -1), upper=(1, 1), stiffness=1e3)
    >>> round(float(bowl.depth([0.5, 0.0, 0.1])), 6)  # (0.125 − 0.1) cos θ, where tan θ = 0.5
    0.022361
    >>> round(float(bowl.depth([7.0, 0.0, 0.5])), 6)
    0.0
    """

    heights: Annotated[Any, TABLE]
    lower: Annotated[Sequence[float], PAIR]
    upper: Annotated[Sequence[float], PAIR]
    stiffness: float = 1e4
    damping: float = 0.0
    friction: float | None = None
    slip_speed: float = 1e-3
    nodes: Annotated[Iterable[int] | None, Members("node")] = None

    def __post_init__(self) -> None:
        heights = finite_array("Terrain.heights", self.heights, (None, None))
        if min(heights.shape) < 2:
            raise ValueError(
                f"Terrain.heights has shape {heights.shape}: give two or more points along each axis"
            )
        corners = {
            name: tuple(finite_array(f"Terrain.{name}", getattr(self, name), (2,)).tolist())
            for name in ("lower", "upper")
        }
        for axis, (low, high) in enumerate(zip(*corners.values(), strict=True)):
            if not high - low >= 1e-9 * max(abs(low), abs(high), 1e-90):
                raise ValueError(
                    f"Terrain.lower is {low:g} and .upper {high:g} along {'xy'[axis]}: give lower < upper"
                )
        self._checked(heights=heights, **corners)

    @cached_property
    def spacing(self) -> Array:
        """Distances between the grid's points along x and y, m."""
        return np.asarray(np.subtract(self.upper, self.lower) / np.subtract(self.heights.shape, 1))

    def contact(self, N: Any) -> Contact:
        """Return how deep nodes are below the surface, and where it pushes them.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        Contact
            Depths, m, and their gradients, downwards.
        """
        N = N if isinstance(N, (ca.SX, ca.MX)) else ca.DM(N)
        cells, shares = [], []
        for axis, (low, width, points) in enumerate(
            zip(self.lower, self.spacing, self.heights.shape, strict=True)
        ):
            place = (N[axis, :] - low) / float(width)
            cell = ca.fmin(
                ca.fmax(ca.floor(place), -1), points - 1
            )  # −1 and points − 1: beyond the grid
            cells.append(cell + 1)
            shares.append(place - cell)
        corners = self._corners(cells[0] + (self.heights.shape[0] + 2) * cells[1])  # 8×n
        height, cosine = (_bilinear(corners[4 * k : 4 * k + 4, :], *shares) for k in range(2))
        above = height[0] - N[2, :]
        sides = [
            -(height[axis] * cosine[0] + above * cosine[axis]) / float(self.spacing[axis - 1])
            for axis in (1, 2)
        ]
        outward = ca.vertcat(*sides, cosine[0])
        return Contact(above * cosine[0], outward, ca.sqrt(ca.sum1(outward * outward)))

    @cached_property
    def _corners(self) -> ca.Function:
        """Function cell → heights and cosines of the slope at its corners (8): 00, 10, 01, 11 of each. The grid has a cell more on each side."""
        slopes = np.gradient(self.heights, *self.spacing)
        cosines = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        table = np.stack(
            [np.pad(values, 1, mode="edge").ravel(order="F") for values in (self.heights, cosines)]
        )
        # A table that is looked up at its own points: generated code reads it where it is, a
        # constant matrix it would copy at every call.
        points = ca.interpolant(
            "points",
            "linear",
            [np.arange(table.shape[1], dtype=float).tolist()],
            table.ravel(order="F"),
            {"lookup_mode": ["exact"]},
        )
        cell, rows = ca.MX.sym("cell"), self.heights.shape[0] + 2
        found = points(ca.horzcat(*(cell + offset for offset in (0, 1, rows, rows + 1)))).T
        # Which cell it is does not change with a small step. The zeros are stored: of a derivative
        # without entries CasADi's scalars make NaN.
        still = ca.Function(
            "jac_corners",
            [cell, ca.MX.sym("out", 8)],
            [ca.MX(ca.DM.zeros(8, 1))],
            ["cell", "out_corners"],
            ["jac_corners_cell"],
        )
        options: dict[str, Any] = {
            "never_inline": True,
            "custom_jacobian": still,
            "enable_forward": False,
            "enable_reverse": False,
        }
        return ca.Function(
            "corners", [cell], [ca.vec(found)], ["cell"], ["corners"], options
        )  # scalar code calls it: it cannot look up itself


def _bilinear(corners: Any, s: Any, t: Any) -> tuple[Any, Any, Any]:
    """Return values (1×n) between corners (4×n) at shares s, t of a cell, and their derivatives by s and t."""
    value, by_s, by_t, mixed = (
        corners[0, :],
        corners[1, :] - corners[0, :],
        corners[2, :] - corners[0, :],
        0,
    )
    mixed = corners[3, :] - corners[2, :] - by_s
    return value + s * by_s + t * (by_t + s * mixed), by_s + t * mixed, by_t + s * mixed


Grounds = Surface | Sequence[Surface] | None


def checked_grounds(value: Any, field: str = "Scene.ground") -> tuple[Surface, ...]:
    """Return one ground or a sequence of them, or None, as a tuple. Raises TypeError."""
    if value is None or isinstance(value, Surface):
        return () if value is None else (value,)
    example = "a tenscasadi.Ground or Terrain, a sequence of them, or None"
    if isinstance(value, (list, tuple)) and all(isinstance(item, Surface) for item in value):
        return tuple(value)
    raise TypeError(f"{field} is {format_value(value)}: give {example}")
