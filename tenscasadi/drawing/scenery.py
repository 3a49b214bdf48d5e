"""Visible parts of grounds and boxes in a picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from tenscasadi.drawing.style import STYLE
from tenscasadi.drawing.view_content import ViewContent
from tenscasadi.scene.ground import Ground, Surface
from tenscasadi.scene.terrain import Terrain
from tenscasadi.util.validate import Array, Indices


class GroundPatch(NamedTuple):
    """Visible part of a ground.

    Attributes
    ----------
    vertices : ndarray, shape (v, 3)
        Positions [m].
    faces : ndarray of int, shape (f, 3)
        Triangles, whose normals point away from the ground.
    lines : ndarray, shape (k, 2, 3)
        Grid lines [m].
    """

    vertices: Array
    faces: Indices
    lines: Array


def grid_spacing(size: float, lines: int = STYLE.grid_lines) -> float:
    """Choose a grid spacing, 1, 2 or 5 times a power of ten [m].

    It is at most `size / lines`.
    """
    largest = size / lines * (1 + 1e-9)
    power = 10.0 ** np.floor(np.log10(largest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= largest))


def find_view(content: ViewContent, margin: float) -> tuple[Array, Array]:
    """Find the corners of the visible box [m].

    They are `low` and `high` (3,). The box contains all motions and obstacles, the height fields
    below and above them, and planes that are not too far away. The margin is relative to the size
    of the content.
    """
    (low, high), size = content.corners, content.size
    for center, radius in content.obstacles:
        low = np.minimum(low, np.asarray(center) - radius)
        high = np.maximum(high, np.asarray(center) + radius)
    low, high = low - margin * size, high + margin * size
    for ground in content.grounds:
        if isinstance(ground, Terrain):
            z = _terrain_grid(ground, low, high)[..., 2]
            low = np.minimum(low, [*low[:2], z.min()])
            high = np.maximum(high, [*high[:2], z.max()])
        elif isinstance(ground, Ground):
            center, normal = (low + high) / 2, np.array(ground.normal)
            foot = center + (ground.height - normal @ center) * normal
            if np.linalg.norm(foot - center) < 2 * size:
                low, high = np.minimum(low, foot - 1e-3 * size), np.maximum(high, foot)
    return low, high


def find_floor(content: ViewContent) -> Ground:
    """Find the horizontal plane below all structures of the content.

    It serves pictures without a ground.
    """
    return Ground(height=float(content.corners[0][2]) - content.bar_radius)


def cut_ground(ground: Surface, low: Array, high: Array) -> GroundPatch | None:
    """Find the part of a ground that lies in a box, or None.

    The corners `low` and `high` (3,) of the box are in m.
    """
    if isinstance(ground, Terrain):
        return _cut_terrain(ground, low, high)
    return _cut_plane(ground, low, high) if isinstance(ground, Ground) else None


def find_box_edges(box: tuple[Array, Array], low: Array, high: Array) -> Array:
    """Find the visible edges (k, 2, 3) of a box.

    The box has two corners (3,). Sides at infinity are omitted. Edges that lead there end outside
    the view, which is the box from `low` to `high`.
    """
    reach = float((high - low).max())
    near, far = np.maximum(box[0], low - reach), np.minimum(box[1], high + reach)
    finite = np.isfinite(np.array(box))
    edges = []
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for sides in np.ndindex(2, 2):
            if any(finite[side, other] for side, other in zip(sides, others, strict=True)):
                ends = np.stack([near, far])
                ends[:, others] = [(near, far)[s][o] for s, o in zip(sides, others, strict=True)]
                edges.append(ends)
    return np.array(edges).reshape(-1, 2, 3)


def _cut_plane(ground: Ground, low: Array, high: Array) -> GroundPatch | None:
    normal, center = np.array(ground.normal), (low + high) / 2
    level = np.cross((0.0, 0.0, 1.0), normal)
    if np.linalg.norm(level) > 1e-12:  # one direction level, the other one up the slope
        across = np.array([level, np.cross(normal, level)]) / np.linalg.norm(level)
    else:
        across = np.eye(3)[:2] if normal[2] > 0 else null_space(normal[None]).T
    reach = float(np.linalg.norm(high - low))
    origin = ground.height * normal
    middle = across @ (center - origin)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * reach + middle
    polygon = origin + square @ across
    for axis in range(3):
        for sign, limit in ((1, low[axis]), (-1, high[axis])):
            polygon = _cut_polygon(polygon, sign * (polygon[:, axis] - limit))
    if len(polygon) < 3:
        return None
    fan = np.arange(1, len(polygon) - 1)
    faces = np.column_stack([np.zeros_like(fan), fan, fan + 1])
    corners = polygon[faces[0]]
    if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ normal < 0:
        faces = faces[:, ::-1]
    spacing = grid_spacing(float((high - low).max()))
    lines = []
    for axis in (0, 1):
        first, last = (middle[axis] - reach) / spacing, (middle[axis] + reach) / spacing
        for k in np.arange(np.ceil(first), last):
            ends = np.full((2, 2), k * spacing)
            ends[:, 1 - axis] = middle[1 - axis] + np.array([-reach, reach])
            lines.append(origin + ends @ across)
    return GroundPatch(polygon, faces, cut_lines(np.array(lines), low, high))


def _cut_polygon(polygon: Array, inside: Array) -> Array:
    """Clip a polygon (k, 3) to where a linear function is not negative.

    `inside` (k,) are the function's values at the corners. This is a step of the algorithm of
    Sutherland and Hodgman.
    """
    kept: list[Array] = []
    for k, (corner, value) in enumerate(zip(polygon, inside, strict=True)):
        before, previous = polygon[k - 1], inside[k - 1]
        if (value < 0) != (previous < 0):
            kept.append(before + (corner - before) * previous / (previous - value))
        if value >= 0:
            kept.append(corner)
    return np.array(kept).reshape(-1, 3)


def cut_lines(lines: Array, low: Array, high: Array) -> Array:
    """Clip lines (k, 2, 3) to a box by the slab method.

    The corners of the box are `low` and `high` (3,).
    """
    start, along = lines[:, 0], lines[:, 1] - lines[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = np.stack([(low - start) / along, (high - start) / along])
    parallel = np.abs(along) < 1e-12
    slabs[:, parallel] = np.array([-np.inf, np.inf])[:, None]
    outside = (parallel & ((start < low - 1e-9) | (start > high + 1e-9))).any(axis=1)
    enter = np.maximum(slabs.min(axis=0).max(axis=1), 0.0)
    leave = np.minimum(slabs.max(axis=0).min(axis=1), 1.0)
    kept = ~outside & (enter < leave)
    ends = np.stack([enter, leave], axis=1)[kept, :, None]
    return np.asarray(start[kept, None] + ends * along[kept, None])


def _cut_terrain(ground: Terrain, low: Array, high: Array) -> GroundPatch:
    points = _terrain_grid(ground, low, high)
    count = points.shape[:2]
    a = (np.arange(count[0] - 1)[:, None] * count[1] + np.arange(count[1] - 1)).ravel()
    b, c, d = a + count[1], a + count[1] + 1, a + 1
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    spacing = grid_spacing(float((high - low).max()))
    lines = []
    for axis, rows in enumerate((points, points.swapaxes(0, 1))):
        steps = rows[:, 0, axis] / spacing
        rows = rows[np.abs(steps - np.round(steps)) < 1e-9]
        lines.append(np.stack([rows[:, :-1], rows[:, 1:]], axis=2).reshape(-1, 2, 3))
    return GroundPatch(points.reshape(-1, 3), faces, np.concatenate(lines))


def _terrain_grid(ground: Terrain, low: Array, high: Array) -> Array:
    """Evaluate points (k, l, 3) of a height field over a box [m].

    The corners of the box are `low` and `high` (3,) [m]. The points lie on the grid lines, halfway
    between them, and on the border of the box. Beyond its own grid the height is constant.
    """
    half = grid_spacing(float((high - low).max())) / 2
    x, y = (
        np.unique(
            np.clip(
                half * np.arange(np.floor(low[axis] / half), np.ceil(high[axis] / half) + 1),
                low[axis],
                high[axis],
            )
        )
        for axis in (0, 1)
    )
    knots = [
        np.linspace(first, last, count)
        for first, last, count in zip(ground.lower, ground.upper, ground.heights.shape, strict=True)
    ]
    along_x = np.array([np.interp(x, knots[0], column) for column in ground.heights.T])
    heights = np.array([np.interp(y, knots[1], row) for row in along_x.T])
    return np.stack([*np.broadcast_arrays(x[:, None], y[None]), heights], axis=2)
