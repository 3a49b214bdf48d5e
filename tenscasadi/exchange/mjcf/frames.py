"""Frames of MJCF elements, and the masses of geoms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.util.validate import Array

_DENSITY = 1000.0  # kg/m³, MuJoCo's default


class Units(NamedTuple):
    """Angle conventions of a file."""

    degrees: bool
    sequence: str  # of Euler angles


class Frame(NamedTuple):
    """Position, and rotation matrix with the axes as columns."""

    place: Array
    turn: Array

    def at(self, point: Array) -> Array:
        """Transform a point of this frame to the outer frame."""
        return np.asarray(self.place + self.turn @ point)

    def seen(self, point: Array) -> Array:
        """Transform a point of the outer frame to this frame."""
        return np.asarray(self.turn.T @ (point - self.place))

    def within(self, outer: Frame) -> Frame:
        """Express this frame in the frame around `outer`."""
        return Frame(outer.at(self.place), outer.turn @ self.turn)


class Mass(NamedTuple):
    """Mass properties of a body.

    Attributes
    ----------
    mass : float
        Mass [kg].
    centre : ndarray, shape (3,)
        Center of mass [m].
    inertia : ndarray, shape (3, 3)
        Inertia about the center of mass [kg m²].
    """

    mass: float
    centre: Array
    inertia: Array


class Rod(NamedTuple):
    """Axis of a geom and its radius [m].

    A sphere has two equal ends.
    """

    ends: Array
    radius: float
    kind: str


WORLD = Frame(np.zeros(3), np.eye(3))


def read_frame(element: Element, units: Units) -> Frame:
    """Read the frame of an element. Raises SceneFileError."""
    given = [
        name
        for name in ("quat", "axisangle", "euler", "xyaxes", "zaxis")
        if name in element.attributes
    ]
    if len(given) > 1:
        raise element.error(f"is given beside {given[0]}: leave one out", given[1])
    return Frame(
        element.numbers("pos", 3, (0, 0, 0)),
        _turn(element, given[0], units) if given else np.eye(3),
    )


def _turn(element: Element, name: str, units: Units) -> Array:
    values = element.numbers(
        name, {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}[name]
    )
    unit = np.pi / 180 if units.degrees else 1.0
    if name == "euler":
        turn = np.eye(3)
        for letter, angle in zip(units.sequence, values, strict=True):
            about = _rotation(np.eye(3)["xyz".index(letter.lower())], angle * unit)
            turn = turn @ about if letter.islower() else about @ turn
        return np.asarray(turn)
    if name == "axisangle":
        return _rotation(_unit(element, name, values[:3]), values[3] * unit)
    if name == "quat":
        unit_quaternion = _unit(element, name, values)
        sine = float(np.linalg.norm(unit_quaternion[1:]))
        return _rotation(
            unit_quaternion[1:] / (sine or 1.0), 2 * np.arctan2(sine, unit_quaternion[0])
        )
    if name == "zaxis":
        return turn_to(_unit(element, name, values))
    x = _unit(element, name, values[:3])
    y = _unit(element, name, values[3:] - (values[3:] @ x) * x)
    return np.column_stack([x, y, np.cross(x, y)])


def turn_to(z: Array) -> Array:
    """Compute the smallest rotation from z to a direction."""
    axis = np.cross([0, 0, 1], z)
    sine = float(np.linalg.norm(axis))
    return (
        _rotation(axis / sine, np.arctan2(sine, z[2]))
        if sine > 1e-10
        else np.diag([1.0, np.sign(z[2]), np.sign(z[2])])
    )


def _unit(element: Element, name: str, vector: Array) -> Array:
    size = float(np.linalg.norm(vector))
    if not 1e-9 < size < 1e30:
        raise element.error(f"is {element.text(name)!r}: give directions of some length", name)
    return np.asarray(vector / size)


def _rotation(axis: Array, angle: float) -> Array:
    """Compute the rotation about a unit axis (Rodrigues)."""
    across = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across)


def read_rod(element: Element, frame: Frame, units: Units) -> Rod | None:
    """Read the axis of a sphere, capsule or cylinder.

    It is expressed in the outer frame, and None for other geoms. Raises SceneFileError.
    """
    kind = element.text("type", "sphere")
    if kind not in ("sphere", "capsule", "cylinder"):
        return None
    if "fromto" in element.attributes and kind == "sphere":
        raise element.error("is given to a sphere: give type capsule or cylinder", "fromto")
    if "fromto" in element.attributes:
        radius, ends = (
            element.numbers("size", (1, 2, 3))[0],
            element.numbers("fromto", 6).reshape(2, 3),
        )
    else:
        own = read_frame(element, units)
        size = element.numbers("size", (1, 2, 3))
        half = 0.0
        if kind != "sphere":
            if len(size) < 2:
                raise element.error(
                    f"is {element.text('size')!r}: give the radius and half the length", "size"
                )
            half = size[1]
        radius, ends = (
            size[0],
            np.array([own.place - half * own.turn[:, 2], own.place + half * own.turn[:, 2]]),
        )
    if radius <= 0 or (kind != "sphere" and not np.any(ends[0] != ends[1])):
        raise element.error(f"is {element.text('size')!r}: give lengths greater than 0", "size")
    return Rod(np.array([frame.at(end) for end in ends]), float(radius), kind)


def rod_mass(element: Element, rod: Rod) -> Mass:
    """Compute the mass of a sphere, capsule or cylinder.

    Raises SceneFileError.
    """
    along = rod.ends[1] - rod.ends[0]
    length, r = float(np.linalg.norm(along)), rod.radius
    tube, caps = np.pi * r**2 * length, 4 / 3 * np.pi * r**3 * (rod.kind != "cylinder")
    mass = element.number("mass", element.number("density", _DENSITY) * (tube + caps))
    if mass < 0:
        raise element.error(
            f"is {mass:g}: give at least 0", "mass" if "mass" in element.attributes else "density"
        )
    tube, caps = (mass * part / (tube + caps) for part in (tube, caps))
    spin = tube * r**2 / 2 + caps * 2 * r**2 / 5
    # two half spheres with their centers 3r/8 beyond the ends
    across = tube * (length**2 / 12 + r**2 / 4) + caps * (
        2 * r**2 / 5 + length**2 / 4 + 3 * length * r / 8
    )
    axis = along / length if length else np.zeros(3)
    return Mass(
        mass, rod.ends.mean(axis=0), across * np.eye(3) + (spin - across) * np.outer(axis, axis)
    )


def read_inertial(element: Element, frame: Frame, units: Units) -> Mass:
    """Read the mass of an `inertial` element. Raises SceneFileError."""
    own = read_frame(element, units).within(frame)
    mass = element.number("mass")
    if mass < 0:
        raise element.error(f"is {mass:g}: give at least 0", "mass")
    if "fullinertia" in element.attributes:
        xx, yy, zz, xy, xz, yz = element.numbers("fullinertia", 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        inertia = np.diag(element.numbers("diaginertia", 3, (0, 0, 0) if mass == 0 else None))
    return Mass(mass, own.place, own.turn @ inertia @ own.turn.T)
