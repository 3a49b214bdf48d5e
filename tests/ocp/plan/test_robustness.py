"""Robustness of plans against the same replays by `simulate`, one by one; what matters, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from controlling import ARM
from planning import driven, folding, prism, raising

import ocp
import tenscasadi as tc
from ocp.plan.robustness import share_variance
from ocp.results.rest_length_schedule import compute_rest_lengths
from tenscasadi.scene.strings import rest_length
from tenscasadi.simulation.rollouts import rollouts


@pytest.fixture(scope="module")
def cross():
    """A pinned D-bar that folds: one string's stiffness is enough for its plan."""
    return ocp.solve(folding(), ocp.MultipleShooting(10))


@pytest.fixture(scope="module")
def stiff():
    """The same with strings that can be wound."""
    asked = folding()
    model = driven(tc.shapes.d_bar(pinned=[0], stiffness=300.0))
    return ocp.solve(
        ocp.Problem(model, goals=asked.goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10)
    )


def missed(plan, state):
    """How far the string lengths are from those of the goal, m, and the greatest velocity, m/s."""
    goal = plan.problem.goals[0].lengths
    nodes, model = plan.model.nodes(state), plan.model
    lengths = np.linalg.norm(
        nodes[model.structure.strings[:, 1]] - nodes[model.structure.strings[:, 0]], axis=1
    )
    return abs(lengths - goal).max(), abs(model.velocities(state)).max()


def scaled(plan, control, *names):
    return tc.Model(
        tc.Scene(plan.structure, control=control, parameters=tc.Parameters(scale=names))
    )


@pytest.mark.parametrize("k", [0, 3])
def test_replays_are_those_of_simulate(plan, k):
    found = plan.robustness({"bar_mass": 0.05}, start=(0.01, 0.02), samples=4)
    model = scaled(plan, tc.ForceDensity(), "bar_mass")
    once = tc.simulate(
        model,
        1.0,
        1 / 120,
        state=found.starts[k],
        control=plan.force_density,
        parameters=found.factors[k],
        compiled=False,
    )
    place, speed = missed(plan, once.states[-1])
    assert found.error[k] >= place - 1e-12  # goals also name what strings leave open
    assert found.speed_error[k] == pytest.approx(speed, rel=1e-9)
    assert found.worst_error[k] == max(found.error[k], found.speed_error[k])


def test_nothing_that_varies_is_the_plan_s_own_replay(plan, cross):
    for one in (plan, cross):
        found = one.robustness({"bar_mass": 1e-12}, samples=3)
        assert found.error == pytest.approx(np.full(3, one.replay_error), rel=1e-4)
        assert found.speed_error == pytest.approx(np.full(3, one.replay_speed_error), rel=1e-4)


@pytest.mark.parametrize(
    "transcription",
    [
        ocp.MultipleShooting(8, control=ocp.PiecewiseLinear()),
        ocp.Variational(intervals=(0.1, 0.2, 0.3, 0.4, 0.5)),
    ],
)
def test_profiles_of_any_kind_are_replayed(transcription):
    plan = ocp.solve(folding(), transcription)
    found = plan.robustness({"bar_mass": 1e-12}, samples=2)
    assert found.error == pytest.approx(np.full(2, plan.replay_error), rel=0.02, abs=1e-8)


@pytest.mark.parametrize("k", [0, 2])
@pytest.mark.parametrize("delay", [0.0, 0.2])
def test_tracked_replays_are_those_of_the_tracker(plan, k, delay):
    """With a delay, the last interval is the shortest, and decides how many decisions there are."""
    time = plan.time.copy()
    time[1:-1] += delay * time[1]
    plan = replace(plan, time=time)
    found = plan.robustness({"bar_mass": 0.05}, start=0.005, samples=3, tracked=True)
    model, tracker = scaled(plan, tc.ForceDensity(), "bar_mass"), ocp.track(plan)
    x = found.starts[k]
    for time in tracker.time[:-1]:
        decided = tracker.control(time, x)
        x = tc.simulate(
            model,
            tracker.period,
            tracker.period / 10,
            state=x,
            control=decided,
            parameters=found.factors[k],
            compiled=False,
        ).states[-1]
    assert found.speed_error[k] == pytest.approx(missed(plan, x)[1], rel=1e-6)


def test_stiffness_acts_under_rest_length_control(stiff):
    found = stiff.robustness({"stiffness": 0.1}, samples=3)
    model = scaled(stiff, tc.RestLength(), "stiffness")
    time, rest = compute_rest_lengths(stiff, stiff.structure.stiffness, 10)
    assert len(time) == 101
    for k in range(3):
        once = tc.simulate(
            model,
            1.0,
            1 / 500,
            state=found.starts[k],
            control=rest,
            parameters=found.factors[k],
            compiled=False,
        )
        assert found.speed_error[k] == pytest.approx(missed(stiff, once.states[-1])[1], rel=1e-6)
    assert np.ptp(found.error) > 1e-5
    nominal = stiff.robustness({"stiffness": 1e-12}, samples=1)
    wound = ocp.replay_rest_lengths(stiff)
    assert nominal.speed_error[0] == pytest.approx(missed(stiff, wound.states[-1])[1], rel=1e-6)


def test_tensions_follow_the_tracker_at_planned_lengths(stiff):
    found = stiff.robustness({"stiffness": 0.2}, start=(0.01, 0.05), samples=1, tracked=True)
    model, tracker = scaled(stiff, tc.RestLength(), "stiffness"), ocp.track(stiff, decisions=100)
    ends = stiff.model.nodes(tracker.states)[:, stiff.structure.strings]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    x = found.starts[0]
    for k, s in enumerate(lengths[:-1]):
        pull = tracker.inputs[k] - tracker.gains[k] @ (x - tracker.states[k])
        wound = rest_length(pull, s, 300.0)
        x = tc.simulate(
            model, 0.01, 0.002, state=x, control=wound, parameters=found.factors[0], compiled=False
        ).states[-1]
    assert found.speed_error[0] == pytest.approx(missed(stiff, x)[1], rel=1e-6)


def test_tracking_helps_where_the_start_is_off(plan):
    free, held = (
        plan.robustness(start=0.005, samples=200, tracked=tracked, tolerance=0.02)
        for tracked in (False, True)
    )
    assert free.success_rate < 0.5 < held.success_rate
    assert (free.dominant_factor, held.dominant_factor) == ("start", "start")


@pytest.mark.slow
def test_waypoints_count():
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
    plan = ocp.solve(asked, ocp.MultipleShooting(20))
    found = plan.robustness({"bar_mass": 0.05}, samples=3)
    weighed = scaled(plan, tc.ForceDensity(), "bar_mass")
    for k in range(3):
        once = tc.simulate(
            weighed,
            1.0,
            0.005,
            state=found.starts[k],
            control=plan.force_density,
            parameters=found.factors[k],
            compiled=False,
        )
        way, end = (
            abs(once.nodes[100, 1, :2] - [-0.2, 0.2]).max(),
            abs(once.nodes[-1, 1, :2] - [0.3, 0.1]).max(),
        )
        assert found.error[k] == pytest.approx(max(way, end), rel=1e-6)


def test_without_a_problem_the_planned_end_counts(plan):
    found = replace(plan, problem=None).robustness({"bar_mass": 0.05}, samples=2)
    once = tc.simulate(
        scaled(plan, tc.ForceDensity(), "bar_mass"),
        1.0,
        1 / 120,
        control=plan.force_density,
        parameters=found.factors[1],
        compiled=False,
    )
    assert found.error[1] == pytest.approx(
        np.linalg.norm(once.nodes[-1] - plan.trajectory.nodes[-1], axis=1).max(), rel=1e-9
    )


def test_the_share_of_the_variance_in_closed_form():
    rng = np.random.default_rng(0)
    a, b, c = rng.uniform(-1, 1, (3, 20000, 1))
    both = rng.uniform(-1, 1, (20000, 3))
    misses = np.hstack([3 * a + 2 * b, 4 * both[:, [1]], 5 * c**2])
    variances = {
        "a": 9 / 3,
        "b": 4 / 3,
        "start": 16 / 3,
        "c": 25 * 4 / 45,
    }  # of uniform draws, and of their squares
    total = sum(variances.values())
    shares = share_variance({"a": a, "b": b, "start": both, "c": c}, misses)
    assert shares == pytest.approx(
        {name: value / total for name, value in variances.items()}, abs=0.01
    )


def test_a_start_that_brings_about_more_than_slopes_tell_has_its_share():
    """Against frozen draws: the variance that is left where all else stands still."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1, 1, (2, 20000, 1))
    both = rng.uniform(-1, 1, (20000, 4))
    jump = np.cos(9 * both).sum(axis=1, keepdims=True)
    misses = np.hstack([a + 0.5 * a * b, 2 * jump])
    shares = share_variance({"a": a, "b": b, "start": both}, misses)
    total = np.var(misses, axis=0).sum()
    assert shares["start"] == pytest.approx(np.var(2 * jump) / total, abs=0.01)
    assert shares["a"] == pytest.approx(np.var(a) / total, abs=0.01)
    assert shares["b"] < 0.01


def test_replays_that_diverge_are_left_out_of_the_variance():
    rng = np.random.default_rng(0)
    a = rng.uniform(-1, 1, (100, 1))
    misses = 2 * a
    misses[:10] = np.nan
    assert share_variance({"a": a}, misses)["a"] == pytest.approx(1.0)


def test_starts_far_off_never_meet_the_tolerance(cross):
    wild = cross.robustness(start=(0.0, 1e9), samples=20)
    assert np.all(np.isinf(wild.error) | (wild.error > 0.1))
    assert wild.success_rate == 0.0


def test_few_replays_do_not_tell_what_matters(plan):
    found = plan.robustness({"bar_mass": 0.05}, start=0.01, samples=20)
    assert found.dominant_factor == ""
    assert "too few replays" in found.summary()


def test_the_same_seed_draws_the_same_within_the_spread(plan):
    one, again, other = (
        plan.robustness({"bar_mass": 0.05}, start=0.01, samples=50, seed=seed) for seed in (0, 0, 1)
    )
    assert np.array_equal(one.error, again.error)
    assert not np.array_equal(one.error, other.error)
    assert 0.04 < abs(one.factors - 1).max() <= 0.05
    assert max(plan.model.bar_length_error(x) for x in one.starts) < 1e-12
    assert 0.005 < abs(one.starts - plan.trajectory.states[0])[:, :18].max() < 0.03


def test_an_interrupted_study_keeps_the_replays_that_ended(plan, monkeypatch, capsys):
    def interrupt(*arguments, **options):
        found = rollouts(*arguments, **options)
        states, message = found.states.copy(), found.message.astype("U60")
        states[6:], message[6:] = (
            np.nan,
            "interrupted from the keyboard, the last state kept is ...",
        )
        ended = found.success & (np.arange(len(states)) < 6)
        return replace(found, states=states, message=message, success=ended, interrupted=True)

    whole = plan.robustness({"bar_mass": 0.05}, start=0.005, samples=8, progress=True)
    assert "steps" in capsys.readouterr().err
    monkeypatch.setattr("ocp.plan.many_replays.rollouts", interrupt)
    found = plan.robustness({"bar_mass": 0.05}, start=0.005, samples=8)
    assert found.interrupted
    assert not whole.interrupted
    for name in ("error", "speed_error", "factors", "starts"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)[:6])
    assert "; interrupted from the keyboard" in found.summary()


def test_quantiles_and_text(plan):
    found = plan.robustness({"bar_mass": 0.05}, samples=101, tolerance=0.003)
    ordered = np.sort(found.worst_error)
    assert found.quantiles([0.0, 0.5, 1.0]).tolist() == ordered[[0, 50, 100]].tolist()
    assert found.success_rate == np.mean(ordered <= 0.003)
    with pytest.warns(DeprecationWarning, match=r"use success_rate"):
        assert found.share == found.success_rate
    with pytest.warns(DeprecationWarning, match=r"use dominant_factor"):
        assert found.matters_most == found.dominant_factor
    assert "open loop" in found.summary()
    assert "bar_mass" in found.summary()
    assert "within 0.003 m" in repr(found)


BAD = {
    "progress": (
        lambda plan: plan.robustness({"bar_mass": 0.05}, progress="yes"),
        TypeError,
        "progress is 'yes': give True or False",
    ),
    "nothing varies": (
        lambda plan: plan.robustness(),
        ValueError,
        "parameters is empty and start is 0",
    ),
    "a list": (
        lambda plan: plan.robustness(["bar_mass"]),
        TypeError,
        "parameters is .'bar_mass'.: give spreads by name",
    ),
    "no such parameter": (
        lambda plan: plan.robustness({"weight": 0.1}),
        ValueError,
        "Parameters got 'weight'",
    ),
    "what the scene has not": (
        lambda plan: plan.robustness({"gravity": 0.1}),
        ValueError,
        "Scene.gravity is None",
    ),
    "a spread too wide": (
        lambda plan: plan.robustness({"bar_mass": 1.0}),
        ValueError,
        "parameters.'bar_mass'. is 1: give a spread relative",
    ),
    "a spread below zero": (
        lambda plan: plan.robustness({"bar_mass": -0.1}),
        ValueError,
        "parameters.'bar_mass'. is -0.1",
    ),
    "start below zero": (lambda plan: plan.robustness(start=-1.0), ValueError, "start is -1"),
    "start of three": (
        lambda plan: plan.robustness(start=(1.0, 1.0, 1.0)),
        ValueError,
        "start has shape",
    ),
    "rest lengths": (
        lambda plan: plan.robustness({"rest_length": 0.1}),
        ValueError,
        "'rest_length', which a plan commands.*vary 'stiffness'",
    ),
    "no samples": (lambda plan: plan.robustness(start=0.1, samples=0), ValueError, "samples is 0"),
    "seed no number": (lambda plan: plan.robustness(start=0.1, seed="a"), TypeError, "seed"),
    "tracked no flag": (
        lambda plan: plan.robustness(start=0.1, tracked=1),
        TypeError,
        "tracked is 1",
    ),
    "tolerance zero": (
        lambda plan: plan.robustness(start=0.1, tolerance=0.0),
        ValueError,
        "tolerance is 0",
    ),
    "shares beyond": (
        lambda plan: plan.robustness(start=0.1, samples=2).quantiles([2.0]),
        ValueError,
        "shares is",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(plan, name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make(plan)


def test_message_names_strings_too_soft_for_rest_length_control():
    model = driven(prism(1.0, stiffness=1.0))
    plan = ocp.solve(raising(model=model), ocp.MultipleShooting(6))
    with pytest.raises(ValueError, match=r"stiffness of string \d is 1 N/m: it must exceed"):
        plan.robustness({"stiffness": 0.1})
