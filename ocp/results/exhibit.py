"""A plan as the viewer shows it: its replay, the planned motion over it, obstacles, targets, and its curves with their limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.problem.bounds.geometric_bounds import InsideBox, Obstacle
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StringLimits,
    TensionLimits,
)
from ocp.problem.goals.goal import soft_goals
from ocp.problem.goals.node_goals import NodePositions
from ocp.problem.goals.waypoints import Waypoint
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from tenscasadi.viewer.exhibit import Chart, Exhibit
    from tenscasadi.viewer.motion import Motion


def exhibit_of_plan(plan: Any) -> Exhibit:
    """Return what the viewer shows of a plan. The replay is solid; it is missing where the plan's model is not known."""
    from tenscasadi.viewer.exhibit import (
        Exhibit,
    )  # what looks at plans is loaded with them only when they are looked at
    from tenscasadi.viewer.motion import of_trajectory

    planned = of_trajectory(plan.trajectory, "plan")
    replay = None if plan.model is None else plan.replay(tracked=plan.tracked)
    motions = (
        (planned,)
        if replay is None
        else (of_trajectory(replay, "replay, tracked" if plan.tracked else "replay"), planned)
    )
    problem = plan.problem
    bounds = (
        []
        if problem is None
        else [*problem.bounds, *(bound for phase in problem.phases for bound in phase.bounds)]
    )
    found = "" if plan.success else "no plan was found that meets its goals; the best there is: "
    return Exhibit(
        motions,
        () if plan.model is None else plan.model.scene.grounds,
        tuple((bound.centre, bound.radius) for bound in bounds if isinstance(bound, Obstacle)),
        tuple(bound.corners() for bound in bounds if isinstance(bound, InsideBox)),
        _targets(_timed(plan), planned),
        tuple(_charts(plan, replay, bounds)),
        (
            f"{found}the replay ends {plan.replay_error:.2g} m and {plan.replay_speed_error:.2g} m/s from the goals",
        ),
    )


def _timed(plan: Any) -> Iterator[tuple[float, Any]]:
    """Yield the goals with the times at which they are to be met, s."""
    problem, first, last = plan.problem, float(plan.time[0]), float(plan.time[-1])
    if problem is None:
        return
    for k, phase in enumerate(problem.phases, start=1):
        end = float(
            plan.time[k * (len(plan.time) - 1) // len(problem.phases)]
        )  # each has as many intervals
        yield from ((end, goal) for goal in phase.goals)
    for goal in problem.goals:
        share = goal.at(problem.shortest, problem.longest) if isinstance(goal, Waypoint) else 1.0
        yield from (
            (first + share * (last - first), part)
            for part in (goal.goals if isinstance(goal, Waypoint) else [goal])
        )
    for share, wish in soft_goals(problem.costs):
        yield first + share * (last - first), wish.goal


def _targets(timed: Iterable[tuple[float, Any]], planned: Motion) -> Array:
    """Return the places (k, 3) where goals want nodes to be; along axes that are free, where the plan brings them."""
    places = []
    for time, goal in timed:
        if isinstance(goal, NodePositions):
            nodes = planned.nodes_at(time)
            given = (
                goal.positions.items()
                if isinstance(goal.positions, dict)
                else enumerate(np.asarray(goal.positions))
            )
            places += [
                [
                    nodes[node, axis] if value is None else float(value)
                    for axis, value in enumerate(place)
                ]
                for node, place in given
            ]
    return np.array(places, dtype=float).reshape(-1, 3)


def _charts(plan: Any, replay: Any, bounds: list[Any]) -> Iterator[Chart]:
    """Yield what was decided, with its limits, and the tensions where they are limited."""
    from tenscasadi.viewer.exhibit import Chart

    names = tuple(f"string {k}" for k in range(plan.force_density.shape[1]))
    if plan.rest_length is not None:
        yield Chart(
            "rest length",
            "m",
            plan.time,
            plan.rest_length,
            names,
            *_limits(RestLengthLimits, plan, bounds),
        )
    yield Chart(
        "force density",
        "N/m",
        plan.time,
        plan.force_density,
        names,
        *_limits(ForceDensityLimits, plan, bounds),
    )
    if replay is not None and any(isinstance(bound, TensionLimits) for bound in bounds):
        names = tuple(f"string {k}" for k in range(replay.tension.shape[1]))
        yield Chart(
            "tension of the replay",
            "N",
            replay.time,
            replay.tension,
            names,
            *_limits(TensionLimits, plan, bounds, replay.tension.shape[1]),
        )


def _limits(
    kind: type[StringLimits], plan: Any, bounds: list[Any], count: int | None = None
) -> tuple[Array, Array]:
    """Return the narrowest limits of a kind (α,); infinite where there is none, and where strings of the model are not those of the plan."""
    strings = plan.force_density.shape[1] if count is None else count
    lower, upper = np.full(strings, -np.inf), np.full(strings, np.inf)
    for bound in bounds:
        if isinstance(bound, kind):
            least, most = bound.limits(plan.structure)
            if len(least) == strings:
                lower, upper = np.maximum(lower, least), np.minimum(upper, most)
    return lower, upper
