"""Height fields with penalty contact and friction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.contact_law import Contact
from tenscasadi.scene.ground import BARS, Surface
from tenscasadi.schema.field_types import PAIR, TABLE, Members
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import (
    MAX_COUNT,
    Array,
    IndexOrName,
    NonNegative,
    Positive,
    whole,
)


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
    nodes : sequence of int or str, optional
        Nodes of the structure that touch the ground as points. Default: all but the ends of `bars`,
        including nodes between the segments of strings. It may be empty if there are `bars`.
    bars : sequence of int or str, or "all", optional
        Bars that touch the ground as capsules of their `bar_radius`. Default: none.
    bar_points : int, optional
        Number of contact points along each of `bars`, at least 2. Default: points no farther apart
        than half the spacing of the grid, but at most 101.

    See Also
    --------
    Ground : Plane.

    Notes
    -----
    The height outside the grid is that of the nearest point of its border.

    The depth is (h − z) cos θ with the slope angle θ. cos θ is bilinear between the grid points,
    where it follows from central differences. The depth is thus continuous, and exact for planes.
    The normal force is the gradient of k d²/2, so that energy is conserved.

    Bars touch at equally spaced points, which share 2 k and 2 c by their part of the length. On flat
    ground the force on a lying bar is thus that of `Ground`, for any number of points. An end alone
    has the fraction 1/(number of points − 1) of k and c.

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
    stiffness: Positive = 1e4
    damping: NonNegative = 0.0
    friction: Positive | None = None
    slip_speed: Positive = 1e-3
    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None
    bars: Annotated[Iterable[IndexOrName] | str | None, BARS] = None
    bar_points: Annotated[int | None, whole(2, MAX_COUNT)] = None

    def __post_init__(self) -> None:
        Surface.__post_init__(self)
        if min(self.heights.shape) < 2:
            raise ValueError(
                f"Terrain.heights has shape {self.heights.shape}: give at least two points along each axis"
            )
        corners = {name: tuple(map(float, getattr(self, name))) for name in ("lower", "upper")}
        self.__dict__.update(corners)
        for axis, (low, high) in enumerate(zip(*corners.values(), strict=True)):
            if not high - low >= 1e-9 * max(abs(low), abs(high), 1e-90):
                raise ValueError(
                    f"Terrain.lower is {low:g} and .upper {high:g} along {'xy'[axis]}: "
                    "give lower < upper"
                )
        if self.bar_points is not None and self.bars is None:
            raise ValueError(
                f'Terrain.bar_points is {self.bar_points}, but no bars touch: give bars="all", or leave it out'
            )

    def _count_points(self, length: float) -> int:
        """Return the number of contact points on a bar of a length [m]."""
        # Each point is computed in each step, and terrain is mostly smooth over 1 % of a bar.
        return self.bar_points or int(np.ceil(min(2 * length / self.spacing.min(), 100.0))) + 1

    @cached_property
    def spacing(self) -> Array:
        """Distances between grid points along x and y [m]."""
        return np.asarray(np.subtract(self.upper, self.lower) / np.subtract(self.heights.shape, 1))

    def contact(self, N: Any) -> Contact:
        """Compute penetration depths and force directions of nodes (3×n).

        The directions are the negative gradients of the depths.

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
        """Function that returns heights and slope cosines at cell corners.

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
    respect to s and t. A column has the corners at (s, t) = (0, 0), (1, 0), (0, 1) and (1, 1).
    """
    value, ds = corners[0, :], corners[1, :] - corners[0, :]
    dt, mixed = corners[2, :] - value, corners[3, :] - corners[2, :] - ds
    return value + s * ds + t * (dt + s * mixed), ds + t * mixed, dt + s * mixed
