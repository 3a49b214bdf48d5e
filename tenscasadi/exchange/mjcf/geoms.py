"""Geoms (shapes) of MJCF files: their axes and masses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.frames import Pose, Units, read_pose
from tenscasadi.util.validate import Array

_ROUND = ("sphere", "capsule", "cylinder")


class Mass(NamedTuple):
    """Mass, center and inertia of a geom or body.

    Attributes
    ----------
    mass : float
        Mass [kg].
    center : ndarray, shape (3,)
        Center of mass [m].
    inertia : ndarray, shape (3, 3)
        Inertia about the center of mass [kg m²].
    """

    mass: float
    center: Array
    inertia: Array


class RodGeom(NamedTuple):
    """Axis and radius of a round geom.

    Attributes
    ----------
    ends : ndarray, shape (2, 3)
        Ends of the axis [m], equal for a sphere.
    radius : float
        Radius [m].
    kind : str
        Type of the geom.
    """

    ends: Array
    radius: float
    kind: str

    @property
    def length(self) -> float:
        """Length of the axis [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))


class Geom(NamedTuple):
    """Geom (shape) of a rigid piece.

    Attributes
    ----------
    element : Element
        XML element.
    frame : Pose
        Pose in the world.
    rod : RodGeom or None
        Its axis; None for planes and others without one.
    mass : Mass or None
        Its mass; None if it has none or it is unknown.
    """

    element: Element
    frame: Pose
    rod: RodGeom | None
    mass: Mass | None


def read_geom(element: Element, outer: Pose, units: Units, has_mass: bool) -> Geom:
    """Read a geom whose body has the frame `outer`.

    `units` are the file's conventions for angles. Without `has_mass` the geom's mass is ignored.
    Raises SceneFileError.
    """
    frame = read_pose(element, units).within(outer)
    kind = element.text("type", "sphere")
    rod = mass = None
    if kind in _ROUND:
        rod = _read_rod(element, outer, frame, kind)
    elif kind in ("box", "ellipsoid"):
        half = element.numbers("size", 3)
        long = int(np.argmax(half))
        reach = half[long] * frame.turn[:, long]
        radius = float(np.delete(half, long).mean())
        rod = RodGeom(np.array([frame.place - reach, frame.place + reach]), radius, kind)
    size = "mass" if "mass" in element.attributes else "density"
    amount = element.number(size, 1000.0)  # MuJoCo's default density, kg/m³
    if amount < 0:
        raise element.error(f"is {amount:g}: give at least 0", size)
    if has_mass and amount > 0:
        if rod is None:
            element.leave_out(
                f"is {kind!r}, whose mass is not read: give the body an <inertial>", "type"
            )
        else:
            given = amount if size == "mass" else None
            mass = _compute_mass(element, frame, rod, given, amount)
    return Geom(element, frame, rod, mass)


def _read_rod(element: Element, outer: Pose, frame: Pose, kind: str) -> RodGeom:
    """Read the axis and radius of a sphere, capsule or cylinder.

    `outer` is the frame of the body, which "fromto" refers to, and `frame` that of the geom. `kind`
    is the type of the geom: "sphere", "capsule" or "cylinder".
    """
    size = element.numbers("size", (1, 2, 3))
    if "fromto" in element.attributes:
        if kind == "sphere":
            raise element.error("is given to a sphere: give type capsule or cylinder", "fromto")
        ends = np.array([outer.at(end) for end in element.numbers("fromto", 6).reshape(2, 3)])
    else:
        if kind != "sphere" and len(size) < 2:
            message = f"is {element.text('size')!r}: give the radius and half the length"
            raise element.error(message, "size")
        reach = (0.0 if kind == "sphere" else size[1]) * frame.turn[:, 2]
        ends = np.array([frame.place - reach, frame.place + reach])
    if size[0] <= 0 or (kind != "sphere" and not np.any(ends[0] != ends[1])):
        message = f"is {element.text('size')!r}: give lengths greater than 0"
        raise element.error(message, "size")
    return RodGeom(ends, float(size[0]), kind)


def _compute_mass(
    element: Element, frame: Pose, rod: RodGeom, mass: float | None, density: float
) -> Mass:
    """Compute the mass properties of a geom.

    `frame` is its coordinate frame, and `rod` its axis and radius. Without a `mass` [kg] they
    follow from its density [kg/m³].
    """
    if rod.kind in ("box", "ellipsoid"):
        half = element.numbers("size", 3)
        is_box = rod.kind == "box"
        total = mass or density * float(np.prod(half)) * (8.0 if is_box else 4 / 3 * np.pi)
        squares = total * half**2 / (3 if is_box else 5)
        inertia = frame.turn @ np.diag(squares.sum() - squares) @ frame.turn.T
        return Mass(total, frame.place, inertia)
    length, r = rod.length, rod.radius
    tube, caps = np.pi * r**2 * length, 4 / 3 * np.pi * r**3 * (rod.kind != "cylinder")
    total = mass or density * (tube + caps)
    tube, caps = (total * part / (tube + caps) for part in (tube, caps))
    spin = tube * r**2 / 2 + caps * 2 * r**2 / 5
    # two half spheres with their centers 3r/8 beyond the ends
    across = tube * (length**2 / 12 + r**2 / 4) + caps * (
        2 * r**2 / 5 + length**2 / 4 + 3 * length * r / 8
    )
    axis = (rod.ends[1] - rod.ends[0]) / length if length else np.zeros(3)
    inertia = across * np.eye(3) + (spin - across) * np.outer(axis, axis)
    return Mass(total, rod.ends.mean(axis=0), inertia)


def read_inertial(element: Element, outer: Pose, units: Units) -> Mass:
    """Read the mass properties of an `inertial` element.

    `outer` is the frame of its body, and `units` are the file's conventions for angles. Raises
    SceneFileError.
    """
    own = read_pose(element, units).within(outer)
    mass = element.number("mass")
    if mass < 0:
        raise element.error(f"is {mass:g}: give at least 0", "mass")
    if "fullinertia" in element.attributes:
        xx, yy, zz, xy, xz, yz = element.numbers("fullinertia", 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        inertia = np.diag(element.numbers("diaginertia", 3, (0, 0, 0) if mass == 0 else None))
    return Mass(mass, own.place, own.turn @ inertia @ own.turn.T)
