"""The search for a plan by several attempts."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven, raising

import ocp
import tenscasadi as tc
from ocp.results.diagnosis import interpolate_plan
from ocp.search.find_plan import find_plan
from ocp.search.task import prepare
from ocp.solvers.monitor import Monitor


@pytest.mark.parametrize("solver", [ocp.Ipopt(), ocp.CondensedNewton()])
def test_bars_come_to_rest_at_right_angles_to_the_target(solver):
    """A bar that turns by 90° in the given time keeps its speed along the target's bar.

    The row of `AtRest` that the bar's length makes redundant at the target is not so there.
    """
    anchors = [[0, 2, 0], [0, -2, 0], [2, 0, 0], [-2, 0, 0]]
    strings = [[1, node] for node in range(2, 6)]
    structure = tc.Structure(
        [[0, 0, 0], [1, 0, 0], *anchors], [[0, 1]], strings, pinned=[0, 2, 3, 4, 5]
    )
    model, speed = driven(structure), np.pi / 2

    def turned(angle):
        nodes, velocities = structure.nodes.copy(), np.zeros((6, 3))
        nodes[1] = np.cos(angle), np.sin(angle), 0.0
        velocities[1] = -speed * np.sin(angle), speed * np.cos(angle), 0.0
        return model.state(nodes, velocities)

    free = [turned(angle) for angle in np.linspace(0.0, np.pi / 2, 13)]
    bounds = [ocp.ForceDensityLimits(upper=100.0)]
    problem = ocp.Problem(model, 1.0, free[0], [ocp.AtRest()], bounds, costs=[ocp.Effort()])
    guess = ocp.TrajectoryGuess(free, np.full((12, 4), 0.1))
    plan = ocp.solve(problem, ocp.Variational(12), solver, guess)
    assert plan.success, plan.message
    assert abs(plan.trajectory.velocities[-1]).max() < 1e-6
    other = ocp.solve(problem, ocp.Variational(12), solver)
    assert plan.objective == pytest.approx(other.objective, rel=1e-3)
    ends = [
        prepare(problem, ocp.PiecewiseConstant(), 0.01, near=near).target.state
        for near in (None, interpolate_plan(plan))
    ]
    distances = [abs(model.nodes(end) - plan.trajectory.nodes[-1]).max() for end in ends]
    assert distances[1] < 1e-3 < distances[0]  # next attempts start from the end of the plan


def test_a_goal_that_fixes_a_free_duration_is_met():
    """Supports come back after 1 s, where their velocity vanishes: bars meet no goal at other times."""
    low = tc.shapes.prism(pinned=[0, 1, 2])
    feet = {
        k: lambda t, place=tuple(low.nodes[k]): (
            *place[:2],
            place[2] + 0.05 * ca.sin(np.pi * t) ** 2,
        )
        for k in range(3)
    }
    model = driven(low, supports=tc.SupportMotion(feet))
    goals = [ocp.NodePositions({k: tuple(low.nodes[k]) for k in (4, 5)}), ocp.AtRest()]
    bounds = [ocp.ForceDensityLimits(1.0, 200.0)]
    problem = ocp.Problem(model, (0.5, 2.0), goals=goals, bounds=bounds, costs=[ocp.Effort()])
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert np.abs(plan.trajectory.nodes[-1][4:] - low.nodes[4:]).max() < 0.01


def test_interruption_before_the_solver_begins_blames_no_limit():
    monitor = Monitor()
    monitor.interrupted = True
    plan = find_plan(raising(), ocp.Variational(6), monitor=monitor)
    assert "before the solver began" in plan.message
    assert "time_limit" not in plan.message
