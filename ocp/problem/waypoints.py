"""Goals that are met on the way, at a time or a share of the duration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ocp.problem.goals import Goal
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import positive_number

INSTANT = 1e-9  # of the duration: what lies nearer together is one instant


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
