"""Waypoints: goals at instants before the end of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from ocp.problem.goals.goal import Goal
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    Array,
    finite_array,
    format_value,
    nesting,
    positive_number,
)

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True, eq=False)
class Waypoint(Goal, kind="Waypoint"):
    """Goals at a time or at a fraction of the duration.

    Between mesh points, states are interpolated by cubic polynomials. Give either ``time`` or
    ``share``, the fraction of the duration.

    Parameters
    ----------
    goals : sequence of goals
        Goals at that instant, such as `NodePositions` or `Shape`. Soft ones (`Goal.soft`) require
        one time or a fraction, not a range of times.
    time : float or (float, float), optional
        Time from the start [s]; it requires a fixed duration. A range (earliest, latest) lets the
        solver choose the time, also for a free duration. Such waypoints are passed in the given
        order, and divide the plan into phases (`Phase`).
    share : float, optional
        Fraction of the duration in (0, 1]. At 1, the goals are terminal constraints.

    Raises
    ------
    TypeError, ValueError
        If ``goals`` is not a list of goals, if both or none of time and share are given, or if the
        share is not in (0, 1]. In a `Problem`: if the time is outside the plan, or if a time is
        given and the duration is free.

    Examples
    --------
    >>> import ocp
    >>> ocp.Waypoint([ocp.NodePositions({3: (0.0, 0.0, 1.2)})], share=0.5).share
    0.5
    """

    timing: ClassVar[str] = "way"
    goals: Sequence[Goal]
    time: float | tuple[float, float] | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.goals, Goal) or not isinstance(self.goals, Sequence) or not self.goals:
            raise TypeError(
                f"Waypoint.goals is {format_value(self.goals)}: give a list of goals, such as [NodePositions({{0: (0, 0, 1)}})]"
            )
        for k, goal in enumerate(self.goals):
            if not isinstance(goal, Goal) or isinstance(goal, Waypoint):
                raise TypeError(
                    f"Waypoint.goals[{k}] is {format_value(goal)}: give a goal, such as NodePositions({{0: (0, 0, 1)}})"
                )
        if (self.time is None) == (self.share is None):
            raise ValueError("Waypoint.time and .share: give one of them")
        if nesting(self.time) == 1:
            object.__setattr__(self, "time", _read_range(self.time))
        elif self.time is not None:
            object.__setattr__(self, "time", positive_number("Waypoint.time", self.time))
        if (
            self.share is not None
            and not NEGLIGIBLE < positive_number("Waypoint.share", self.share) <= 1
        ):
            raise ValueError(
                f"Waypoint.share is {self.share:g}: give a fraction of the duration between 0 and 1"
            )

    def check(self, structure: Structure) -> None:
        """Check that the goals can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a goal does not fit the structure.
        """
        for goal in self.goals:
            goal.check(structure)

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Complete the goals with data of model and initial state.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Initial state; None if it is free.

        Returns
        -------
        Goal
            The same waypoint with bound goals.

        Raises
        ------
        ValueError
            If a goal refers to the initial state, and that is free.
        """
        goals = tuple(goal.bind(model, start) for goal in self.goals)
        if any(goal.repeats_start for goal in goals):
            raise ValueError(
                "Waypoint.goals has Periodic(), and the start is free: give Periodic(start=...), or Periodic() as a goal of the end"
            )
        return replace(self, goals=goals)

    def soft(self, weight: float = 1.0) -> Waypoint:
        """Convert all goals into quadratic penalties; see `SoftGoal`.

        Parameters
        ----------
        weight : float, optional
            Cost of a residual of 1 m, or of 1 m/s; > 0.

        Returns
        -------
        Waypoint
            Waypoint with soft goals, for the goals of a problem.
        """
        return replace(self, goals=[goal.soft(weight) for goal in self.goals])

    def at(self, shortest: float, longest: float) -> float:
        """Compute the waypoint's time as a fraction of the duration.

        Parameters
        ----------
        shortest : float
            Shortest duration of the plan [s].
        longest : float
            Longest duration of the plan [s].

        Returns
        -------
        float
            Fraction of the duration. It is 1 if the time is within 10⁻⁹ of the duration from the
            end.

        Raises
        ------
        ValueError
            If the time is outside the plan, or if a time is given and the duration is free.
        """
        if self.share is not None:
            return 1.0 if self.share > 1 - NEGLIGIBLE else float(self.share)
        time = float(self.time or 0.0) if not isinstance(self.time, tuple) else self.time[1]
        if shortest < longest:
            raise ValueError(
                f"Waypoint.time is {time:g}, and Problem.duration is free: give Waypoint(share=...)"
            )
        if time > (1 + NEGLIGIBLE) * longest:
            raise ValueError(
                f"Waypoint.time is {time:g}, and the plan takes {longest:g} s: give an earlier time, or a goal of the end"
            )
        if time <= NEGLIGIBLE * longest:
            raise ValueError(
                f"Waypoint.time is {time:g}, where a plan of {longest:g} s has hardly begun: give a later time"
            )
        return 1.0 if time > (1 - NEGLIGIBLE) * longest else time / longest


def _read_range(value: Any) -> tuple[float, float]:
    earliest, latest = finite_array("Waypoint.time", value, (2,)).tolist()
    if not 0 < earliest <= latest:
        raise ValueError(
            f"Waypoint.time is ({earliest:g}, {latest:g}): give (earliest, latest), greater than 0"
        )
    return earliest, latest
