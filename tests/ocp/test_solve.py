"""Plans end to end: what is asked is found within limits at the least cost; and what is said when there is none."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planning import BAR, driven, prism, raising

import ocp
import tenscasadi as tc

PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)


def raised(intervals=12, to=1.1, **changes):
    """A prism raised from 1 m, by default within PRESTRESS at the least effort."""
    goals = [ocp.StringLengths(prism(to).string_lengths), ocp.AtRest()]
    return ocp.solve(raising(**{"goals": goals, **changes}), ocp.MultipleShooting(intervals))


def prism_of_four(height):
    """The equilibrium prism of a height with four bars, BAR long."""
    return tc.shapes.prism(4, np.sqrt(BAR**2 - height**2) / (2 * np.sin(3 * np.pi / 8)), height)


def heights(nodes):
    """Distance of the top's centre from the bottom's."""
    half = nodes.shape[-2] // 2
    return np.linalg.norm(
        nodes[..., half:, :].mean(axis=-2) - nodes[..., :half, :].mean(axis=-2), axis=-1
    )


def asked(**changes):
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    return {"goals": goals, "bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}


def test_a_time_limit_stops_the_solver_with_the_best_so_far(plan, monkeypatch):
    seen, clock = [], time.perf_counter
    late = SimpleNamespace(
        perf_counter=lambda: clock() + (1e4 if len(seen) > 2 * plan.iterations else 0.0)
    )  # however loaded the machine is
    monkeypatch.setattr("ocp.solvers.monitor.time", late)
    endless = ocp.Ipopt(tolerance=1e-30, max_iterations=10**6, callback=seen.append)
    stopped = ocp.solve(plan.problem, plan.transcription, endless, time_limit=1e3)
    assert stopped.success
    assert "the cost is not settled: stopped at the time limit" in stopped.message
    assert stopped.objective == pytest.approx(plan.objective, rel=1e-3)
    at_once = ocp.solve(plan.problem, time_limit=1e-6)
    assert not at_once.success
    assert "before the solver began" in at_once.message
    assert at_once.iterations == 0
    with pytest.raises(ValueError, match="time_limit"):
        ocp.solve(plan.problem, time_limit=-1.0)


def test_a_prism_rises(plan):
    assert plan.success
    assert plan.status == "Solve_Succeeded"
    assert "27 → 18 rows: 4 bar, 6 momentum, 1 added for the shape" in plan.message
    assert plan.replay_error < 1e-4
    assert plan.replay_speed_error < 1e-3
    assert 0 < plan.iterations < 100
    assert plan.seconds > 0
    assert plan.time == pytest.approx(np.linspace(0.0, 1.0, 13))
    assert plan.force_density.shape == (12, 9)
    assert heights(plan.trajectory.nodes)[[0, -1]] == pytest.approx([1.0, 1.1], abs=1e-7)
    assert np.abs(plan.trajectory.velocities[-1]).max() < 1e-3
    assert plan.trajectory.bar_length_error.max() < 1e-7
    interval = plan.time[1]
    assert plan.objective == pytest.approx(interval * np.sum(plan.force_density**2), rel=1e-6)
    for words in ("iterations", "force density", "replay", "N/m"):
        assert words in plan.summary()


def test_more_intervals_or_substeps_replay_better(plan):
    finer, substeps = (
        raised(24),
        ocp.solve(ocp.Problem(driven(prism(1.0)), **asked()), ocp.MultipleShooting(12, substeps=3)),
    )
    assert finer.replay_error < plan.replay_error / 4
    assert substeps.replay_error < plan.replay_error / 20


def test_force_densities_stay_within_their_limits(plan):
    assert plan.force_density.min() >= 5.0
    assert plan.force_density.min() < 5.001  # and meet them
    tight = raised(bounds=[ocp.ForceDensityLimits(5.0, 8.75)])
    assert plan.force_density.max() > 8.8
    assert tight.success
    assert 8.7499 < tight.force_density.max() <= 8.75


def test_tensions_stay_within_their_limits():
    loose = [ocp.ForceDensityLimits(1.0, 100.0)]
    free = raised(bounds=loose)
    upper = np.full(9, np.inf)
    upper[6:] = 0.97 * free.tension()[:, 6:].max()
    limited = raised(bounds=[*loose, ocp.TensionLimits(upper=upper)])
    assert limited.success
    for end in (False, True):
        tension = limited.tension(end=end)
        assert tension.shape == (12, 9)
        assert np.all(tension <= upper * (1 + 1e-6))
    assert (
        max(limited.tension()[:, 6:].max(), limited.tension(end=True)[:, 6:].max())
        > 0.999 * upper[6]
    )
    assert limited.objective > free.objective
    slack = raised(bounds=[ocp.TensionLimits(lower=4.0)])
    assert min(slack.tension().min(), slack.tension(end=True).min()) == pytest.approx(4.0, abs=1e-4)


def test_wider_limits_cost_no_more(plan):
    wide, narrow = (
        raised(bounds=[ocp.ForceDensityLimits(4.0, 100.0)]),
        raised(bounds=[ocp.ForceDensityLimits(6.0, 100.0)]),
    )
    assert wide.objective < plan.objective < narrow.objective


def test_smoothness_smooths(plan):
    smooth = raised(costs=[ocp.Effort(1e-3), ocp.Smoothness()])
    jumps = [np.sum(np.diff(found.force_density, axis=0) ** 2) for found in (smooth, plan)]
    assert smooth.success
    assert jumps[0] < 0.7 * jumps[1]


def test_a_free_duration_costs_no_more(plan):
    free = raised(duration=(0.8, 1.3))
    assert free.success
    assert 0.8 <= free.time[-1] <= 1.3
    assert abs(free.time[-1] - 1.0) > 0.05
    assert free.objective < plan.objective
    assert free.replay_error < 1e-3


def test_a_whole_state_is_reached():
    start, end = prism(1.0), prism(1.05)
    shift = start.nodes.mean(axis=0) - end.nodes.mean(axis=0)
    found = raised(goals=[ocp.NodePositions(end.nodes + shift), ocp.AtRest()])
    assert found.success
    assert "36 → 21 rows: 6 bar, 9 momentum" in found.message
    assert found.trajectory.nodes[-1] == pytest.approx(end.nodes + shift, abs=1e-6)
    assert found.replay_error < 1e-3


def test_four_bars():
    goals = [ocp.StringLengths(prism_of_four(1.05).string_lengths), ocp.AtRest()]
    found = raised(10, model=driven(prism_of_four(1.0)), goals=goals)
    assert found.success
    assert found.replay_error < 1e-3


@pytest.mark.parametrize("mass", [1.0, [1.0, 2.0, 3.0, 4.0]])
def test_a_pinned_d_bar_folds(mass):
    """Class 2. Pinned at a node its place follows from its shape, and may be asked where it is met."""
    bar = tc.shapes.d_bar(pinned=[0], bar_mass=mass)
    model = driven(bar)
    lengths = ocp.StringLengths(tc.shapes.d_bar(angle=0.6).string_lengths)
    folded = ocp.solve(
        ocp.Problem(model, goals=[lengths, ocp.AtRest()], costs=[ocp.Effort()]),
        ocp.MultipleShooting(20, substeps=2),
    )
    assert folded.success
    assert "11 → 2 rows" in folded.message
    assert folded.replay_error < 1e-4
    assert np.abs(folded.trajectory.nodes[:, 0] - bar.nodes[0]).max() == 0.0
    goals = [ocp.NodePositions(folded.trajectory.nodes[-1]), ocp.AtRest()]
    placed = ocp.solve(
        ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(20, substeps=2)
    )
    assert placed.success
    assert placed.objective == pytest.approx(folded.objective, rel=1e-3)


def test_a_pendulum_swings_between_two_strings_under_its_weight():
    nodes = [(0, 0, 0), (0.3, 0, -0.95), (-1, 0, 0), (1, 0, 0)]
    structure = tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3)], pinned=[0, 2, 3])
    goals = [ocp.NodePositions({1: (-0.3, None, None)}), ocp.AtRest()]
    problem = ocp.Problem(
        driven(structure, gravity=tc.Gravity()), 0.8, goals=goals, costs=[ocp.Effort()]
    )
    found = ocp.solve(problem, ocp.MultipleShooting(20))
    assert found.success
    assert "plane" in found.message
    assert found.replay().nodes[-1, 1] == pytest.approx([-0.3, 0.0, -0.95], abs=1e-4)
    assert found.force_density.min() >= 0.0


def test_a_falling_prism_changes_shape():
    goals = [ocp.StringLengths(prism(1.05).string_lengths)]
    found = raised(
        model=driven(prism(1.0), gravity=tc.Gravity((0.0, 0.0, -9.81))), goals=goals, duration=0.5
    )
    assert found.success
    fallen = found.trajectory.nodes[-1].mean(axis=0) - found.trajectory.nodes[0].mean(axis=0)
    assert fallen == pytest.approx([0.0, 0.0, -9.81 / 8], abs=1e-6)


def test_nothing_to_do_costs_nothing():
    found = raised(to=1.0, bounds=[])
    assert found.success
    assert found.objective < 1e-3
    assert found.replay_error < 1e-6


def test_units_do_not_matter(plan):
    """The same plan in millimetres and grams: γ in N/m is 1e-3 kg/s² there."""
    k = 1e3
    small = tc.Structure(prism(1.0).nodes * k, prism(1.0).bars, prism(1.0).strings, bar_mass=k)
    goals = [ocp.StringLengths(prism(1.1).string_lengths * k), ocp.AtRest()]
    found = raised(
        model=driven(small), goals=goals, bounds=[ocp.ForceDensityLimits(5.0 * k, 100.0 * k)]
    )
    assert found.success
    assert found.force_density / k == pytest.approx(plan.force_density, rel=1e-3)


def test_full_coordinates_plan_the_same(plan):
    scene = tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity())
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    found = [
        ocp.solve(
            ocp.Problem(tc.Model(scene, coordinates), goals=goals, costs=[ocp.Effort()]),
            ocp.MultipleShooting(6),
        )
        for coordinates in ("reduced", "full")
    ]
    assert all(one.success for one in found)
    assert found[0].force_density == pytest.approx(found[1].force_density, abs=1e-3)


@pytest.mark.slow
def test_the_ball_changes_shape():
    ball = tc.shapes.six_bar_ball()
    model = driven(ball)
    shaken = model.state(ball.nodes + 0.03 * np.random.default_rng(0).normal(size=(12, 3)))
    nodes = model.nodes(tc.Projection(iterations=10).step(model)(shaken).full().ravel())
    goals = [
        ocp.StringLengths(tc.Structure(nodes, ball.bars, ball.strings).string_lengths),
        ocp.AtRest(),
    ]
    found = raised(10, model=model, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    assert found.success
    assert found.replay_error < 1e-3


@pytest.mark.slow
def test_strings_in_segments_plan_too():
    goals = [ocp.StringLengths(prism(1.05).string_lengths)]
    problem = ocp.Problem(
        driven(prism(1.0, string_mass=0.1), segments=2),
        goals=goals,
        bounds=[PRESTRESS],
        costs=[ocp.Effort()],
    )
    found = ocp.solve(problem, ocp.MultipleShooting(12, substeps=4))
    assert found.success
    assert found.trajectory.nodes.shape == (13, 15, 3)
    assert found.replay_error < 1e-3


@pytest.mark.slow
def test_too_little_force_is_said(plan):
    found = raised(bounds=[ocp.ForceDensityLimits(5.0, 8.0)])
    assert not found.success
    assert found.status in (
        "Infeasible_Problem_Detected",
        "Maximum_Iterations_Exceeded",
    )  # rounding decides what IPOPT sees first
    for words in (
        "no plan",
        "largest violation: ",
        "upper limits are active",
        "force density of string",
        "increase ",
    ):
        assert words in found.message
    assert found.replay_error > 1e-3


def test_too_few_iterations_are_said():
    problem = ocp.Problem(driven(prism(1.0)), **asked())
    found = ocp.solve(
        problem, ocp.MultipleShooting(12), ocp.Ipopt(max_iterations=1), tolerance=1e-6
    )
    assert not found.success
    assert found.iterations == 1
    assert "increase max_iterations" in found.message
    assert "largest violation" in found.message
    assert found.force_density.shape == (12, 9)


def test_what_is_feasible_but_not_settled_is_said():
    found = ocp.solve(
        ocp.Problem(driven(prism(1.0)), **asked()),
        ocp.MultipleShooting(12),
        ocp.Ipopt(max_iterations=3),
        ocp.InverseDynamics(noise=0.0),
    )
    assert found.success
    assert "the cost is not settled: stopped at the iteration limit" in found.message


def test_a_goal_that_external_forces_keep_away_is_said():
    """Nothing is conserved under a wind, so that nothing is refused beforehand; but no string stops a free prism in it."""
    wind = np.zeros((6, 3))
    wind[:, 0] = 0.5
    found = raised(model=driven(prism(1.0), forces=tc.NodalForce(wind)))
    assert not found.success
    assert "farthest in AtRest" in found.message
    assert found.replay_speed_error == pytest.approx(1.0, abs=0.05)  # 3 N on 3 kg for 1 s


def test_plans_whose_replay_misses_the_tolerance_are_no_success(plan):
    lowered = asked(goals=[ocp.StringLengths(prism(0.6).string_lengths), ocp.AtRest()])
    found = ocp.solve(ocp.Problem(driven(prism(1.0)), **lowered), ocp.ImplicitMidpoint(4))
    assert found.status == "Solve_Succeeded"
    assert not found.success
    assert found.replay_error > 1e-2
    assert found.message.startswith("a plan was found after ")
    assert "plan.refine(" in found.message
    problem, allowed = ocp.Problem(driven(prism(1.0)), **asked()), plan.worst_error
    for tolerance, met in ((1.01 * allowed, True), (0.99 * allowed, False)):
        assert ocp.solve(problem, ocp.MultipleShooting(12), tolerance=tolerance).success is met
    with pytest.raises(ValueError, match="tolerance"):
        ocp.solve(problem, tolerance=0.0)


@pytest.mark.parametrize("solver", [None, ocp.CondensedNewton(), ocp.Sampling()], ids=repr)
def test_progress_is_a_function_that_can_stop_any_method(solver):
    seen = []

    def watch(now):
        seen.append(now)
        return False

    plan = ocp.solve(raising(), solver=solver, progress=watch)
    assert 1 <= len(seen) <= 3
    assert plan.iterations <= 1  # the best iterate may already meet the goals
    assert plan.success or "stopped" in plan.message


def test_errors_of_the_progress_function_are_raised():
    def fail(now):
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"):
        ocp.solve(raising(), progress=fail)


def test_progress_of_all_starts_is_seen():
    seen = []
    plan = ocp.solve(raising(), n_starts=2, progress=seen.append)
    assert plan.success
    assert len(seen) > plan.iterations


def test_plan_as_guess_repeats_its_method_with_a_warm_start():
    first = ocp.solve(raising(), ocp.Variational(24), ocp.Ipopt())
    assert first.success
    other = replace(first.problem, bounds=[ocp.ForceDensityLimits(1.0, 180.0)])
    cold, warm = ocp.solve(other), ocp.solve(other, guess=first)
    assert warm.success
    assert len(warm.time) == 25
    assert warm.iterations < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-3)
