"""Plans of the suite integrated by SciPy: they miss their goals by what they say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ocp_problems.case import Case
from ocp_problems.shape_changes import large_cases, small_cases
from ocp_problems.tasks import constrained_cases, reaching_cases
from scipy.integrate import solve_ivp

import ocp

KINDS = ("prism", "D-bar, T-bar", "free duration", "arm", "loads", "least time", "limits", "costs")
LONG = ("prism of 8", "prism of 12", "arm of five bars", "ball", "tower")
CASES = [
    case
    for case in (*small_cases(), *large_cases(), *reaching_cases(), *constrained_cases())
    if case.kind in KINDS and not case.name.startswith(LONG)
]


def end_by_scipy(plan: ocp.Plan) -> tuple[Any, Any]:
    """Return nodes (n, 3) and velocities (n, 3) at the end of the plan's motion."""
    model, x = plan.model, plan.trajectory.states[0]
    linear = len(plan.force_density) == len(plan.time)
    for k, (first, last) in enumerate(zip(plan.time[:-1], plan.time[1:], strict=True)):

        def slope(t: float, y: Any, k: int = k, first: float = first, last: float = last) -> Any:
            share = (t - first) / (last - first) if linear else 0.0
            gamma = (
                plan.force_density[k]
                if not share
                else (1 - share) * plan.force_density[k] + share * plan.force_density[k + 1]
            )
            return model.ode(y, gamma).full().ravel()

        x = solve_ivp(slope, (first, last), x, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return model.nodes(x), model.velocities(x)


def missed(problem: ocp.Problem, nodes: Any, velocities: Any) -> tuple[list[float], list[float]]:
    """Return by how many m, and m/s, the goals at the end are missed."""
    places, speeds = [0.0], [0.0]
    structure = problem.model.scene.structure
    for goal in problem.goals:
        if isinstance(goal, ocp.StringLengths):
            a, b = structure.strings.T
            lengths = np.linalg.norm(nodes[b] - nodes[a], axis=1)
            places.append(abs(lengths - goal.lengths).max())
        elif isinstance(goal, ocp.NodePositions):
            places += [
                abs(nodes[node, axis] - wanted)
                for node, place in goal.positions.items()
                for axis, wanted in enumerate(place)
                if wanted is not None
            ]
        elif isinstance(goal, ocp.AtRest):
            speeds.append(abs(velocities).max())
    return places, speeds


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_replay_error_is_that_of_scipy(case: Case) -> None:
    problem = case.problem()
    plan = ocp.solve(problem, tolerance=case.tolerance)
    assert plan.success, plan.message
    nodes, velocities = end_by_scipy(plan)
    replayed = plan.replay()
    grown = 1e-12 * plan.error_growth  # what both integrators leave
    apart = np.linalg.norm(replayed.nodes[-1] - nodes, axis=1).max()
    apart_speed = abs(replayed.velocities[-1] - velocities).max()
    estimate = replayed.error_estimate + 1e-9 + grown  # which holds for positions
    assert apart < estimate
    assert apart_speed < 10 * estimate + 1e-6
    # Of the goals as they are asked: errors of the replay hold what follows from them, too. Both
    # ends of a string may be apart.
    places, speeds = missed(problem, nodes, velocities)
    assert max(places) < plan.replay_error + 2 * apart + 1e-12
    assert max(speeds) < plan.replay_speed_error + apart_speed + 1e-12
