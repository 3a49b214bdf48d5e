"""Things that stand still beside a motion: grounds with a grid, obstacles, boxes that nodes stay in, and targets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import null_space

from tenscasadi.scene.ground import Ground, Surface, Terrain
from tenscasadi.util.validate import Array
from tenscasadi.viewer.colours import GROUND, OBSTACLE, TARGET, Rgb, linear
from tenscasadi.viewer.poses import ball

if TYPE_CHECKING:
    import viser

_FINER = 2  # cells of a height field between two lines of its grid
_GRID: Rgb = (180, 174, 159)


def grid_spacing(size: float) -> float:
    """Return 1, 2 or 5 times a power of ten, m, about a tenth of `size`."""
    power = 10.0 ** np.floor(np.log10(size / 10))
    return float(power * max(step for step in (1, 2, 5) if step * power <= size / 10 * (1 + 1e-9)))


def add_grounds(
    scene: viser.SceneApi, name: str, grounds: tuple[Surface, ...], low: Array, high: Array
) -> None:
    """Add what of the grounds lies under the box of a motion, and around it."""
    centre = (low + high) / 2
    reach = 1.2 * float((high - low).max())
    for k, ground in enumerate(grounds):
        if isinstance(ground, Terrain):
            points, faces = _field(ground, centre, reach)
            _surface(scene, f"{name}/{k}", points.reshape(-1, 3), faces)
            _lines(
                scene,
                f"{name}/{k}/grid",
                np.concatenate(
                    [_pairs(points[::_FINER]), _pairs(points[:, ::_FINER].swapaxes(0, 1))]
                ),
                reach,
            )
        elif isinstance(ground, Ground):
            corners, lines = _plane(ground, centre, reach)
            _surface(scene, f"{name}/{k}", corners, np.array([(0, 1, 2), (0, 2, 3)]))
            _lines(scene, f"{name}/{k}/grid", lines, reach)


def add_obstacles(
    scene: viser.SceneApi, name: str, obstacles: tuple[tuple[Any, float], ...]
) -> None:
    """Add balls of (centre, radius)."""
    for k, (centre, radius) in enumerate(obstacles):
        scene.add_icosphere(
            f"{name}/{k}",
            radius=float(radius),
            color=OBSTACLE,
            position=np.asarray(centre, dtype=float),
            opacity=0.6,
            subdivisions=3,
            material="toon5",
            cast_shadow=False,
        )


def add_boxes(
    scene: viser.SceneApi,
    name: str,
    boxes: tuple[tuple[Array, Array], ...],
    low: Array,
    high: Array,
) -> None:
    """Add the edges of boxes between two corners; sides at infinity are left out of the view."""
    reach = float((high - low).max())
    for k, (least, most) in enumerate(boxes):
        near, far = np.maximum(least, low - reach), np.minimum(most, high + reach)
        corners = np.array(
            [[(near, far)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
        )
        edges = [(i, i | 1 << axis) for i in range(8) for axis in range(3) if not i >> axis & 1]
        known = np.isfinite(np.array([least, most]))
        kept = [edge for edge in edges if _finite_edge(edge, known)]
        if kept:
            scene.add_line_segments(
                f"{name}/{k}",
                corners[np.array(kept)],
                OBSTACLE,
                thickness=2.0,
                thickness_units="screen",
            )


def add_targets(scene: viser.SceneApi, name: str, targets: Array, radius: float) -> None:
    """Add small balls where a plan wants nodes to be, (k, 3)."""
    if len(targets):
        mesh, still = ball(), np.tile([1.0, 0.0, 0.0, 0.0], (len(targets), 1))
        scene.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            still,
            targets,
            batched_scales=np.full((len(targets), 3), 2.5 * radius),
            batched_colors=linear(TARGET),
            opacity=0.45,
            lod="off",
            material="toon5",
            cast_shadow=False,
            receive_shadow=False,
        )


def _finite_edge(edge: tuple[int, int], known: Any) -> bool:
    """Return whether an edge lies on a side that is there."""
    first, second = edge
    along = (first ^ second).bit_length() - 1
    return any(known[first >> axis & 1, axis] for axis in range(3) if axis != along)


def _surface(scene: viser.SceneApi, name: str, vertices: Array, faces: Any) -> None:
    scene.add_mesh_simple(
        name,
        vertices,
        faces,
        color=GROUND,
        opacity=0.85,
        side="double",
        material="toon5",
        cast_shadow=False,
        receive_shadow=False,
    )


def _lines(scene: viser.SceneApi, name: str, lines: Array, reach: float) -> None:
    lifted = lines + 1e-3 * reach * np.array(
        [0.0, 0.0, 1.0]
    )  # else the surface covers them in places
    scene.add_line_segments(name, lifted, _GRID, thickness=1.0, thickness_units="screen")


def _plane(ground: Ground, centre: Array, reach: float) -> tuple[Array, Array]:
    """Return the corners (4, 3) of a square of the plane below `centre`, and the lines (k, 2, 3) of its grid."""
    normal = np.array(ground.normal)
    across = np.eye(3)[:2] if abs(normal[2]) > 1 - 1e-12 else null_space(normal[None]).T
    if abs(normal[2]) <= 1 - 1e-12:  # one direction level, the other up the slope
        level = np.cross((0.0, 0.0, 1.0), normal)
        across = np.array([level, np.cross(normal, level)]) / np.linalg.norm(level)
    foot = ground.height * normal
    middle = across @ (centre - foot)
    spacing = grid_spacing(reach)
    first, last = np.floor((middle - reach) / spacing), np.ceil((middle + reach) / spacing)
    lines = []
    for axis in (0, 1):
        for k in np.arange(first[axis], last[axis] + 1):
            ends = np.full((2, 2), k * spacing)
            ends[:, 1 - axis] = spacing * first[1 - axis], spacing * last[1 - axis]
            lines.append(foot + ends @ across)
    (a, c), (b, d) = spacing * first, spacing * last
    corners = np.array([(a, c), (b, c), (b, d), (a, d)])
    return foot + corners @ across, np.array(lines)


def _field(ground: Terrain, centre: Array, reach: float) -> tuple[Array, Any]:
    """Return points (k, l, 3) of a height field around `centre` and triangles between them; every `_FINER`-th point is on a line of the grid."""
    spacing = grid_spacing(reach)
    first, last = np.floor((centre[:2] - reach) / spacing), np.ceil((centre[:2] + reach) / spacing)
    x, y = (
        spacing / _FINER * np.arange(_FINER * low, _FINER * high + 1)
        for low, high in zip(first, last, strict=True)
    )
    grid = [
        np.linspace(low, high, count)
        for low, high, count in zip(ground.lower, ground.upper, ground.heights.shape, strict=True)
    ]
    along_x = np.array(
        [np.interp(x, grid[0], column) for column in ground.heights.T]
    )  # beyond the grid it goes on as it ends
    heights = np.array([np.interp(y, grid[1], row) for row in along_x.T])
    points = np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), heights], axis=2)
    a = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)).ravel()
    b, c, d = a + len(y), a + len(y) + 1, a + 1
    return points, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _pairs(rows: Array) -> Array:
    """Return the lines (k, 2, 3) along rows (m, l, 3) of points."""
    return np.stack([rows[:, :-1], rows[:, 1:]], axis=2).reshape(-1, 2, 3)
