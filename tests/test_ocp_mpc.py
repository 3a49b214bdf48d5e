"""Closed loop: disturbances that ruin a plan are rejected, limits are kept, derivatives are exact."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.linearized import Motion, Tangents

BAR = 1.4


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


MODEL = driven(prism(1.0))
TALL = prism(1.15)


def problem(*bounds):
    goals = [ocp.Shape(TALL.nodes), ocp.AtRest()]
    return ocp.Problem(MODEL, 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0), *bounds], costs=[ocp.Effort()])


@pytest.fixture(scope="module")
def plan():
    return ocp.solve(problem(), ocp.MultipleShooting(20))


def misfit(trajectory):
    """Of the distances between nodes, at the end."""
    pairs = list(combinations(range(6), 2))
    return max(
        abs(np.linalg.norm(trajectory.nodes[-1, a] - trajectory.nodes[-1, b]) - np.linalg.norm(TALL.nodes[a] - TALL.nodes[b])) for a, b in pairs
    )


def gust():
    """A heavier prism, pulled at two nodes in opposite directions."""
    wind = np.zeros((6, 3))
    wind[4, 0], wind[0, 0] = 0.3, -0.3
    return driven(prism(1.0, bar_mass=1.1), forces=tc.NodalForce(wind))


def test_a_regulator_keeps_nearer_to_the_plan(plan):
    alone = tc.simulate(gust(), 1.0, 5e-3, control=plan.force_density, compiled=False)
    tracker = ocp.track(plan, lower=1.0, upper=100.0)
    kept = ocp.run(tracker, 1.0, gust())
    assert kept.trajectory.success
    assert misfit(kept.trajectory) < 0.5 * misfit(alone)
    assert kept.trajectory.force_density.min() >= 1.0
    assert len(kept.seconds) == 20


def test_the_regulator_keeps_to_the_limits_of_the_problem(plan):
    tracker = ocp.track(plan)
    assert tracker.lower == pytest.approx(plan.problem.force_density_limits[0])
    assert tracker.upper == pytest.approx(plan.problem.force_density_limits[1])
    assert tracker.lower[0] > 0
    assert "20 decisions" in repr(tracker)
    assert ocp.track(replace(plan, problem=None)).lower == pytest.approx(np.zeros(9))


def test_without_disturbance_the_regulator_is_the_plan(plan):
    kept = ocp.run(ocp.track(plan), 1.0)
    assert misfit(kept.trajectory) < 1e-3
    assert kept.trajectory.nodes[-1] == pytest.approx(plan.trajectory.nodes[-1], abs=1e-3)


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
        squeezed = MODEL.state(nodes, MODEL.velocities(x) + 0.5 * (nodes - nodes.mean(axis=0)) * [1.0, 1.0, -1.0])
        return tc.Projection().step(MODEL)(squeezed).full().ravel()

    held = ocp.run(controller, 3.0, disturbance=push).trajectory
    height = np.linalg.norm(held.nodes[:, 4] - held.nodes[:, 1], axis=1)
    assert np.ptp(height[200:300]) > 5 * np.ptp(height[180:200])  # it was felt
    assert misfit(held) < 0.02


def test_predictive_control_keeps_limits_of_the_path():
    free, held = (ocp.run(ocp.Mpc(problem(*bounds), 0.05, 8), 1.5).trajectory for bounds in ((), (ocp.TensionLimits(upper=3.0),)))
    assert free.tension.max() > 3.2
    assert held.tension.max() < 3.1
    assert misfit(held) < 0.02


def test_an_anchored_arm_is_held():
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    arm = tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5])
    goals = [ocp.NodePositions({1: (0.4, 0.0, None)}), ocp.AtRest()]
    asked = ocp.Problem(driven(arm), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    held = ocp.run(ocp.Mpc(asked, 0.05, 10), 2.0, driven(arm, gravity=tc.Gravity((0, 0, -1.0))))
    assert held.trajectory.nodes[-1, 1] == pytest.approx([0.4, 0.0, np.sqrt(1 - 0.16)], abs=0.02)


def test_derivatives_of_the_motion_are_exact():
    rng = np.random.default_rng(0)
    motion = Motion(MODEL, 3, 2)
    x, u = MODEL.initial_state + 0.01 * rng.normal(size=36), rng.uniform(1, 10, (3, 9))
    states, points = motion.states(x, u, 0.05)
    A, B = motion.derivatives(points, u, 0.05)
    eps = 1e-6
    for k in range(3):
        own = Motion(MODEL, 1, 2)
        for column in (0, 20, 35):
            step = np.eye(36)[column] * eps
            slope = (own.states(states[k] + step, u[k : k + 1], 0.05)[0][1] - own.states(states[k] - step, u[k : k + 1], 0.05)[0][1]) / (2 * eps)
            assert A[k][:, column] == pytest.approx(slope, abs=1e-7)
        step = np.eye(9)[4] * eps
        slope = (own.states(states[k], u[k : k + 1] + step, 0.05)[0][1] - own.states(states[k], u[k : k + 1] - step, 0.05)[0][1]) / (2 * eps)
        assert B[k][:, 4] == pytest.approx(slope, abs=1e-7)


def test_tangents_are_what_bars_allow():
    Z = Tangents(MODEL, MODEL.initial_state)(MODEL.initial_state)
    assert Z.shape == (36, 30)
    assert pytest.approx(np.eye(30), abs=1e-12) == Z.T @ Z
    moved = MODEL.initial_state + 1e-4 * Z @ np.ones(30)
    assert MODEL.bar_length_error(moved) < 1e-6


BAD = {
    "mpc of no problem": (lambda plan: ocp.Mpc(MODEL), TypeError, "problem"),
    "period zero": (lambda plan: ocp.Mpc(problem(), 0.0), ValueError, "period"),
    "intervals zero": (lambda plan: ocp.Mpc(problem(), 0.1, 0), ValueError, "intervals"),
    "plan no plan": (lambda plan: ocp.Mpc(problem(), plan=1), TypeError, "plan"),
    "effort zero": (lambda plan: ocp.Mpc(problem(), effort=0.0), ValueError, "effort"),
    "track no plan": (lambda plan: ocp.track(1), TypeError, "plan"),
    "track at no place": (lambda plan: ocp.track(plan, place=-1.0), ValueError, "place"),
    "run of another plant": (lambda plan: ocp.run(ocp.track(plan), 1.0, driven(tc.shapes.d_bar())), ValueError, "model has other nodes"),
    "run of no controller": (lambda plan: ocp.run(ocp.Mpc, 1.0), TypeError, "controller is <class .*: give an ocp.Mpc"),
    "mpc along another structure": (
        lambda plan: ocp.Mpc(ocp.Problem(driven(tc.shapes.d_bar())), plan=plan),
        ValueError,
        "plan is of another structure than the problem",
    ),
    "run for no time": (lambda plan: ocp.run(ocp.track(plan), 0.0), ValueError, "t_end"),
    "disturbance of wrong size": (lambda plan: ocp.run(ocp.track(plan), 1.0, disturbance=lambda t, x: x[:3]), ValueError, "disturbance"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(plan, name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make(plan)
