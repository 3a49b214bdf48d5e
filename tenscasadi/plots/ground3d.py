"""Grounds in 3-D drawings: planes, cut to the box of the axes, and height fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy.linalg import null_space

from tenscasadi.scene.ground import Ground, Surface, Terrain
from tenscasadi.util.validate import Array

Faces = list[Array]  # corners (k, 3) of each, m

_COLOUR = np.array([0.86, 0.83, 0.76])
_OPACITY = 0.75
_CELLS = 40  # of a height field along each side of the box
_LIGHT = np.array([-0.4, -0.5, 0.77])  # where it comes from


def include_heights(grounds: Sequence[Surface], low: Array, high: Array) -> tuple[Array, Array]:
    """Return the corners of the box, m, widened along z to hold the height fields in it."""
    for ground in grounds:
        if isinstance(ground, Terrain):
            heights = _heights(ground, *_grid(low, high))
            low, high = (
                pick(corner, [*corner[:2], edge])
                for pick, corner, edge in zip(
                    (np.minimum, np.maximum),
                    (low, high),
                    (heights.min(), heights.max()),
                    strict=True,
                )
            )
    return low, high


def draw_grounds(axes: Any, grounds: Sequence[Surface], low: Array, high: Array) -> None:
    """Add what of the grounds lies in the box between two corners, m, behind all else that the axes show."""
    for ground in grounds:
        faces = (
            _field_faces(ground, low, high)
            if isinstance(ground, Terrain)
            else _plane_faces(ground, low, high)
        )
        if faces:
            colours = [
                np.append(_COLOUR * (0.75 + 0.25 * abs(_normal(face) @ _LIGHT)), _OPACITY)
                for face in faces
            ]
            axes.add_collection3d(
                Poly3DCollection(
                    faces, facecolors=colours, edgecolors="none", zorder=1, clip_on=False
                )
            )


def _plane_faces(ground: Any, low: Array, high: Array) -> Faces:
    """Return the polygon in which a plane cuts the box, or none."""
    if not isinstance(ground, Ground):
        return []
    normal, centre = np.array(ground.normal), (low + high) / 2
    foot, reach = (
        centre + (ground.height - normal @ centre) * normal,
        2 * float(np.linalg.norm(high - low)),
    )
    across = null_space(normal[None]).T
    face = foot + reach * np.array(
        [
            across[0] + across[1],
            across[0] - across[1],
            -across[0] - across[1],
            across[1] - across[0],
        ]
    )
    for axis in range(3):
        for sign, limit in ((1, low[axis]), (-1, high[axis])):
            face = _cut(face, sign * (face[:, axis] - limit))
    return [face] if len(face) else []


def _cut(face: Array, inside: Array) -> Array:
    """Return the part of a polygon where a linear function with these values (k,) at its corners is not negative (Sutherland, Hodgman)."""
    kept: list[Array] = []
    for k, (corner, value) in enumerate(zip(face, inside, strict=True)):
        before, previous = face[k - 1], inside[k - 1]
        if (value < 0) != (previous < 0):
            kept.append(before + (corner - before) * previous / (previous - value))
        if value >= 0:
            kept.append(corner)
    return np.array(kept).reshape(-1, 3)


def _field_faces(ground: Terrain, low: Array, high: Array) -> Faces:
    x, y = _grid(low, high)
    points = np.stack(
        [*np.broadcast_arrays(x[:, None], y[None, :]), _heights(ground, x, y)], axis=2
    )
    corners = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
    return list(corners.reshape(-1, 4, 3))


def _grid(low: Array, high: Array) -> tuple[Array, Array]:
    return np.linspace(low[0], high[0], _CELLS + 1), np.linspace(low[1], high[1], _CELLS + 1)


def _heights(ground: Terrain, x: Array, y: Array) -> Array:
    """Return the heights (len(x), len(y)), m, of points."""
    places = np.array([(a, b, 0.0) for a in x for b in y]).T
    depth, outward, _ = ground.contact(places)
    return np.asarray((depth / outward[2, :]).full().reshape(len(x), len(y)))


def _normal(face: Array) -> Array:
    normal = np.cross(face[1] - face[0], face[2] - face[0])
    return np.asarray(normal / (np.linalg.norm(normal) or 1.0))
