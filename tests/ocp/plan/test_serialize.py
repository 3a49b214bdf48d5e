"""Options of plans as text: every kind comes back as it was."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.plan.serialize import plan_arrays, rebuilt

PRISM = tc.shapes.prism(3, stiffness=1000.0, bar_radius=0.005)
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
NINE = np.linspace(1.0, 2.0, 9) / 3
GOALS = [
    ocp.StringLengths({0: 1.0 / 3, 2: 0.7}),
    ocp.StringLengths(PRISM.string_lengths),
    ocp.NodePositions({0: (0.1, None, None)}),
    ocp.NodePositions(PRISM.nodes),
    ocp.Shape(PRISM.nodes),
    ocp.AtRest(),
    ocp.Waypoint([ocp.Shape(PRISM.nodes), ocp.AtRest()], share=0.5),
    ocp.Waypoint([ocp.AtRest()], time=0.3),
    ocp.Periodic((0.1, 0.0, None)),
]
BOUNDS = [
    ocp.ForceDensityLimits(NINE, 100.0),
    ocp.TensionLimits(upper=NINE * 1e3),
    ocp.RestLengthLimits(0.01, 2.0),
    ocp.RestLengthRateLimits(NINE, stiffness=2000.0),
    ocp.BarForceLimits(compression=1e3),
    ocp.Buckling(7e10),
    ocp.InsideBox((None, -9.0, None), (9.0, None, None), nodes=[0, 1]),
    ocp.AboveGround(-1.0),
    ocp.BarClearance(0.001, pairs=[(0, 1)]),
    ocp.Obstacle((5.0, 5.0, 5.0), 0.1),
]
COSTS = [ocp.Effort(0.1), ocp.Smoothness(), ocp.Prestress(NINE), ocp.Tracking({1: (0.0, None, 1.0)}), ocp.Duration(), ocp.Work(0.5)]
TRANSCRIPTIONS = [
    ocp.MultipleShooting(7, scheme=tc.Collocation(degree=3), substeps=2, control=ocp.PiecewiseLinear(groups=((0, 1, 2),))),
    ocp.MultipleShooting((1.0, 2.0, 3.0), scheme=tc.DormandPrince853()),
    ocp.ImplicitMidpoint(np.int64(5), accuracy=1e-5),
    ocp.Variational(3),
    ocp.Collocation(4, degree=3),
]
SOLVERS = [ocp.Ipopt(50, seconds=2.0, options={"mu_strategy": "adaptive", "acceptable_tol": np.float64(1e-6)}), ocp.Fatrop(tolerance=1e-7)]


def same(one: Any, other: Any) -> bool:
    """Equal in type and value, bit by bit."""
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, (list, tuple)):
        return type(one) is type(other) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    return bool(one == other)


def again(parts: dict[str, Any]) -> dict[str, Any]:
    """How a plan was solved, through a file's arrays."""
    whole: dict[str, Any] = {"transcription": ocp.Variational(2), "solver": ocp.Ipopt(), "unknown": "", **parts}
    plan = {
        name: np.zeros(1) for name in ("success", "status", "message", "objective", "iterations", "seconds", "replay_error", "replay_speed_error")
    }
    run = tc.simulate(MODEL, 0.01, 0.01, compiled=False)
    content = plan_arrays({**plan, **whole, "time": run.time, "force_density": NINE, "trajectory": run, "model": MODEL, "duals": None})
    return rebuilt(content, MODEL, None)


@pytest.mark.parametrize("field", ["goals", "bounds", "costs"])
def test_problems_come_back(field):
    every = {"goals": GOALS, "bounds": BOUNDS, "costs": COSTS}
    asked = ocp.Problem(MODEL, 1.0 if field == "goals" else (0.5, 1.5), **{field: every[field]})
    found = again({"problem": asked})
    assert found["unknown"] == ""
    assert found["problem"].duration == asked.duration
    assert np.abs(found["problem"].start - asked.start).max() < 1e-14
    assert same(getattr(found["problem"], field), getattr(asked, field))


def test_a_free_start_comes_back():
    asked = ocp.Problem(MODEL, start=ocp.FreeStart(goals=[ocp.NodePositions({0: (0.1, None, None)})]))
    found = again({"problem": asked})["problem"]
    assert same(found.start.goals, asked.start.goals)
    assert np.abs(found.start.near - asked.start.near).max() < 1e-14


@pytest.mark.parametrize("transcription", TRANSCRIPTIONS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_transcriptions_and_solvers_come_back(transcription, solver):
    found = again({"problem": ocp.Problem(MODEL), "transcription": transcription, "solver": solver})
    assert same(found["transcription"], transcription)
    assert same(found["solver"], solver)
