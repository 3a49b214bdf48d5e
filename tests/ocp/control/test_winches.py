"""Controllers of models under every control: winches, motors, rest lengths, tensions, cables."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import ocp
import tenscasadi as tc

MOTOR = tc.Winch(0.02, 1e-3, 1e-3, torque=5.0, speed=60.0)
CONTROLS = {
    "tensions": (tc.Tension(), []),
    "rest lengths": (tc.RestLength(), []),
    "winding speeds": (tc.RestLengthRate(), [ocp.RestLengthRateLimits(1.0)]),
    "motors": (MOTOR, []),
}


def mast(control, mass=2.0):
    """A bar of 1 m on a hinge, under its weight, between two guys with winches."""
    s = tc.Structure(
        [(0, 0, 0), (0, 0, 1), (-1, 0, 0), (1, 0, 0)],
        bars=[(0, 1)],
        strings=[(1, 2), (1, 3)],
        bar_mass=mass,
        pinned={0: "xyz", 1: "y", 2: "xyz", 3: "xyz"},
        stiffness=1000.0,
        damping=2.0,
    )
    return tc.Model(tc.Scene(s.prestressed([60.0, 60.0]), control=control, gravity=tc.Gravity()))


@cache
def leaning(name):
    """The mast leans by 0.3 m."""
    control, bounds = CONTROLS[name]
    goals = [ocp.NodePositions({1: (0.3, None, None)}), ocp.AtRest()]
    limits = [*bounds, ocp.ForceDensityLimits(5.0, 300.0)]
    return ocp.Problem(mast(control), 1.0, goals=goals, bounds=limits, costs=[ocp.Effort()])


@cache
def planned(name):
    return ocp.solve(leaning(name))


def push_of(controller):
    """Build the disturbance by which the tip gets 0.3 m/s in the first decision after 0.5 s."""

    def push(time, x):
        pushed = 0.0 <= time - 0.5 + 1e-9 < controller.period
        return x + 0.3 * pushed * np.eye(len(x))[2]

    return push


@pytest.mark.parametrize("name", ["rest lengths", "winding speeds", "motors"])
def test_a_plan_is_tracked_after_a_push_and_held(name):
    plan = planned(name)
    assert plan.success, plan.message
    tracker = ocp.track(plan)
    assert "the end is held by tensions up to" in tracker.message
    end = plan.trajectory.nodes[-1]
    push = push_of(tracker)
    alone, kept, held = (
        np.abs(run.trajectory.nodes[-1] - end).max()
        for run in (
            ocp.run(ocp.track(plan, control_scale=1e-6), 1.0, steps=20, disturbance=push),
            ocp.run(tracker, 1.0, steps=20, disturbance=push),
            ocp.run(tracker, 4.0, steps=20),
        )
    )
    assert kept < 0.5 * alone
    assert held < 1e-4


def test_a_motor_that_nobody_tracks_falls():
    plan = planned("motors")
    heavy = mast(MOTOR, 2.2)
    start, end = plan.trajectory.states[0], plan.trajectory.nodes[-1]
    control = np.vstack([plan.control, np.tile(plan.control[-1], (2 * len(plan.control), 1))])
    alone = tc.simulate(heavy, 3.0, 1e-3, state=start, control=control, compiled=False)
    kept = ocp.run(ocp.track(plan), 3.0, heavy, start, steps=20).trajectory
    assert np.abs(alone.nodes[-1] - end).max() > 0.3
    assert np.abs(kept.nodes[-1] - end).max() < 0.01


def test_rollouts_track_motors_as_one_run_does():
    plan = planned("motors")
    tracker, start = ocp.track(plan), plan.trajectory.states[0]
    many = tc.rollouts(
        plan.model, 1.0, 1.0 / (20 * len(plan.control)), start[None], tracker.feedback
    )
    one = ocp.run(tracker, 1.0, state=start, steps=20).trajectory
    assert plan.model.nodes(many.final[0]) == pytest.approx(one.nodes[-1], abs=1e-6)


@pytest.mark.parametrize("name", CONTROLS)
def test_predictive_control_reaches_goals(name):
    controller = ocp.Mpc(leaning(name), 0.05, 10, substeps=4)
    run = ocp.run(controller, 2.0, steps=20).trajectory
    assert run.nodes[-1, 1, 0] == pytest.approx(0.3, abs=1e-4)
    lower, upper = leaning(name).control_limits
    assert (run.control >= lower - 1e-9).all()
    assert (run.control <= upper + 1e-9).all()


@pytest.mark.parametrize("name", ["winding speeds", "motors"])
def test_exported_decisions_are_those_of_the_controller(name):
    controller = ocp.Mpc(leaning(name), 0.05, 5, substeps=4)
    state = controller.model.initial_state
    decide = controller.function()
    more = [np.full(len(state), np.nan)] * (decide.n_in() - 3)
    exported = decide(0.0, state, controller.first, *more)[0].full()[:, 0]
    assert exported == pytest.approx(controller.control(0.0, state), abs=1e-5)


@pytest.mark.parametrize("along_plan", [True, False])
def test_predictive_control_follows_a_plan_of_motors(along_plan):
    plan = planned("motors")
    controller = ocp.Mpc(leaning("motors"), 0.05, 10, plan=plan if along_plan else None, substeps=4)
    run = ocp.run(controller, 3.0, mast(MOTOR, 2.2), steps=20).trajectory
    assert run.nodes[-1, 1, 0] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(("name", "noise"), [("winding speeds", None), ("motors", 0.1)])
def test_sampled_control_reaches_goals(name, noise):
    # goals are weighed against costs, and the prestress alone costs 7200 a second at weight 1
    problem = replace(leaning(name), costs=[ocp.Effort(1e-4)])
    controller = ocp.Mppi(problem, 0.05, 0.5, 128, noise=noise, steps=20)
    run = ocp.run(controller, 3.0, steps=20).trajectory
    assert run.nodes[-1, 1, 0] == pytest.approx(0.3, abs=0.01)


def hoist(control):
    """A load of 2 kg hangs from a cable that runs from a winch over a pulley."""
    return tc.Structure(
        [(0, 0, 1), (1, 0, 1), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        cables=[[0, 1]],
        node_mass=[0, 0, 2.0],
        pinned={0: "xyz", 1: "xyz", 2: "xy"},
        stiffness=4000.0,
        damping=20.0,
    ).prestressed([19.62, 19.62])


@pytest.mark.parametrize(
    ("control", "bounds"),
    [
        (tc.RestLengthRate(), [ocp.RestLengthRateLimits(0.5)]),
        (tc.Winch(0.05, 2e-3, 1e-2, torque=2.0), []),
    ],
    ids=["winding speed", "motor"],
)
def test_a_winch_raises_a_load_to_the_height_asked_for(control, bounds):
    """At rest, T = m g, ρ = Σs − T/k with the stiffness k of both strings, and τ = r T."""
    model = tc.Model(tc.Scene(hoist(control), control=control, gravity=tc.Gravity()))
    goals = [ocp.NodePositions({2: (None, None, 0.4)}), ocp.AtRest()]
    problem = ocp.Problem(model, 1.0, goals=goals, bounds=bounds)
    controller = ocp.Mpc(problem, 0.05, 10, substeps=4)
    run = ocp.run(controller, 4.0, steps=20).trajectory
    assert run.success
    assert run.nodes[-1, 2, 2] == pytest.approx(0.4, abs=1e-5)
    assert run.tension[-1] == pytest.approx(2.0 * 9.81, abs=1e-3)
    rest = run.internal_states["rest length"][-1]
    assert rest == pytest.approx([1.6 - 2.0 * 9.81 / 2000.0], abs=1e-5)
    held = 0.0 if isinstance(control, tc.RestLengthRate) else 0.05 * 2.0 * 9.81
    assert run.control[-1] == pytest.approx([held], abs=1e-3)
    if bounds:  # 0.4 m take 0.8 s at least
        assert np.abs(run.control).max() <= 0.5 + 1e-9
        reached = run.time[run.nodes[:, 2, 2] > 0.39][0]
        assert 0.78 < reached < 1.3


def test_limits_given_to_the_tracker_are_checked():
    plan = planned("motors")
    tracker = ocp.track(plan, lower=-1.0, upper=1.5)
    assert tracker.lower.tolist() == [-1.0, -1.0]
    assert ocp.track(plan).upper.tolist() == [5.0, 5.0]
    with pytest.raises(ValueError, match="lower is 2 and upper is 1 for input 0"):
        ocp.track(plan, lower=2.0, upper=1.0)
    with pytest.raises(ValueError, match="upper has shape"):
        ocp.track(plan, upper=[1.0, 2.0, 3.0])


def test_a_plant_with_another_control_is_rejected():
    with pytest.raises(ValueError, match=r"model has the control RestLength\(\): give a model of"):
        ocp.run(ocp.Mpc(leaning("motors")), 0.1, mast(tc.RestLength()))
