"""Shapes of a motion at one time: members, nodes, supports and arrows."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.style import STYLE, Bytes, Rgb
from tenscasadi.drawing.view_content import ViewContent
from tenscasadi.util.validate import Array, Indices


class Shape(NamedTuple):
    """Copies of one form.

    Attributes
    ----------
    form : {"member", "ball", "cone", "arrow"}
        Form of each copy.
    points : ndarray, shape (m, 2, 3) or (m, 3)
        Ends of members and arrows, centers of balls, tips of cones [m].
    radius : ndarray, shape (m,)
        Radii [m].
    colors : ndarray of uint8, shape (m, 3)
        Colors, sRGB.
    """

    form: Literal["member", "ball", "cone", "arrow"]
    points: Array
    radius: Array
    colors: Bytes


class MotionShapes:
    """Shapes of one motion of a picture.

    Parameters
    ----------
    content : ViewContent
        Content of the picture.
    index : int
        Index of the motion.
    tint : Rgb, optional
        Color of all shapes. Default: colors by kind.
    """

    def __init__(self, content: ViewContent, index: int = 0, tint: Rgb | None = None) -> None:
        self.motion, self.tint = content.motions[index], tint
        self.radius = content.bar_radius
        self._reach = STYLE.arrow_length * content.size
        count = self.motion.nodes.shape[1]
        ends, meeting = np.unique(self.motion.bars, return_counts=True)
        self.joints: Indices = ends[meeting > 1]
        self._node_colors = _fill(STYLE.node if tint is None else tint, count)
        self._node_radius = np.full(count, 0.8 * self.radius)
        self._node_radius[ends] = 1.15 * self.radius
        self._node_radius[self.joints] = 1.5 * self.radius
        if tint is None:
            self._node_colors[self.joints] = STYLE.joint
        self._largest = {forces.name: 0.0 for forces in self.motion.forces}

    def at_rest(self, nodes: Array, values: Array | None, scale: ColorScale | None) -> list[Shape]:
        """Build bars, strings, nodes and supports at positions (n, 3).

        `values` (α,) of the strings select their colors by `scale`; slack strings are thin.
        """
        motion, radius, tint = self.motion, self.radius, self.tint
        count = len(motion.strings)
        taut = np.ones(count) if values is None else np.where(np.nan_to_num(values) != 0, 1.0, 0.5)
        if tint is not None or values is None or scale is None:
            colors = _fill(STYLE.slack if tint is None else tint, count)
        else:
            colors = scale.colors(np.nan_to_num(values))
        bars = _fill(STYLE.bar if tint is None else tint, len(motion.bars))
        supports = _fill(STYLE.support if tint is None else tint, len(motion.pinned))
        pins = np.full(len(motion.pinned), 2.2 * radius)
        return [
            Shape("member", nodes[motion.bars], np.full(len(motion.bars), radius), bars),
            Shape("member", nodes[motion.strings], STYLE.string_radius * radius * taut, colors),
            Shape("ball", nodes, self._node_radius, self._node_colors),
            Shape("cone", nodes[motion.pinned], pins, supports),
        ]

    def arrows(self, name: str, nodes: Array, forces: Array) -> Shape:
        """Build arrows of forces (n, 3) [N] at positions (n, 3).

        The longest one so far has the length of the style; those below 1 % of it are left out.
        """
        sizes = np.linalg.norm(np.nan_to_num(forces), axis=1)
        self._largest[name] = largest = max(self._largest[name], float(sizes.max(initial=0.0)))
        shown = np.flatnonzero(sizes > 0.01 * largest)
        tips = nodes[shown] + forces[shown] * (self._reach / (largest or 1.0))
        ends = np.stack([nodes[shown], tips], axis=1)
        color = getattr(STYLE, name)
        return Shape("arrow", ends, np.full(len(shown), 0.5 * self.radius), _fill(color, len(ends)))


def _fill(color: Rgb, count: int) -> Bytes:
    return np.tile(np.array(color, dtype=np.uint8), (count, 1))


def choose_tint(content: ViewContent, index: int) -> Rgb | None:
    """Choose the color of a motion.

    Returns None if it is opaque and colored by its forces.

    The first motion is, unless it consists of copies.
    """
    opaque = content.motions[0].copies == 1
    if index == 0 and opaque:
        return None
    return STYLE.curves[(index - opaque) % len(STYLE.curves)]
