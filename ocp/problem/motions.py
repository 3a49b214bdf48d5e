"""Goals of a whole motion: that it comes back to its start, that it passes somewhere on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals import Goal, Rows
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import coordinates, finite_array, positive_number

INSTANT = 1e-9  # of the duration: what lies nearer together is one instant


@dataclass(frozen=True, eq=False)
class Periodic(Goal):
    """The end repeats the start, so that the plan may be run again and again: each node back in its place and at its velocity.

    shift: (x, y, z), m, by which all nodes have moved, as in a gait; None for an axis: as far as the first node has. start: nodes and
    velocities (n, 3) to come back to; None: those of the problem, also where they are sought (`FreeStart`).
    """

    shift: Sequence[float | None] = (0.0, 0.0, 0.0)
    start: tuple[ArrayLike, ArrayLike] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shift", coordinates("Periodic.shift", self.shift, "an axis that is free"))
        if self.start is not None and (not isinstance(self.start, (tuple, list)) or len(self.start) != 2):
            raise TypeError("Periodic.start is no pair: give (nodes, velocities), or None for the start of the problem")

    def check(self, structure: Structure) -> None:
        """Raise where a pinned node would have to move, or `start` does not fit."""
        for name, given in zip(("nodes", "velocities"), self.start or (), strict=False):
            finite_array(f"Periodic.start: {name}", given, structure.nodes.shape)
        for axis, value in enumerate(self.shift):
            if value and structure.fixed[:, axis].any():
                node = int(np.argmax(structure.fixed[:, axis]))
                raise ValueError(f"Periodic.shift moves node {node}, which is pinned along {'xyz'[axis]}: give 0 for that axis")

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> tuple[Rows, Rows]:
        """Coordinates and velocities minus those of the start."""
        if self.start is None:
            raise ValueError("Periodic.start is None: give it to a Problem, which knows its start")
        before, speeds = (value if isinstance(value, (ca.SX, ca.MX)) else np.asarray(value) for value in self.start)
        places, rates, names = [], [], []
        for node, axis in np.argwhere(~structure.fixed).tolist():
            shift = self.shift[axis]
            moved = nodes[axis, 0] - before[0, axis] if shift is None else shift
            if shift is not None or node:
                places.append((nodes[axis, node] - before[node, axis] - moved, f"Periodic: node {node} {'xyz'[axis]}"))
            rates.append(velocities[axis, node] - speeds[node, axis])
            names.append(f"Periodic: node {node} {'xyz'[axis]} velocity")
        return Rows(ca.vertcat(*(value for value, _ in places)), tuple(name for _, name in places)), Rows(
            ca.vertcat(*rates), tuple(names), speed=True
        )


@dataclass(frozen=True, eq=False)
class Waypoint(Goal):
    """Goals that are met on the way, at `time` s, or at `share` of the duration (between 0 and 1), which is the one for free durations.

    Between the ends of intervals the motion is taken as cubic.
    """

    goals: Sequence[Goal]
    time: float | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.goals, Goal) or not isinstance(self.goals, Sequence) or not self.goals:
            raise TypeError(f"Waypoint.goals is {self.goals!r}: give a list of goals, such as [NodePositions({{0: (0, 0, 1)}})]")
        for k, goal in enumerate(self.goals):
            if not isinstance(goal, Goal) or isinstance(goal, Waypoint):
                raise TypeError(f"Waypoint.goals[{k}] is {goal!r}: give a goal, such as NodePositions({{0: (0, 0, 1)}})")
        if (self.time is None) == (self.share is None):
            raise ValueError("Waypoint.time and .share: give one of them")
        if self.time is not None:
            object.__setattr__(self, "time", positive_number("Waypoint.time", self.time))
        if self.share is not None and not INSTANT < positive_number("Waypoint.share", self.share) < 1 - INSTANT:
            raise ValueError(f"Waypoint.share is {self.share:g}: give a share of the duration between 0 and 1, or a goal of the end")

    def check(self, structure: Structure) -> None:
        """Raise where a goal does not fit the structure."""
        for goal in self.goals:
            goal.check(structure)

    def at(self, shortest: float, longest: float) -> float:
        """The share of the duration. Raises ValueError for a time outside the plan, or one given where the duration is free."""
        if self.share is not None:
            return float(self.share)
        time = float(self.time or 0.0)
        if shortest < longest:
            raise ValueError(f"Waypoint.time is {time:g}, and Problem.duration is free: give Waypoint(share=...)")
        if time >= (1 - INSTANT) * longest:
            raise ValueError(f"Waypoint.time is {time:g}, and the plan takes {longest:g} s: give an earlier time, or a goal of the end")
        if time <= INSTANT * longest:
            raise ValueError(f"Waypoint.time is {time:g}, where a plan of {longest:g} s has hardly begun: give a later time")
        return time / longest

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> tuple[Rows, ...]:
        """None at the end."""
        return ()
