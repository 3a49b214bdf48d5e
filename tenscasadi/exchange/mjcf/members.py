"""Conversion of rigid bodies into bars, point masses and nodes."""

from __future__ import annotations

import re
from collections.abc import Hashable
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Piece, Site
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.util.validate import Array

CLOSE = 1e-5  # relative to the structure's size: closer points coincide
_ROUND = 1e-12  # of a bar's squared length: a smaller squared radius counts as zero
_ALIKE = 1e-3  # relative difference allowed between the transverse inertias of a bar
# of a squared length
_THIN = 1e-5
_WORLD = 0


class Place(NamedTuple):
    """Endpoint of a piece: a node without a number.

    Attributes
    ----------
    piece : int
        Index of the piece; 0 is the world.
    end : int
        Index among the endpoints of the piece.
    """

    piece: int
    end: int


class Members:
    """Bars, point masses and shared nodes of a file."""

    def __init__(self, bodies: Bodies, attached: list[Site]) -> None:
        self.bodies = bodies
        points = [site.place for site in bodies.sites.values()]
        points += [
            end
            for piece in bodies.pieces
            for shape in piece.shapes
            if shape.rod
            for end in shape.rod.ends
        ]
        self.close = CLOSE * max(float(np.ptp(points, axis=0).max()) if points else 0.0, 1e-9)
        self.ends: list[list[Array]] = [[] for _ in bodies.pieces]
        self._same: dict[Place, Place] = {}
        self._cells: dict[tuple[int, ...], Place] = {}
        for site in attached:
            self._attach(site.piece, site.place)
        for k, piece in bodies.moving():
            if piece.anchor is not None:
                self._attach(k, piece.anchor)
                if piece.parent:
                    self._attach(piece.parent, piece.anchor)
        for k, piece in bodies.moving():
            self._complete(k, piece)
        self.pinned: set[Place] = set()
        self.slides: dict[Place, list[Array]] = {}
        for k, piece in bodies.moving():
            self._hang(k, piece)

    def place(self, piece: int, point: Array, element: Element | None = None) -> Place:
        """Find the endpoint of a piece at a point.

        In the world it is added if necessary.

        Raises SceneFileError if a moving piece has no endpoint there.
        """
        found = self.near(piece, point)
        if found is not None:
            return found
        if piece == _WORLD:
            return self._add(_WORLD, point)
        raise (element or self.bodies.pieces[piece].element).error(
            f"holds a body at {point.round(6).tolist()}, where no end of it is"
        )

    def join(self, one: Place, other: Place) -> None:
        """Merge two endpoints into one node.

        An endpoint of the world pins it.
        """
        for place, to in ((one, other), (other, one)):
            if to.piece == _WORLD:
                self.pinned.add(self.node(place))
        first, second = sorted((self.node(one), self.node(other)))
        if first != second:
            self._same[second] = first
            if second in self.pinned:
                self.pinned.add(first)

    def node(self, place: Place) -> Place:
        """Return the endpoint that represents the node of this one."""
        while place in self._same:
            place = self._same[place]
        return place

    def near(self, piece: int, point: Array) -> Place | None:
        """Find the endpoint of a piece near a point.

        Returns None if there is none.
        """
        x, y, z = (int(v) for v in np.floor(point / (2 * self.close)))
        for cell in product((x - 1, x, x + 1), (y - 1, y, y + 1), (z - 1, z, z + 1)):
            found = self._cells.get((piece, *cell))
            if (
                found is not None
                and np.linalg.norm(self.ends[piece][found.end] - point) <= self.close
            ):
                return found
        return None

    def _add(self, piece: int, point: Array) -> Place:
        place = Place(piece, len(self.ends[piece]))
        self.ends[piece].append(point)
        self._cells[(piece, *(int(v) for v in np.floor(point / (2 * self.close))))] = place
        return place

    def _attach(self, piece: int, point: Array) -> None:
        if self.near(piece, point) is None:
            self._add(piece, point)

    def _complete(self, k: int, piece: Piece) -> None:
        """Add the missing endpoints of a piece and order them.

        The order is that of its longest geom. Raises SceneFileError.
        """
        ends = self.ends[k]
        if len(ends) > 2:
            where = ", ".join(str(end.round(4).tolist()) for end in ends[:4])
            raise piece.element.error(
                f"has strings or joints at {len(ends)} places ({where}): a bar has two ends"
            )
        rods = [shape.rod for shape in piece.shapes if shape.rod and shape.rod.kind != "sphere"]
        longest = max(
            rods, key=lambda rod: float(np.linalg.norm(rod.ends[1] - rod.ends[0])), default=None
        )
        if longest is not None and len(ends) < 2:
            for end in longest.ends:
                near = float(np.linalg.norm(longest.ends[1] - longest.ends[0])) / 100
                if not any(np.linalg.norm(known - end) <= near for known in ends):
                    self._add(k, end)
            if len(ends) != 2:
                raise piece.element.error(
                    f"has a string or joint at {ends[0].round(4).tolist()}: bars have them at their ends"
                )
        if (
            longest is not None
            and len(ends) == 2
            and np.linalg.norm(ends[0] - longest.ends[0])
            > np.linalg.norm(ends[1] - longest.ends[0])
        ):
            first, second = ends
            ends.clear()
            for end in (second, first):
                self._add(k, end)
        if not ends:
            if not piece.masses:
                raise piece.element.error("has no mass: give an <inertial> or a geom")
            self._add(k, np.mean([mass.centre for mass in piece.masses], axis=0))

    def _hang(self, k: int, piece: Piece) -> None:
        """Connect a piece to its parent. Raises SceneFileError."""
        if piece.free:
            return
        slides = piece.slides
        rank = np.linalg.matrix_rank(np.array(slides), tol=1e-6) if slides else 0
        if rank < len(slides):
            raise piece.element.error(
                "slides along directions that depend on each other: give independent ones"
            )
        if piece.anchor is None:
            if len(self.ends[k]) == 2:
                raise piece.element.error(
                    "is a bar that slides without turning: give it a ball, too, or a free joint"
                )
            own = Place(k, 0)
        else:
            own = self.place(k, piece.anchor)
            if piece.parent:
                self.join(own, self.place(piece.parent, piece.anchor))
                return
        if not slides:
            self.join(own, self.place(_WORLD, self.ends[k][own.end]))
        elif rank < 3:
            self.slides[own] = slides

    def read_bar(self, k: int, piece: Piece) -> tuple[float, float, Array]:
        """Compute mass, radius and end masses (2,) of a bar.

        The end masses are the geoms with their centers at the ends. Raises SceneFileError.
        """
        ends = np.array(self.ends[k])
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        on_ends, rest, centre, inertia = np.zeros(2), 0.0, np.zeros(3), np.zeros((3, 3))
        for mass in piece.masses:
            at = [bool(np.linalg.norm(mass.centre - end) <= self.close) for end in ends]
            if any(at):
                on_ends[at.index(True)] += mass.mass
            else:
                rest, centre = rest + mass.mass, centre + mass.mass * mass.centre
            inertia += mass.inertia
        if rest <= 0:
            raise piece.element.error("has no mass between its ends: a bar needs one")
        centre /= rest
        if np.linalg.norm(centre - ends.mean(axis=0)) > 1e-3 * length:
            said = f"its mass has its centre at {centre.round(4).tolist()}, which is not the middle of its ends {ends.round(4).tolist()}"
            raise piece.element.error(
                f"{said}: bars are even, give masses on ends by geoms of their own"
            )
        for mass in piece.masses:
            if not any(np.linalg.norm(mass.centre - end) <= self.close for end in ends):
                off = mass.centre - centre
                inertia += mass.mass * (off @ off * np.eye(3) - np.outer(off, off))
        return rest, self._radius(piece, rest, length, along / length, inertia), on_ends

    def _radius(
        self, piece: Piece, mass: float, length: float, axis: Array, inertia: Array
    ) -> float:
        """Compute the radius from the transverse inertia (Eq. 19).

        Raises SceneFileError.
        """
        other = np.linalg.svd(axis[None])[2][1:]
        across = other @ inertia @ other.T
        mean, uneven = (
            np.trace(across) / 2,
            np.linalg.norm(across - np.trace(across) / 2 * np.eye(2)),
        )
        if uneven > _ALIKE * mean:
            raise piece.element.error(
                "has another inertia across one direction than across the other: bars are round"
            )
        squared = 4 * (mean / mass - length**2 / 12)
        if squared < -_THIN * length**2:
            raise piece.element.error(
                f"has an inertia of {mean:.4g} kg m², less than a thin rod between its ends: {mass * length**2 / 12:.4g} kg m²"
            )
        radius = float(np.sqrt(max(squared, 0.0))) if abs(squared) > _ROUND * length**2 else 0.0
        drawn = [
            shape.rod.radius for shape in piece.shapes if shape.rod and shape.rod.kind == "cylinder"
        ]
        return next(
            (size for size in drawn if abs(size**2 - squared) < _ROUND * length**2), radius
        )  # avoids the rounding error of the square root

    def read_point(self, k: int, piece: Piece) -> float:
        """Compute the mass of a point. Raises SceneFileError."""
        total = sum(mass.mass for mass in piece.masses)
        if (
            total > 0
            and np.linalg.norm(
                sum(mass.mass * mass.centre for mass in piece.masses) / total - self.ends[k][0]
            )
            > 1e-3 * self.close / CLOSE
        ):
            raise piece.element.error(
                "is a point whose mass is elsewhere: give a capsule or a cylinder to make it a bar"
            )
        return float(total)


def by_number(names: list[list[str]], prefix: str) -> list[int] | None:
    """Sort items by the numbers in their names.

    Returns None unless the numbers are complete and start at 0.
    """
    numbers = [
        next(
            (int(name[len(prefix) :]) for name in own if re.fullmatch(prefix + "[0-9]{1,9}", name)),
            -1,
        )
        for own in names
    ]
    return (
        [int(k) for k in np.argsort(numbers)]
        if sorted(numbers) == list(range(len(names)))
        else None
    )


def unique(items: list[Any]) -> list[Any]:
    """Remove repeated items, keeping the first of each."""
    seen: dict[Hashable, Any] = {item: item for item in items}
    return list(seen)
