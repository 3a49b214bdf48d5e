"""Plans of rest lengths by way of force densities."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
from planning import prism

import ocp
import tenscasadi as tc
from ocp.control.lqr import trace_motion
from ocp.search.methods import plan_guess
from ocp.search.policy import Attempt, attempts
from ocp.search.rest_lengths import (
    build_force_density_problem,
    convert_outcome,
    limit_instants,
    tighten_limits,
)
from ocp.search.task import prepare
from ocp.solvers.base import Outcome
from ocp.transcription.mesh import PiecewiseConstant


def stiff(stiffness, *bounds, damping=1e-3, slack=None, **changes):
    """The prism grows by 5 cm; damping is in units of the stiffness."""
    low = prism(1.0, stiffness=stiffness, damping=damping * stiffness, prestress=50.0)
    given = {
        "goals": [ocp.StringLengths(prism(1.05).string_lengths), ocp.AtRest()],
        "bounds": [ocp.ForceDensityLimits(5.0, 200.0), *bounds],
        "costs": [ocp.Effort()],
        **changes,
    }
    scene = tc.Scene(low, control=tc.RestLength(), slack=slack or tc.Clip())
    return ocp.Problem(tc.Model(scene), **given)


@pytest.mark.parametrize("stiffness", [1e3, 1e5])
def test_stiff_strings_reach_the_goal_by_their_rest_lengths(stiffness):
    plan = ocp.solve(stiff(stiffness, ocp.RestLengthRateLimits(0.5)))
    assert plan.success, plan.message
    assert "in force densities" in plan.message
    assert plan.rest_lengths().shape == plan.force_density.shape
    rates = np.diff(plan.rest_lengths(), axis=0) / np.diff(plan.time)[:, None]
    assert np.abs(rates).max() <= 0.5 + 1e-6

    end = plan.replay(tc.RungeKutta4(), 0.5 * tc.stable_step(plan.model)).nodes[-1]
    ends = end[plan.structure.strings]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert lengths == pytest.approx(prism(1.05).string_lengths, abs=5e-3)


@pytest.mark.parametrize("stiffness", [1e3, 1e4, 1e5])
def test_rates_keep_to_active_limits_between_mesh_points(stiffness):
    """Between the 30 mesh points of the plan in force densities, too.

    The largest rate without limits is 0.063 m/s.
    """
    limit = 0.06
    plan = ocp.solve(stiff(stiffness, ocp.RestLengthRateLimits(limit), damping=0.0))
    assert plan.success, plan.message
    assert "in force densities" in plan.message
    rates = np.abs(np.diff(plan.rest_lengths(), axis=0)) / np.diff(plan.time)[:, None]
    assert 0.98 * limit < rates.max() <= limit * (1 + 1e-4)
    if stiffness > 1e4:
        assert len(plan.time) > 100


def test_more_rest_lengths_keep_elastic_strings_from_vibrating():
    """Without damping, the first conversion ends at 0.03 m/s."""
    plan = ocp.solve(stiff(1e4, damping=0.0))
    assert plan.success, plan.message
    assert "in force densities" in plan.message
    assert plan.replay_speed_error < 1e-3
    end = plan.replay(tc.RungeKutta4(), 0.5 * tc.stable_step(plan.model))
    assert np.abs(end.velocities[-1]).max() < 2e-3


def test_plan_holds_strings_taut_that_damping_would_slacken():
    """Slack strings lose their damping, so that the first plan misses the goal by 7 cm."""
    low = prism(1.0, stiffness=1e3, damping=10.0, prestress=30.0, pinned=range(3))
    scene = tc.Scene(low, control=tc.RestLength(), gravity=tc.Gravity())
    goals = [ocp.NodePositions(dict.fromkeys(range(3, 6), (None, None, 1.03))), ocp.AtRest()]
    bounds, costs = [ocp.ForceDensityLimits(2.0, 300.0)], [ocp.Effort()]
    plan = ocp.solve(ocp.Problem(tc.Model(scene), goals=goals, bounds=bounds, costs=costs))
    assert plan.success, plan.message
    assert "in force densities" in plan.message
    end = plan.replay(tc.RungeKutta4(), 0.5 * tc.stable_step(plan.model))
    assert end.nodes[-1, 3:, 2] == pytest.approx(1.03, abs=2e-3)
    stretch = plan.lengths() - plan.rest_lengths()
    assert stretch.min() > -1e-3


@pytest.mark.parametrize("rate", [0.0605, 0.1])
def test_warm_start_repeats_the_plan_in_force_densities(rate):
    first = ocp.solve(stiff(1e4, ocp.RestLengthRateLimits(rate)))
    assert first.duals["force density of string 0"].shape == (31,)
    again = first.replan()
    assert again.success, again.message
    assert "in force densities" in again.message
    assert again.iterations < 0.4 * first.iterations
    assert again.objective == pytest.approx(first.objective, rel=1e-3)

    goals = [ocp.StringLengths(prism(1.049).string_lengths), ocp.AtRest()]
    cold = ocp.solve(replace(first.problem, goals=goals))
    warm = first.replan(goals=goals)
    assert warm.success, warm.message
    assert warm.iterations < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-3)


def test_strings_that_carry_compression_need_not_be_taut():
    """A repeated plan in force densities keeps none of them longer than its rest length."""
    first = ocp.solve(stiff(1e4, slack=tc.Linear()))
    assert "in force densities" in first.message
    again = first.replan()
    assert again.success, again.message
    assert again.objective == pytest.approx(first.objective, rel=1e-3)

    law = {k: tc.Linear() for k in range(8)}
    problem = stiff(1e4, slack=law)
    limited = limit_instants(problem, build_force_density_problem(problem))
    assert limited.bounds[-1].damping.tolist() == [0.0] * 8 + [15.0]


@pytest.mark.parametrize("parts", [1, 3, 7])
def test_traced_states_are_the_planned_ones_at_mesh_points(plan, parts):
    """Also where the last time is rounded down."""
    states, nodes = plan.trajectory.states, plan.time
    time = np.linspace(0.0, nodes[-1], parts * (len(nodes) - 1) + 1) * (1 - 1e-15)
    moved = states + 1e-6 * np.arange(len(states))[:, None]
    traced = trace_motion(plan.model, nodes, moved, plan.control, time)
    assert traced[::parts] == pytest.approx(moved, abs=1e-12)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_rates_are_not_tightened_where_states_between_mesh_points_diverge():
    """Velocities whose squares overflow: whole intervals remain, and the replay decides."""
    problem = stiff(1e3, ocp.RestLengthRateLimits(0.5))
    twin, count = limit_instants(problem, build_force_density_problem(problem)), 3
    states = np.tile(twin.initial_state, (count + 1, 1))
    states[:, twin.model.nq :] = 1e200
    forces = np.full((count + 1, twin.model.nu), 50.0)
    found = Outcome(states, forces, 1.0, 1.0, True, "", 1)
    shares = np.full(count, 1 / count)
    assert tighten_limits(problem, twin, shares, found) is None
    converted = convert_outcome(problem, shares, found)
    assert np.array_equal(converted.states, states)
    assert np.isfinite(converted.force_density).all()


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_damped_strings_keep_their_least_force_density(stiffness):
    """Strings that get longer need tension above their damping force, unlike without damping."""
    plan = ocp.solve(stiff(stiffness, damping=1e-2))
    assert plan.success, plan.message
    assert "go slack" not in plan.message
    pairs = zip(plan.trajectory.states, plan.rest_lengths(), strict=True)
    least = min(plan.model.force_density(state, rest).min() for state, rest in pairs)
    assert least > 5.0 * (1 - 1e-3)


def test_limits_are_tightened_where_strings_go_slack_between_mesh_points():
    """A motion at constant force density, whose strings get longer as fast as damping permits."""
    problem = stiff(1e5, damping=1e-2)
    twin = limit_instants(problem, build_force_density_problem(problem))
    plan = ocp.solve(build_force_density_problem(problem))
    shares = np.full(len(plan.force_density), 1 / len(plan.force_density))
    states, forces = (
        plan.trajectory.states,
        np.vstack([plan.force_density, plan.force_density[-1:]]),
    )
    found = Outcome(states, forces, 1.0, 1.0, True, "", 1)
    tighter = tighten_limits(problem, twin, shares, found)
    ends, speeds = (
        value(states)[:, plan.structure.strings]
        for value in (plan.model.nodes, plan.model.velocities)
    )
    along, apart = ends[:, :, 1] - ends[:, :, 0], speeds[:, :, 1] - speeds[:, :, 0]
    needed = 1e3 * (along * apart).sum(axis=2) / (along**2).sum(axis=2) - forces
    assert tighter.bounds[-1].least == pytest.approx(needed.max(), rel=0.05)


def test_damped_strings_keep_their_least_tension():
    """A bar is lifted quickly; without a margin its strings are slack for a third of the replay."""
    nodes = [[-0.5, 0, 0], [0.5, 0, 0], [-1.5, 0, 2], [1.5, 0, 2], [-0.5, 1.5, 2], [0.5, -1.5, 2]]
    strings = [(0, 2), (1, 3), (0, 4), (1, 5), (0, 5), (1, 4)]
    hung = tc.Structure(
        nodes, [(0, 1)], strings, pinned=range(2, 6), bar_mass=4.0, stiffness=2e4, damping=20.0
    )
    gravity = tc.Gravity()
    weight = np.outer([1, 1, 0, 0, 0, 0], [0, 0, -2.0 * 9.80665])
    hung = hung.prestressed(tc.equilibrium_force_density(hung, weight, 2.0))
    bounds = [ocp.RestLengthRateLimits(1.0), ocp.TensionLimits(lower=0.5)]
    end = ocp.NodePositions({0: (-0.3, 0.1, 0.5), 1: (None, None, 0.5)})
    model = tc.Model(tc.Scene(hung, control=tc.RestLength(), gravity=gravity))
    problem = ocp.Problem(
        model, 1.5, goals=[end, ocp.AtRest()], bounds=bounds, costs=[ocp.Effort()]
    )
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert plan.replay().tension.min() > 0.49


def test_costs_of_rest_lengths_have_no_counterpart():
    assert build_force_density_problem(stiff(1e3)) is not None
    problem = replace(stiff(1e3), costs=[ocp.Effort(), ocp.Smoothness()])
    assert build_force_density_problem(problem) is None
    assert build_force_density_problem(build_force_density_problem(stiff(1e3))) is None


def wind(problem, rate):
    scene = replace(problem.model.scene, control=tc.RestLengthRate())
    bounds = [*problem.bounds, ocp.RestLengthRateLimits(rate)]
    return replace(problem, model=tc.Model(scene), start=None, bounds=bounds)


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_rates_of_rest_lengths_are_planned_in_force_densities(stiffness):
    problem = wind(stiff(stiffness), 0.5)
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert "in force densities" in plan.message
    assert plan.replay_error < 2e-3
    rest = plan.trajectory.internal_states["rest length"]
    assert np.array_equal(rest[0], plan.structure.rest_length)
    steps = np.diff(plan.time)[:, None] * plan.rest_length_rate
    assert np.diff(rest, axis=0) == pytest.approx(steps, abs=1e-7)
    assert np.abs(plan.rest_length_rate).max() <= 0.5 + 1e-6
    assert plan.force_density.min() > 4.5


def motors(**limits):
    winch = tc.Winch(radius=0.02, inertia=1e-4, friction=1e-3, **limits)
    problem = stiff(1e3)
    scene = replace(problem.model.scene, control=winch)
    return replace(problem, model=tc.Model(scene), start=None)


def test_torques_follow_from_rest_lengths():
    problem = motors(torque=5.0, speed=60.0)
    task = prepare(problem, PiecewiseConstant(), 1e-2)
    attempt = next(iter(attempts(task, None)))
    assert isinstance(attempt.guess, Attempt)
    assert "from a plan in force densities" in attempt.describe()
    planned, iterations = plan_guess(task, attempt)
    assert iterations > 0
    assert planned.describe() == attempt.describe()
    guess = planned.guess.plan
    model, step = problem.model, guess.duration / len(guess.force_density)
    rest, speed = np.split(model.split(guess.states).internal, 2, axis=1)
    assert rest[0] == pytest.approx(model.structure.rest_length)
    assert not speed[0].any()
    assert np.diff(rest, axis=0) == pytest.approx(-0.02 * step * speed[1:], abs=1e-9)
    assert np.abs(guess.force_density).max() <= 5.0
    ends = model.nodes(guess.states)[:, model.structure.strings]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    stretch = model.structure.stiffness * (lengths - rest)  # nearly the tension
    tension = (stretch[1:] + stretch[:-1]) / 2
    torque = 0.02 * tension + 1e-3 * speed[1:] + 1e-4 * np.diff(speed, axis=0) / step
    assert guess.force_density == pytest.approx(torque, abs=0.05)


def test_failed_plans_are_no_guess(monkeypatch):
    """The description of the search names the guess that was used."""
    problem = motors(torque=5.0, speed=60.0)
    asked = []

    def fail(task, attempt):
        asked.append(attempt.describe())
        states = np.tile(task.problem.initial_state, (attempt.transcription.count + 1, 1))
        controls = np.ones((attempt.transcription.count, task.problem.model.nu))
        return Outcome(states, controls, 0.5, 1.0, False, "failed", 7, why="it fails"), task.target

    for name in ("methods", "find_plan"):
        monkeypatch.setattr(importlib.import_module(f"ocp.search.{name}"), "run_attempt", fail)
    plan = ocp.solve(problem)
    assert asked[0].startswith("Variational of ")
    assert asked[1].startswith("DirectCollocation of ")
    assert "from a plan" not in plan.message
    assert plan.iterations == 7 * len(asked)


@pytest.mark.slow  # 10 s of CPU time
def test_motors_of_winches_are_planned_from_force_densities():
    plan = ocp.solve(motors(torque=5.0, speed=60.0))
    assert plan.success, plan.message
    assert "from a plan in force densities" in plan.message
    assert np.abs(plan.motor_torque).max() <= 5.0 + 1e-6
    assert np.abs(plan.trajectory.internal_states["winding speed"]).max() <= 60.0 + 1e-3


def test_rates_from_forces_beyond_limits_have_no_counterpart():
    problem = wind(stiff(1e3), 0.5)
    assert build_force_density_problem(problem) is not None
    tight = replace(problem, bounds=[*problem.bounds, ocp.ForceDensityLimits(upper=45.0)])
    assert build_force_density_problem(tight) is None
    assert build_force_density_problem(replace(problem, start=ocp.FreeStart())) is None
