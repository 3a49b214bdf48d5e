"""Rigid pieces of an MJCF file (MuJoCo's XML)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.frames import WORLD, Pose, Units, read_pose
from tenscasadi.exchange.mjcf.geoms import Geom, Mass, read_geom, read_inertial
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.util.validate import Array


@dataclass
class Piece:
    """Rigid piece of an MJCF file: bodies fixed to each other.

    Attributes
    ----------
    element : Element
        XML element of its first body.
    parent : int or None
        Piece that it is attached to.
    slides : list of ndarray
        Unit directions in which it slides.
    anchor : ndarray or None
        Position of its ball joint or hinge [m].
    axis : ndarray or None
        Unit direction of its hinge.
    free : bool
        Whether it moves freely.
    welded : bool
        Whether it consists of several that are fixed to each other by equalities.
    masses, geoms : list
        Mass properties and shapes of its parts.
    """

    element: Element
    parent: int | None = None
    slides: list[Array] = field(default_factory=list)
    anchor: Array | None = None
    axis: Array | None = None
    free: bool = False
    welded: bool = False
    masses: list[Mass] = field(default_factory=list)
    geoms: list[Geom] = field(default_factory=list)


class Site(NamedTuple):
    """Site of an MJCF file.

    `piece` is the index of its rigid piece, and `place` (3,) its position [m].
    """

    piece: int
    place: Array


class UnreadBody(NamedTuple):
    """Body of an MJCF file whose content has not been read.

    Attributes
    ----------
    element : Element
        XML element.
    frame : Pose
        Pose in the world.
    piece : int
        Piece that it belongs to.
    childclass : str
        Default class of its children.
    """

    element: Element
    frame: Pose
    piece: int
    childclass: str


class Bodies:
    """Rigid pieces of an MJCF file in the reference configuration.

    Attributes
    ----------
    pieces : list of Piece
        All pieces; the first one is the world.
    sites : dict of str to Site
        Sites by name.
    frames : dict of str to (int, Pose)
        Pieces and frames of bodies by name.
    """

    def __init__(
        self, root: Element, defaults: Defaults, units: Units, geoms_weigh: bool | None
    ) -> None:
        self.pieces: list[Piece] = []
        self.sites: dict[str, Site] = {}
        self.frames: dict[str, tuple[int, Pose]] = {}
        self._defaults, self._units, self._geoms_weigh = defaults, units, geoms_weigh
        self._merged: dict[int, int] = {}
        for element in root.find("worldbody"):
            if not self.pieces:
                self.pieces.append(Piece(element))
            waiting = [UnreadBody(check(element), WORLD, 0, "")]
            while waiting:  # keeps the order of the file at any depth
                waiting += reversed(self._read(waiting.pop()))
        if not self.pieces:
            raise root.error("has no <worldbody>: give one with bodies")
        self.frames.setdefault("world", (0, WORLD))

    def moving(self) -> Iterator[tuple[int, Piece]]:
        """Yield the index and piece of all pieces that can move."""
        return ((k, piece) for k, piece in enumerate(self.pieces) if k and k not in self._merged)

    def find_body(self, element: Element, attribute: str) -> tuple[int, Pose]:
        """Find index of piece, and frame, of the body that an attribute names.

        The default is the world. Raises SceneFileError.
        """
        name = element.text(attribute, "world")
        if name not in self.frames:
            raise element.error(f"is {name!r}, which is no body: name one", attribute)
        return self.frames[name]

    def find_site(self, element: Element, attribute: str = "site") -> Site:
        """Find the site that an attribute names.

        Raises SceneFileError.
        """
        name = element.text(attribute)
        if name not in self.sites:
            raise element.error(f"is {name!r}, which is no site: name one", attribute)
        return self.sites[name]

    def weld(self, one: int, other: int, element: Element) -> None:
        """Merge two pieces into the one with the lower index.

        `one` and `other` are their indices. One of them must be free, because the other keeps its
        joint. Raises SceneFileError, which names `element`.
        """
        kept, merged = sorted((one, other))
        if kept == merged:
            return
        first, second = self.pieces[kept], self.pieces[merged]
        if kept and first.free and second.parent != kept:
            for name in ("parent", "slides", "anchor", "axis", "free"):
                setattr(first, name, getattr(second, name))
        elif not second.free and second.parent != kept:
            element.leave_out("fixes two bodies that both hang from joints: leave one joint out")
            return
        first.welded = kept > 0
        self._merged[merged] = kept
        self.pieces[kept].masses += self.pieces[merged].masses
        self.pieces[kept].geoms += self.pieces[merged].geoms
        for name, site in self.sites.items():
            if site.piece == merged:
                self.sites[name] = site._replace(piece=kept)
        for name, (owner, frame) in self.frames.items():
            if owner == merged:
                self.frames[name] = kept, frame
        for piece in self.pieces:
            piece.parent = kept if piece.parent == merged else piece.parent

    def _read(self, body: UnreadBody) -> list[UnreadBody]:
        """Add the content of a body to its piece.

        Returns the bodies inside.
        """
        element, own, piece, childclass = body
        frame = WORLD if self._units.is_global else own
        inner: list[UnreadBody] = []
        has_inertial = bool(element.find("inertial"))
        weigh = not has_inertial if self._geoms_weigh is None else self._geoms_weigh
        for child in children(element):
            if child.tag == "site":
                self._add_site(self._defaults.apply(child, childclass), frame, piece)
            elif child.tag == "geom":
                given = self._defaults.apply(child, childclass)
                geom = read_geom(given, frame, self._units, weigh and piece > 0)
                self.pieces[piece].geoms.append(geom)
                self.pieces[piece].masses += [] if geom.mass is None else [geom.mass]
            elif child.tag == "inertial" and self._geoms_weigh is not True:
                self.pieces[piece].masses.append(read_inertial(check(child), frame, self._units))
            elif child.tag == "body":
                name = child.text("childclass", childclass)
                inner.append(self._add_body(check(child), frame, piece, name))
        return inner

    def _add_body(self, element: Element, outer: Pose, parent: int, childclass: str) -> UnreadBody:
        if element.flag("mocap", False):
            cure = "tenscasadi moves pinned nodes by SupportMotion, leave it out"
            element.leave_out(f"is moved from outside: {cure}", "mocap")
        frame = read_pose(element, self._units).within(outer)
        joints = element.find("joint", "freejoint")
        piece = parent
        if joints:
            piece = len(self.pieces)
            self.pieces.append(Piece(element, parent))
            for joint in joints:
                is_free = joint.tag == "freejoint"
                given = check(joint) if is_free else self._defaults.apply(joint, childclass)
                self._add_joint(given, frame, self.pieces[piece])
        name = element.text("name", f"#{len(self.frames)}")
        if name in self.frames:
            raise element.error("is the name of two bodies: give each its own", "name")
        self.frames[name] = piece, frame
        return UnreadBody(element, frame, piece, childclass)

    def _add_joint(self, joint: Element, frame: Pose, piece: Piece) -> None:
        kinds = ("hinge", "slide", "ball", "free")
        kind = "free" if joint.tag == "freejoint" else joint.word("type", "hinge", *kinds)
        if kind == "hinge" and piece.slides:
            joint.leave_out("is a hinge of a body that slides: give a ball", "type")
            kind = "ball"
        limited = joint.flag("limited")
        if limited or (limited is None and "range" in joint.attributes and kind != "free"):
            joint.leave_out(
                "limits a joint, which has no counterpart in a scene: leave it out", "range"
            )
        if piece.free or piece.anchor is not None:
            joint.leave_out(
                "follows a joint that lets the body turn: slides come first, one ball or free joint last"
            )
        elif kind == "free":
            if piece.parent != 0 or piece.slides:
                joint.leave_out(
                    "is free inside another body, or beside other joints: give it alone, to a body in the world"
                )
                piece.parent = 0
            piece.free = True
        elif kind == "ball":
            piece.anchor = self._joint_place(joint, frame)
        else:
            axis = frame.turn @ joint.numbers("axis", 3, (0, 0, 1))
            size = float(np.linalg.norm(axis))
            if kind == "hinge" and 1e-9 < size < 1e30:
                piece.anchor, piece.axis = self._joint_place(joint, frame), axis / size
            elif kind == "hinge":
                joint.leave_out("turns about no direction: give one", "axis")
                piece.anchor = self._joint_place(joint, frame)
            elif piece.parent == 0 and 1e-9 < size < 1e30:
                piece.slides.append(axis / size)
            else:
                joint.leave_out(
                    "slides in another body, or along no direction: give slides along directions, to bodies in the world",
                    "axis",
                )

    def _joint_place(self, joint: Element, frame: Pose) -> Array:
        origin = WORLD if self._units.is_global else frame
        return origin.at(joint.numbers("pos", 3, (0, 0, 0)))

    def _add_site(self, site: Element, frame: Pose, piece: int) -> None:
        if "name" not in site.attributes:
            return  # without a name nothing can refer to it
        name = site.text("name")
        if name in self.sites:
            raise site.error("is the name of two sites: give each its own", "name")
        if "fromto" in site.attributes:
            place = site.numbers("fromto", 6).reshape(2, 3).mean(axis=0)
        else:
            place = read_pose(site, self._units).place
        self.sites[name] = Site(piece, frame.at(place))
