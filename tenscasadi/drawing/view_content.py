"""Content of a picture: trajectories, grounds, and curves over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.drawing.style import STYLE
from tenscasadi.structure.class_one import distances, measure_extent
from tenscasadi.structure.structure import Structure
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array, Indices

MOST_FRAMES = 3000  # of a page or a film


class Frame(NamedTuple):
    """State of a structure at one time, for drawing.

    Attributes
    ----------
    nodes : ndarray, shape (n, 3)
        Positions [m].
    velocities : ndarray, shape (n, 3), or None
        Velocities [m/s].
    tension, force_density : ndarray, shape (α,), or None
        Forces [N] and force densities [N/m] of the strings.
    time : float
        Time [s].
    row : int
        Row of the motion at or before this time.
    """

    nodes: Array
    velocities: Array | None = None
    tension: Array | None = None
    force_density: Array | None = None
    time: float = 0.0
    row: int = 0

    def values(self, quantity: str) -> Array | None:
        """Select a quantity of the strings: "tension" or "force density".

        Returns None if it is not known.
        """
        return self.tension if quantity == "tension" else self.force_density


class NodeForces(NamedTuple):
    """Forces of one kind on the nodes of a structure, for drawing.

    Attributes
    ----------
    name : {"load", "contact", "reaction"}
        Kind of force, which selects its color.
    at : callable
        Computes the forces (n, 3) [N] in a frame of the motion.
    """

    name: str
    at: Callable[[Frame], Array]


def list_names(structure: Structure | None, kind: str, count: int) -> tuple[str, ...]:
    """List the names of `count` items of a kind, "node", "bar" or "string".

    Unnamed ones are called by their index, such as "node 3".
    """
    given = () if structure is None else getattr(structure, f"{kind}_names")
    return tuple((given[k] if k < len(given) else "") or f"{kind} {k}" for k in range(count))


@dataclass(frozen=True, eq=False)
class Motion:
    """Trajectory of a structure's nodes and forces, for drawing.

    Attributes
    ----------
    name : str
        Name in legends.
    time : ndarray, shape (T,)
        Times [s].
    nodes : ndarray, shape (T, n, 3)
        Positions [m].
    bars, strings : ndarray of int, shape (β, 2) and (α, 2)
        Nodes at the ends of each member.
    pinned : ndarray of int
        Nodes with supports.
    velocities : ndarray, shape (T, n, 3), optional
        Velocities [m/s] for the interpolation between rows. Default: linear.
    tension, force_density : ndarray, shape (T, α), optional
        Forces [N] and force densities [N/m] of the strings; NaN for broken strings.
    copies : int
        Number of equal structures in the arrays.
    forces : tuple of NodeForces
        Forces that are drawn as arrows.
    structure : Structure, optional
        Structure that names the items of each copy.
    """

    name: str
    time: Array
    nodes: Array
    bars: Indices
    strings: Indices
    pinned: Indices
    velocities: Array | None = None
    tension: Array | None = None
    force_density: Array | None = None
    copies: int = 1
    forces: tuple[NodeForces, ...] = ()
    structure: Structure | None = None

    def count(self, kind: str) -> int:
        """Count the items of a kind in one copy.

        The kind is "nodes", "bars" or "strings".
        """
        whole = self.nodes.shape[1] if kind == "nodes" else len(getattr(self, kind))
        return whole // self.copies

    @cached_property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Names of the "nodes", "bars" and "strings" of one copy."""
        kinds = ("nodes", "bars", "strings")
        return {kind: list_names(self.structure, kind[:-1], self.count(kind)) for kind in kinds}

    @property
    def start(self) -> float:
        """First time [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Last time [s]."""
        return float(self.time[-1])

    def row_at(self, time: float) -> int:
        """Find the last row at or before a time.

        The time is in s, and the result is the row's index.
        """
        row = np.searchsorted(self.time, time, side="right") - 1
        return int(np.clip(row, 0, len(self.time) - 1))

    def nodes_at(self, time: float) -> Array:
        """Interpolate the nodes (n, 3) [m] at a time [s] by a cubic Hermite spline.

        Before the first and after the last row the nodes are at rest.
        """
        k = self.row_at(time)
        if k + 1 >= len(self.time) or time <= self.time[k]:
            return np.asarray(self.nodes[k])
        h = float(self.time[k + 1] - self.time[k])
        s = (time - float(self.time[k])) / h
        first, second = self.nodes[k], self.nodes[k + 1]
        with np.errstate(over="ignore", invalid="ignore"):
            if self.velocities is None:
                return np.asarray(first + s * (second - first))
            slope = s * (1 - s) ** 2 * self.velocities[k] - s**2 * (1 - s) * self.velocities[k + 1]
            return np.asarray(first + s**2 * (3 - 2 * s) * (second - first) + h * slope)

    def frame_at(self, time: float) -> Frame:
        """Build the frame at a time.

        Nodes are interpolated, other quantities those of the last row before.
        """
        row = self.row_at(time)
        velocities, tension, force_density = (
            values if values is None else values[row]
            for values in (self.velocities, self.tension, self.force_density)
        )
        return Frame(self.nodes_at(time), velocities, tension, force_density, time, row)


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over time with their limits.

    Attributes
    ----------
    title, unit : str
        Quantity and its unit.
    time : ndarray, shape (T,)
        Times [s].
    values : ndarray, shape (T, m) or (T − 1, m)
        Values at the times, or constant between consecutive times.
    names : tuple of str
        Names of the curves.
    lower, upper : ndarray, shape (m,), optional
        Limits, infinite where there is none.
    shaded : tuple of (float, float)
        Intervals of time with a gray background, such as contact [s].
    """

    title: str
    unit: str
    time: Array
    values: Array
    names: tuple[str, ...]
    lower: Array | None = None
    upper: Array | None = None
    shaded: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class ViewContent:
    """Content of a picture, independent of the drawing library.

    Attributes
    ----------
    motions : tuple of Motion
        Superimposed trajectories, the first of them opaque.
    grounds : tuple of Surface
        Planes and height fields.
    obstacles : tuple of (center, radius)
        Spheres [m].
    boxes : tuple of (corner, corner)
        Boxes that nodes stay in [m].
    targets : ndarray, shape (k, 3)
        Target positions of nodes [m].
    charts : tuple of Chart
        Curves beside the picture.
    notes : tuple of str
        Remarks below the legend.
    """

    motions: tuple[Motion, ...]
    grounds: tuple[Any, ...] = ()
    obstacles: tuple[tuple[Any, float], ...] = ()
    boxes: tuple[tuple[Array, Array], ...] = ()
    targets: Array = field(default_factory=lambda: np.zeros((0, 3)))
    charts: tuple[Chart, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def start(self) -> float:
        """First time of any trajectory [s]."""
        return min(motion.start for motion in self.motions)

    @property
    def end(self) -> float:
        """Last time of any trajectory [s]."""
        return max(motion.end for motion in self.motions)

    @cached_property
    def corners(self) -> tuple[Array, Array]:
        """Opposite corners of a box around all trajectories [m].

        Each is (3,). Outliers are ignored, such as the nodes of a trajectory that diverged.
        """
        first = np.concatenate([motion.nodes[0] for motion in self.motions])
        first = first[np.isfinite(first).all(axis=1)]
        if not len(first):
            return np.full(3, -0.5), np.full(3, 0.5)
        center, extent = (first.max(0) + first.min(0)) / 2, measure_extent(first) or 1
        ends = [(motion.nodes.min(axis=0), motion.nodes.max(axis=0)) for motion in self.motions]
        points = np.concatenate([corner for pair in ends for corner in pair])
        if not (np.abs(points - center) <= 20 * extent).all():
            points = np.concatenate([motion.nodes.reshape(-1, 3) for motion in self.motions])
            points = points[(np.abs(points - center) <= 20 * extent).all(axis=1)]
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.0 if np.any(high > low) else 0.5
        return low - margin, high + margin

    @property
    def size(self) -> float:
        """Largest extent of all trajectories [m]."""
        low, high = self.corners
        return float((high - low).max())

    @property
    def least_radius(self) -> float:
        """Smallest radius of a member that is visible [m]."""
        return STYLE.min_radius * self.size

    @cached_property
    def bar_radius(self) -> float:
        """Radius of bars [m].

        It is a fraction of the median member length, but large enough to be visible.
        """
        motion, whole = self.motions[0], self.size
        members = motion.bars if len(motion.bars) else motion.strings
        typical = float(np.median(distances(motion.nodes[0], members))) if len(members) else 0.0
        length = typical if 0 < typical < np.inf else whole
        return max(self.least_radius, STYLE.bar_radius * length)


def choose_frame_times(content: ViewContent, speed: float, frames_per_second: int) -> Array:
    """Choose the times of a film's frames [s], including both ends.

    The film shows the content. `speed` is in simulated seconds per second. Raises ValueError for
    more than `MOST_FRAMES`.
    """
    duration = content.end - content.start
    steps = max(round(duration / speed * frames_per_second), int(duration > 0))
    if steps >= MOST_FRAMES:
        raise add_address(
            ValueError(
                f"speed is {speed:g}: {duration:g} s would take {steps + 1} frames, give a speed of at least {speed * (steps + 1) / MOST_FRAMES:.2g}"
            )
        )
    return np.linspace(content.start, content.end, steps + 1)
