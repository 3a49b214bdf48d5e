"""The arguments of a problem as planning takes them: read, checked, completed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StringLimits,
    TensionLimits,
)
from ocp.problem.control import check_control, refuse_wound
from ocp.problem.costs import Cost, CostAt, Effort
from ocp.problem.expressions import check_expressions
from ocp.problem.goals.goal import Goal, SoftGoal
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.phase import Phase, check_phases, phases_between, read_duration, read_items
from ocp.problem.start import FreeStart, read_start
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, format_value, instance

Duration = float | tuple[float, float]


class Resolved(NamedTuple):
    """The fields of a `Problem` as planning takes them.

    model: with the values of its parameters as constants. start: a state, or a `FreeStart` near
    one. goals: those that are met; soft ones are among the costs.
    """

    model: Model
    duration: Duration
    start: Array | FreeStart
    goals: tuple[Goal, ...]
    bounds: tuple[Bound, ...]
    costs: tuple[Cost, ...]
    phases: tuple[Phase, ...]


def resolve(
    model: Model,
    duration: Any,
    start: ArrayLike | FreeStart | None,
    goals: Iterable[Goal],
    bounds: Iterable[Bound],
    costs: Iterable[Cost],
    parameters: Any,
    phases: Sequence[Phase],
) -> Resolved:
    """Read, check and complete the arguments of a problem. Raises TypeError, ValueError."""
    instance("Problem.model", model, Model, "a tenscasadi.Model")
    model = model.with_parameters(parameters)
    check_control(model)
    if model.nq == 0:
        raise ValueError("Problem.model has all nodes pinned: there is nothing to move")
    for bar in np.flatnonzero(model.structure.elastic):
        raise ValueError(
            f"Problem.model has an elastic bar, {bar}: plan with rigid bars, of structure.replace(bar_stiffness=None)"
        )
    own_phases = read_items("Problem.phases", phases, Phase, "[Phase(0.5)]")
    time = read_duration("Problem.duration", _whole_duration(duration, own_phases))
    own_goals = read_items("Problem.goals", goals, Goal, "[AtRest()]")
    own_goals, parts = _divide(model, own_goals, own_phases, time)
    begin = read_start(model, start)
    own_bounds = read_items("Problem.bounds", bounds, Bound, "[ForceDensityLimits(0, 200)]")
    own_costs = read_items("Problem.costs", costs, Cost, "[Effort()]")
    first_goals = begin.goals if isinstance(begin, FreeStart) else ()
    for item in (*own_goals, *own_bounds, *own_costs, *first_goals):
        item.check(model.scene.structure)
    begin, own_goals, own_costs = _complete(model, begin, own_goals, own_costs)
    for goal in own_goals:
        share_of(goal, time)  # refuses times that are none of the plan's
    _check_limits(model.scene.structure, own_bounds)
    upper = string_limits(model.scene.structure, own_bounds, ForceDensityLimits)[1]
    if not own_costs and np.isposinf(upper).any():
        # With nothing to keep them small, barriers of the solver let force densities grow without
        # bound.
        own_costs = (Effort(),)
    own_goals, wishes = _split_soft(own_goals, own_costs, time)
    own_costs = (*own_costs, *wishes)
    state = None if isinstance(begin, FreeStart) else begin
    check_expressions(model, own_bounds, own_costs, state)
    found = Resolved(model, time, begin, own_goals, own_bounds, own_costs, parts)
    _check_phases(found, divided=parts is not own_phases)
    return found


def share_of(goal: Goal, duration: Duration) -> float:
    """Return the share of the duration at which a goal is met. Raises ValueError for a time that is none of the plan's."""
    shortest, longest = duration if isinstance(duration, tuple) else (duration, duration)
    return goal.at(shortest, longest) if isinstance(goal, Waypoint) else 1.0


def string_limits(structure: Structure, bounds: Iterable[Bound], kind: type) -> tuple[Array, Array]:
    """Return the limits (α,) that all bounds of one kind leave; infinite where there is none."""
    given = [
        bound.limits(structure)
        for bound in bounds
        if isinstance(bound, kind) and isinstance(bound, StringLimits)
    ]
    count = len(structure.strings)
    lower = np.max([np.full(count, -np.inf), *(low for low, _ in given)], axis=0)
    upper = np.min([np.full(count, np.inf), *(up for _, up in given)], axis=0)
    return lower, upper


def _whole_duration(given: Any, phases: tuple[Phase, ...]) -> Any:
    """Return the duration that is given, or that of all phases."""
    if not phases:
        return given
    last = phases[-1].until
    sums = sum(phase.shortest for phase in phases), sum(phase.longest for phase in phases)
    whole = read_duration("Problem.duration", sums if last is None else last)
    if read_duration("Problem.duration", given) not in (1.0, whole):
        raise ValueError(
            f"Problem.duration is {format_value(given)}, and phases have durations of their own: leave it out"
        )
    return whole


def _divide(
    model: Model, goals: tuple[Goal, ...], phases: tuple[Phase, ...], duration: Duration
) -> tuple[tuple[Goal, ...], tuple[Phase, ...]]:
    """Make waypoints of free times the ends of phases."""
    ways = [goal for goal in goals if isinstance(goal, Waypoint)]
    if phases or not any(isinstance(way.time, tuple) for way in ways):
        return goals, phases
    for way in ways:
        way.check(model.scene.structure)
    shortest, longest = duration if isinstance(duration, tuple) else (duration, duration)
    rest = tuple(goal for goal in goals if goal not in ways)
    return rest, tuple(phases_between(ways, shortest, longest))


def _complete(
    model: Model, start: Array | FreeStart, goals: tuple[Goal, ...], costs: tuple[Cost, ...]
) -> tuple[Array | FreeStart, tuple[Goal, ...], tuple[Cost, ...]]:
    """Give goals what they take from the start: distances, or places that stay."""
    begin = None
    if isinstance(start, FreeStart):
        start = replace(start, goals=tuple(goal.complete(model, None) for goal in start.goals))
    else:
        begin = start
    own_goals = tuple(goal.complete(model, begin) for goal in goals)
    own_costs: tuple[Any, ...] = tuple(
        cost.complete(model, begin) if isinstance(cost, SoftGoal) else cost for cost in costs
    )
    return start, own_goals, own_costs


def _split_soft(
    goals: tuple[Goal, ...], costs: tuple[Cost, ...], duration: Duration
) -> tuple[tuple[Goal, ...], tuple[Cost, ...]]:
    """Return the goals that are met, and the costs of those that are not."""
    met: list[Goal] = []
    wished: list[Cost] = []
    for goal in goals:
        parts = list(goal.goals) if isinstance(goal, Waypoint) else [goal]
        soft = [part for part in parts if isinstance(part, SoftGoal)]
        share = share_of(goal, duration)
        wished += soft if share == 1.0 else [CostAt(part, share) for part in soft]
        if isinstance(goal, Waypoint) and 0 < len(soft) < len(parts):
            met.append(replace(goal, goals=tuple(part for part in parts if part not in soft)))
        elif not soft:
            met.append(goal)
    asked = [wish.cost if isinstance(wish, CostAt) else wish for wish in (*costs, *wished)]
    if any(
        isinstance(wish.goal, Periodic) and wish.goal.start is None
        for wish in asked
        if isinstance(wish, SoftGoal)
    ):
        raise ValueError(
            "Problem.goals has Periodic().soft(), and the start is free: give Periodic(start=...), or Periodic()"
        )
    return tuple(met), tuple(wished)


def _check_limits(structure: Structure, bounds: tuple[Bound, ...]) -> None:
    for kind in (ForceDensityLimits, TensionLimits, RestLengthLimits):
        lower, upper = string_limits(structure, bounds, kind)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise ValueError(
                f"Problem.bounds: {kind.__name__} leave string {i} nothing, lower {lower[i]:g} and upper {upper[i]:g}: widen one"
            )


def _check_phases(found: Resolved, divided: bool) -> None:
    """Refuse phases that do not fit the rest. divided: whether they come from waypoints."""
    if not found.phases:
        return
    try:
        refuse_wound(found.model, "Problem.phases")
        if isinstance(found.start, FreeStart):
            raise ValueError(
                "Problem.start is free, and phases begin where nodes stand: give the start"
            )
        check_phases(found.model, found.start, found.phases, found.goals, found.bounds, found.costs)
    except (TypeError, ValueError) as error:
        if not divided:
            raise
        raise ValueError(
            f"{error}; a range as Waypoint.time makes phases: or give one time, or a share"
        ) from None
