"""Geometric shapes of a structure at one time.

They are members, nodes, supports and force arrows.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.hulls import find_hulls
from tenscasadi.drawing.style import STYLE, Bytes, Rgb
from tenscasadi.drawing.view_content import Frame, NodeForces, ViewContent
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import Array, Indices

PARTS = ("bars", "strings", "nodes", "supports")  # of a motion, in the order of their shapes
# kinds of forces on nodes, with their names in legends
FORCES = {"load": "loads", "contact": "contact forces", "reaction": "reactions"}


class DrawnShape(NamedTuple):
    """Several copies of one geometric form.

    Attributes
    ----------
    form : {"member", "ball", "cone", "arrow", "face"}
        Form of each copy.
    points : ndarray, shape (m, 3, 3), (m, 2, 3) or (m, 3)
        Corners of faces, ends of members and arrows, centers of balls, tips of cones [m].
    radius : ndarray, shape (m,)
        Radii [m].
    colors : ndarray of uint8, shape (m, 3)
        Colors, sRGB.
    """

    form: Literal["member", "ball", "cone", "arrow", "face"]
    points: Array
    radius: Array
    colors: Bytes


class MotionShapes:
    """Geometric shapes of one trajectory in a picture.

    Parameters
    ----------
    content : ViewContent
        Content of the picture.
    index : int
        Index of the motion.
    tint : Rgb, optional
        Color of all shapes. Default: colors by kind.

    Attributes
    ----------
    reach : float
        Length of an arrow of the force `force_scale` [m]; others are at most twice as long.
    """

    def __init__(self, content: ViewContent, index: int = 0, tint: Rgb | None = None) -> None:
        self.motion, self.tint = content.motions[index], tint
        self.radius, self.least = content.bar_radius, content.least_radius
        extent = measure_extent(self.motion.nodes[0])
        self.reach = STYLE.arrow_length * (extent if 0 < extent < np.inf else content.size)
        self._scales: dict[str, float] = {}
        offsets = self.motion.count("nodes") * np.arange(self.motion.copies)
        hulls = [hull + offset for offset in offsets for hull in find_hulls(self.motion.structure)]
        self.hulls: list[Indices] = [hull for hull in hulls if len(hull)]
        count = self.motion.nodes.shape[1]
        ends, meeting = np.unique(self.motion.bars, return_counts=True)
        self.joints: Indices = ends[meeting > 1]
        self._node_colors = _fill(STYLE.node if tint is None else tint, count)
        self._node_radius = np.full(count, 0.8 * self.radius)
        self._node_radius[ends] = 1.15 * self.radius
        self._node_radius[self.joints] = 1.5 * self.radius
        if tint is None:
            self._node_colors[self.joints] = STYLE.joint

    def build(
        self,
        frame: Frame,
        scale: ColorScale | None = None,
        kinds: Iterable[str] = ("load", "contact"),
    ) -> list[DrawnShape]:
        """Build the shapes of members, nodes, supports and forces.

        They are those of a frame. Forces are arrows of the given kinds; rigid bodies have faces.
        Strings are colored by the quantity of the scale; slack strings are thin, and broken
        strings, whose tension is NaN, have no width.
        """
        motion, radius, tint = self.motion, self.radius, self.tint
        nodes, values = frame.nodes, None if scale is None else frame.values(scale.quantity)
        count = len(motion.strings)
        known = frame.tension if values is None else values
        broken = np.zeros(count, dtype=bool) if known is None else np.isnan(known)
        taut = np.ones(count) if values is None else np.where(values != 0, 1.0, 0.5)
        if tint is not None or values is None or scale is None:
            colors = _fill(STYLE.slack if tint is None else tint, count)
        else:
            colors = scale.colors(np.nan_to_num(values))
        visible = np.maximum(STYLE.string_radius * radius * taut, self.least)
        strings = np.where(broken, 0.0, visible)
        bars = _fill(STYLE.bar if tint is None else tint, len(motion.bars))
        supports = _fill(STYLE.support if tint is None else tint, len(motion.pinned))
        pins = np.full(len(motion.pinned), 2.2 * radius)
        return [
            DrawnShape("member", nodes[motion.bars], np.full(len(motion.bars), radius), bars),
            DrawnShape("member", nodes[motion.strings], strings, colors),
            DrawnShape("ball", nodes, self._node_radius, self._node_colors),
            DrawnShape("cone", nodes[motion.pinned], pins, supports),
            *self._build_arrows(frame, kinds),
            *self._build_faces(nodes),
        ]

    def _build_faces(self, nodes: Array) -> list[DrawnShape]:
        """Build the faces of rigid bodies, one shape for each body.

        `nodes` (n, 3) are the positions of nodes [m].
        """
        color = STYLE.body if self.tint is None else self.tint
        return [
            DrawnShape("face", nodes[hull], np.zeros(len(hull)), _fill(color, len(hull)))
            for hull in self.hulls
        ]

    def _build_arrows(self, frame: Frame, kinds: Iterable[str]) -> list[DrawnShape]:
        """Build the arrows of forces, one shape for each kind.

        The forces are those in a frame. Kinds that are not wanted have no arrows.
        """
        found = []
        for forces in self.motion.forces:
            vectors = np.zeros((0, 3))
            if forces.name in kinds:
                unit = self.reach / (self.force_scale(forces) or 1.0)
                vectors = unit * np.nan_to_num(forces.at(frame))
            lengths = np.linalg.norm(vectors, axis=1)
            shown = np.flatnonzero(lengths > 0.02 * self.reach)
            factors = np.minimum(1.0, 2 * self.reach / lengths[shown])[:, None]
            tails = frame.nodes[shown]
            ends = np.stack([tails, tails + factors * vectors[shown]], axis=1)
            colors = _fill(getattr(STYLE, forces.name), len(shown))
            found.append(DrawnShape("arrow", ends, np.full(len(shown), 0.5 * self.radius), colors))
        return found

    def force_scale(self, forces: NodeForces) -> float:
        """Compute the force that an arrow of length `reach` shows [N].

        It is a quantile over the trajectory, so that an impact does not shrink all other arrows.
        """
        if forces.name not in self._scales:
            count = len(self.motion.time)
            rows = np.unique(np.linspace(0, count - 1, min(count, 50)).astype(int))
            frames = [self.motion.frame_at(self.motion.time[row]) for row in rows]
            sizes = np.linalg.norm([forces.at(frame) for frame in frames], axis=2)
            sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
            scale = float(np.quantile(sizes, STYLE.saturation)) if sizes.size else 0.0
            self._scales[forces.name] = scale
        return self._scales[forces.name]


def _fill(color: Rgb, count: int) -> Bytes:
    return np.tile(np.array(color, dtype=np.uint8), (count, 1))


def choose_tint(content: ViewContent, index: int) -> Rgb | None:
    """Choose one color for a trajectory of a picture.

    `index` is the number of the trajectory. Returns None for a trajectory whose members are colored
    by their forces. This is the first one, unless it consists of copies.
    """
    opaque = content.motions[0].copies == 1
    if index == 0 and opaque:
        return None
    return STYLE.curves[(index - opaque) % len(STYLE.curves)]
