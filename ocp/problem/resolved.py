"""Validated and completed arguments of a problem."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StrengthLimits,
    StringLimits,
    TensionLimits,
)
from ocp.problem.control import check_control, require_force_densities
from ocp.problem.costs import Cost, CostAt, Effort
from ocp.problem.expressions import check_expressions
from ocp.problem.goals.goal import Goal, SoftGoal
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.phase import Phase, check_phases, phases_between
from ocp.problem.reading import Duration, limits_of, read_duration, read_items
from ocp.problem.start import FreeStart, read_start
from tenscasadi.dynamics.base_model import check_model
from tenscasadi.scene.breaking import Strength
from tenscasadi.scene.failed_strings import require_intact
from tenscasadi.scene.samples import reject_python_functions
from tenscasadi.scene.strength import count_states, drop_states, limit_tensions
from tenscasadi.schema.definitions import resolve_names
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, finite_array, format_value, instance, nesting

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


class Resolved(NamedTuple):
    """Validated and completed fields of a `Problem`.

    Attributes
    ----------
    model : Model
        Model with the values of its parameters as constants.
    duration : float or (float, float)
        Duration [s], or its limits.
    start : ndarray, shape (nx,), or FreeStart
        Initial state.
    goals, bounds, costs, phases : tuple
        Goals are bound to model and start; soft goals are among the costs. Waypoints of free times
        become phases.
    strength : Strength or None
        Tensions at which strings fail.
    """

    model: Model
    duration: Duration
    start: Array | FreeStart
    goals: tuple[Goal, ...]
    bounds: tuple[Bound, ...]
    costs: tuple[Cost, ...]
    phases: tuple[Phase, ...]
    strength: Strength | None


def resolve(
    model: Model,
    duration: Any,
    start: ArrayLike | FreeStart | None,
    goals: Iterable[Goal],
    bounds: Iterable[Bound],
    costs: Iterable[Cost],
    parameters: Any,
    phases: Sequence[Phase],
    strength: Strength | None,
) -> Resolved:
    """Validate and complete the arguments of a problem.

    They are those of `Problem`. Raises TypeError, ValueError.
    """
    check_model(model, "Problem.model")
    model = model.with_parameters(parameters)
    reject_python_functions(model.scene, "Problem.model")
    names = model.scene.structure.names
    if strength is not None:
        instance("Problem.strength", strength, Strength, "Breaking(), Yielding() or None")
        strength = resolve_names(strength, names)
        strength.check(len(model.scene.structure.strings))
    strength = model.scene.strength if strength is None else strength
    most = limit_tensions(model.scene.structure, strength)
    start = resolve_names(start, names)
    start = _drop_strength_states(model, start)
    if model.scene.strength is not None:
        model = model.with_scene(replace(model.scene, strength=None))
    _check_plannable(model)
    structure = model.scene.structure
    own_phases = read_items("Problem.phases", phases, Phase, "[Phase(0.5)]", names)
    time = read_duration("Problem.duration", _add_durations(duration, own_phases))
    own_goals = read_items("Problem.goals", goals, Goal, "[AtRest()]", names)
    own_goals, parts = _divide(structure, own_goals, own_phases, time)
    begin = read_start(model, start)
    own_bounds = read_items("Problem.bounds", bounds, Bound, "[ForceDensityLimits(0, 200)]", names)
    own_bounds = drop_derived(own_bounds)  # a copied problem has them
    if np.isfinite(most).any():
        own_bounds = (*own_bounds, StrengthLimits(upper=most))
    own_costs = read_items("Problem.costs", costs, Cost, "[Effort()]", names)
    first_goals = begin.goals if isinstance(begin, FreeStart) else ()
    for item in (*own_goals, *own_bounds, *own_costs, *first_goals):
        item.check(structure)
    state = None if isinstance(begin, FreeStart) else begin
    if isinstance(begin, FreeStart):
        begin = replace(begin, goals=tuple(goal.bind(model, None) for goal in begin.goals))
    own_goals = tuple(goal.bind(model, state) for goal in own_goals)
    own_costs = tuple(
        cost.bind(model, state) if isinstance(cost, SoftGoal) else cost for cost in own_costs
    )
    _check_limits(structure, own_bounds, most)
    upper = string_limits(structure, own_bounds, ForceDensityLimits)[1]
    if not own_costs and np.isposinf(upper).any():
        # Without a cost, the barrier function of the solver lets force densities diverge.
        own_costs = (Effort(),)
    own_goals, penalties = _split_soft(own_goals, own_costs, time)
    own_costs = (*own_costs, *penalties)
    check_expressions(model, own_bounds, own_costs, state)
    found = Resolved(model, time, begin, own_goals, own_bounds, own_costs, parts, strength)
    if parts:
        _check_phases(found, divided=parts is not own_phases)
    return found


def fraction_of(goal: Goal, duration: Duration) -> float:
    """Compute a goal's fraction of the duration.

    Raises ValueError if the time of a waypoint is outside the plan, or needs a fixed duration.
    """
    return goal.at(*limits_of(duration)) if isinstance(goal, Waypoint) else 1.0


def string_limits(
    structure: Structure, bounds: Iterable[Bound], kind: type[StringLimits]
) -> tuple[Array, Array]:
    """Combine the string limits of all bounds of a class.

    ``kind`` is the class. Limits are (α,), or (nu,) with one entry for each cable and each string
    in no cable; infinite if there are none.
    """
    given = [
        bound.limits(structure)
        for bound in bounds
        if isinstance(bound, kind) and isinstance(bound, StringLimits)
    ]
    count = len(kind.names_of(structure))
    lower = np.max([np.full(count, -np.inf), *(low for low, _ in given)], axis=0)
    upper = np.min([np.full(count, np.inf), *(up for _, up in given)], axis=0)
    return lower, upper


def _check_plannable(model: Model) -> None:
    """Check that a model has a control, rigid bars and mobility."""
    check_control(model)
    if model.nq == 0:
        raise ValueError("Problem.model has all nodes pinned: there is nothing to move")
    for bar in np.flatnonzero(model.structure.elastic):
        raise ValueError(
            f"Problem.model has an elastic bar, {bar}: plan with rigid bars, of structure.replace(bar_stiffness=None)"
        )


def _add_durations(given: Any, phases: tuple[Phase, ...]) -> Any:
    """Compute the total duration of all phases.

    Without phases, ``given`` is returned.
    """
    if not phases:
        return given
    last = phases[-1].end_time
    sums = sum(phase.shortest for phase in phases), sum(phase.longest for phase in phases)
    whole = read_duration("Problem.duration", sums if last is None else last)
    if read_duration("Problem.duration", given) not in (1.0, whole):
        raise ValueError(
            f"Problem.duration is {format_value(given)}, and phases have durations of their own: leave it out"
        )
    return whole


def _divide(
    structure: Structure, goals: tuple[Goal, ...], phases: tuple[Phase, ...], duration: Duration
) -> tuple[tuple[Goal, ...], tuple[Phase, ...]]:
    """Convert waypoints with free times into phases that end there.

    ``duration`` is that of the plan. Returns the other goals, and the phases.
    """
    ways = [goal for goal in goals if isinstance(goal, Waypoint)]
    if phases or not any(isinstance(way.time, tuple) for way in ways):
        return goals, phases
    for way in ways:
        way.check(structure)
    rest = tuple(goal for goal in goals if goal not in ways)
    return rest, phases_between(ways, *limits_of(duration))


def _split_soft(
    goals: tuple[Goal, ...], costs: tuple[Cost, ...], duration: Duration
) -> tuple[tuple[Goal, ...], tuple[Cost, ...]]:
    """Move soft goals from the goals to the costs.

    ``duration`` is that of the plan. Returns the other goals, and the penalties.
    """
    met: list[Goal] = []
    penalties: list[Any] = []
    for goal in goals:
        parts = goal.goals if isinstance(goal, Waypoint) else (goal,)
        soft = [part for part in parts if isinstance(part, SoftGoal)]
        share = fraction_of(goal, duration)
        penalties += soft if share == 1.0 else [CostAt(part, share) for part in soft]
        if isinstance(goal, Waypoint) and 0 < len(soft) < len(parts):
            met.append(replace(goal, goals=tuple(part for part in parts if part not in soft)))
        elif not soft:
            met.append(goal)
    for cost in (*costs, *penalties):
        soft_goal = cost.cost if isinstance(cost, CostAt) else cost
        if isinstance(soft_goal, SoftGoal) and soft_goal.goal.repeats_start:
            raise ValueError(
                "Problem.goals has Periodic().soft(), and the start is free: give Periodic(start=...), or Periodic()"
            )
    return tuple(met), tuple(penalties)


def join_soft(
    goals: Iterable[Goal], costs: Iterable[Cost]
) -> tuple[tuple[Goal, ...], tuple[Cost, ...]]:
    """Move soft goals from the costs back to the goals.

    This is the inverse of `_split_soft`. Returns goals and costs.
    """
    given, own = list(goals), []
    for cost in costs:
        if isinstance(cost, CostAt) and isinstance(cost.cost, SoftGoal):
            given.append(Waypoint([cost.cost], share=cost.share))
        elif isinstance(cost, SoftGoal):
            given.append(cost)
        else:
            own.append(cost)
    return tuple(given), tuple(own)


def drop_derived(bounds: Iterable[Bound]) -> tuple[Bound, ...]:
    """Drop the bounds that follow from the strings' strength."""
    return tuple(bound for bound in bounds if not isinstance(bound, StrengthLimits))


def _drop_strength_states(model: Model, start: Any) -> Any:
    """Remove the states that record broken or yielded strings.

    The start is a state (nx,). Raises ValueError if a string has failed.
    """
    if not count_states(model.scene) or nesting(start) != 1:  # none, nodes or FreeStart
        return start
    state = finite_array("Problem.start", start, (None,))
    if len(state) != model.nx:
        return state
    require_intact("Problem.start", model.scene, model.split(state).internal)
    return drop_states(model.scene, state)


def _check_limits(structure: Structure, bounds: tuple[Bound, ...], strength: Array) -> None:
    for kind in (ForceDensityLimits, TensionLimits, RestLengthLimits):
        lower, upper = string_limits(structure, bounds, kind)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            if kind is TensionLimits and upper[i] == strength[i]:
                raise ValueError(
                    f"TensionLimits.lower is {lower[i]:g} for {kind.names_of(structure)[i]}: "
                    f"Problem.strength leaves {upper[i]:g} N to plans, give a smaller one"
                )
            raise ValueError(
                f"Problem.bounds: {kind.__name__} leave {kind.names_of(structure)[i]} nothing, lower {lower[i]:g} and upper {upper[i]:g}: widen one"
            )


def _check_phases(found: Resolved, divided: bool) -> None:
    """Check that phases are consistent with the problem.

    ``found`` has the fields of the problem. ``divided`` tells whether the phases come from
    waypoints. Raises TypeError, ValueError.
    """
    try:
        require_force_densities(found.model, "Problem.phases")
        if isinstance(found.start, FreeStart):
            raise ValueError(
                "Problem.start is free, and phases begin with nodes on the ground: give the start"
            )
        check_phases(found.model, found.start, found.phases, found.goals, found.bounds, found.costs)
    except (TypeError, ValueError) as error:
        if not divided:
            raise
        raise ValueError(
            f"{error}; a range as Waypoint.time makes phases: or give one time, or a share"
        ) from None
