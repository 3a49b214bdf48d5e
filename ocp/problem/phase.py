"""A phase of a plan: a time in which the same nodes stand on the ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import Bound, RateBound
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal, SoftGoal
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.instant import symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.schema.field_types import SPAN, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    Array,
    as_tuple,
    finite_array,
    instance,
    nesting,
    node_index,
    positive_number,
    whole_number,
)

SHORTEST = 1e-2  # of a plan's longest duration: what lies between waypoints of free times at least
TOUCHES = 1e-2  # of the structure's size: a node that is nearer to the ground touches it


@dataclass(frozen=True, eq=False)
class Phase(Value, kind="Phase"):
    """A part of a plan in which the same nodes stand on the ground; all others are in the air.

    A plan of several phases is a jump, a landing, steps. Nodes that stand keep their places, as the
    ground pushes on them: never pulls, and never more along itself than its friction holds. Where a
    phase begins with nodes that did not stand before, they land in an impact without rebound.

    Parameters
    ----------
    duration : float or (float, float)
        Seconds, or (shortest, longest) to let the solver choose.
    stands : sequence of int, optional
        Nodes that stand all along; none in a flight.
    goals : iterable of goals, optional
        What is met at the end of the phase, such as `CentreOfMass` at the top of a jump.
    bounds : iterable of bounds, optional
        What holds in this phase, beside the bounds of the problem.
    until : (float, float), optional
        (earliest, latest) time at which the phase ends, s from the start of the plan; None for what
        the durations allow.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; with a problem, if a node does not exist, or cannot stand.

    See Also
    --------
    Problem : Takes phases, one after another.

    Examples
    --------
    >>> import ocp
    >>> push = ocp.Phase(duration=(0.1, 0.5), stands=[0, 1, 2])
    >>> flight = ocp.Phase(duration=(0.05, 0.5), goals=[ocp.CentreOfMass((None, None, 0.7))])
    >>> push.shortest, flight.longest, flight.stands
    (0.1, 0.5, ())
    """

    duration: float | tuple[float, float]
    stands: Annotated[Sequence[int], Members("node")] = ()
    goals: Iterable[Goal] = ()
    bounds: Iterable[Bound] = ()
    until: Annotated[tuple[float, float] | None, SPAN] = None

    def __post_init__(self) -> None:
        own = self.__dict__
        own["duration"] = read_duration("Phase.duration", self.duration)
        own["stands"] = tuple(
            whole_number("Phase.stands", node, 0)
            for node in as_tuple("Phase.stands", self.stands, "[0, 1, 2]")
        )
        if len(set(own["stands"])) < len(own["stands"]):
            raise ValueError(f"Phase.stands is {own['stands']}: give each node once")
        own["goals"] = read_items("Phase.goals", self.goals, Goal, "[AtRest()]")
        own["bounds"] = read_items(
            "Phase.bounds", self.bounds, Bound, "[ForceDensityLimits(0, 200)]"
        )
        if self.until is not None:
            until = read_duration("Phase.until", self.until)
            own["until"] = until if isinstance(until, tuple) else (until, until)

    @property
    def shortest(self) -> float:
        """The least duration, s."""
        return self.duration[0] if isinstance(self.duration, tuple) else self.duration

    @property
    def longest(self) -> float:
        """The greatest duration, s."""
        return self.duration[1] if isinstance(self.duration, tuple) else self.duration


def read_items(field: str, values: Any, kinds: type, example: str) -> tuple[Any, ...]:
    """Return the values as a tuple. Raises TypeError unless all are of a kind."""
    found = as_tuple(field, values, example)
    for k, value in enumerate(found):
        instance(
            f"{field}[{k}]", value, kinds, f"a {kinds.__name__.lower()}, such as {example[1:-1]}"
        )
    return found


def read_duration(field: str, value: Any) -> float | tuple[float, float]:
    """Return seconds, or (shortest, longest). Raises TypeError, ValueError."""
    if nesting(value) == 0:
        return positive_number(field, value)
    pair = finite_array(field, value, (2,))
    shortest = positive_number(f"{field}[0]", pair[0])
    if pair[1] < shortest:
        raise ValueError(f"{field} is ({shortest:g}, {pair[1]:g}): give (shortest, longest)")
    return shortest if pair[1] == shortest else (shortest, float(pair[1]))


def phases_between(
    waypoints: Sequence[Waypoint], shortest: float, longest: float
) -> tuple[Phase, ...]:
    """Return phases that end at waypoints of free times, in their order, and at the end. Raises ValueError where times contradict each other."""
    least = SHORTEST * longest
    ends = [
        (0.0, 0.0),
        *(waypoint.time for waypoint in waypoints if isinstance(waypoint.time, tuple)),
        (shortest, longest),
    ]
    if len(ends) < len(waypoints) + 2:
        raise ValueError(
            "Problem.goals has waypoints of free and of given times: give each Waypoint(time=(earliest, latest))"
        )
    for earliest, latest in ends[1:-1]:
        if earliest > longest:
            raise ValueError(
                f"Waypoint.time is ({earliest:g}, {latest:g}), and the plan takes {longest:g} s at most: give earlier times"
            )
    phases = []
    for k, ((begun, last_begun), (earliest, latest)) in enumerate(pairwise(ends)):
        if latest - begun < least:
            name = (
                f"Waypoint.time is ({earliest:g}, {latest:g})"
                if k < len(waypoints)
                else f"Problem.duration is up to {latest:g}"
            )
            raise ValueError(
                f"{name}, and the waypoint before is met at {begun:g} s or later: give waypoints in the order of their times"
            )
        goals = waypoints[k].goals if k < len(waypoints) else ()
        phases.append(
            Phase(
                (max(least, earliest - last_begun), latest - begun),
                goals=goals,
                until=(earliest, latest),
            )
        )
    return tuple(phases)


def refuse_phases(phases: Sequence[Phase], user: str) -> None:
    """Raise ValueError, saying who cannot, where there are phases."""
    if phases:
        raise ValueError(
            f"{user} takes no problem with phases: give one without, or plan it by ocp.solve"
        )


def check_phases(
    model: Model,
    start: Array,
    phases: Sequence[Phase],
    goals: Sequence[Goal],
    bounds: Sequence[Bound],
    costs: Sequence[Cost],
) -> None:
    """Raise TypeError or ValueError, naming the phase, where phases do not fit the model, its ground, or what else is asked."""
    structure = model.scene.structure
    if (
        model.coordinates != "reduced"
        or model.mechanism.joints
        or model.scene.supports is not None
        or model.scene.has_clock
    ):
        raise ValueError(
            'Problem.phases needs Model(scene, coordinates="reduced") of a scene in which nothing depends on time'
        )
    numbered = [(f"Problem.phases[{k}]", phase) for k, phase in enumerate(phases)]
    for name, goal in [("Problem", goal) for goal in goals] + [
        (name, goal) for name, phase in numbered for goal in phase.goals
    ]:
        if isinstance(goal, (Waypoint, Periodic)):
            kind = type(goal).__name__
            raise ValueError(
                f"{name}.goals has a {kind}, and phases have goals at their ends alone: end a phase where it is to be met"
            )
        if isinstance(goal, SoftGoal):
            raise ValueError(
                f"{name}.goals has a SoftGoal, and goals of phases are met: give it to the problem, for the end of the last"
            )
    for name, bound in [("Problem", bound) for bound in bounds] + [
        (name, bound) for name, phase in numbered for bound in phase.bounds
    ]:
        if isinstance(bound, RateBound):
            raise ValueError(
                f"{name}.bounds has {type(bound).__name__}, which would not hold from phase to phase: leave it out"
            )
    for cost in costs:
        now, terms = symbolic(model), cost.terms()
        if any(share < 1.0 for share, _ in terms.instants):
            raise ValueError(
                "Problem has a soft Waypoint, whose time is that of the whole plan: with phases give goals of phases"
            )
        expressions = [
            *terms.running,
            *(() if cost.additive else (one for _, one in terms.instants)),
        ]
        if any(ca.depends_on(one(now), now.time) for one in expressions):
            raise ValueError(
                f"Problem.costs has {type(cost).__name__}, which depends on the time: with phases give goals of phases"
            )
    for phase in phases:
        for goal in phase.goals:
            goal.check(structure)
        for bound in phase.bounds:
            bound.check(structure)
    _check_standing(model, start, phases)


def _check_standing(model: Model, start: Array, phases: Sequence[Phase]) -> None:
    structure, grounds = model.scene.structure, model.scene.grounds
    for k, phase in enumerate(phases):
        for node in phase.stands:
            name = f"Problem.phases[{k}].stands"
            node_index(name, node, len(structure.nodes))
            if structure.held[node].any():
                raise ValueError(
                    f"{name} has node {node}, which is pinned: leave it out, it does not move anyway"
                )
            if len(grounds) != 1:
                raise ValueError(
                    f"{name} has nodes, and the scene has {len(grounds) or 'no'} grounds: give Scene(..., ground=tc.Ground(friction=...))"
                )
            if grounds[0].friction is None:
                raise ValueError(
                    f"{name} has nodes, and the ground has no friction to hold them: give Ground(..., friction=0.6)"
                )
            if grounds[0].nodes is not None and node not in grounds[0].nodes:
                raise ValueError(
                    f"{name} has node {node}, on which the ground does not act: name it in {type(grounds[0]).__name__}.nodes"
                )
    if phases and phases[0].stands:
        size = float(np.linalg.norm(np.ptp(structure.nodes, axis=0)))
        depths = np.asarray(grounds[0].depth(model.nodes(start).T).full()).ravel()
        for node in phases[0].stands:
            if abs(depths[node]) > TOUCHES * size:
                side = "below" if depths[node] > 0 else "above"
                raise ValueError(
                    f"Problem.phases[0].stands has node {node}, which starts {abs(depths[node]):.3g} m {side} the ground: start where it touches"
                )
