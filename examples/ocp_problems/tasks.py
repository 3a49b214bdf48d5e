"""Planning problems with arms, waypoints, minimum time, loads and constraints."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

import ocp
import tenscasadi as tc
from ocp.problem.bounds.bound import Bound
from ocp.problem.costs import Cost
from ocp_problems.case import Case
from ocp_problems.shape_changes import EFFORT, Span, ball, free_prism, free_tower, standing_prism
from ocp_problems.structures import arm, driven, prism, tower


def reach(
    place: float,
    weight: bool = False,
    duration: Span = 1.0,
    costs: tuple[Cost, ...] = EFFORT,
    top: float = 300.0,
) -> ocp.Problem:
    """Inclination of a hinged bar between four strings."""
    model = driven(arm(), gravity=tc.Gravity() if weight else None)
    goals = [ocp.NodePositions({1: (place, 0.2, None)}), ocp.AtRest()]
    return ocp.Problem(
        model, duration, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, top)], costs=costs
    )


def long_arm(bars: int, lean: float, weight: bool = False) -> ocp.Problem:
    """Sideways motion of the tip of an arm of several bars."""
    model = driven(arm(bars), gravity=tc.Gravity() if weight else None)
    goals = [ocp.NodePositions({bars: (lean, 0.1, None)}), ocp.AtRest()]
    return ocp.Problem(
        model, 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 300.0)], costs=EFFORT
    )


def there_and_back(height: float = 1.1) -> ocp.Problem:
    """Height change of a prism and return to its initial state."""
    goals = [ocp.Waypoint([ocp.Shape(prism(3, height).nodes)], time=0.5), ocp.Periodic()]
    return ocp.Problem(
        driven(prism(3, 1.0)),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(2.0, 200.0)],
        costs=EFFORT,
    )


def prism_by_way_of(*heights: float, duration: Span = 1.0) -> ocp.Problem:
    """Height changes of a prism, one after another, as waypoints."""
    *between, last = heights
    waypoints = [
        ocp.Waypoint([ocp.StringLengths(prism(3, h).string_lengths)], share=(k + 1) / len(heights))
        for k, h in enumerate(between)
    ]
    goals = [*waypoints, ocp.StringLengths(prism(3, last).string_lengths), ocp.AtRest()]
    return ocp.Problem(
        driven(prism(3, 1.0)),
        duration,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(2.0, 200.0)],
        costs=EFFORT,
    )


def arm_by_way_of(side: float) -> ocp.Problem:
    """Inclination of an arm through a waypoint at the side."""
    goals = [
        ocp.Waypoint([ocp.NodePositions({1: (0.0, side, None)})], share=0.5),
        ocp.NodePositions({1: (0.4, 0.2, None)}),
        ocp.AtRest(),
    ]
    return ocp.Problem(
        driven(arm()), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 300.0)], costs=EFFORT
    )


def limited(*bounds: Bound, costs: tuple[Cost, ...] = EFFORT) -> ocp.Problem:
    """Height change of a prism with additional bounds."""
    asked = free_prism(3, 1.0, 1.1)
    return ocp.Problem(
        asked.model, 1.0, goals=asked.goals, bounds=[*asked.bounds, *bounds], costs=costs
    )


def within(asked: ocp.Problem, *bounds: Bound) -> ocp.Problem:
    """Problem with additional bounds."""
    return ocp.Problem(
        asked.model,
        asked.duration,
        goals=asked.goals,
        bounds=[*asked.bounds, *bounds],
        costs=asked.costs,
    )


def leaning_tower(stages: int) -> ocp.Problem:
    """Sideways motion of an upper node of a tower with pinned lowest ring."""
    structure, top = tower(stages, 0.8, pinned=range(3)), 3 * stages
    x, y, _ = structure.nodes[top]
    goals = [ocp.NodePositions({top: (x + 0.125 * stages, y, None)}), ocp.AtRest()]
    return ocp.Problem(
        driven(structure),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 500.0)],
        costs=EFFORT,
    )


def around(stages: int) -> ocp.Obstacle:
    """Spherical obstacle on the straight path of that node."""
    nodes, top, way = tower(stages, 0.8).nodes, 3 * stages, 0.125 * stages
    return ocp.Obstacle(
        nodes[top] + np.array([0.4, 0.2, -0.2]) * way,
        0.3 * way,
        bars=[],
        nodes=[top, top + 1, top + 2],
    )


def past_a_ball(stages: int) -> ocp.Problem:
    """Motion of `leaning_tower` that avoids the obstacle."""
    return within(leaning_tower(stages), around(stages))


def slowly(stages: int) -> ocp.Problem:
    """Height change of an unsupported tower with limited node velocities."""
    return within(free_tower(stages), slow(0.3 * stages))


def short(stages: int) -> ocp.Problem:
    """Height change of an unsupported tower with limited string lengths.

    The limits are the larger of the initial and final lengths, plus 1 %.
    """
    longest = np.maximum(*(tower(stages, height).string_lengths for height in (0.8, 0.88)))
    return within(
        free_tower(stages), ocp.Constraint("length", lambda now: now.lengths, upper=1.01 * longest)
    )


def beside(stages: int) -> ocp.Problem:
    """Motion of `leaning_tower` through a waypoint beside the obstacle."""
    asked, top, way = leaning_tower(stages), 3 * stages, 0.125 * stages
    x, y, _ = asked.model.scene.structure.nodes[top]
    waypoint = ocp.Waypoint(
        [ocp.NodePositions({top: (x + 0.4 * way, y - 0.45 * way, None)})], share=0.5
    )
    bounds = [*asked.bounds, around(stages), slow(1.6 * way)]
    return ocp.Problem(
        asked.model, 1.0, goals=[waypoint, *asked.goals], bounds=bounds, costs=EFFORT
    )


def quickest(asked: ocp.Problem) -> ocp.Problem:
    """Problem with minimum duration, 0.2 to 2 s, and a small cost of effort."""
    return ocp.Problem(
        asked.model,
        (0.2, 2.0),
        goals=asked.goals,
        bounds=asked.bounds,
        costs=[ocp.Duration(), ocp.Effort(1e-5)],
    )


def loaded(structure: tc.Structure, rise: float, **scene: Any) -> ocp.Problem:
    """Lifting of the top of a structure of three-node rings against a load."""
    top = range(len(structure.nodes) - 3, len(structure.nodes))
    goals = [
        ocp.NodePositions({k: (None, None, structure.nodes[k, 2] + rise) for k in top}),
        ocp.AtRest(),
    ]
    return ocp.Problem(
        driven(structure, **scene),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 500.0)],
        costs=EFFORT,
    )


def wind(structure: tc.Structure, force: float) -> tc.NodalForce:
    """Gusts along x as forces on all nodes that are not pinned."""
    free = np.ones((len(structure.nodes), 1))
    free[:3] = 0
    return tc.NodalForce(lambda t: ca.DM(free @ [[force, 0, 0]]) * (1 + 0.5 * ca.sin(6 * t)))


def shaken(lift: float) -> ocp.Problem:
    """Lifting of a prism's top while its supports move."""
    structure = prism(3, 1.0, pinned=range(3))
    feet = {
        k: (lambda t, x=x, y=y: (x + 0.03 * ca.sin(2 * np.pi * t) ** 2, y, 0.0))
        for k, (x, y, _) in enumerate(structure.nodes[:3])
    }
    return loaded(structure, lift, supports=tc.SupportMotion(feet))


def in_full_coordinates(asked: ocp.Problem) -> ocp.Problem:
    """Problem of the same model in full coordinates."""
    model = tc.Model(asked.model.scene, coordinates="full")
    return ocp.Problem(
        model, asked.duration, goals=asked.goals, bounds=asked.bounds, costs=asked.costs
    )


def reaching_cases() -> Iterator[Case]:
    """Yield problems of arms, waypoints and minimum time."""
    yield Case("arm", "arm leans", partial(reach, 0.4), 1e-4, True)
    yield Case("arm", "arm leans far", partial(reach, -0.7), 1e-4)
    yield Case("arm", "arm leans under its weight", partial(reach, 0.4, True), 1e-4)
    yield Case("arm", "arm of two bars", partial(long_arm, 2, 0.6), 1e-3)
    yield Case("arm", "arm of three bars", partial(long_arm, 3, 0.8), 1e-3)
    yield Case("arm", "arm of three bars under its weight", partial(long_arm, 3, 0.5, True), 1e-3)
    yield Case("arm", "arm of five bars", partial(long_arm, 5, 1.0), 1e-3)
    yield Case("waypoints", "prism there and back", there_and_back, 2e-4)
    yield Case("waypoints", "prism there and back, far", partial(there_and_back, 1.2), 1e-3)
    yield Case(
        "waypoints", "prism by way of one height", partial(prism_by_way_of, 1.1, 0.9), 1e-3, True
    )
    yield Case(
        "waypoints",
        "prism by way of two heights",
        partial(prism_by_way_of, 1.1, 0.9, 1.05, duration=1.5),
        1e-3,
    )
    yield Case(
        "waypoints",
        "prism by way of one, free duration",
        partial(prism_by_way_of, 1.1, 0.9, duration=(0.8, 2.0)),
        1e-3,
    )
    yield Case("waypoints", "arm by way of a place", partial(arm_by_way_of, -0.4), 1e-3)
    yield Case("least time", "prism, least time", lambda: quickest(free_prism(3, 1.0, 1.1)), 1e-3)
    yield Case(
        "least time", "prism of 4, least time", lambda: quickest(free_prism(4, 1.0, 1.1)), 1e-3
    )
    yield Case("least time", "arm, least time", lambda: quickest(reach(0.4)), 1e-3, True)
    yield Case(
        "least time", "arm under its weight, least time", lambda: quickest(reach(0.4, True)), 1e-3
    )
    yield Case("least time", "tower, least time", lambda: quickest(free_tower(2)), 1e-3)
    yield Case(
        "least time",
        "prism on its feet, least time",
        lambda: quickest(standing_prism(3, 0.1)),
        1e-3,
    )


def constrained_cases() -> Iterator[Case]:
    """Yield problems with loads, constraints, moving supports and other costs."""
    yield Case(
        "limits", "prism, limited tension", lambda: limited(ocp.TensionLimits(upper=12.0)), 1e-4
    )
    yield Case(
        "limits",
        "prism, limited winding",
        lambda: limited(ocp.RestLengthRateLimits(0.4, stiffness=1000.0)),
        1e-4,
    )
    yield Case(
        "limits",
        "prism, limited bar forces",
        lambda: limited(ocp.BarForceLimits(compression=30.0)),
        1e-3,
    )
    yield Case("limits", "prism, a speed limit of its own", lambda: limited(slow(0.25)), 1e-3)
    yield Case(
        "limits",
        "arm around an obstacle",
        lambda: within(reach(0.6), ocp.Obstacle((0.3, 0.15, 0.95), 0.12, nodes=[1])),
        1e-3,
    )
    yield Case(
        "limits",
        "tower in a box",
        lambda: within(free_tower(2), ocp.InsideBox(upper=(None, None, 1.685))),
        1e-3,
    )
    yield Case(
        "limits",
        "ball, limited tension",
        lambda: within(ball(0.9), ocp.TensionLimits(upper=20.0)),
        1e-3,
    )
    yield Case(
        "limits", "tower, bars apart", lambda: within(free_tower(2), ocp.BarClearance(0.05)), 1e-3
    )
    for stages in (4, 8):
        bars = 3 * stages
        yield Case(
            "obstacles at size",
            f"tower of {bars} bars round a ball",
            partial(past_a_ball, stages),
            1e-3,
        )
        yield Case(
            "obstacles at size",
            f"tower of {bars} bars by way of a place beside it",
            partial(beside, stages),
            1e-3,
        )
        yield Case(
            "obstacles at size", f"free tower of {bars} bars, slow", partial(slowly, stages), 1e-3
        )
        yield Case(
            "obstacles at size",
            f"free tower of {bars} bars, strings hardly longer",
            partial(short, stages),
            1e-3,
        )
    yield Case("costs", "prism, smooth", lambda: limited(costs=(ocp.Smoothness(),)), 1e-3)
    yield Case(
        "costs", "prism, near a prestress", lambda: limited(costs=(ocp.Prestress(20.0),)), 1e-3
    )
    yield Case(
        "costs", "prism, least work", lambda: limited(costs=(ocp.Work(), ocp.Effort(1e-3))), 1e-3
    )
    yield Case(
        "loads",
        "prism lifts a weight",
        lambda: loaded(prism(3, 1.0, pinned=range(3)), 0.05, gravity=tc.Gravity()),
        1e-3,
    )
    yield Case(
        "loads",
        "prism of heavy nodes",
        lambda: loaded(prism(3, 1.0, pinned=range(3), node_mass=1.0), 0.05, gravity=tc.Gravity()),
        1e-3,
    )
    yield Case(
        "loads",
        "prism in the wind",
        lambda: loaded(prism(3, 1.0, pinned=range(3)), 0.05, forces=wind(prism(3, 1.0), 2.0)),
        1e-3,
    )
    yield Case(
        "loads",
        "tower in the wind",
        lambda: loaded(tower(2, 0.8, pinned=range(3)), 0.1, forces=wind(tower(2, 0.8), 1.0)),
        1e-3,
    )
    yield Case("coordinates", "prism on shaken feet", partial(shaken, 0.05), 1e-3)
    yield Case(
        "coordinates",
        "prism, full coordinates",
        lambda: in_full_coordinates(free_prism(3, 1.0, 1.1)),
        1e-3,
    )
    yield Case(
        "coordinates", "tower, full coordinates", lambda: in_full_coordinates(free_tower(2)), 1e-3
    )
    yield Case(
        "coordinates", "arm, full coordinates", lambda: in_full_coordinates(reach(0.4)), 1e-3
    )


def slow(limit: float) -> ocp.Constraint:
    """Constraint that no node is faster than `limit` m/s."""
    return ocp.Constraint("speed", lambda now: ca.sum1(now.velocities**2).T, upper=limit**2)
