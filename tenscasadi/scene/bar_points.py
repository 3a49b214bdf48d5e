"""Points of bars at which contact forces act."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.scene.contact_law import times
from tenscasadi.util.validate import Array, Indices


class CapsulePoints(NamedTuple):
    """Centers of spheres on the axes of bars, for contact with a ground.

    The m spheres have the `radii` of their bars, and lie at `fractions` of the bar lengths from the
    first end. The contact force of each sphere is multiplied by a weight. The weights of a bar add
    up to 2, so that a bar that lies on a plane has the contact stiffness of its two end nodes.
    """

    bars: Indices  # (m,)
    fractions: Array  # of the length of the bar, (m,)
    radii: Array  # (m,) [m]
    weights: Array  # factors on stiffness and damping, (m,)


@dataclass(frozen=True, eq=False)
class BarPoints:
    """Points that move with bars, at which contact forces act.

    A bar does not rotate about its axis, and no force has a moment about it.

    Attributes
    ----------
    starts, ends : list of int
        Columns of the ends of each bar.
    fractions : casadi row, shape (1, m)
        Positions along the axes, from 0 at the start to 1 at the end.
    offsets : casadi expression, shape (3, m), or None
        Vectors from the axes to the points [m]. None: on the axes.
    """

    starts: list[int]
    ends: list[int]
    fractions: Any
    offsets: Any = None

    @property
    def columns(self) -> list[int]:
        """Node columns of all bar starts, then of all bar ends."""
        return [*self.starts, *self.ends]

    def place(self, N: Any) -> Any:
        """Compute the points (3×m) on the axes of bars [m].

        N (3×n) are the positions of all nodes. Offsets are not included.
        """
        first, second = N[:, self.starts], N[:, self.ends]
        return times(first, 1 - self.fractions) + times(second, self.fractions)

    def velocities(self, N: Any, V: Any) -> Any:
        """Compute the velocities (3×m) [m/s] of the points.

        N and V (3×n) are positions and velocities of all nodes.
        """
        moves = self.place(V)
        if self.offsets is None:
            return moves
        axis, along, squared = self._axes(N)
        turning = V[:, self.ends] - V[:, self.starts]  # ω × d, ω = b × ḃ/bᵀb
        across = ca.sum1(turning * self.offsets)
        return moves + times(turning, along / squared) - times(axis, across / squared)

    def end_forces(self, N: Any, F: Any) -> Any:
        """Distribute forces F (3×m) [N] at the points to the bar ends.

        N (3×n) are the node positions [m]. The result (3×2m) belongs to the nodes `columns`.
        """
        first, second = times(F, 1 - self.fractions), times(F, self.fractions)
        if self.offsets is not None:  # the couple d × F across the axis
            axis, along, squared = self._axes(N)
            pull = times(F, along / squared)
            pull = pull - times(self.offsets, ca.sum1(F * axis) / squared)
            first, second = first - pull, second + pull
        return ca.horzcat(first, second)

    def _axes(self, N: Any) -> tuple[Any, Any, Any]:
        axis = N[:, self.ends] - N[:, self.starts]
        return axis, ca.sum1(axis * self.offsets), ca.sum1(axis * axis)


@dataclass(frozen=True, eq=False)
class NodePoints:
    """Nodes at which contact forces act.

    They are given by their `columns` in N (3×n).
    """

    columns: list[int]

    def velocities(self, N: Any, V: Any) -> Any:
        """Select the velocities (3×m) [m/s] of these m nodes.

        V (3×n) are the velocities of all nodes; their positions N are not used.
        """
        return V[:, self.columns]

    def end_forces(self, N: Any, F: Any) -> Any:
        """Return the forces F (3×m) [N], which act at these nodes.

        N (3×n) are the node positions, which are not used.
        """
        return F


def press_spheres(
    surface: Any, capsules: CapsulePoints, ends: Indices, N: Any
) -> tuple[Any, BarPoints]:
    """Compute the contact of spheres on bar axes with a ground.

    Parameters
    ----------
    surface : Surface
        Ground.
    capsules : CapsulePoints
        Spheres.
    ends : ndarray of int, shape (m, 2)
        Columns of the ends of their bars.
    N : casadi expression, shape (3, n)
        Positions of the columns [m].

    Returns
    -------
    tuple
        Contact, and the points where the spheres touch.
    """
    fractions = ca.DM(capsules.fractions).T
    points = BarPoints(ends[:, 0].tolist(), ends[:, 1].tolist(), fractions)
    row = ca.DM(capsules.radii).T
    contact = surface.contact(points.place(N))
    contact = contact._replace(depth=contact.depth + row)
    if (capsules.weights != 1.0).any():
        contact = contact._replace(weight=ca.DM(capsules.weights).T)
    if surface.friction is None:
        return contact, points  # normal forces have no moment about the axes
    lever = row if contact.steepness is None else row / contact.steepness
    offsets = -times(contact.outward, lever)
    return contact, BarPoints(points.starts, points.ends, points.fractions, offsets)
