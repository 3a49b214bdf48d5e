"""Planes and height fields with penalty contact and friction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.contact_law import Contact, compute_slip, find_switching, press, times
from tenscasadi.schema.field_types import PAIR, TABLE, VECTOR, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.immutable import ReadOnlyArrays
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


class Surface(Value, ABC, implied="Ground"):
    """Base of grounds with penalty contact.

    The normal force on a node at penetration depth d is k d − c v, and at least 0.
    """

    stiffness: float
    damping: float
    friction: float | None
    slip_speed: float
    nodes: Iterable[int] | None

    @abstractmethod
    def contact(self, N: Any) -> Contact:
        """Compute penetration depths and force directions of nodes (3×n) [m]."""

    @property
    def conservative(self) -> bool:
        """Whether the ground has neither damping nor friction."""
        return self.damping == 0 and self.friction is None

    def check(self, nodes: int) -> None:
        """Check the node indices of the ground.

        Parameters
        ----------
        nodes : int
            Number of nodes of the structure.

        Raises
        ------
        ValueError
            If an index is out of range.
        """
        for node in self.nodes or ():
            node_index(f"{type(self).__name__}.nodes", node, nodes)

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
        contact = self.contact(N)
        push = press(self, contact, V, touching)
        W = times(contact.outward, push)
        if self.friction is not None:
            slip, steepness = compute_slip(contact, V)
            normal_force = push if steepness is None else push * steepness
            regularized = ca.sqrt(ca.sum1(slip * slip) + self.slip_speed**2)
            W = W - slip * ca.repmat(self.friction * normal_force / regularized, 3, 1)
        return W

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
        """Build the switching functions (1×n) [m], positive in contact.

        Nodes N and velocities V are 3×n.
        """
        return find_switching(self, self.contact(N), V)

    def _check_fields(self, **others: Any) -> None:
        """Check the common fields of surfaces, and set `others`."""
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


def _distinct(field: str, nodes: Any) -> tuple[int, ...]:
    found = tuple(whole_number(field, node, 0) for node in as_tuple(field, nodes, "[0, 3]"))
    if not found or len(set(found)) < len(found):
        raise ValueError(f"{field} is {found}: give each node once, or None for all")
    return found


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
    nodes : sequence of int, optional
        Nodes of the structure that can touch the ground. Default: all, including nodes between the
        segments of strings.

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
        if abs(size - 1) >= 1e-15:  # a unit normal stays equal to the last bit
            normal = normal / np.abs(normal).max()  # its square neither vanishes nor overflows
            normal = normal / np.linalg.norm(normal)
        unit = tuple(float(v) for v in normal)
        self._check_fields(height=number("Ground.height", self.height), normal=unit)

    def contact(self, N: Any) -> Contact:
        """Compute the penetration depths of nodes.

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


@dataclass(frozen=True, eq=False)
class Terrain(ReadOnlyArrays, Surface, kind="Terrain"):
    """Height field with penalty contact and Coulomb friction.

    Heights z = h(x, y) are bilinear between the points of a regular grid. The normal force on a node at
    penetration depth d with normal velocity v is k d − c v, and at least 0.

    Parameters
    ----------
    heights : array_like, shape (K, L)
        Heights z [m] at K equally spaced x and L equally spaced y.
    lower, upper : sequence of float, shape (2,)
        Corners (x, y) of the grid with the smallest and largest coordinates [m].
    stiffness : float
        Contact stiffness k [N/m].
    damping : float
        Contact damping c [N·s/m].
    friction : float, optional
        Coulomb's friction coefficient μ. Default: no friction.
    slip_speed : float
        Slip velocity v_s over which friction is regularized [m/s], see `Ground`.
    nodes : sequence of int, optional
        Nodes of the structure that can touch the ground. Default: all, including nodes between the
        segments of strings.

    See Also
    --------
    Ground : Plane.

    Notes
    -----
    The height outside the grid is that of the nearest point of its border.

    The depth is (h − z) cos θ with the slope angle θ. cos θ is bilinear between the grid points,
    where it follows from central differences. The depth is thus continuous, and exact for planes.
    The normal force is the gradient of k d²/2, so that energy is conserved.

    The slope jumps from cell to cell, and so does the direction of the normal force. A node at rest
    in a groove between two cells chatters between them. Fixed steps average over that. Schemes with
    error control need a tolerance above about 1e-8 or a finer grid.

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
                f"Terrain.heights has shape {heights.shape}: give at least two points along each axis"
            )
        corners = {
            name: tuple(finite_array(f"Terrain.{name}", getattr(self, name), (2,)).tolist())
            for name in ("lower", "upper")
        }
        for axis, (low, high) in enumerate(zip(*corners.values(), strict=True)):
            if not high - low >= 1e-9 * max(abs(low), abs(high), 1e-90):
                raise ValueError(
                    f"Terrain.lower is {low:g} and .upper {high:g} along {'xy'[axis]}: "
                    "give lower < upper"
                )
        self._check_fields(heights=heights, **corners)

    @cached_property
    def spacing(self) -> Array:
        """Distances between grid points along x and y [m]."""
        return np.asarray(np.subtract(self.upper, self.lower) / np.subtract(self.heights.shape, 1))

    def contact(self, N: Any) -> Contact:
        """Compute penetration depths and their negative gradients.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes [m].

        Returns
        -------
        Contact
            Depths [m] and directions of normal forces.
        """
        N = N if isinstance(N, (ca.SX, ca.MX)) else ca.DM(N)
        cells, fractions = [], []
        for axis, (low, width, points) in enumerate(
            zip(self.lower, self.spacing, self.heights.shape, strict=True)
        ):
            place = (N[axis, :] - low) / float(width)
            # cells −1 and points − 1 are outside the grid
            cell = ca.fmin(ca.fmax(ca.floor(place), -1), points - 1)
            cells.append(cell + 1)
            fractions.append(place - cell)
        corners = self._corners(cells[0] + (self.heights.shape[0] + 2) * cells[1])  # 8×n
        height, cosine = (
            _interpolate_cells(corners[4 * k : 4 * k + 4, :], *fractions) for k in range(2)
        )
        above = height[0] - N[2, :]
        sides = [
            -(height[axis] * cosine[0] + above * cosine[axis]) / float(self.spacing[axis - 1])
            for axis in (1, 2)
        ]
        outward = ca.vertcat(*sides, cosine[0])
        return Contact(above * cosine[0], outward, ca.sqrt(ca.sum1(outward * outward)))

    @cached_property
    def _corners(self) -> ca.Function:
        """Function that looks up heights and cosines at corners.

        The input is the number of a cell. The result is (8,): heights, then cosines of the slope,
        in the order 00, 10, 01, 11. The grid is extended by a cell on each side.
        """
        slopes = np.gradient(self.heights, *self.spacing)
        cosines = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        table = np.stack(
            [np.pad(values, 1, mode="edge").ravel(order="F") for values in (self.heights, cosines)]
        )
        # generated code reads a lookup table in place, but copies a constant matrix at each call
        points = ca.interpolant(
            "points",
            "linear",
            [np.arange(table.shape[1], dtype=float).tolist()],
            table.ravel(order="F"),
            {"lookup_mode": ["exact"]},
        )
        cell, rows = ca.MX.sym("cell"), self.heights.shape[0] + 2
        found = points(ca.horzcat(*(cell + offset for offset in (0, 1, rows, rows + 1)))).T
        # The number of the cell is piecewise constant. Its zero derivative is stored, because
        # CasADi's scalars turn an empty derivative into NaN.
        jacobian = ca.Function(
            "jac_corners",
            [cell, ca.MX.sym("out", 8)],
            [ca.MX(ca.DM.zeros(8, 1))],
            ["cell", "out_corners"],
            ["jac_corners_cell"],
        )
        options: dict[str, Any] = {
            "never_inline": True,
            "custom_jacobian": jacobian,
            "enable_forward": False,
            "enable_reverse": False,
        }
        # scalar code cannot look up tables, and calls this function
        return ca.Function("corners", [cell], [ca.vec(found)], ["cell"], ["corners"], options)


def _interpolate_cells(corners: Any, s: Any, t: Any) -> tuple[Any, Any, Any]:
    """Interpolate bilinearly between the corners (4×n) of cells.

    s and t (1×n) are fractions of the cells. Returns the values (1×n) and their derivatives with
    respect to s and t.
    """
    value, ds = corners[0, :], corners[1, :] - corners[0, :]
    dt, mixed = corners[2, :] - value, corners[3, :] - corners[2, :] - ds
    return value + s * ds + t * (dt + s * mixed), ds + t * mixed, dt + s * mixed


Grounds = Surface | Sequence[Surface] | None


def read_grounds(value: Any, field: str = "Scene.ground") -> tuple[Surface, ...]:
    """Convert the field `ground` to a tuple.

    Raises TypeError.
    """
    if value is None or isinstance(value, Surface):
        return () if value is None else (value,)
    example = "a tenscasadi.Ground or Terrain, a sequence of them, or None"
    if isinstance(value, (list, tuple)) and all(isinstance(item, Surface) for item in value):
        return tuple(value)
    raise TypeError(f"{field} is {format_value(value)}: give {example}")
