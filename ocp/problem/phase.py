"""Phases of a plan, each with fixed contact nodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca

from ocp.problem.bounds.bound import Bound, RateBound
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal
from ocp.problem.instant import symbolic
from ocp.problem.reading import limits_of, read_duration, read_items
from tenscasadi.schema.field_types import SPAN, Members
from tenscasadi.schema.value import Value
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import (
    Array,
    IndexOrName,
    as_tuple,
    check_indices,
    index_or_name,
)

if TYPE_CHECKING:
    from ocp.problem.goals.waypoints import Waypoint
    from tenscasadi.dynamics.model import Model


@rename_fields(stands="contact_nodes", until="end_time")
@dataclass(frozen=True, eq=False)
class Phase(Value, kind="Phase"):
    """Stance or flight phase with fixed contact nodes.

    Jumps, landings and steps are plans of several phases. Contact nodes keep their positions. Their
    normal forces are compressive, and their tangential forces stay within the friction cone. At the
    beginning of a phase, nodes that come into contact have an inelastic impact.

    Parameters
    ----------
    duration : float or (float, float)
        Duration [s], or its limits (shortest, longest), between which the solver chooses.
    contact_nodes : sequence of int or str, optional
        Nodes in contact with the ground; none in a flight phase.
    goals : iterable of goals, optional
        Goals at the end of the phase, such as `CenterOfMass` at the top of a jump.
    bounds : iterable of bounds, optional
        Limits in this phase, in addition to those of the problem.
    end_time : (float, float), optional
        Earliest and latest end of the phase, measured from the start of the plan [s]. Default: the
        durations alone limit it.

    Raises
    ------
    TypeError, ValueError
        If a value has the wrong type or is out of range. In a `Problem`: if a node does not exist,
        or has no ground.

    See Also
    --------
    Problem : Takes a sequence of phases.

    Examples
    --------
    >>> import ocp
    >>> push = ocp.Phase(duration=(0.1, 0.5), contact_nodes=[0, 1, 2])
    >>> flight = ocp.Phase(duration=(0.05, 0.5), goals=[ocp.CenterOfMass((None, None, 0.7))])
    >>> push.shortest, flight.longest, flight.contact_nodes
    (0.1, 0.5, ())
    """

    duration: float | tuple[float, float]
    contact_nodes: Annotated[Sequence[IndexOrName], Members("node")] = ()
    goals: Iterable[Goal] = ()
    bounds: Iterable[Bound] = ()
    end_time: Annotated[tuple[float, float] | None, SPAN] = None

    def __post_init__(self) -> None:
        own = self.__dict__
        own["duration"] = read_duration("Phase.duration", self.duration)
        nodes = as_tuple("Phase.contact_nodes", self.contact_nodes, "[0, 1, 2]")
        own["contact_nodes"] = tuple(index_or_name("Phase.contact_nodes", node) for node in nodes)
        if len(set(own["contact_nodes"])) < len(own["contact_nodes"]):
            raise ValueError(f"Phase.contact_nodes is {own['contact_nodes']}: give each node once")
        own["goals"] = read_items("Phase.goals", self.goals, Goal, "[AtRest()]")
        own["bounds"] = read_items(
            "Phase.bounds", self.bounds, Bound, "[ForceDensityLimits(0, 200)]"
        )
        if self.end_time is not None:
            own["end_time"] = limits_of(read_duration("Phase.end_time", self.end_time))

    @property
    def shortest(self) -> float:
        """Shortest duration [s]."""
        return limits_of(self.duration)[0]

    @property
    def longest(self) -> float:
        """Longest duration [s]."""
        return limits_of(self.duration)[1]


def phases_between(
    waypoints: Sequence[Waypoint], shortest: float, longest: float
) -> tuple[Phase, ...]:
    """Build the phases between waypoints whose times are free.

    Raises ValueError if the times contradict each other or the duration. The total duration is
    between ``shortest`` and ``longest`` [s].
    """
    least = 1e-2 * longest
    spans = [one.time for one in waypoints if isinstance(one.time, tuple)]
    ends = [(0.0, 0.0), *spans, (shortest, longest)]
    if len(spans) < len(waypoints):
        raise ValueError(
            "Problem.goals has waypoints of free and of given times: give each Waypoint(time=(earliest, latest))"
        )
    for earliest, latest in spans:
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
        span = max(least, earliest - last_begun), latest - begun
        goals = waypoints[k].goals if k < len(waypoints) else ()
        phases.append(Phase(span, goals=goals, end_time=(earliest, latest)))
    return tuple(phases)


def reject_phases(phases: Sequence[Phase], user: str) -> None:
    """Raise ValueError if a problem has phases.

    ``user`` names the function that does not support them.
    """
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
    """Check that phases are consistent with the problem.

    The other arguments are fields of the problem; ``start`` (nx,) is its initial state. Raises
    TypeError, ValueError.
    """
    structure, scene = model.scene.structure, model.scene
    reduced = model.coordinates == "reduced" and not model.mechanism.joints
    if not reduced or scene.supports is not None or scene.has_clock:
        raise ValueError(
            'Problem.phases needs Model(scene, coordinates="reduced") of a scene in which nothing depends on time'
        )
    named: list[Any] = [("Problem", goals, bounds)]
    named += [(f"Problem.phases[{k}]", one.goals, one.bounds) for k, one in enumerate(phases)]
    for name, own_goals, own_bounds in named:
        for goal in own_goals:
            if goal.timing != "end":
                kind = type(goal).__name__
                raise ValueError(
                    f"{name}.goals has a {kind}, and phases have goals at their ends alone: end a phase where it is to be met"
                    if goal.timing != "soft"
                    else f"{name}.goals has a SoftGoal, and goals of phases are met: give it to the problem, for the end of the last"
                )
        for bound in own_bounds:
            if isinstance(bound, RateBound):
                raise ValueError(
                    f"{name}.bounds has {type(bound).__name__}, which would not hold from phase to phase: leave it out"
                )
    _check_costs(model, costs)
    for phase in phases:
        for goal in phase.goals:
            goal.check(structure)
        for bound in phase.bounds:
            bound.check(structure)
    _check_contact(model, start, phases)


def _check_costs(model: Model, costs: Sequence[Cost]) -> None:
    """Check that costs do not depend on the total time.

    Raises ValueError, as only the time since the beginning of the phase is known within it.
    """
    for cost in costs:
        now, terms = symbolic(model), cost.terms()
        if any(share < 1.0 for share, _ in terms.instants):
            raise ValueError(
                "Problem has a soft Waypoint, whose time is that of the whole plan: with phases give goals of phases"
            )
        instants = () if cost.additive else (one for _, one in terms.instants)
        if any(ca.depends_on(one(now), now.time) for one in (*terms.running, *instants)):
            raise ValueError(
                f"Problem.costs has {type(cost).__name__}, which depends on the time: with phases give goals of phases"
            )


def _check_contact(model: Model, start: Array, phases: Sequence[Phase]) -> None:
    """Check that the scene has a ground for contact nodes.

    The contact nodes of the first phase have to start on it. Raises ValueError.
    """
    structure, grounds = model.scene.structure, model.scene.grounds
    on_bodies = {node for body in structure.bodies for node in body.nodes}
    for k, phase in enumerate(phases):
        name = f"Problem.phases[{k}].contact_nodes"
        check_indices(name, phase.contact_nodes, len(structure.nodes))
        for node in phase.contact_nodes:
            if structure.held[node].any():
                raise ValueError(
                    f"{name} has node {node}, which is pinned: leave it out, it does not move anyway"
                )
            if node in on_bodies:
                raise ValueError(
                    f"{name} has node {node} of a rigid body, which phases do not hold: "
                    "give nodes at which bars end"
                )
            if len(grounds) != 1:
                raise ValueError(
                    f"{name} has nodes, and the scene has {len(grounds) or 'no'} grounds: give Scene(..., ground=tc.Ground(friction=...))"
                )
            if grounds[0].bars is not None:
                raise ValueError(
                    f"{name} has nodes, and {type(grounds[0]).__name__}.bars touch the ground, which phases do not hold: "
                    "give a ground without bars"
                )
            if grounds[0].friction is None:
                raise ValueError(
                    f"{name} has nodes, and the ground has no friction to hold them: give Ground(..., friction=0.6)"
                )
            if grounds[0].nodes is not None and node not in grounds[0].nodes:
                raise ValueError(
                    f"{name} has node {node}, on which the ground does not act: name it in {type(grounds[0]).__name__}.nodes"
                )
    if phases and phases[0].contact_nodes:
        size = measure_diagonal(structure.nodes)
        depths = grounds[0].depth(model.nodes(start).T).full().ravel()
        for node in phases[0].contact_nodes:
            if abs(depths[node]) > 1e-2 * size:  # closer nodes count as in contact
                side = "below" if depths[node] > 0 else "above"
                raise ValueError(
                    f"Problem.phases[0].contact_nodes has node {node}, which starts {abs(depths[node]):.3g} m {side} the ground: "
                    "start where it touches"
                )
