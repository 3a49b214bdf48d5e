"""Plans of rest-length rates: limits, replay, files, and unsupported uses."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ocp
import tenscasadi as tc

RATE = 1.0


@cache
def problem(**changes: Any) -> ocp.Problem:
    cross = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0, damping=2.0)
    model = tc.Model(tc.Scene(cross, control=tc.RestLengthRate()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.75).string_lengths), ocp.AtRest()]
    bounds = [ocp.RestLengthRateLimits(RATE), ocp.TensionLimits(upper=100.0)]
    fields = {"duration": 0.6, "goals": goals, "bounds": bounds, "costs": [ocp.Effort()]}
    return ocp.Problem(model, **fields | changes)


@pytest.mark.parametrize(
    "transcription",
    [ocp.Variational(30), ocp.MultipleShooting(12, substeps=2), ocp.DirectCollocation(12)],
)
def test_plans_wind_within_their_limits(transcription: Any, tmp_path: Path) -> None:
    plan = ocp.solve(problem(), transcription)
    assert plan.success, plan.message
    assert plan.control is plan.rest_length_rate
    assert np.abs(plan.rest_length_rate).max() <= RATE * (1 + 1e-6)
    assert plan.tension().max() <= 100.0 + 1e-3
    rest = plan.trajectory.internal_states["rest length"]
    changes = np.diff(plan.time)[:, None] * plan.rest_length_rate
    assert np.allclose(np.diff(rest, axis=0), changes, rtol=0, atol=1e-7)
    assert np.allclose(rest[0], plan.structure.rest_length)
    assert np.allclose(plan.rest_lengths(), rest[:-1])
    replay = plan.replay()
    assert np.allclose(replay.nodes[-1], plan.trajectory.nodes[-1], rtol=0, atol=5e-3)
    plan.save(tmp_path / "plan.npz")
    back = ocp.Plan.load(tmp_path / "plan.npz")
    assert np.array_equal(back.rest_length_rate, plan.rest_length_rate)
    assert "rest-length rate of string 0" in str(plan.report())


def motors() -> ocp.Problem:
    cross = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0, damping=2.0)
    winch = tc.Winch(0.02, 1e-3, friction=1e-3, torque=2.5, speed=30.0)
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.75).string_lengths), ocp.AtRest()]
    model = tc.Model(tc.Scene(cross, control=winch))
    return ocp.Problem(model, duration=0.6, goals=goals, costs=[ocp.Effort()])


def test_plans_of_motors_keep_their_limits(tmp_path: Path) -> None:
    plan = ocp.solve(motors(), ocp.DirectCollocation(30))
    assert plan.success, plan.message
    assert plan.control is plan.motor_torque
    assert np.abs(plan.motor_torque).max() <= 2.5 * (1 + 1e-6)
    speeds = plan.trajectory.internal_states["winding speed"]
    assert 20.0 < np.abs(speeds).max() <= 30.0 * (1 + 1e-6)
    plan.save(tmp_path / "plan.npz")
    assert np.array_equal(ocp.Plan.load(tmp_path / "plan.npz").motor_torque, plan.motor_torque)
    earlier = plan.to_arrays()  # whose inputs were in a field of their control
    earlier["motor_torque"] = earlier.pop("inputs")
    del earlier["input_attribute"]
    assert np.array_equal(ocp.Plan.from_arrays(earlier).motor_torque, plan.motor_torque)
    with pytest.raises(ValueError, match=r"give MultipleShooting\(\) or DirectCollocation\(\)"):
        ocp.solve(motors(), ocp.Variational(10))


@pytest.mark.parametrize("costs", [[], [ocp.Effort(0.5)]])
def test_effort_of_motors_is_that_of_their_torques(costs: list[ocp.Effort]) -> None:
    hanging = tc.Structure(
        nodes=[(0, 0, 0), (0, 0, -1)],
        strings=[(0, 1)],
        pinned=[0],
        node_mass=[0.0, 2.0],
        stiffness=500.0,
        rest_length=0.96,
    )
    scene = tc.Scene(hanging, control=tc.Winch(0.05, 2e-3, 1e-3), gravity=tc.Gravity())
    goals = [ocp.NodePositions({1: (0, 0, -0.8)}), ocp.AtRest()]
    plan = ocp.solve(ocp.Problem(tc.Model(scene), 0.6, goals=goals, costs=costs))
    assert plan.success, plan.message  # without limits, torques do not alternate
    effort = float(np.diff(plan.time) @ (plan.motor_torque**2).sum(axis=1))
    weight = costs[0].weight if costs else 1.0
    assert plan.objective == pytest.approx(weight * effort, rel=1e-6)


def test_the_default_method_plans_winches() -> None:
    plan = ocp.solve(problem())
    assert plan.success, plan.message


def test_limits_of_rest_lengths_are_path_constraints() -> None:
    least = 0.9 * problem().model.structure.rest_length.min()
    bounds = [ocp.RestLengthRateLimits(RATE), ocp.RestLengthLimits(least)]
    plan = ocp.solve(problem(bounds=tuple(bounds)), ocp.Variational(20))
    assert plan.rest_lengths().min() >= least - 1e-6


@pytest.mark.parametrize(
    ("use", "cure"),
    [
        (
            lambda: ocp.solve(problem(), ocp.MultipleShooting(5), ocp.Sampling()),
            r"Sampling .*control=ForceDensity",
        ),
        (
            lambda: ocp.Problem(problem().model, phases=[ocp.Phase(0.3)]),
            r"phases .*control=ForceDensity",
        ),
    ],
)
def test_unsupported_uses_name_the_cure(use: Any, cure: str) -> None:
    with pytest.raises(ValueError, match=cure):
        use()
