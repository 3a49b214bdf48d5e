"""Tasks: what is refused, and what an episode is."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.envs import Task

CROSS = tc.shapes.d_bar(pinned=[0], stiffness=100.0)
DRIVEN, WOUND = (
    tc.Model(tc.Scene(CROSS, control=control)) for control in (tc.ForceDensity(), tc.RestLength())
)
GRAVITY = tc.Gravity((0, 0, -10))
WEIGHED = tc.Model(
    tc.Scene(
        CROSS,
        control=tc.ForceDensity(),
        gravity=GRAVITY,
        parameters=tc.Parameters("gravity", scale=["bar_mass"]),
    )
)


def nothing(now):
    return np.zeros(len(now.time))


def test_spreads_are_of_nominal_values():
    task = Task(WEIGHED, nothing, 0.0, 9.0, parameters={"bar_mass": 0.2, "gravity": 0.1})
    assert task.spread == pytest.approx([0.0, 0.0, 1.0, 0.2])


def test_an_episode_is_as_many_decisions_as_fit():
    assert [
        Task(DRIVEN, nothing, 0.0, 9.0, period=0.1, duration=duration).decisions
        for duration in (0.1, 0.3, 0.35)
    ] == [1, 3, 4]


BAD = {
    "no model": (lambda: Task(1, nothing, 0.0, 1.0), TypeError, "Task.model"),
    "no control": (
        lambda: Task(tc.Model(tc.Scene(CROSS)), nothing, 0.0, 1.0),
        ValueError,
        "Task.model has the control None",
    ),
    "no reward": (
        lambda: Task(DRIVEN, None, 0.0, 1.0),
        TypeError,
        "Task.reward is None: give a function",
    ),
    "observation no function": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, observation=3),
        TypeError,
        "Task.observation is 3",
    ),
    "limits crossed": (
        lambda: Task(DRIVEN, nothing, 1.0, 1.0),
        ValueError,
        "Task.lower of string 0 is not below upper",
    ),
    "strings that push": (
        lambda: Task(DRIVEN, nothing, -1.0, 1.0),
        ValueError,
        "Task.lower of string 0 is -1",
    ),
    "limits of other strings": (
        lambda: Task(DRIVEN, nothing, [0.0] * 5, 1.0),
        ValueError,
        "Task.lower has shape",
    ),
    "rest lengths of zero": (
        lambda: Task(WOUND, nothing, 0.0, 1.0, rest_length_rate=1.0),
        ValueError,
        "Task.lower of string 0 is 0",
    ),
    "no speed": (
        lambda: Task(WOUND, nothing, 0.1, 1.0),
        ValueError,
        "Task.rest_length_rate is None: give the greatest rate",
    ),
    "a speed without text, of force densities": (
        lambda: Task(DRIVEN, nothing, 0.1, 1.0, rest_length_rate=10**5000),
        ValueError,
        "Task.rest_length_rate is a value",
    ),
    "a speed of force densities": (
        lambda: Task(DRIVEN, nothing, 0.1, 1.0, rest_length_rate=1.0),
        ValueError,
        "Task.rest_length_rate is 1",
    ),
    "period zero": (lambda: Task(DRIVEN, nothing, 0.0, 1.0, period=0.0), ValueError, "Task.period"),
    "steps for hours": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, steps=10**9),
        ValueError,
        "Task.steps is 1e\\+09: it must be at most 1000000",
    ),
    "steps zero": (lambda: Task(DRIVEN, nothing, 0.0, 1.0, steps=0), ValueError, "Task.steps"),
    "shorter than a period": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, duration=0.01),
        ValueError,
        "Task.duration is 0.01, shorter",
    ),
    "a state off its bars": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, state=2 * DRIVEN.initial_state),
        ValueError,
        "Task.state is off",
    ),
    "start negative": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, start=-1.0),
        ValueError,
        "Task.start is -1",
    ),
    "start of three": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, start=(1.0, 2.0, 3.0)),
        ValueError,
        "Task.start has shape",
    ),
    "parameters no mapping": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, parameters=0.1),
        TypeError,
        "Task.parameters is 0.1",
    ),
    "no such parameter": (
        lambda: Task(WEIGHED, nothing, 0.0, 1.0, parameters={"stiffness": 0.1}),
        ValueError,
        "Task.parameters has 'stiffness', and the model's parameters are gravity, bar_mass",
    ),
    "too wide": (
        lambda: Task(WEIGHED, nothing, 0.0, 1.0, parameters={"bar_mass": 1.0}),
        ValueError,
        "'bar_mass'. is 1: give a spread relative",
    ),
    "correction no correction": (
        lambda: Task(DRIVEN, nothing, 0.0, 1.0, correction=1),
        TypeError,
        "Task.correction is 1",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_arguments_are_rejected_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
