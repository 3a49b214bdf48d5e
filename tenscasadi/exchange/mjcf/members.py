"""Conversion of MuJoCo's rigid pieces to bars, point masses and nodes."""

from __future__ import annotations

import re
from collections.abc import Hashable
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Piece, Site
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.geoms import Mass
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import FILE_ROUNDING, ROUNDING, Array

_WORLD = 0


class Endpoint(NamedTuple):
    """Endpoint of a rigid piece that becomes a node.

    Attributes
    ----------
    piece : int
        Index of the piece; 0 is the world.
    end : int
        Index among the endpoints of the piece.
    """

    piece: int
    end: int


class PieceEnds:
    """Endpoints of all rigid pieces, and the nodes that they share.

    Attributes
    ----------
    close : float
        Distance of coinciding points [m].
    points : list of list of ndarray
        Endpoints of each piece [m]: two of a bar, one of a point mass, more of a rigid body.
    pinned : set of Endpoint
        Nodes that are pinned.
    slides : dict of Endpoint to list of ndarray
        Directions in which nodes slide.
    """

    def __init__(self, bodies: Bodies, attached: list[Site]) -> None:
        self.bodies = bodies
        points = [site.place for site in bodies.sites.values()]
        rods = [geom.rod for piece in bodies.pieces for geom in piece.geoms if geom.rod]
        points += [end for rod in rods for end in rod.ends]
        self.close = FILE_ROUNDING * max(measure_extent(np.array(points)) if points else 0.0, 1e-9)
        self.points: list[list[Array]] = [[] for _ in bodies.pieces]
        self._same: dict[Endpoint, Endpoint] = {}
        self._snaps: set[int] = set()
        self._anchors = {
            k: self._list_anchors(k, piece, attached)
            for k, piece in bodies.moving()
            if piece.anchor is not None
        }
        attached = attached + [
            Site(side, place)
            for k, places in self._anchors.items()
            for place in places
            for side in {k, bodies.pieces[k].parent or k}
        ]
        for site in attached:
            self._add_point(site.piece, site.place)
        for k, places in self._anchors.items():
            for side in {k, bodies.pieces[k].parent or k} if len(places) == 2 else ():
                self._add_point_off(side, *places)
        for k, piece in bodies.moving():
            self._complete(k, piece)
        self.pinned: set[Endpoint] = set()
        self.slides: dict[Endpoint, list[Array]] = {}
        for k, piece in bodies.moving():
            self._hang(k, piece)

    def _list_anchors(self, k: int, piece: Piece, attached: list[Site]) -> list[Array]:
        """List the points of a joint that two pieces share.

        They are piece `k` and its parent. A ball joint has one, and a hinge two on its axis, the
        second at a site if there is one. `attached` are the sites of strings and constraints.
        """
        if piece.axis is None or piece.anchor is None:
            return [] if piece.anchor is None else [piece.anchor]
        sides, axis, start = {k, piece.parent}, piece.axis, piece.anchor
        sites = [site for name, site in self.bodies.sites.items() if _is_node(name)]
        along = 0.0
        for site in (site for site in [*sites, *attached] if site.piece in sides):
            arm = site.place - start
            if np.linalg.norm(arm - arm @ axis * axis) <= self.close:
                along = max(along, float(arm @ axis), key=abs)
        if abs(along) <= self.close:
            along = self._extent(k, start)
        return [start, start + along * axis]

    def _extent(self, k: int, start: Array) -> float:
        """Compute the extent of piece `k` from the point `start` [m].

        It is the largest distance of its mass and geoms.
        """
        piece = self.bodies.pieces[k]
        points = [mass.center for mass in piece.masses]
        points += [end for geom in piece.geoms if geom.rod for end in geom.rod.ends]
        sizes = [float(np.linalg.norm(point - start)) for point in points]
        return max((size for size in sizes if size > self.close), default=0.1)

    def _add_point(self, k: int, point: Array) -> None:
        """Add the endpoint `point` [m] to piece `k`, unless it has one there."""
        if self.find(k, point) is None:
            self.points[k].append(point)

    def _add_point_off(self, k: int, start: Array, end: Array) -> None:
        """Add endpoints of a hinged piece that are off the hinge axis.

        The axis of piece k runs from `start` to `end` (3,) [m].
        """
        axis = (end - start) / np.linalg.norm(end - start)
        piece = self.bodies.pieces[k]
        for geom in piece.geoms:
            for place in geom.rod.ends if geom.rod and geom.rod.kind != "sphere" else ():
                self._add_point(k, place)
        points = [*self.points[k], *(mass.center for mass in piece.masses)]
        off = [
            point
            for point in points
            if np.linalg.norm(np.cross(point - start, axis)) > 1e-3 * self._extent(k, start)
        ]
        across = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = across - across @ axis * axis
        self._add_point(
            k, off[0] if off else start + self._extent(k, start) * across / np.linalg.norm(across)
        )

    def find(self, piece: int, point: Array) -> Endpoint | None:
        """Find the endpoint of a piece at a point (3,) [m], or None."""
        ends = self.points[piece]
        if not ends:
            return None
        distances = np.linalg.norm(np.array(ends) - point, axis=1)
        nearest = int(np.argmin(distances))
        found = distances[nearest] <= self.close or piece in self._snaps
        return Endpoint(piece, nearest) if found else None

    def place(self, piece: int, point: Array, element: Element | None = None) -> Endpoint:
        """Find the endpoint of a piece at a point.

        The point is (3,) [m]. In the world it is added if necessary. Raises SceneFileError, which
        names `element`, if a moving piece has no endpoint there.
        """
        found = self.find(piece, point)
        if found is None and piece == _WORLD:
            self.points[_WORLD].append(point)
            found = Endpoint(_WORLD, len(self.points[_WORLD]) - 1)
        if found is None:
            raise (element or self.bodies.pieces[piece].element).error(
                f"holds a body at {point.round(6).tolist()}, where no end of it is"
            )
        return found

    def join(self, one: Endpoint, other: Endpoint) -> None:
        """Merge two endpoints into one node.

        An endpoint of the world pins it.
        """
        for end, to in ((one, other), (other, one)):
            if to.piece == _WORLD:
                self.pinned.add(self.node(end))
        first, second = sorted((self.node(one), self.node(other)))
        if first != second:
            self._same[second] = first
            if second in self.pinned:
                self.pinned.add(first)

    def node(self, end: Endpoint) -> Endpoint:
        """Return the representative of all endpoints that form one node.

        `end` is one of these endpoints.
        """
        while end in self._same:
            end = self._same[end]
        return end

    def _complete(self, k: int, piece: Piece) -> None:
        """Choose the endpoints of piece `k`.

        They are the attached points, or the ends of its longest geom if there are fewer than two.
        In an inexact import they are those ends also if there are more, and the attached points
        move to them. Raises SceneFileError.
        """
        if piece.welded:
            for geom in piece.geoms:
                for place in geom.rod.ends if geom.rod and geom.rod.kind != "sphere" else ():
                    self._add_point(k, place)
        ends = self.points[k]
        sites = [
            site.place
            for name, site in self.bodies.sites.items()
            if site.piece == k and _is_node(name)
        ]
        places = ends + [place for place in sites if self.find(k, place) is None]
        if self._span_plane(places) and any(mass.inertia.any() for mass in piece.masses):
            self.points[k] = places  # of a rigid body
            return
        rods = [geom.rod for geom in piece.geoms if geom.rod and geom.rod.kind != "sphere"]
        longest = max(rods, key=lambda rod: rod.length, default=None)
        if longest is None and len(places) == 2:  # of a rod without geoms
            ends.extend(places[len(ends) :])
        if len(ends) > 2:
            where = ", ".join(str(end.round(4).tolist()) for end in ends[:4])
            piece.element.leave_out(
                f"has strings or joints at {len(ends)} places ({where}): a bar has two ends"
            )
            self._snap(k, piece, longest.ends if longest else _find_extremes(ends))
        elif longest is not None and len(ends) < 2:
            near = [
                end
                for end in longest.ends
                if all(np.linalg.norm(known - end) > longest.length / 100 for known in ends)
            ]
            if len(ends) + len(near) == 2:
                ends.extend(near)
            else:
                piece.element.leave_out(
                    f"has a string or joint at {ends[0].round(4).tolist()}: bars have them at their ends"
                )
                self._snap(k, piece, longest.ends)
        elif longest is not None and not piece.element.source.strict:
            away = np.linalg.norm(np.array(ends)[:, None] - longest.ends, axis=2).min(axis=1)
            if away.max() > longest.length / 100:
                self._snap(k, piece, longest.ends)
        ends = self.points[k]
        if longest is not None and len(ends) == 2:
            first, second = (np.linalg.norm(end - longest.ends[0]) for end in ends)
            if first > second:
                ends.reverse()
        if not ends:
            if not piece.masses:
                raise piece.element.error("has no mass: give an <inertial> or a geom")
            ends.append(np.mean([mass.center for mass in piece.masses], axis=0))

    def _span_plane(self, points: list[Array]) -> bool:
        """Return whether points are not all on one line."""
        if len(points) < 3:
            return False
        arms = np.array(points) - np.mean(points, axis=0)
        sizes = np.linalg.svd(arms, compute_uv=False)
        return bool(sizes[1] > 1e-3 * sizes[0] > self.close)

    def _snap(self, k: int, piece: Piece, ends: Array) -> None:
        """Move the attached points of piece `k` to its two ends.

        `ends` (2, 3) are their positions [m].
        """
        away = np.linalg.norm(np.array(self.points[k])[:, None] - ends, axis=2).min(axis=1)
        error = piece.element.error(f"has attached points up to {away.max():.3g} m from its ends")
        piece.element.source.leave_out(error)
        self.points[k] = list(ends)
        self._snaps.add(k)

    def _hang(self, k: int, piece: Piece) -> None:
        """Connect piece `k` to its parent by its joint.

        Raises SceneFileError.
        """
        slides = piece.slides
        rank = np.linalg.matrix_rank(np.array(slides), tol=1e-6) if slides else 0
        if rank < len(slides):
            raise piece.element.error(
                "slides along directions that depend on each other: give independent ones"
            )
        if piece.free or (piece.anchor is None and piece.parent):
            return
        if piece.anchor is None and len(self.points[k]) >= 2:
            kind = "bar" if len(self.points[k]) == 2 else "body"
            piece.element.leave_out(
                f"is a {kind} that slides without turning: give it a ball, too, or a free joint"
            )
        for point in self._anchors.get(k, [self.points[k][0]]):
            own = self.place(k, point)
            if piece.parent:
                self.join(own, self.place(piece.parent, point))
            elif not slides:
                self.join(own, self.place(_WORLD, self.points[k][own.end]))
            elif rank < 3:
                self.slides[own] = slides

    def read_bar(self, k: int, piece: Piece) -> tuple[float, float, Array]:
        """Compute mass, radius and end masses (2,) of a bar.

        The bar is piece k. The end masses are those with their centers at the ends. Raises
        SceneFileError.
        """
        ends = np.array(self.points[k])
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        on_ends, inner = np.zeros(2), []
        inertia = sum((mass.inertia for mass in piece.masses), np.zeros((3, 3)))
        for mass in piece.masses:
            at = np.linalg.norm(mass.center - ends, axis=1) <= self.close
            if at.any():
                on_ends[int(np.argmax(at))] += mass.mass
            else:
                inner.append(mass)
        rest = sum(mass.mass for mass in inner)
        if rest <= 0:
            piece.element.leave_out("has no mass between its ends: a bar needs one")
            rest = float(on_ends.sum()) / 2 or 1.0
            return rest, 0.0, on_ends - on_ends.sum() / 4 if on_ends.any() else on_ends
        center = np.sum([mass.mass * mass.center for mass in inner], axis=0) / rest
        if np.linalg.norm(center - ends.mean(axis=0)) > 1e-3 * length:
            given = f"its mass has its center at {center.round(4).tolist()}"
            piece.element.leave_out(
                f"{given}, which is not the middle of its ends {ends.round(4).tolist()}: bars are even, give masses on ends by geoms of their own"
            )
        for mass in inner:
            off = mass.center - center
            inertia = inertia + mass.mass * (off @ off * np.eye(3) - np.outer(off, off))
        return rest, self._radius(piece, rest, length, along / length, inertia), on_ends

    def _radius(
        self, piece: Piece, mass: float, length: float, axis: Array, inertia: Array
    ) -> float:
        """Compute a bar's radius from the transverse inertia (Eq. 19).

        It is in m. The bar has a mass, a length, a direction `axis` (3,) and an inertia matrix (3,
        3) about its center. Raises SceneFileError.
        """
        other = np.linalg.svd(axis[None])[2][1:]
        across = other @ inertia @ other.T
        mean = float(np.trace(across)) / 2
        if np.linalg.norm(across - mean * np.eye(2)) > 1e-3 * mean:
            piece.element.leave_out(
                "has another inertia across one direction than across the other: bars are round"
            )
        squared = 4 * (mean / mass - length**2 / 12)
        if squared < -FILE_ROUNDING * length**2:
            piece.element.leave_out(
                f"has an inertia of {mean:.4g} kg m², less than a thin rod between its ends: {mass * length**2 / 12:.4g} kg m²"
            )
        radius = float(np.sqrt(max(squared, 0.0))) if abs(squared) > ROUNDING * length**2 else 0.0
        drawn = [
            geom.rod.radius for geom in piece.geoms if geom.rod and geom.rod.kind == "cylinder"
        ]
        exact = [size for size in drawn if abs(size**2 - squared) < ROUNDING * length**2]
        return exact[0] if exact else radius  # without the rounding error of the square root

    def read_body(self, k: int, piece: Piece) -> tuple[Mass, Array]:
        """Compute the mass properties of rigid body `k`.

        Also returns the point masses on its nodes [kg], which are separate. Raises SceneFileError.
        """
        points = np.array(self.points[k])
        on_nodes, inner = np.zeros(len(points)), []
        for mass in piece.masses:
            at = np.linalg.norm(mass.center - points, axis=1) <= self.close
            if at.any() and not mass.inertia.any():
                on_nodes[int(np.argmax(at))] += mass.mass
            else:
                inner.append(mass)
        total = sum(mass.mass for mass in inner)
        if total <= 0:
            raise piece.element.error("has no mass: give an <inertial> or a geom")
        center = np.sum([mass.mass * mass.center for mass in inner], axis=0) / total
        inertia = np.zeros((3, 3))
        for mass in inner:
            off = mass.center - center
            inertia += mass.inertia + mass.mass * (off @ off * np.eye(3) - np.outer(off, off))
        return Mass(total, center, inertia), on_nodes

    def read_point(self, k: int, piece: Piece) -> float:
        """Compute the mass of a point mass [kg].

        It is piece `k`. Raises SceneFileError.
        """
        total = sum(mass.mass for mass in piece.masses)
        if total > 0:
            center = np.sum([mass.mass * mass.center for mass in piece.masses], axis=0) / total
            if np.linalg.norm(center - self.points[k][0]) > 1e-3 * self.close / FILE_ROUNDING:
                piece.element.leave_out(
                    "is a point whose mass is elsewhere: give a capsule or a cylinder to make it a bar"
                )
        return float(total)


def _is_node(site: str) -> bool:
    """Return whether a site is named like a node, such as "n3".

    `export_mjcf` uses such names.
    """
    return re.fullmatch("n[0-9]{1,9}", site) is not None


def _find_extremes(points: list[Array]) -> Array:
    """Find the two points (2, 3) with the largest distance."""
    every = np.array(points)
    distances = np.linalg.norm(every[:, None] - every, axis=2)
    return every[list(np.unravel_index(np.argmax(distances), distances.shape))]


def order_by_number(names: list[list[str]], prefix: str) -> list[int] | None:
    """Sort items by the numbers in their names.

    A name has the number after `prefix`; each item has several names. Returns None unless the
    numbers are complete and start at 0.
    """
    pattern = re.compile(prefix + "([0-9]{1,9})")
    matches = [[pattern.fullmatch(name) for name in own] for own in names]
    numbers = [next((int(found[1]) for found in own if found), -1) for own in matches]
    complete = sorted(numbers) == list(range(len(names)))
    return [int(k) for k in np.argsort(numbers)] if complete else None


def drop_duplicates(items: list[Any]) -> list[Any]:
    """Remove repeated items, keeping the first of each."""
    seen: dict[Hashable, Any] = dict.fromkeys(items)
    return list(seen)
