"""Coordinate frames of MJCF elements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.util.validate import Array

_SIZES = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}


class Units(NamedTuple):
    """Conventions of an MJCF file for angles and frames.

    Attributes
    ----------
    degrees : bool
        Whether angles are in degrees.
    sequence : str
        Axes of Euler angles.
    is_global : bool
        Whether frames are relative to the world, as in older files.
    """

    degrees: bool = True
    sequence: str = "xyz"
    is_global: bool = False


class Pose(NamedTuple):
    """Coordinate frame: origin `place` (3,) [m] and rotation matrix `turn`.

    Columns of `turn` (3, 3) are the frame's axes in the outer frame.
    """

    place: Array
    turn: Array

    def at(self, point: Array) -> Array:
        """Transform a point from this frame to the outer frame.

        The point is (3,) [m].
        """
        return np.asarray(self.place + self.turn @ point)

    def within(self, outer: Pose) -> Pose:
        """Express this frame, given relative to `outer`, in the coordinates of `outer`'s parent."""
        return Pose(outer.at(self.place), outer.turn @ self.turn)


WORLD = Pose(np.zeros(3), np.eye(3))


def read_pose(element: Element, units: Units) -> Pose:
    """Read the coordinate frame of an element.

    `units` are the file's conventions for angles. Raises SceneFileError.
    """
    given = [name for name in _SIZES if name in element.attributes]
    if len(given) > 1:
        raise element.error(f"is given beside {given[0]}: leave one out", given[1])
    turn = _read_rotation(element, given[0], units) if given else np.eye(3)
    return Pose(element.numbers("pos", 3, (0, 0, 0)), turn)


def _read_rotation(element: Element, name: str, units: Units) -> Array:
    values = element.numbers(name, _SIZES[name])
    unit = np.pi / 180 if units.degrees else 1.0
    if name == "euler":
        turn = np.eye(3)
        for letter, angle in zip(units.sequence, values, strict=True):
            about = _rotate(np.eye(3)["xyz".index(letter.lower())], angle * unit)
            turn = turn @ about if letter.islower() else about @ turn
        return np.asarray(turn)
    if name == "axisangle":
        return _rotate(_normalize(element, name, values[:3]), values[3] * unit)
    if name == "quat":
        quaternion = _normalize(element, name, values)
        sine = float(np.linalg.norm(quaternion[1:]))
        return _rotate(quaternion[1:] / (sine or 1.0), 2 * np.arctan2(sine, quaternion[0]))
    if name == "zaxis":
        return rotate_z_to(_normalize(element, name, values))
    x = _normalize(element, name, values[:3])
    y = _normalize(element, name, values[3:] - (values[3:] @ x) * x)
    return np.column_stack([x, y, np.cross(x, y)])


def rotate_z_to(direction: Array) -> Array:
    """Compute the smallest rotation from z to a unit direction.

    The result is the rotation matrix (3, 3).
    """
    axis = np.cross([0, 0, 1], direction)
    sine = float(np.linalg.norm(axis))
    if sine <= 1e-10:
        return np.diag([1.0, np.sign(direction[2]), np.sign(direction[2])])
    return _rotate(axis / sine, np.arctan2(sine, direction[2]))


def _normalize(element: Element, name: str, vector: Array) -> Array:
    size = float(np.linalg.norm(vector))
    if not 1e-9 < size < 1e30:
        raise element.error(f"is {element.text(name)!r}: give directions of some length", name)
    return np.asarray(vector / size)


def _rotate(axis: Array, angle: float) -> Array:
    """Compute the rotation matrix about a unit axis.

    `angle` is in rad.
    """
    across = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across)
