"""Closed loops: clocks, decisions and disturbances; other plants and controllers."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from controlling import ARM, MODEL
from planning import driven, prism

import ocp
import tenscasadi as tc


def test_the_last_decision_holds_for_what_is_left(plan):
    tracker = ocp.track(plan)
    whole, part, short = (ocp.run(tracker, t_end).trajectory for t_end in (0.15, 0.12, 0.01))
    assert part.time[-1] == pytest.approx(0.12, abs=1e-12)
    assert np.array_equal(part.control[20:30], whole.control[20:30])
    assert part.nodes[-1] == pytest.approx(whole.nodes[24], abs=1e-9)
    assert short.time[-1] == 0.01


def test_periods_take_the_many_steps_of_hard_grounds(plan):
    held = ocp.run(ocp.track(plan), 0.01, steps=1806).trajectory
    assert held.success
    assert len(held.time) == 1807


def test_what_bars_do_not_allow_of_a_push_is_taken_off(plan):
    def push(time, x):
        return x + np.eye(36)[18] * (time == 0)

    held = ocp.run(ocp.track(plan), 0.05, disturbance=push).trajectory
    assert held.bar_length_error.max() < 1e-6


def test_run_names_functions_of_time_that_are_not_finite(plan):
    def fade(t):
        return ca.DM.ones(6, 3) * ca.sqrt(0.05 - t)

    gusts = tc.Model(replace(plan.problem.model.scene, forces=tc.NodalForce(fade)))
    with pytest.raises(ValueError, match=r"NodalForce\.values is not finite at t = 0\.05\d* s"):
        ocp.run(ocp.track(plan), 0.1, model=gusts)


@pytest.mark.parametrize(
    "make",
    [lambda asked, plan: ocp.Mpc(asked, 0.05, 8, plan=plan), lambda asked, plan: ocp.track(plan)],
    ids=["mpc", "track"],
)
def test_a_clock_runs_on_from_the_start(make):
    def wind(time):
        return ca.vertcat(
            ca.DM.zeros(1, 3), ca.horzcat(20 * ca.sin(4 * time), 0, 0), ca.DM.zeros(4, 3)
        )

    model = driven(ARM, forces=tc.NodalForce(wind))
    start = np.append(model.initial_state[:-1], 0.7)
    goals = [ocp.NodePositions({1: (0.3, 0.1, None)}), ocp.AtRest()]
    asked = ocp.Problem(
        model,
        1.0,
        start,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
        costs=[ocp.Effort()],
    )
    held = ocp.run(
        make(asked, ocp.solve(asked, ocp.MultipleShooting(20, substeps=2))), 1.0, state=start
    ).trajectory
    assert held.states[[0, -1], -1] == pytest.approx([0.7, 1.7])
    assert held.nodes[-1, 1, :2] == pytest.approx([0.3, 0.1], abs=0.02)


class Own:
    """A controller as users write them."""

    model = MODEL

    def __init__(self, decide, period=0.05):
        self.control, self.period = decide, period


def decided(value):
    return lambda plan: ocp.run(Own(lambda time, x: value), 0.1)


STATE = MODEL.initial_state


BAD = {
    "run with bars of other lengths": (
        lambda plan: ocp.run(ocp.track(plan), 0.1, state=2 * STATE),
        ValueError,
        "state is off the lengths",
    ),
    "run for ever": (lambda plan: ocp.run(ocp.track(plan), 1e99), ValueError, "t_end is 1e.99"),
    "run back in time": (
        lambda plan: ocp.run(Own(lambda time, x: np.ones(9), -1.0), 0.1),
        ValueError,
        "controller.period is -1",
    ),
    "run of a number": (lambda plan: ocp.run(Own(5), 0.1), TypeError, "controller is"),
    "run of a controller without model": (
        lambda plan: ocp.run(
            type("Blind", (Own,), {"model": None})(lambda time, x: np.ones(9)), 0.1
        ),
        TypeError,
        "controller.model is None",
    ),
    "run of other strings": (
        decided(np.ones(4)),
        ValueError,
        r"controller.control\(0, state\) has shape",
    ),
    "run of nothing decided": (decided(None), TypeError, "controller.control"),
    "run of NaN": (
        decided(np.full(9, np.nan)),
        ValueError,
        r"controller.control\(0, state\)\[0\] is nan",
    ),
    "disturbance no function": (
        lambda plan: ocp.run(ocp.track(plan), 0.1, disturbance=5),
        TypeError,
        "disturbance is 5",
    ),
    "run of a wound plant": (
        lambda plan: ocp.run(
            ocp.track(plan),
            0.1,
            tc.Model(tc.Scene(prism(1.0, stiffness=1e3), control=tc.RestLength())),
        ),
        ValueError,
        "model has the control RestLength",
    ),
    "run of another plant": (
        lambda plan: ocp.run(ocp.track(plan), 1.0, driven(tc.shapes.d_bar())),
        ValueError,
        "model has other nodes",
    ),
    "run of no controller": (
        lambda plan: ocp.run(ocp.Mpc, 1.0),
        TypeError,
        "controller is <class .*: give an ocp.Mpc",
    ),
    "run for no time": (lambda plan: ocp.run(ocp.track(plan), 0.0), ValueError, "t_end"),
    "disturbance that raises": (
        lambda plan: ocp.run(ocp.track(plan), 1.0, disturbance=lambda t: 1),
        ValueError,
        "disturbance fails with TypeError",
    ),
    "disturbance of wrong size": (
        lambda plan: ocp.run(ocp.track(plan), 1.0, disturbance=lambda t, x: x[:3]),
        ValueError,
        "disturbance",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(plan, name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make(plan)


def test_an_interrupted_run_keeps_what_there_is(capsys):
    count = []

    def decide(time, x):
        count.append(time)
        if len(count) == 4:
            raise KeyboardInterrupt
        return np.full(MODEL.nu, 20.0)

    loop = ocp.run(Own(decide), 1.0, progress=True)
    assert loop.trajectory.interrupted
    assert not loop.trajectory.success
    assert loop.trajectory.message == "interrupted after t = 0.15 s: the trajectory ends there"
    assert loop.trajectory.time[-1] == pytest.approx(0.15)
    assert len(loop.seconds) == 3
    assert "3/20" in capsys.readouterr().err
