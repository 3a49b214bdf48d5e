"""3-D axes of matplotlib for structures.

All axes have the same scale. Members are sorted by depth, so that near ones cover far ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, log10
from typing import Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.meshes import build_ball
from tenscasadi.drawing.scenery import cut_ground, cut_lines, find_box_edges, find_view
from tenscasadi.drawing.shapes import DrawnShape
from tenscasadi.drawing.style import STYLE, Rgb, interpolate_colors
from tenscasadi.drawing.view_content import ViewContent
from tenscasadi.util.validate import Array

_PIECES = 9  # of each member, so that two crossing ones are sorted where they cross


class Canvas3D:
    """3-D axes of matplotlib for one picture.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure that holds the axes.
    content : ViewContent
        Content, whose surroundings are drawn at once.
    place : tuple of float
        Left, bottom, width and height of the axes, relative to the figure.
    """

    def __init__(
        self,
        figure: Figure,
        content: ViewContent,
        place: tuple[float, float, float, float] = (0.05, 0.05, 0.9, 0.82),
    ) -> None:
        self.figure = figure
        self.axes: Any = cast(Any, figure).add_axes(place, projection="3d", computed_zorder=False)
        self._drawn: list[Any] = []
        low, high = content.corners
        inches = np.array(place[2:]) / [0.9, 0.82] * figure.get_size_inches()
        self._points_per_meter = 36 * inches.min() / (high - low).max()
        thin = np.flatnonzero(high - low < 0.05 * (high - low).max())
        broadside = {0: (12, -20), 1: (12, -72), 2: (62, -80)}
        elevation, azimuth = broadside[int(thin[0])] if len(thin) else (18, -62)
        self.axes.view_init(elev=elevation, azim=azimuth)
        center, self._half = self._set_limits(*find_view(content, margin=0.0))
        self._add_surroundings(content, center - self._half, center + self._half)

    def draw(self, shapes: Iterable[DrawnShape]) -> None:
        """Draw shapes in place of the present ones."""
        for artist in self._drawn:
            artist.remove()
        self._drawn = []
        shapes = [shape for shape in shapes if len(shape.points)]
        self._draw_lines([shape for shape in shapes if shape.form in ("member", "ball")])
        for shape in shapes:
            if shape.form == "cone":
                sizes = (2 * self._points_per_meter * shape.radius) ** 2
                options = {"marker": "^", "depthshade": False, "clip_on": False, "zorder": 4}
                marks = self.axes.scatter(*shape.points.T, s=sizes, c=shape.colors / 255, **options)
                self._drawn.append(marks)
            elif shape.form == "face":
                shade = np.ones(len(shape.points))
                color = (shape.colors[0, 0], shape.colors[0, 1], shape.colors[0, 2])
                opacity = STYLE.body_opacity
                self._drawn.append(self._add_faces(shape.points, color, shade, opacity, zorder=2))
            elif shape.form == "arrow":
                tails, tips = shape.points.swapaxes(0, 1)
                color = shape.colors[0] / 255
                arrows = self.axes.quiver(
                    *tails.T, *(tips - tails).T, color=color, lw=1.5, zorder=5
                )
                self._drawn.append(arrows)

    def add_color_bar(self, scale: ColorScale) -> None:
        """Add the color bar of string forces.

        It shows the color `scale`.
        """
        ramp = interpolate_colors(STYLE.ramp, np.linspace(0, 1, 256)) / 255
        mapped = ScalarMappable(Normalize(0.0, scale.largest or 1.0), ListedColormap(ramp))
        exceeded = scale.highest > scale.largest
        self.add_bar(mapped, label=scale.label, extend="max" if exceeded else "neither")

    def add_bar(self, mapped: ScalarMappable, **options: Any) -> Any:
        """Add a color bar to the right of the axes.

        `mapped` contains matplotlib's color map and range of values.
        """
        place = cast(Any, self.figure).add_axes((0.86, 0.22, 0.025, 0.54))
        bar = self.figure.colorbar(mapped, cax=place, **options)
        backend: Any = FigureCanvasAgg(self.figure)
        extent = place.get_tightbbox(backend.get_renderer()).extents / self.figure.bbox.width
        left = min(0.86, 0.86 + 0.98 - extent[2])  # room for long numbers
        place.set_position((left, 0.22, 0.025, 0.54))
        self.axes.set_position((0.05, 0.05, left - 0.1, 0.82))
        return bar

    def fit(self) -> None:
        """Zoom and move the axes until they fill the figure with their labels.

        Call it last, once.
        """
        backend: Any = FigureCanvasAgg(self.figure)
        place, zoom, axes = self.axes.bbox.frozen(), 1.0, self.axes
        for _ in range(4):  # labels do not grow with the rest
            backend.draw()
            extents = [
                axis.get_tightbbox(backend.get_renderer()).extents
                for axis in (axes.xaxis, axes.yaxis, axes.zaxis)
            ]
            low, high = np.min(extents, axis=0)[:2], np.max(extents, axis=0)[2:]
            zoom *= min(place.width / (high[0] - low[0]), place.height / (high[1] - low[1]))
            shift = (place.p0 + place.p1) / 2 - (low + high) / 2
            x, y, *size = axes.get_position().bounds
            x, y = np.array([x, y]) + shift / self.figure.bbox.size
            axes.set_position((x, y, *size))
            axes.set_box_aspect(tuple(self._half), zoom=zoom)

    def label(self, nodes: Array, names: Sequence[str]) -> None:
        """Write the name of each node (n, 3) beside it, outward and up."""
        middle = nodes.mean(axis=0)
        reach = np.linalg.norm(nodes - middle, axis=1).max(initial=0.0)
        camera = self._camera_direction()
        up = np.array([0.0, 0.0, 1.0]) - camera[2] * camera
        for name, node in zip(names, nodes, strict=True):
            outward = (node - middle) / (np.linalg.norm(node - middle) or 1.0)
            place = node + 0.06 * reach * (outward + up / np.linalg.norm(up))
            halo = [withStroke(linewidth=2.5, foreground="white")]
            self.axes.text(
                *place, name, fontsize=9, ha="center", va="center", zorder=6, path_effects=halo
            )

    def _draw_lines(self, shapes: list[DrawnShape]) -> None:
        """Draw members (`shapes`), and balls as very short members with round ends."""
        if not shapes:
            return
        parts = []
        for shape in shapes:
            short = 1e-9 * self._half.max() * np.array([[-1.0], [1.0]])
            ends = shape.points if shape.form == "member" else shape.points[:, None] + short
            cuts = np.linspace(0, 1, (_PIECES if shape.form == "member" else 1) + 1)[:, None]
            points = ends[:, None, 0] + cuts * (ends[:, None, 1] - ends[:, None, 0])
            pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2)
            radius = shape.radius  # 0 of broken strings
            widths = np.where(radius > 0, np.maximum(2 * self._points_per_meter * radius, 0.5), 0.0)
            count = pieces.shape[1]
            styles = np.repeat(np.column_stack([shape.colors / 255, widths]), count, axis=0)
            parts.append((pieces.reshape(-1, 2, 3), styles))
        pieces, styles = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.argsort(pieces.mean(axis=1) @ self._camera_direction(), kind="stable")
        lines = Line3DCollection(
            pieces[order],
            colors=styles[order, :3],
            linewidths=styles[order, 3],
            capstyle="round",
            clip_on=False,
            zorder=3,
        )
        self._drawn.append(self.axes.add_collection3d(lines))

    def _add_surroundings(self, content: ViewContent, low: Array, high: Array) -> None:
        light = np.array([-0.4, -0.5, 0.77])
        for ground in content.grounds:
            patch = cut_ground(ground, low, high)
            if patch is None:
                continue
            corners = patch.vertices[patch.faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            shade = 0.75 + 0.25 * np.abs(normals @ light)
            self._add_faces(corners, STYLE.ground, shade, opacity=0.75, zorder=1)
            self._add_lines(patch.lines, STYLE.grid, width=0.4)
        ball = build_ball(12, 20)
        for center, radius in content.obstacles:
            corners = (np.asarray(center) + radius * ball.vertices)[ball.faces]
            self._add_faces(corners, STYLE.obstacle, np.ones(len(corners)), opacity=0.15, zorder=2)
        for box in content.boxes:
            edges = cut_lines(find_box_edges(box, low, high), low, high)
            self._add_lines(edges, STYLE.obstacle, width=1.2)
        if len(content.targets):
            color = np.array(STYLE.target) / 255
            self.axes.scatter(
                *content.targets.T, s=70, marker="o", facecolor="none", edgecolor=color, zorder=5
            )

    def _add_faces(
        self, corners: Array, color: Rgb, shade: Array, opacity: float, zorder: int
    ) -> Any:
        colors = np.column_stack([np.outer(shade, color) / 255, np.full(len(corners), opacity)])
        faces = Poly3DCollection(
            corners, facecolors=colors, edgecolors="none", zorder=zorder, clip_on=False
        )
        return self.axes.add_collection3d(faces)

    def _add_lines(self, lines: Array, color: Rgb, width: float) -> None:
        if len(lines):
            drawn = Line3DCollection(
                lines, colors=[np.array(color) / 255], linewidths=width, clip_on=False, zorder=2
            )
            self.axes.add_collection3d(drawn)

    def _set_limits(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Set the limits and ticks of all axes.

        The corners of the picture are `low` and `high` (3,). Returns their center and half the
        extent of each.
        """
        size = float((high - low).max()) or 1.0
        half = np.maximum((high - low) / 2, 0.12 * size) + 0.04 * size
        self.axes.set_proj_type("ortho")
        self.axes.set_box_aspect(tuple(half))
        for name, center, reach in zip("xyz", (low + high) / 2, half, strict=True):
            axis = getattr(self.axes, f"{name}axis")
            getattr(self.axes, f"set_{name}lim")(center - reach, center + reach)
            getattr(self.axes, f"set_{name}label")(
                f"{name} (m)", labelpad=6 if name == "z" else 3, fontsize=9
            )
            ticks = round(4 * reach / half.max())
            if ticks > 1:
                axis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 5, 10]))
            else:  # no room for two; rounding about 0 is not shown as a number
                axis.set_ticks(
                    [tick := round(center, 1 - floor(log10(size))) + 0.0], labels=[f"{tick:g}"]
                )
            axis.set_tick_params(labelsize=8, pad=0)
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        return (low + high) / 2, half

    def _camera_direction(self) -> Array:
        elevation, azimuth = np.radians([self.axes.elev, self.axes.azim])
        level = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
        return np.array([*level, np.sin(elevation)])
