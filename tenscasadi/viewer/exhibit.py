"""All that is shown together: motions over each other, what stands beside them, and curves over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Surface
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, shown, text
from tenscasadi.viewer.motion import Motion, of_rollouts, of_structure, of_trajectory, renamed

_VISIBLE = 0.0008  # of the whole: half a pixel
_FAR = 20.0  # times the size of the start: what goes further is lost, and not made room for


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over time beside the canvas, with the limits that they keep.

    values: (T, m) at `time` (T,), or (T − 1, m), held from each time to the next. lower, upper:
    (m,), infinite where there is no limit.
    """

    title: str
    unit: str
    time: Array
    values: Array
    names: tuple[str, ...]
    lower: Array | None = None
    upper: Array | None = None


@dataclass(frozen=True, eq=False)
class Exhibit:
    """Motions over each other, the first one solid; grounds; balls of (centre, radius); boxes of two corners; targets (k, 3); curves."""

    motions: tuple[Motion, ...]
    grounds: tuple[Surface, ...] = ()
    obstacles: tuple[tuple[Any, float], ...] = ()
    boxes: tuple[tuple[Array, Array], ...] = ()
    targets: Array = field(default_factory=lambda: np.zeros((0, 3)))
    charts: tuple[Chart, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def start(self) -> float:
        """First time of any motion, s."""
        return min(motion.start for motion in self.motions)

    @property
    def end(self) -> float:
        """Last time of any motion, s."""
        return max(motion.end for motion in self.motions)

    def corners(self) -> tuple[Array, Array]:
        """Return the corners of a box that holds all motions, m."""
        first = np.concatenate([_known(motion.nodes[0]) for motion in self.motions])
        if not len(first):
            return np.full(3, -0.5), np.full(3, 0.5)
        low, high = first.min(axis=0), first.max(axis=0)
        room = _FAR * (float((high - low).max()) or 1.0)  # one node has no size
        for motion in self.motions:
            points = _known(motion.nodes.reshape(-1, 3))
            points = points[(np.abs(points - (low + high) / 2) <= room).all(axis=1)]
            if len(points):
                low, high = (
                    np.minimum(low, points.min(axis=0)),
                    np.maximum(high, points.max(axis=0)),
                )
        flat = 0.5 if not np.any(high > low) else 0.0
        return low - flat, high + flat

    def bar_radius(self) -> float:
        """Return how thick bars are drawn, m: by the length of one in the middle, or as much of the whole as can be seen."""
        motion = self.motions[0]
        members: Indices = motion.bars if len(motion.bars) else motion.strings
        lengths = np.linalg.norm(
            motion.nodes[0][members[:, 0]] - motion.nodes[0][members[:, 1]], axis=1
        )
        low, high = self.corners()
        whole = float((high - low).max())
        size = float(np.median(lengths)) if len(members) else whole
        thickness = 0.014 if len(motion.bars) else 0.01
        return max(
            _VISIBLE * whole, thickness * (size if size > 0 and np.isfinite(size) else whole)
        )


def exhibit_of(things: Any) -> Exhibit:
    """Return how things are shown: one, several in a list or tuple, or a mapping of names to them.

    An object of another package says it by a method `_exhibit_()`.
    """
    if isinstance(things, Mapping):
        named = [(text("things", name), thing) for name, thing in things.items()]
    else:
        named = [
            ("", thing) for thing in (things if isinstance(things, (list, tuple)) else [things])
        ]
    if not named:
        raise ValueError(
            "things is empty: give at least one structure, scene, trajectory, plan or rollouts"
        )
    parts = [_read(thing, name) for name, thing in named]
    motions = tuple(motion for part in parts for motion in part.motions)
    unique = {motion.name for motion in motions}
    if len(unique) < len(motions):
        motions = tuple(
            renamed(motion, f"{k + 1}: {motion.name}") for k, motion in enumerate(motions)
        )
    return Exhibit(
        motions,
        _distinct([ground for part in parts for ground in part.grounds]),
        tuple(ball for part in parts for ball in part.obstacles),
        tuple(box for part in parts for box in part.boxes),
        np.concatenate([part.targets for part in parts]),
        tuple(chart for part in parts for chart in part.charts),
        tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def standing_on(exhibit: Exhibit, grounds: tuple[Surface, ...]) -> Exhibit:
    """Return the exhibit with more grounds."""
    return replace(exhibit, grounds=_distinct([*exhibit.grounds, *grounds]))


def _read(thing: Any, name: str) -> Exhibit:
    if isinstance(thing, Structure):
        return Exhibit((of_structure(thing, name or "structure"),))
    if isinstance(thing, Model):
        thing = thing.scene
    if isinstance(thing, Scene):
        return Exhibit(
            (of_structure(thing.modelled, name or "scene", thing.string_laws),), thing.grounds
        )
    if isinstance(thing, Trajectory):
        notes = () if thing.success else (f"{name or 'trajectory'}: {thing.message}",)
        return Exhibit((of_trajectory(thing, name or "trajectory"),), notes=notes)
    if isinstance(thing, Rollouts):
        failed = np.count_nonzero(~thing.success)
        notes = (
            (f"{failed} of {len(thing.success)} motions failed: what is lost is not shown",)
            if failed
            else ()
        )
        return Exhibit((of_rollouts(thing, name or "rollouts"),), notes=notes)
    told = getattr(thing, "_exhibit_", None)
    if callable(told):
        exhibit = told()
        if isinstance(exhibit, Exhibit):
            return exhibit
    raise TypeError(
        f"things is {shown(thing)}: give a Structure, Scene, Model, Trajectory, Rollouts or an ocp.Plan, a list or a mapping of them"
    )


def _known(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]


def _distinct(values: list[Any]) -> tuple[Any, ...]:
    kept: list[Any] = []
    for value in values:
        if not any(value is other for other in kept):
            kept.append(value)
    return tuple(kept)
