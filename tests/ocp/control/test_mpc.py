"""Closed loop: disturbances that ruin a plan are rejected, limits are kept, derivatives are exact."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.boundary.sensitivities import Motion
from ocp.control.lqr import Tangents

BAR = 1.4


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


MODEL = driven(prism(1.0))
TALL = prism(1.15)
ARM = tc.Structure(
    [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)],
    bars=[(0, 1)],
    strings=[(1, 2), (1, 3), (1, 4), (1, 5)],
    pinned=[0, 2, 3, 4, 5],
)


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


def rest_lengths(trajectory, stiffness, steps=10):
    """At the decisions."""
    rows = trajectory.nodes[:-1:steps][:, trajectory.strings]
    return np.linalg.norm(rows[:, :, 1] - rows[:, :, 0], axis=2) * (1 - trajectory.control[:-1:steps] / stiffness)


def test_predictive_control_winds_no_faster_than_motors_do():
    bound = ocp.RestLengthRateLimits(0.1, stiffness=1000.0)
    free, held = (ocp.run(ocp.Mpc(problem(*bounds), 0.05, 8), 1.5).trajectory for bounds in ((), (bound,)))
    rates = [np.abs(np.diff(rest_lengths(trajectory, 1000.0), axis=0)).max() / 0.05 for trajectory in (free, held)]
    assert rates[0] > 0.5
    assert rates[1] < 0.1001
    assert misfit(held) < 0.02


def test_another_run_begins_anew():
    controller = ocp.Mpc(problem(ocp.RestLengthRateLimits(0.1, stiffness=1000.0)), 0.05, 5)
    first, second = (ocp.run(controller, 0.2).trajectory for _ in range(2))
    assert np.array_equal(first.control, second.control)


def test_a_plan_passes_waypoints_for_the_controller():
    goals = [ocp.NodePositions({1: (0.3, 0.1, None)}), ocp.AtRest(), ocp.Waypoint([ocp.NodePositions({1: (-0.2, 0.2, None)})], share=0.5)]
    asked = ocp.Problem(driven(ARM), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=[ocp.Effort()])
    with pytest.raises(ValueError, match=r"problem has Waypoint.*: plan first, then Mpc"):
        ocp.Mpc(asked)
    found = ocp.solve(asked, ocp.MultipleShooting(20))
    held = ocp.run(ocp.Mpc(asked, 0.05, 8, plan=found), 1.0).trajectory
    assert held.nodes[100, 1, :2] == pytest.approx([-0.2, 0.2], abs=0.02)
    assert held.nodes[-1, 1, :2] == pytest.approx([0.3, 0.1], abs=0.02)


@pytest.mark.parametrize("change", [{"start": ocp.FreeStart()}, {"goals": [ocp.Periodic()]}], ids=["FreeStart", "Periodic"])
def test_motions_need_a_plan(change):
    asked = ocp.Problem(MODEL, 1.0, bounds=[ocp.ForceDensityLimits(1.0, 100.0)], **change)
    with pytest.raises(ValueError, match=r"problem has (FreeStart|Periodic), .*: plan first"):
        ocp.Mpc(asked)


@pytest.mark.parametrize("make", [lambda asked, plan: ocp.Mpc(asked, 0.05, 8, plan=plan), lambda asked, plan: ocp.track(plan)], ids=["mpc", "track"])
def test_a_clock_runs_on_from_the_start(make):
    def wind(time):
        return ca.vertcat(ca.DM.zeros(1, 3), ca.horzcat(20 * ca.sin(4 * time), 0, 0), ca.DM.zeros(4, 3))

    model = driven(ARM, forces=tc.NodalForce(wind))
    start = np.append(model.initial_state[:-1], 0.7)
    goals = [ocp.NodePositions({1: (0.3, 0.1, None)}), ocp.AtRest()]
    asked = ocp.Problem(model, 1.0, start, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=[ocp.Effort()])
    held = ocp.run(make(asked, ocp.solve(asked, ocp.MultipleShooting(20, substeps=2))), 1.0, state=start).trajectory
    assert held.states[[0, -1], -1] == pytest.approx([0.7, 1.7])
    assert held.nodes[-1, 1, :2] == pytest.approx([0.3, 0.1], abs=0.02)


def test_the_last_decision_holds_for_what_is_left(plan):
    tracker = ocp.track(plan)
    whole, part, short = (ocp.run(tracker, t_end).trajectory for t_end in (0.15, 0.12, 0.01))
    assert part.time[-1] == pytest.approx(0.12, abs=1e-12)
    assert np.array_equal(part.control[20:30], whole.control[20:30])
    assert part.nodes[-1] == pytest.approx(whole.nodes[24], abs=1e-9)
    assert short.time[-1] == 0.01


def test_what_bars_do_not_allow_of_a_push_is_taken_off(plan):
    def push(time, x):
        return x + np.eye(36)[18] * (time == 0)

    held = ocp.run(ocp.track(plan), 0.05, disturbance=push).trajectory
    assert held.bar_length_error.max() < 1e-6


def test_an_anchored_arm_is_held():
    goals = [ocp.NodePositions({1: (0.4, 0.0, None)}), ocp.AtRest()]
    asked = ocp.Problem(driven(ARM), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    held = ocp.run(ocp.Mpc(asked, 0.05, 10), 2.0, driven(ARM, gravity=tc.Gravity((0, 0, -1.0))))
    assert held.trajectory.nodes[-1, 1] == pytest.approx([0.4, 0.0, np.sqrt(1 - 0.16)], abs=0.02)


def test_a_structure_that_needs_no_force_at_the_goal_is_moved_there():
    cross, folded = driven(tc.shapes.d_bar(pinned=[0])), tc.shapes.d_bar(angle=0.7).string_lengths
    held = ocp.run(ocp.Mpc(ocp.Problem(cross, goals=[ocp.StringLengths(folded), ocp.AtRest()]), 0.1, 5), 2.0).trajectory
    assert cross.structure.replace(nodes=held.nodes[-1]).string_lengths == pytest.approx(folded, abs=0.01)


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


class Own:
    """A controller as users write them."""

    model = MODEL

    def __init__(self, decide, period=0.05):
        self.control, self.period = decide, period


def decided(value):
    return lambda plan: ocp.run(Own(lambda time, x: value), 0.1)


STATE = MODEL.initial_state
BAD = {
    "track above NaN": (lambda plan: ocp.track(plan, lower=np.nan), ValueError, "lower is nan"),
    "track within nothing": (lambda plan: ocp.track(plan, lower=50.0, upper=10.0), ValueError, "lower is 50 and upper is 10 for string 0"),
    "track that pushes": (lambda plan: ocp.track(plan, lower=-5.0, upper=-5.0), ValueError, "lower of string 0 is -5"),
    "track above a word": (lambda plan: ocp.track(plan, lower="a"), TypeError, "lower"),
    "mpc at a state too short": (lambda plan: ocp.Mpc(problem()).control(0.0, STATE[:3]), ValueError, r"state has shape \(3,\)"),
    "mpc at no state": (lambda plan: ocp.Mpc(problem()).control(0.0, None), TypeError, "state"),
    "mpc at a state that is no number": (lambda plan: ocp.Mpc(problem()).control(0.0, STATE * np.nan), ValueError, r"state\[0\] is nan"),
    "mpc at a word": (lambda plan: ocp.Mpc(problem()).control("a", STATE), TypeError, "time"),
    "mpc before the beginning": (lambda plan: ocp.Mpc(problem()).control(-1.0, STATE), ValueError, "time is -1"),
    "track at a state too short": (lambda plan: ocp.track(plan).control(0.0, STATE[:3]), ValueError, r"state has shape \(3,\)"),
    "track at NaN": (lambda plan: ocp.track(plan).control(np.nan, STATE), ValueError, "time is nan"),
    "run with bars of other lengths": (lambda plan: ocp.run(ocp.track(plan), 0.1, state=2 * STATE), ValueError, "state is off the lengths"),
    "run for ever": (lambda plan: ocp.run(ocp.track(plan), 1e99), ValueError, "t_end is 1e.99"),
    "run back in time": (lambda plan: ocp.run(Own(lambda time, x: np.ones(9), -1.0), 0.1), ValueError, "controller.period is -1"),
    "run of a number": (lambda plan: ocp.run(Own(5), 0.1), TypeError, "controller is"),
    "run of a controller without model": (
        lambda plan: ocp.run(type("Blind", (Own,), {"model": None})(lambda time, x: np.ones(9)), 0.1),
        TypeError,
        "controller.model is None",
    ),
    "run of other strings": (decided(np.ones(4)), ValueError, r"controller.control\(time, state\) has shape"),
    "run of nothing decided": (decided(None), TypeError, "controller.control"),
    "run of NaN": (decided(np.full(9, np.nan)), ValueError, r"controller.control\(time, state\)\[0\] is nan"),
    "disturbance no function": (lambda plan: ocp.run(ocp.track(plan), 0.1, disturbance=5), TypeError, "disturbance is 5"),
    "run of a wound plant": (
        lambda plan: ocp.run(ocp.track(plan), 0.1, tc.Model(tc.Scene(prism(1.0, stiffness=1e3), control=tc.RestLength()))),
        ValueError,
        "model has the control RestLength",
    ),
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
