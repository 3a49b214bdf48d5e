"""Pictures of plans: trajectories, obstacles, targets and charts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ocp.problem.bounds.geometric_bounds import InsideBox, Obstacle
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StringLimits,
    TensionLimits,
    combine_rates,
)
from ocp.problem.goals.goal import soft_goals
from ocp.problem.goals.node_goals import NodePositions
from ocp.problem.goals.waypoints import Waypoint
from tenscasadi.drawing.describe import describe_trajectory
from tenscasadi.drawing.view_content import Chart, Motion, ViewContent, list_names
from tenscasadi.structure.cables import name_inputs
from tenscasadi.util.validate import Array


def describe_plan(plan: Any) -> ViewContent:
    """Describe a plan for plots and the viewer.

    The replay is drawn opaque. It is missing if the plan's model is unknown.
    """
    planned = describe_trajectory(plan.trajectory, "plan")
    replay = None if plan.model is None else plan.replay(tracked=plan.tracked)
    motions: tuple[Motion, ...] = (planned,)
    if replay is not None:
        name = "replay, tracked" if plan.tracked else "replay"
        motions = (describe_trajectory(replay, name), planned)
    bounds: list[Any] = []
    if plan.problem is not None:
        owners = (plan.problem, *plan.problem.phases)
        bounds = [bound for owner in owners for bound in owner.bounds]
    result = "" if plan.success else "no plan was found that meets its goals; the best one: "
    errors = f"{plan.replay_error:.2g} m and {plan.replay_speed_error:.2g} m/s"
    return ViewContent(
        motions,
        () if plan.model is None else plan.model.scene.grounds,
        tuple((bound.center, bound.radius) for bound in bounds if isinstance(bound, Obstacle)),
        tuple(bound.corners() for bound in bounds if isinstance(bound, InsideBox)),
        _find_targets(_list_goals(plan), planned),
        tuple(_build_charts(plan, replay, bounds)),
        (f"{result}the replay ends {errors} from the goals",),
    )


def _list_goals(plan: Any) -> Iterator[tuple[float, Any]]:
    """Yield the goals of a plan's problem with their times [s]."""
    problem, first, last = plan.problem, float(plan.time[0]), float(plan.time[-1])
    if problem is None:
        return
    for k, phase in enumerate(problem.phases, start=1):
        # all phases have the same number of intervals
        end = float(plan.time[k * (len(plan.time) - 1) // len(problem.phases)])
        yield from ((end, goal) for goal in phase.goals)
    for goal in problem.goals:
        is_waypoint = isinstance(goal, Waypoint)
        fraction = goal.at(problem.shortest, problem.longest) if is_waypoint else 1.0
        parts = goal.goals if is_waypoint else [goal]
        yield from ((first + fraction * (last - first), part) for part in parts)
    for fraction, soft in soft_goals(problem.costs):
        yield first + fraction * (last - first), soft.goal


def _find_targets(timed: Iterable[tuple[float, Any]], planned: Motion) -> Array:
    """Find the target positions (k, 3) of nodes [m].

    Along axes without a goal they are the positions in the plan, `planned`. `timed` are goals with
    their times [s].
    """
    targets = []
    for time, goal in timed:
        if isinstance(goal, NodePositions):
            given = goal.positions
            pairs = given.items() if isinstance(given, dict) else enumerate(np.asarray(given))
            nodes = planned.nodes_at(time)
            targets += [
                [nodes[node, axis] if x is None else float(x) for axis, x in enumerate(position)]
                for node, position in pairs
            ]
    return np.array(targets, dtype=float).reshape(-1, 3)


def _build_charts(plan: Any, replay: Any, bounds: list[Any]) -> Iterator[Chart]:
    """Yield charts of the control and of limited tensions.

    `bounds` are those of the problem. `replay` is the replay of the plan.
    """

    def chart(title: str, unit: str, time: Array, values: Array, kind: type[StringLimits]) -> Chart:
        names = list_names(plan.structure, "string", values.shape[1])
        if plan.structure.cables and kind.per_cable and values is not getattr(replay, "tension", 0):
            names = tuple(kind.names_of(plan.structure))
        return Chart(title, unit, time, values, names, *_limits(kind, plan, bounds, len(names)))

    if plan.rest_length is not None:
        yield chart("rest length", "m", plan.time, plan.rest_length, RestLengthLimits)
    names = tuple(name_inputs(plan.structure))
    if plan.rest_length_rate is not None:
        largest = combine_rates(plan.structure, bounds)
        rates = plan.rest_length_rate
        yield Chart("rest-length rate", "m/s", plan.time, rates, names, -largest, largest)
    if plan.motor_torque is not None:
        largest = plan.trajectory.scene.control.limits("torque", len(names))
        yield Chart("motor torque", "N m", plan.time, plan.motor_torque, names, -largest, largest)
    if plan.trajectory.internal_states:
        yield chart("rest length", "m", plan.time, plan.rest_lengths(), RestLengthLimits)
    if plan.input_tension is not None:
        yield chart("tension", "N", plan.time, plan.input_tension, TensionLimits)
    yield chart("force density", "N/m", plan.time, plan.force_density, ForceDensityLimits)
    if replay is not None and any(isinstance(bound, TensionLimits) for bound in bounds):
        yield chart("tension of the replay", "N", replay.time, replay.tension, TensionLimits)


def _limits(
    kind: type[StringLimits], plan: Any, bounds: list[Any], count: int
) -> tuple[Array, Array]:
    """Find the tightest limits (α,) of a class of bounds.

    They are infinite if there are none. `kind` is the class; `count` is the number α of strings.
    """
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    for bound in bounds:
        if isinstance(bound, kind):
            least, most = bound.limits(plan.structure)
            if len(least) == count:  # the model may have subdivided strings
                lower, upper = np.maximum(lower, least), np.minimum(upper, most)
    return lower, upper
