"""A 3-D drawing of bars and strings: equal scales, members sorted by depth so that near ones cover far ones."""

from __future__ import annotations

from math import floor, log10
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from tenscasadi.plots.ground3d import draw_grounds, include_heights
from tenscasadi.scene.ground import Grounds, checked_grounds
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, instance

BAR = "#39424e"
SLACK = "#b9bec5"
PUSHING = "#1b9e77"
_PIN = "#c0392b"
_PIECES = 9  # of each member: two that pass each other are then sorted where they do
_FLAT = 0.05  # of the largest extent: what is thinner is seen from its broad side


class Members(NamedTuple):
    """Which nodes are joined by bars (β, 2) and strings (α, 2), and which are pinned."""

    bars: Indices
    strings: Indices
    pinned: Indices


class Layer(NamedTuple):
    """One configuration: nodes (n, 3), m, and a colour each for bars and strings: one for all or (members, 4). `width` scales the lines."""

    nodes: Array
    bar_colour: Any = BAR
    string_colour: Any = SLACK
    width: float = 1.0


class Canvas:
    """3-D axes in `figure` that hold all `points` (…, 3), m, in one scale, and grounds; `draw` replaces what they show of the structure."""

    def __init__(
        self, figure: Figure, members: Members, points: Array, ground: Grounds = None
    ) -> None:
        grounds = checked_grounds(ground, "ground")
        self.members = members
        self.figure = figure
        self.axes: Any = cast(Any, figure).add_axes(
            (0.05, 0.05, 0.9, 0.82), projection="3d", computed_zorder=False
        )
        self._loose = np.setdiff1d(np.arange(points.shape[-2]), members.bars)
        self._shown: list[Any] = []
        crowd = 12 / max(12.0, len(members.bars), len(members.strings) / 3)
        self._bar_width, self._string_width = 1 + 3.5 * crowd, 0.5 + crowd
        points = points.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        thin = np.flatnonzero(high - low < _FLAT * (high - low).max())
        elevation, azimuth = (
            {0: (12, -20), 1: (12, -72), 2: (62, -80)}[int(thin[0])] if len(thin) else (18, -62)
        )
        self.axes.view_init(elev=elevation, azim=azimuth)
        centre, self._half = self._limit(*include_heights(grounds, low, high))
        draw_grounds(self.axes, grounds, centre - self._half, centre + self._half)

    def draw(self, *layers: Layer) -> None:
        """Show these configurations, all sorted by depth; pinned nodes are marked in the last."""
        for artist in self._shown:
            artist.remove()
        self._shown = []
        parts = [self._pieces(layer) for layer in layers]
        ends, colours, widths = (np.concatenate([part[k] for part in parts]) for k in range(3))
        if len(ends):
            order = np.argsort(ends.mean(axis=1) @ self._toward_camera(), kind="stable")
            lines = Line3DCollection(
                ends[order],
                colors=colours[order],
                linewidths=widths[order],
                capstyle="round",
                clip_on=False,
                zorder=3,
            )
            self._shown.append(self.axes.add_collection3d(lines))
        last = layers[-1]
        self._mark(
            last.nodes[self._loose],
            marker="o",
            s=4 * (1 + self._string_width) ** 2,
            color=last.bar_colour,
            zorder=3,
        )
        self._mark(last.nodes[self.members.pinned], marker="^", s=55, color=_PIN, zorder=4)

    def colour_bar(self, scale: ScalarMappable, label: str, **options: Any) -> Any:
        """Add a bar of the scale's colours to the right of the axes."""
        self.axes.set_position((0.05, 0.05, 0.76, 0.82))
        return self.figure.colorbar(
            scale, cax=self.figure.add_axes((0.86, 0.22, 0.025, 0.54)), label=label, **options
        )

    def fit(self) -> None:
        """Zoom and move so that the axes with their labels just fill their place. Call it last, once."""
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
            off = (place.p0 + place.p1) / 2 - (low + high) / 2
            x, y, width, height = axes.get_position().bounds
            axes.set_position(
                (
                    x + off[0] / self.figure.bbox.width,
                    y + off[1] / self.figure.bbox.height,
                    width,
                    height,
                )
            )
            axes.set_box_aspect(tuple(self._half), zoom=zoom)

    def number(self, nodes: Array) -> None:
        """Write each node's index beside it, outwards and up."""
        reach = np.linalg.norm(nodes - nodes.mean(axis=0), axis=1).max(initial=0.0)
        toward = self._toward_camera()
        up = np.array([0.0, 0.0, 1.0]) - toward[2] * toward
        for index, node in enumerate(nodes):
            outward = node - nodes.mean(axis=0)
            place = node + 0.06 * reach * (
                outward / (np.linalg.norm(outward) or 1.0) + up / np.linalg.norm(up)
            )
            halo = [withStroke(linewidth=2.5, foreground="white")]
            self.axes.text(
                *place,
                str(index),
                fontsize=9,
                ha="center",
                va="center",
                zorder=5,
                path_effects=halo,
            )

    def _mark(self, places: Array, **style: Any) -> None:
        if len(places):
            self._shown.append(
                self.axes.scatter(*places.T, depthshade=False, clip_on=False, **style)
            )

    def _limit(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Set the limits and ticks of all axes; return their centre and half the extent of each."""
        size = float((high - low).max()) or 1.0
        half = np.maximum((high - low) / 2, 0.12 * size) + 0.04 * size
        self.axes.set_proj_type("ortho")
        self.axes.set_box_aspect(tuple(half))
        for name, centre, reach in zip("xyz", (low + high) / 2, half, strict=True):
            axis = getattr(self.axes, f"{name}axis")
            getattr(self.axes, f"set_{name}lim")(centre - reach, centre + reach)
            getattr(self.axes, f"set_{name}label")(
                f"{name} (m)", labelpad=6 if name == "z" else 3, fontsize=9
            )
            ticks = round(4 * reach / half.max())
            if ticks > 1:
                axis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 5, 10]))
            else:  # no room for two; rounding about 0 is not shown as a number
                axis.set_ticks(
                    [tick := round(centre, 1 - floor(log10(size))) + 0.0], labels=[f"{tick:g}"]
                )
            axis.set_tick_params(labelsize=8, pad=0)
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        return (low + high) / 2, half

    def _toward_camera(self) -> Array:
        elevation, azimuth = np.radians([self.axes.elev, self.axes.azim])
        return np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )

    def _pieces(self, layer: Layer) -> tuple[Array, Array, Array]:
        """Return ends (p, 2, 3), colours (p, 4) and widths (p,) of the pieces that members are drawn in."""
        strings, bars = self.members.strings, self.members.bars
        first, second = (
            layer.nodes[np.concatenate([strings[:, end], bars[:, end]])] for end in (0, 1)
        )
        cuts = np.linspace(0, 1, _PIECES + 1)[None, :, None]
        points = first[:, None] + cuts * (second - first)[:, None]
        ends = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
        colours = np.concatenate(
            [
                _per_member(layer.string_colour, len(strings)),
                _per_member(layer.bar_colour, len(bars)),
            ]
        )
        widths = layer.width * np.repeat(
            [self._string_width, self._bar_width], [len(strings), len(bars)]
        )
        return ends, np.repeat(colours, _PIECES, axis=0), np.repeat(widths, _PIECES)


def members_of(what: Structure | Trajectory) -> Members:
    """Return the members of a structure or trajectory, as a `Canvas` draws them."""
    pinned: Indices = (
        what.pinned
        if isinstance(what, Trajectory)
        else np.array(sorted({*what.pinned, *what.rollers}), dtype=np.intp)
    )
    return Members(what.bars, what.strings, pinned)


def check_drawable(
    field: str,
    value: Any,
    kinds: type | tuple[type, ...] = Trajectory,
    example: str = "a tenscasadi.Trajectory",
) -> None:
    """Raise TypeError unless `value` is one of `kinds`; where a part of it is, as of a plan, the message names the part."""
    parts = [
        name
        for name in ("trajectory", "structure")
        if isinstance(getattr(value, name, None), kinds)
    ]
    if "trajectory" in parts and hasattr(value, "replay"):
        parts.insert(0, "replay()")
    instance(field, value, kinds, f"its {' or '.join(parts)}" if parts else example)


def cut_colours(name: str, start: float, stop: float) -> Colormap:
    """Return the colours of a named map from `start` to `stop`: the ends of many are hard to see on white."""
    return LinearSegmentedColormap.from_list(
        name, mpl.colormaps[name](np.linspace(start, stop, 64))
    )


def tension_scale(largest: float) -> ScalarMappable:
    """Return the scale of colours from cold, 0 N, to hot, `largest` N."""
    return ScalarMappable(
        Normalize(0.0, largest if largest > 0 else 1.0), cut_colours("plasma", 0.0, 0.86)
    )


def tension_colours(scale: ScalarMappable, tension: Array) -> Array:
    """Return the scale's colours (α, 4) of tensions (α,), N; slack strings are grey, those that push green."""
    colours = np.array(scale.to_rgba(tension), dtype=float).reshape(-1, 4)
    colours[tension <= 0] = to_rgba_array(SLACK)[0]
    colours[tension < 0] = to_rgba_array(PUSHING)[0]
    return colours


def tension_label(tension: Array) -> str:
    """Return the label of the scale for tensions, N: which of the colours beside it are seen, and how hard strings push."""
    told = ["tension (N)"]
    if np.any(tension == 0):
        told.append("grey: slack")
    if np.any(tension < 0):
        told.append(f"green: pushing, up to {-tension.min():.3g} N")
    return "; ".join(told)


def _per_member(colour: Any, count: int) -> Array:
    return np.broadcast_to(to_rgba_array(colour), (count, 4))
