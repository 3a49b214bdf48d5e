"""Model predictive control: disturbances are rejected, limits are kept."""

from __future__ import annotations

import numpy as np
import pytest
from controlling import ARM, MODEL, gust, misfit, problem
from planning import driven

import ocp
import tenscasadi as tc


@pytest.mark.parametrize("along_plan", [True, False])
def test_predictive_control_rejects_a_gust(plan, along_plan):
    controller = ocp.Mpc(problem(), 0.05, 8, plan=plan if along_plan else None)
    held = ocp.run(controller, 2.0, gust())
    assert held.trajectory.success
    assert misfit(held.trajectory) < 0.05
    controller.reset()
    again = ocp.run(controller, 0.2, gust())
    assert again.trajectory.nodes[-1] == pytest.approx(held.trajectory.nodes[40], abs=1e-9)


def test_predictive_control_recovers_from_a_push():
    controller = ocp.Mpc(problem(), 0.05, 8)

    def push(time, x):
        if abs(time - 1.0) > 1e-9:
            return x
        nodes = MODEL.nodes(x)
        squeezed = MODEL.state(
            nodes, MODEL.velocities(x) + 0.5 * (nodes - nodes.mean(axis=0)) * [1.0, 1.0, -1.0]
        )
        return tc.Projection().step(MODEL)(squeezed).full().ravel()

    held = ocp.run(controller, 3.0, disturbance=push).trajectory
    height = np.linalg.norm(held.nodes[:, 4] - held.nodes[:, 1], axis=1)
    assert np.ptp(height[200:300]) > 5 * np.ptp(height[180:200])  # it was felt
    assert misfit(held) < 0.02


def test_predictive_control_keeps_limits_of_the_path():
    free, held = (
        ocp.run(ocp.Mpc(problem(*bounds), 0.05, 8), 1.5).trajectory
        for bounds in ((), (ocp.TensionLimits(upper=3.0),))
    )
    assert free.tension.max() > 3.2
    assert held.tension.max() < 3.1
    assert misfit(held) < 0.02


def rest_lengths(trajectory, stiffness, steps=10):
    """At the decisions."""
    rows = trajectory.nodes[:-1:steps][:, trajectory.strings]
    return np.linalg.norm(rows[:, :, 1] - rows[:, :, 0], axis=2) * (
        1 - trajectory.control[:-1:steps] / stiffness
    )


def test_predictive_control_winds_no_faster_than_motors_do():
    bound = ocp.RestLengthRateLimits(0.1, stiffness=1000.0)
    free, held = (
        ocp.run(ocp.Mpc(problem(*bounds), 0.05, 8), 1.5).trajectory for bounds in ((), (bound,))
    )
    rates = [
        np.abs(np.diff(rest_lengths(trajectory, 1000.0), axis=0)).max() / 0.05
        for trajectory in (free, held)
    ]
    assert rates[0] > 0.5
    assert rates[1] < 0.1001
    assert misfit(held) < 0.02


def test_another_run_begins_anew():
    controller = ocp.Mpc(problem(ocp.RestLengthRateLimits(0.1, stiffness=1000.0)), 0.05, 5)
    first, second = (ocp.run(controller, 0.2).trajectory for _ in range(2))
    assert np.array_equal(first.control, second.control)


def test_runs_count_decisions_without_a_solution():
    """The sensitivities of a state at 1e98 m/s are not finite."""
    controller = ocp.Mpc(problem(), 0.05, 5)
    assert not ocp.run(controller, 0.2).failed.any()
    held = ocp.run(controller, 0.2, disturbance=lambda time, x: x * 1e98 if time > 0.07 else x)
    assert list(held.failed) == [False, False, True]
    assert not held.trajectory.success
    assert "no solution in 1 of 3 decisions" in held.trajectory.message
    assert controller.failed


def test_a_plan_passes_waypoints_for_the_controller():
    goals = [
        ocp.NodePositions({1: (0.3, 0.1, None)}),
        ocp.AtRest(),
        ocp.Waypoint([ocp.NodePositions({1: (-0.2, 0.2, None)})], share=0.5),
    ]
    asked = ocp.Problem(
        driven(ARM),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
        costs=[ocp.Effort()],
    )
    with pytest.raises(ValueError, match=r"problem has Waypoint, which needs a plan"):
        ocp.Mpc(asked)
    found = ocp.solve(asked, ocp.MultipleShooting(20))
    held = ocp.run(ocp.Mpc(asked, 0.05, 8, plan=found), 1.0).trajectory
    assert held.nodes[100, 1, :2] == pytest.approx([-0.2, 0.2], abs=0.02)
    assert held.nodes[-1, 1, :2] == pytest.approx([0.3, 0.1], abs=0.02)


@pytest.mark.parametrize(
    "change",
    [{"start": ocp.FreeStart()}, {"goals": [ocp.Periodic()]}],
    ids=["FreeStart", "Periodic"],
)
def test_motions_need_a_plan(change):
    asked = ocp.Problem(MODEL, 1.0, bounds=[ocp.ForceDensityLimits(1.0, 100.0)], **change)
    with pytest.raises(ValueError, match=r"problem has (FreeStart|Periodic), which needs a plan"):
        ocp.Mpc(asked)


def test_an_anchored_arm_is_held():
    goals = [ocp.NodePositions({1: (0.4, 0.0, None)}), ocp.AtRest()]
    asked = ocp.Problem(driven(ARM), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    held = ocp.run(ocp.Mpc(asked, 0.05, 10), 2.0, driven(ARM, gravity=tc.Gravity((0, 0, -1.0))))
    assert held.trajectory.nodes[-1, 1] == pytest.approx([0.4, 0.0, np.sqrt(1 - 0.16)], abs=0.02)


def test_a_structure_that_needs_no_force_at_the_goal_is_moved_there():
    cross, folded = driven(tc.shapes.d_bar(pinned=[0])), tc.shapes.d_bar(angle=0.7).string_lengths
    held = ocp.run(
        ocp.Mpc(ocp.Problem(cross, goals=[ocp.StringLengths(folded), ocp.AtRest()]), 0.1, 5), 2.0
    ).trajectory
    assert cross.structure.replace(nodes=held.nodes[-1]).string_lengths == pytest.approx(
        folded, abs=0.01
    )


STATE = MODEL.initial_state


BAD = {
    "mpc at a state too short": (
        lambda plan: ocp.Mpc(problem()).control(0.0, STATE[:3]),
        ValueError,
        r"state has shape \(3,\)",
    ),
    "mpc at no state": (lambda plan: ocp.Mpc(problem()).control(0.0, None), TypeError, "state"),
    "mpc at a state that is no number": (
        lambda plan: ocp.Mpc(problem()).control(0.0, STATE * np.nan),
        ValueError,
        r"state\[0\] is nan",
    ),
    "mpc at a word": (lambda plan: ocp.Mpc(problem()).control("a", STATE), TypeError, "time"),
    "mpc before the beginning": (
        lambda plan: ocp.Mpc(problem()).control(-1.0, STATE),
        ValueError,
        "time is -1",
    ),
    "mpc of no problem": (lambda plan: ocp.Mpc(MODEL), TypeError, "problem"),
    "period zero": (lambda plan: ocp.Mpc(problem(), 0.0), ValueError, "period"),
    "intervals zero": (lambda plan: ocp.Mpc(problem(), 0.1, 0), ValueError, "intervals"),
    "plan no plan": (lambda plan: ocp.Mpc(problem(), plan=1), TypeError, "plan"),
    "effort zero": (
        lambda plan: ocp.Mpc(problem(), control_scale=0.0),
        ValueError,
        "control_scale",
    ),
    "mpc along another structure": (
        lambda plan: ocp.Mpc(ocp.Problem(driven(tc.shapes.d_bar())), plan=plan),
        ValueError,
        "plan is of another structure than the problem",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(plan, name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make(plan)
