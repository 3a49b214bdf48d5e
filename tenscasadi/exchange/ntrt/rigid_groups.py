"""NTRT's rods and boxes, and the rigid bodies that they form."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tenscasadi.exchange.ntrt.assembly import rotate_between
from tenscasadi.structure.rigid_body import MassProperties
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices


@dataclass(frozen=True, eq=False)
class RigidPart:
    """Rod or box of NTRT between two nodes.

    Attributes
    ----------
    nodes : tuple of int
        Its two nodes.
    ends : ndarray, shape (2, 3)
        Their positions [m].
    density : float
        Density [kg/m³]; 0 holds it in place.
    radius : float
        Radius of a rod [m].
    sides : tuple of float, optional
        Half width and half height of a box [m].
    """

    nodes: tuple[int, int]
    ends: Array
    density: float
    radius: float = 0.0
    sides: tuple[float, float] | None = None

    @property
    def length(self) -> float:
        """Distance between its ends [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def _frame(self) -> Array:
        """Compute its axes, columns of (3, 3); the last one points from end to end."""
        along = self.ends[1] - self.ends[0]
        return rotate_between(np.array([0.0, 0.0, 1.0]), along, np.array([1.0, 0.0, 0.0]))

    def mass_properties(self) -> MassProperties:
        """Compute mass, center and second moments of the solid."""
        turn = self._frame()
        if self.sides is None:
            section, across = float(np.pi) * self.radius**2, np.full(2, self.radius**2 / 4)
        else:
            section, across = 4 * float(np.prod(self.sides)), np.square(self.sides) / 3
        mass = section * self.length * self.density
        moments = mass * turn @ np.diag([*across, self.length**2 / 12]) @ turn.T
        return MassProperties(mass, self.ends.mean(axis=0), moments)

    def corners(self) -> Array:
        """Compute the eight corners of a box, none of a rod (k, 3) [m]."""
        if self.sides is None:
            return np.zeros((0, 3))
        half = np.array([*self.sides, self.length / 2])
        signs = np.array(list(product((-1, 1), repeat=3)))
        return np.asarray(self.ends.mean(axis=0) + signs * half @ self._frame().T)


def group_parts(parts: list[RigidPart], welded: bool) -> list[list[RigidPart]]:
    """Group the rods and boxes that form one rigid body.

    With `welded`, these are all that share nodes. Otherwise each part is a group. Groups are in the
    order of the file.
    """
    if not welded or not parts:
        return [[part] for part in parts]
    pairs: Indices = np.array([part.nodes for part in parts], dtype=np.intp)
    count = int(pairs.max()) + 1
    links = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    label = connected_components(links, directed=False)[1]
    groups: dict[int, list[RigidPart]] = {}
    for part in parts:
        groups.setdefault(int(label[part.nodes[0]]), []).append(part)
    return list(groups.values())


def combine_mass(parts: list[RigidPart]) -> MassProperties:
    """Combine the masses of rods and boxes that form one rigid body.

    If all `parts` lie on one line, the result is a thin rod of the same inertia across it.
    """
    own = [part.mass_properties() for part in parts]
    mass = sum(each.mass for each in own)
    center = sum((each.mass * each.center for each in own), start=np.zeros(3)) / mass
    moments = np.zeros((3, 3))
    for each in own:
        arm = each.center - center
        moments += each.moments + each.mass * np.outer(arm, arm)
    ends = np.concatenate([part.ends for part in parts])
    _, sizes, right = np.linalg.svd(ends - ends.mean(axis=0))
    if sizes[1] <= NEGLIGIBLE * sizes[0] and all(part.sides is None for part in parts):
        along = right[0] @ moments @ right[0]
        moments = (np.trace(moments) + along) / 2 * np.outer(right[0], right[0])
    return MassProperties(float(mass), center, moments)
