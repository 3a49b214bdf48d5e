"""Rest lengths as what is decided: plans of elastic strings that motors wind, as SciPy integrates them, and what is refused."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from planning import prism
from scipy.integrate import solve_ivp

import ocp
import tenscasadi as tc

PULLS = ocp.ForceDensityLimits(5.0, 100.0)
GOALS = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())


def wound(stiffness=500.0, damping=5.0, **options):
    structure = prism(1.0, stiffness=stiffness, damping=damping, prestress=50.0)
    return tc.Model(tc.Scene(structure, control=tc.RestLength(), **options))


MODEL = wound()


def planned(*bounds, model=MODEL, transcription=None, **changes):
    given = {"goals": GOALS, "bounds": [PULLS, *bounds], "costs": [ocp.Effort()], **changes}
    return ocp.solve(
        ocp.Problem(model, **given), ocp.Variational(24) if transcription is None else transcription
    )


@pytest.fixture(scope="module")
def plan():
    return planned()


def motion(plan):
    """The states at the nodes of the mesh under the strings' own law, by SciPy from rest lengths that are held in intervals."""
    states = [plan.trajectory.states[0]]
    for begin, end, rest in zip(plan.time, plan.time[1:], plan.rest_lengths(), strict=False):
        rate = lambda t, x, rest=rest: plan.model.ode(x, rest).full().ravel()  # noqa: E731
        states.append(
            solve_ivp(rate, (begin, end), states[-1], "DOP853", rtol=1e-9, atol=1e-9).y[:, -1]
        )
    return np.array(states)


def lengths(nodes):
    ends = nodes[MODEL.structure.strings]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def test_wound_strings_meet_the_goal(plan):
    assert plan.success, plan.message
    states = motion(plan)
    missed = np.abs(lengths(plan.model.nodes(states[-1])) - prism(1.1).string_lengths).max()
    assert missed < 2e-3
    assert missed == pytest.approx(plan.replay_error, abs=1e-5)
    assert plan.rest_lengths().shape == plan.force_density.shape == (24, 9)
    assert plan.rest_lengths() is not plan.force_density
    s = plan.lengths()[:-1]
    ends = (
        plan.trajectory.nodes[:-1, plan.structure.strings],
        plan.trajectory.velocities[:-1, plan.structure.strings],
    )
    along, rates = (value[:, :, 1] - value[:, :, 0] for value in ends)
    law = (
        500.0 * (1 - plan.rest_lengths() / s) + 5.0 * np.sum(along * rates, axis=2) / s**2
    )  # Eq. 99
    assert plan.force_density == pytest.approx(law, rel=1e-9)
    assert plan.force_density.min() > 5.0 - 1e-5


def test_effort_is_that_of_the_force_densities_that_follow(plan):
    fine = plan.replay()
    power = np.sum(fine.force_density**2, axis=1)
    assert plan.objective == pytest.approx(
        np.sum((power[1:] + power[:-1]) / 2 * np.diff(fine.time)), rel=0.05
    )


def test_the_default_finds_them(plan):
    found = ocp.solve(plan.problem)
    assert found.success, found.message
    assert found.replay_error < 1e-3
    assert found.objective < 1.01 * plan.objective
    fine = found.replay()
    power = np.sum(fine.force_density**2, axis=1)
    effort = np.sum((power[1:] + power[:-1]) / 2 * np.diff(fine.time))
    assert found.objective == pytest.approx(effort, rel=0.05)


def test_motors_have_a_speed(plan):
    fastest = np.abs(np.diff(plan.rest_lengths(), axis=0)).max() * 24
    slow = planned(ocp.RestLengthRateLimits(0.93 * fastest), ocp.RestLengthLimits(0.2, 2.0))
    assert slow.success, slow.message
    assert np.abs(np.diff(slow.rest_lengths(), axis=0)).max() * 24 == pytest.approx(
        0.93 * fastest, rel=1e-3
    )
    assert {
        finding.unit
        for finding in slow.report().active
        if finding.name.startswith("rest length rate of string")
    } == {"m/s"}
    assert slow.objective > plan.objective


def test_limits_of_rest_lengths_hold_exactly(plan):
    most = 0.998 * plan.rest_lengths().max()
    short = planned(ocp.RestLengthLimits(upper=most))
    assert short.success, short.message
    assert short.rest_lengths().max() <= most
    assert ("rest length of string 8", "upper", "m") in {
        (one.name, one.side, one.unit) for one in short.report().active
    }


@pytest.mark.slow
def test_shooting_finds_the_same(plan):
    other = planned(transcription=ocp.MultipleShooting(24, substeps=2))
    assert other.success, other.message
    assert other.objective == pytest.approx(plan.objective, rel=0.1)


def test_strings_that_hardly_pull_lower_a_load():
    structure = prism(1.0, stiffness=500.0, damping=5.0, prestress=50.0, pinned=[0, 1, 2])
    model = tc.Model(tc.Scene(structure, control=tc.RestLength(), gravity=tc.Gravity()))
    goals = [ocp.NodePositions({3: (None, None, 0.97)}), ocp.AtRest()]
    plan = planned(
        model=model,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
        transcription=ocp.Variational(30),
    )
    assert plan.success, plan.message
    assert plan.model.nodes(motion(plan)[-1])[3, 2] == pytest.approx(0.97, abs=2e-3)


def test_files_copies_guesses_and_trackers_know_them(plan, tmp_path):
    plan.save(tmp_path / "plan.npz")
    again = ocp.Plan.load(tmp_path / "plan.npz")
    assert np.array_equal(again.rest_lengths(), plan.rest_lengths())
    assert np.array_equal(again.replay().states, plan.replay().states)
    repeated = ocp.solve(deepcopy(again.problem), plan.transcription, guess=again)
    assert repeated.iterations < plan.iterations
    tracker = ocp.track(plan)
    assert (
        np.abs(tracker.control(0.0, plan.trajectory.states[0]) - plan.rest_lengths()[0]).max()
        < 1e-3
    )


def limp():
    return tc.Model(
        tc.Scene(prism(1.0, stiffness=[500.0] * 3 + [0.0] * 6), control=tc.RestLength())
    )


BAD = {
    "no control": (lambda: ocp.Problem(tc.Model(tc.Scene(prism(1.0)))), "give a model of Scene"),
    "no stiffness": (
        lambda: ocp.Problem(limp()),
        "string 3 without stiffness, which no rest length pulls: give Structure",
    ),
    "Sampling": (
        lambda: ocp.solve(ocp.Problem(MODEL, goals=GOALS), solver=ocp.Sampling()),
        r"Sampling is for force densities, and the model has control=RestLength\(\)",
    ),
    "crossed": (
        lambda: ocp.Problem(
            MODEL, bounds=[ocp.RestLengthLimits(0.5), ocp.RestLengthLimits(upper=0.4)]
        ),
        "RestLengthLimits leave string 0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_rest_length_does_is_refused(name):
    make, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        make()


def test_plans_of_rest_lengths_are_not_wound_again(plan):
    for ask in (ocp.is_realizable, ocp.replay_rest_lengths):
        with pytest.raises(ValueError, match="plan has decided rest lengths"):
            ask(plan)


def test_robustness_replays_a_plan_of_rest_lengths(plan):
    exact = plan.robustness({"bar_mass": 1e-9, "stiffness": 1e-9}, samples=2)
    np.testing.assert_allclose(exact.error, plan.replay_error, rtol=0.05, atol=1e-6)
