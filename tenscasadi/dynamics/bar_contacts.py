"""Forces of bars on each other, see `BarContact`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca

from tenscasadi.dynamics.force_element import ForceElement, NodeMotion, spread
from tenscasadi.scene.closest_points import Segments, find_contact
from tenscasadi.scene.contact_law import find_switching, press, times

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism
    from tenscasadi.scene.bar_contact import BarContact
    from tenscasadi.structure.structure import Structure
    from tenscasadi.util.validate import Indices


@dataclass(frozen=True, eq=False)
class BarContacts(ForceElement):
    """Contact of bars with each other.

    Attributes
    ----------
    surface : BarContact
        Contact law.
    mode : casadi row or None
        1 for pairs in contact.
    """

    name: ClassVar[str] = "bar contact"
    surface: BarContact
    structure: Structure
    mech: Mechanism
    mode: Any = None

    @property
    def _pairs(self) -> Indices:
        return self.surface.select_pairs(self.structure)

    @property
    def switch_count(self) -> int:  # type: ignore[override]
        """Number of pairs that may be in contact."""
        return len(self._pairs)

    @property
    def _columns(self) -> list[list[int]]:
        """Columns of N of the four ends of all pairs."""
        ends = self.mech.bar_ends[self._pairs]
        return [ends[:, bar, end].tolist() for bar in (0, 1) for end in (0, 1)]

    def _find(self, N: Any) -> tuple[Any, list[Any]]:
        radii = ca.DM(self.structure.bar_radius[self._pairs].sum(axis=1)).T
        return find_contact(Segments(*(N[:, columns] for columns in self._columns)), radii)

    def _separate(self, V: Any, weights: list[Any]) -> Any:
        """Compute the relative velocities (3×m) of the closest points [m/s]."""
        ends = zip(self._columns, weights, strict=True)
        return sum(V[:, columns] * ca.repmat(weight, 3, 1) for columns, weight in ends)

    def forces(self, at: NodeMotion) -> Any:
        """Compute the contact forces (3×n) [N]."""
        contact, weights = self._find(at.N)
        push = press(self.surface, contact, self._separate(at.V, weights), self.mode)
        W = ca.horzcat(*(times(contact.outward, push * weight) for weight in weights))
        return spread(self.mech, W, [column for part in self._columns for column in part])

    def energy(self, N: Any) -> Any:
        """Compute the energy of the contact springs [J]."""
        depth = ca.fmax(self._find(N)[0].depth, 0)
        return self.surface.stiffness * ca.sum2(depth * depth) / 2

    def switches(self, at: NodeMotion) -> Any:
        """Compute the switching functions [m], positive in contact."""
        contact, weights = self._find(at.N)
        return find_switching(self.surface, contact, self._separate(at.V, weights))
