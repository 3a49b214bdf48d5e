"""Time-varying LQR: disturbances that ruin a plan are rejected, within limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from controlling import MODEL, gust, misfit

import ocp
import tenscasadi as tc
from ocp.control import lqr
from tenscasadi.dynamics.linearization import tangents


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


def test_decisions_are_as_long_as_the_shortest_interval(plan):
    time = plan.time.copy()
    time[1:-1] += 0.2 * (time[1] - time[0])
    uneven = replace(plan, time=time)
    assert len(ocp.track(uneven).gains) == 25
    assert len(ocp.track(uneven, decisions=12).gains) == 12


def test_without_disturbance_the_regulator_is_the_plan(plan):
    kept = ocp.run(ocp.track(plan), 1.0)
    assert misfit(kept.trajectory) < 1e-3
    assert kept.trajectory.nodes[-1] == pytest.approx(plan.trajectory.nodes[-1], abs=1e-3)


def test_many_motions_roll_out_as_one_does(plan):
    """Plants of three masses under the regulator, beyond the end of the plan: all at once, and one by one."""
    tracker, start = ocp.track(plan, decisions=10), plan.trajectory.states[0]
    plants = tc.Model(
        tc.Scene(
            MODEL.structure, control=tc.ForceDensity(), parameters=tc.Parameters(scale=["bar_mass"])
        )
    )
    scales = np.array([[0.9], [1.0], [1.2]])
    many = tc.rollouts(
        plants, 1.2, 0.01, start, tracker.feedback, scales, correction=tc.Projection(every=10)
    )
    assert many.success.all(), many.summary()
    for scale, final in zip(scales[:, 0], many.final, strict=True):
        plant = tc.Model(
            tc.Scene(
                MODEL.structure.replace(bar_mass=scale * MODEL.structure.bar_mass),
                control=tc.ForceDensity(),
            )
        )
        alone = ocp.run(tracker, 1.2, plant, start, steps=10).trajectory
        np.testing.assert_allclose(final, alone.states[-1], rtol=0, atol=1e-9)


def test_tangents_are_what_bars_allow():
    Z = tangents(MODEL, MODEL.initial_state)
    assert Z.shape == (36, 30)
    assert pytest.approx(np.eye(30), abs=1e-12) == Z.T @ Z
    moved = MODEL.initial_state + 1e-4 * Z @ np.ones(30)
    assert MODEL.bar_length_error(moved) < 1e-6


STATE = MODEL.initial_state


BAD = {
    "track above NaN": (lambda plan: ocp.track(plan, lower=np.nan), ValueError, "lower is nan"),
    "track within nothing": (
        lambda plan: ocp.track(plan, lower=50.0, upper=10.0),
        ValueError,
        "lower is 50 and upper is 10 for string 0",
    ),
    "track that pushes": (
        lambda plan: ocp.track(plan, lower=-5.0, upper=-5.0),
        ValueError,
        "lower of string 0 is -5",
    ),
    "track above a word": (lambda plan: ocp.track(plan, lower="a"), TypeError, "lower"),
    "track at a state too short": (
        lambda plan: ocp.track(plan).control(0.0, STATE[:3]),
        ValueError,
        r"state has shape \(3,\)",
    ),
    "track at NaN": (
        lambda plan: ocp.track(plan).control(np.nan, STATE),
        ValueError,
        "time is nan",
    ),
    "track no plan": (lambda plan: ocp.track(1), TypeError, "plan"),
    "track at no place": (
        lambda plan: ocp.track(plan, position_scale=-1.0),
        ValueError,
        "position_scale",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(plan, name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make(plan)


@pytest.mark.parametrize("success", [True, False])
def test_track_rejects_a_plan_whose_deviations_explode(plan, monkeypatch, success):
    exact = lqr.transitions
    monkeypatch.setattr(lqr, "transitions", lambda *given: [1e200 * part for part in exact(*given)])
    failed = "" if success else ", which failed,"
    with pytest.raises(
        ValueError,
        match=rf"decisions is 20: deviations from the plan{failed} grow too fast.* more decisions",
    ):
        ocp.track(replace(plan, success=success))
