"""The acceptance test of plans."""

from __future__ import annotations

import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from planning import folding, raising

import ocp
from ocp.problem.scaling import Scales
from ocp.results.acceptance import assess_plan, find_missed_goal
from ocp.results.diagnosis import interpolate_plan
from ocp.results.replay import replay_in_doubt
from ocp.results.result import Replayed
from ocp.solvers.base import Outcome
from ocp.solvers.early_stop import stop_early
from ocp.solvers.monitor import TIME_UP
from ocp.targets.find_target import find_target


@pytest.fixture(scope="module")
def plan():
    return ocp.solve(raising(), ocp.Variational(6))


def find_goals(plan, *goals):
    problem = replace(plan.problem, goals=goals)
    return find_target(problem, Scales.of(problem))


def test_waypoints_are_judged_on_the_interpolant_that_imposes_them(plan):
    share = 0.25 / 6  # within the first interval, where velocities change most
    model, state = plan.model, interpolate_plan(plan)(share)
    node = int(np.argmax(np.linalg.norm(model.velocities(state), axis=1)))
    place = ocp.NodePositions({node: tuple(model.nodes(state)[node])})
    target = find_goals(plan, ocp.Waypoint([place], share=share))
    straight = plan.trajectory.nodes[:2, node]
    assert np.abs(0.75 * straight[0] + 0.25 * straight[1] - model.nodes(state)[node]).max() > 1e-5
    assert find_missed_goal(plan, target, 1e-9) == ""


def test_message_names_the_goal_that_the_planned_motion_misses(plan):
    node = int(np.argmax(plan.trajectory.nodes[-1][:, 2]))
    place = plan.trajectory.nodes[-1][node]
    far = find_goals(plan, ocp.NodePositions({node: (None, None, place[2] - 0.1)}))
    states, gamma = plan.trajectory.states, plan.force_density
    found = Outcome(states, gamma, float(plan.time[-1]), plan.objective, True, "", 1)
    judged = assess_plan(
        plan,
        far,
        found,
        1e-3,
        lambda plan, tracked: Replayed((plan.replay(),)),
        False,
        plan.model.scene,
    )
    assert not judged.success
    assert f"node {node} z: give another guess" in judged.message
    assert "intervals" not in judged.message


def test_message_says_that_time_was_up_before_the_replay(plan):
    target = find_target(plan.problem, Scales.of(plan.problem))
    states, gamma = plan.trajectory.states, plan.force_density
    found = Outcome(states, gamma, float(plan.time[-1]), plan.objective, True, "", 7)
    judged = assess_plan(
        plan, target, found, 1e-3, lambda plan, tracked: None, False, plan.model.scene
    )
    assert not judged.success
    assert "the plan after 7 iterations is unchecked: increase time_limit" in judged.message
    assert "misses" not in judged.message


def test_motion_beyond_a_named_limit_is_no_plan(plan):
    """A solver that converged does not excuse it: strings go slack unlike in its program."""
    least = 1.1 * float(plan.force_density[0, 0])
    limits = [*plan.problem.bounds, ocp.ForceDensityLimits(lower=least)]
    strict = replace(plan, problem=replace(plan.problem, bounds=limits))
    target = find_target(plan.problem, Scales.of(plan.problem))
    states, gamma = plan.trajectory.states, plan.force_density
    found = Outcome(states, gamma, float(plan.time[-1]), plan.objective, True, "", 7)
    both = Replayed((plan.replay(),))
    for given, accepted in ((plan, True), (strict, False)):
        judged = assess_plan(
            given, target, found, 1e-2, lambda plan, tracked: both, False, plan.model.scene
        )
        assert judged.success is accepted
    expected = "no plan: after 7 iterations, the motion violates force density of string"
    assert expected in judged.message
    assert "misses" not in judged.message


def test_goals_decide_where_the_step_check_fails(plan, monkeypatch):
    """The step check fails in a run that ends at the goals: so does the one in half the steps."""
    module = sys.modules["ocp.results.replay"]
    simulated, steps = module.replay_open, []

    def doubted(plan, model, scheme, step, verify=True):
        motion = simulated(plan, model, scheme, step, verify)
        steps.append(motion.step)
        return replace(motion, success=motion.success and not verify)

    monkeypatch.setattr(module, "replay_open", doubted)
    found = replay_in_doubt(plan, plan.model)
    assert found.failure == ""
    assert steps == pytest.approx([steps[0], steps[0], steps[0] / 2])
    assert [motion.step for motion in found.motions] == steps[1:]


def test_the_worst_of_repeated_replays_counts(plan):
    target = find_target(plan.problem, Scales.of(plan.problem))
    states, gamma = plan.trajectory.states, plan.force_density
    found = Outcome(states, gamma, float(plan.time[-1]), plan.objective, True, "", 1)
    motion = plan.replay()
    moved = motion.states.copy()
    moved[-1, : plan.model.nq] *= 1.05
    both = Replayed((motion, replace(motion, states=moved)))
    scene = plan.model.scene
    judged = assess_plan(plan, target, found, 1e-2, lambda plan, tracked: both, False, scene)
    assert not judged.success
    assert judged.replay_error > 0.01


def test_message_quotes_the_failure_of_the_replay(plan):
    target = find_target(plan.problem, Scales.of(plan.problem))
    states, gamma = plan.trajectory.states, plan.force_density
    found = Outcome(states, gamma, float(plan.time[-1]), plan.objective, True, "", 1)
    failed = Replayed((), "its replay diverged at 0.2 s")
    scene = plan.model.scene
    judged = assess_plan(plan, target, found, 1e-2, lambda plan, tracked: failed, False, scene)
    assert not judged.success
    assert judged.message.endswith("its replay diverged at 0.2 s")


@pytest.mark.parametrize("solver", [ocp.Sampling(), ocp.CondensedNewton()])
def test_plans_with_undefined_costs_fail(solver):
    undefined = ocp.Integral("log", lambda now: ca.log(now.control[0] - 50.0))
    plan = ocp.solve(replace(folding(), costs=[undefined]), solver=solver)
    assert plan.worst_error < 0.01
    assert np.isnan(plan.objective)
    assert not plan.success
    assert plan.message.startswith("no plan: the sum of Problem.costs is not a number: keep roots")


def test_a_guess_that_meets_all_goals_is_no_success(plan):
    """A search that stops before the solver returns its guess, whose costs are unknown."""
    target = find_target(plan.problem, Scales.of(plan.problem))
    guess = plan.guess(plan.problem, target, 6)
    early = stop_early(plan.problem, plan.transcription, TIME_UP, guess)
    judged = assess_plan(
        replace(plan, objective=early.objective),
        target,
        early,
        1e-2,
        lambda plan, tracked: Replayed((plan.replay(),)),
        False,
        plan.model.scene,
    )
    assert judged.worst_error < 1e-2
    assert not judged.success
    assert judged.message.startswith("no plan: stopped before the solver began, with the guess")
    again = plan.replan(time_limit=1e-3)
    assert np.isfinite(again.objective) or not again.success
