"""Contact forces of nodes and bars with grounds, and between bars."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca

from tenscasadi.dynamics.force_element import ForceElement, NodeMotion, spread
from tenscasadi.scene.bar_points import BarPoints, CapsulePoints, NodePoints, press_spheres
from tenscasadi.scene.closest_points import Segments, find_contact
from tenscasadi.scene.contact_law import Contact, compute_forces, find_switching, times

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism
    from tenscasadi.scene.bar_contact import BarContact
    from tenscasadi.scene.ground import Surface
    from tenscasadi.structure.structure import Structure
    from tenscasadi.util.validate import Indices


class TouchingPoints(NamedTuple):
    """Points in contact with a surface, or with opposite points.

    `contact` has the penetration depths of the m points and the directions of their normal forces.
    `points` are the nodes or bar points on which the forces act. `opposite` are the points of the
    other bars, on which the opposite forces act; None for a ground.
    """

    contact: Contact
    points: NodePoints | BarPoints
    opposite: BarPoints | None = None

    def velocities(self, N: Any, V: Any) -> Any:
        """Compute the relative velocities (3×m) of the touching surfaces [m/s].

        N and V (3×n) are the positions and velocities of all nodes.
        """
        own = self.points.velocities(N, V)
        return own if self.opposite is None else own - self.opposite.velocities(N, V)


@dataclass(frozen=True, eq=False)
class ContactElement(ForceElement):
    """Force element of a contact law between pairs of points.

    Attributes
    ----------
    surface : Surface or BarContact
        Contact law.
    structure : Structure
        Bars and nodes that can touch.
    mech : Mechanism
        Columns of the nodes in N (3×n).
    mode : casadi row or None
        1 for each pair in contact, else 0. None: the depths determine the contacts.
    """

    surface: Any
    structure: Structure
    mech: Mechanism
    mode: Any = None

    def locate_contact(self, N: Any) -> TouchingPoints:
        """Compute the contact points for node positions N (3×n) [m]."""
        raise NotImplementedError

    def assemble(self, touch: TouchingPoints, N: Any, F: Any) -> Any:
        """Convert contact-point forces (3×m) to forces on nodes (3×n) [N].

        `touch` has the m contact points at the node positions N (3×n), and F (3×m) are their
        forces. Opposite points have the opposite forces.
        """
        W, columns = touch.points.end_forces(N, F), touch.points.columns
        if touch.opposite is not None:
            W = ca.horzcat(W, touch.opposite.end_forces(N, -F))
            columns = [*columns, *touch.opposite.columns]
        return spread(self.mech, W, columns)

    def forces(self, at: NodeMotion) -> Any:
        """Compute the contact forces (3×n) on nodes [N].

        `at` has the positions and velocities of the nodes.
        """
        touch = self.locate_contact(at.N)
        V = touch.velocities(at.N, at.V)
        return self.assemble(touch, at.N, compute_forces(self.surface, touch.contact, V, self.mode))

    def energy(self, N: Any) -> Any:
        """Compute the energy of the contact springs [J].

        N (3×n) are the node positions [m].
        """
        contact = self.locate_contact(N).contact
        squared = ca.fmax(contact.depth, 0) ** 2
        if contact.weight is not None:
            squared = squared * contact.weight
        return self.surface.stiffness * ca.sum2(squared) / 2

    def switches(self, at: NodeMotion) -> Any:
        """Compute switching functions (1×m) [m], positive in contact.

        There is one for each point or pair. `at` has the positions and velocities of the nodes.
        """
        touch = self.locate_contact(at.N)
        return find_switching(self.surface, touch.contact, touch.velocities(at.N, at.V))


@dataclass(frozen=True, eq=False)
class NodeContacts(ContactElement):
    """Contact of nodes with a ground."""

    name: ClassVar[str] = "ground"
    surface: Surface

    @cached_property
    def columns(self) -> list[int]:
        """Columns of N (nodes) on which the ground acts."""
        return self.mech.first[self.surface.select_nodes(self.structure)].tolist()  # type: ignore[no-any-return]

    @property
    def switch_count(self) -> int:  # type: ignore[override]
        """Number of nodes that may be in contact."""
        return len(self.columns)

    def locate_contact(self, N: Any) -> TouchingPoints:
        """Compute the contact points for node positions N (3×n) [m]."""
        return TouchingPoints(self.surface.contact(N[:, self.columns]), NodePoints(self.columns))


@dataclass(frozen=True, eq=False)
class CapsuleContacts(ContactElement):
    """Contact of bars with a ground, as capsules."""

    name: ClassVar[str] = "bars on the ground"
    surface: Surface

    @cached_property
    def _points(self) -> CapsulePoints:
        return self.surface.select_bar_points(self.structure)

    @property
    def switch_count(self) -> int:  # type: ignore[override]
        """Number of points of bars that may be in contact."""
        return len(self._points.bars)

    def locate_contact(self, N: Any) -> TouchingPoints:
        """Compute the contact points for node positions N (3×n) [m]."""
        ends = self.mech.bar_ends[self._points.bars]
        return TouchingPoints(*press_spheres(self.surface, self._points, ends, N))


@dataclass(frozen=True, eq=False)
class BarContacts(ContactElement):
    """Contact of bars with each other, as capsules."""

    name: ClassVar[str] = "bar contact"
    surface: BarContact

    @cached_property
    def _pairs(self) -> Indices:
        return self.surface.select_pairs(self.structure)

    @property
    def switch_count(self) -> int:  # type: ignore[override]
        """Number of pairs that may be in contact."""
        return len(self._pairs)

    def locate_contact(self, N: Any) -> TouchingPoints:
        """Compute the contact points for node positions N (3×n) [m]."""
        ends = self.mech.bar_ends[self._pairs]
        columns = [ends[:, bar, end].tolist() for bar in (0, 1) for end in (0, 1)]
        radii = [ca.DM(self.structure.bar_radius[self._pairs[:, bar]]).T for bar in (0, 1)]
        contact, fractions = find_contact(
            Segments(*(N[:, column] for column in columns)), radii[0] + radii[1]
        )
        offsets: list[Any] = [None, None]
        if self.surface.friction is not None:  # the point in the middle of the overlap
            overlap = contact.depth / 2
            levers = overlap - radii[0], radii[1] - overlap
            offsets = [times(contact.outward, lever) for lever in levers]
        one, other = (
            BarPoints(columns[2 * k], columns[2 * k + 1], fractions[k], offsets[k]) for k in (0, 1)
        )
        return TouchingPoints(contact, one, other)
