"""Rigid pieces of an MJCF file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.frames import (
    WORLD,
    Frame,
    Mass,
    Rod,
    Units,
    read_frame,
    read_inertial,
    read_rod,
    rod_mass,
)
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.util.validate import Array


class Shape(NamedTuple):
    """Geom with its frame.

    Attributes
    ----------
    element : Element
        XML element.
    rod : Rod or None
        Axis; None unless it is a sphere, capsule or cylinder.
    frame : Frame
        Frame in the world.
    """

    element: Element
    rod: Rod | None
    frame: Frame


@dataclass
class Piece:
    """Rigid piece: bodies fixed to each other.

    The first piece is the world.
    """

    element: Element
    parent: int | None = None
    slides: list[Array] = field(default_factory=list)  # unit directions
    anchor: Array | None = None  # of the ball joint
    free: bool = False
    masses: list[Mass] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)


class Site(NamedTuple):
    """Site: its piece and its position."""

    piece: int
    place: Array


class Body(NamedTuple):
    """Body that has not been read yet.

    Attributes
    ----------
    element : Element
        XML element.
    frame : Frame
        Frame in the world.
    piece : int
        Piece that it belongs to.
    childclass : str
        Default class of its children.
    """

    element: Element
    frame: Frame
    piece: int
    childclass: str


class Bodies:
    """Pieces of a file in MuJoCo's reference configuration.

    It maps the names of sites and bodies to their pieces and frames.
    """

    def __init__(
        self, root: Element, defaults: Defaults, units: Units, geoms_weigh: bool | None
    ) -> None:
        self.pieces: list[Piece] = []
        self.sites: dict[str, Site] = {}
        self.frames: dict[str, tuple[int, Frame]] = {}
        self._defaults, self._units, self._geoms_weigh = defaults, units, geoms_weigh
        for element in root.of("worldbody"):
            if not self.pieces:
                self.pieces.append(Piece(element))
            waiting = [Body(check(element), WORLD, 0, "")]
            while waiting:  # keeps the order of the file at any depth
                waiting += reversed(self._fill(waiting.pop()))
        if not self.pieces:
            raise root.error("has no <worldbody>: give one with bodies")
        self.frames.setdefault("world", (0, WORLD))

    def _fill(self, body: Body) -> list[Body]:
        """Add the contents of a body to its piece.

        Returns the bodies inside.
        """
        element, frame, piece, childclass = body
        own, inner = self.pieces[piece], list[Body]()
        inertials = element.of("inertial")
        weigh = self._geoms_weigh is True or (self._geoms_weigh is None and not inertials)
        for child in children(element):
            if child.tag == "site":
                self._site(self._defaults.apply(child, childclass), frame, piece)
            elif child.tag == "geom":
                self._geom(
                    check(self._defaults.apply(child, childclass)), frame, own, weigh and piece > 0
                )
            elif child.tag == "inertial" and self._geoms_weigh is not True:
                own.masses.append(read_inertial(check(child), frame, self._units))
            elif child.tag == "body":
                inner.append(
                    self._body(check(child), frame, piece, child.text("childclass", childclass))
                )
        return inner

    def _body(self, element: Element, outer: Frame, parent: int, childclass: str) -> Body:
        if element.flag("mocap", False):
            raise element.error(
                "is moved from outside: tenscasadi moves pinned nodes by SupportMotion, leave it out",
                "mocap",
            )
        frame = read_frame(element, self._units).within(outer)
        joints = [
            child if child.tag == "freejoint" else self._defaults.apply(child, childclass)
            for child in element.of("joint", "freejoint")
        ]
        piece = parent
        if joints:
            piece = len(self.pieces)
            self.pieces.append(Piece(element, parent))
            for joint in joints:
                self._joint(check(joint), frame, self.pieces[piece])
        name = element.text("name", f"#{len(self.frames)}")
        if name in self.frames:
            raise element.error("is the name of two bodies: give each its own", "name")
        self.frames[name] = piece, frame
        return Body(element, frame, piece, childclass)

    def _joint(self, joint: Element, frame: Frame, piece: Piece) -> None:
        kind = "free" if joint.tag == "freejoint" else joint.text("type", "hinge")
        if kind == "hinge":
            raise joint.error("is a hinge: bars turn freely about their nodes, give a ball", "type")
        limited = joint.flag("limited")
        if limited or (limited is None and "range" in joint.attributes and kind != "free"):
            raise joint.error(
                "limits a joint, which has no counterpart in a scene: leave it out", "range"
            )
        if piece.free or piece.anchor is not None:
            raise joint.error(
                "follows a joint that lets the body turn: slides come first, one ball or free joint last"
            )
        if kind == "free":
            if piece.parent != 0 or piece.slides:
                raise joint.error(
                    "is free inside another body, or beside other joints: give it alone, to a body in the world"
                )
            piece.free = True
        elif kind == "ball":
            piece.anchor = frame.at(joint.numbers("pos", 3, (0, 0, 0)))
        elif joint.word("type", "hinge", "hinge", "slide", "ball", "free") == "slide":
            axis = frame.turn @ joint.numbers("axis", 3, (0, 0, 1))
            size = float(np.linalg.norm(axis))
            if piece.parent != 0 or not 1e-9 < size < 1e30:
                raise joint.error(
                    "slides in another body, or along no direction: give slides along directions, to bodies in the world",
                    "axis",
                )
            piece.slides.append(axis / size)

    def _site(self, site: Element, frame: Frame, piece: int) -> None:
        check(site)
        if "name" not in site.attributes:
            return  # without a name nothing can refer to it
        name = site.text("name")
        if name in self.sites:
            raise site.error("is the name of two sites: give each its own", "name")
        own = read_frame(site.given({**site.attributes, "pos": _middle(site)}), self._units)
        self.sites[name] = Site(piece, frame.at(own.place))

    def _geom(self, geom: Element, frame: Frame, piece: Piece, weigh: bool) -> None:
        rod = read_rod(geom, frame, self._units)
        piece.shapes.append(Shape(geom, rod, read_frame(geom, self._units).within(frame)))
        if not weigh or (
            geom.number("mass", 1.0) == 0.0
            if "mass" in geom.attributes
            else geom.number("density", 1.0) == 0.0
        ):
            return
        if rod is None:
            kind = geom.text("type", "sphere")
            raise geom.error(
                f"is {kind!r}, whose mass is not read: give the body an <inertial>, or spheres, capsules and cylinders",
                "type",
            )
        piece.masses.append(rod_mass(geom, rod))

    def named(self, element: Element, attribute: str) -> tuple[int, Frame]:
        """Find piece and frame of the body an attribute names.

        The default is the world. Raises SceneFileError.
        """
        name = element.text(attribute, "world")
        if name not in self.frames:
            raise element.error(f"is {name!r}, which is no body: name one", attribute)
        return self.frames[name]

    def site(self, element: Element, attribute: str = "site") -> Site:
        """Find the site that an attribute names. Raises SceneFileError."""
        name = element.text(attribute)
        if name not in self.sites:
            raise element.error(f"is {name!r}, which is no site: name one", attribute)
        return self.sites[name]

    def moving(self) -> Iterator[tuple[int, Piece]]:
        """Yield the index and piece of all moving pieces."""
        return ((k, piece) for k, piece in enumerate(self.pieces) if k)


def _middle(site: Element) -> str:
    """Return the position or midpoint of a site."""
    if "fromto" not in site.attributes:
        return site.text("pos", "0 0 0")
    ends = site.numbers("fromto", 6).reshape(2, 3)
    return " ".join(repr(float(x)) for x in ends.mean(axis=0))
