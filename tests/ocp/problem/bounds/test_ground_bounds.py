"""Nodes above planes and height fields."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.constraints import build_constraint

PRISM = tc.shapes.prism(prestress=20.0, stiffness=1000.0)
LOW = float(PRISM.nodes[:, 2].min())
SLOPE = tc.Ground(normal=(-0.3, 0.1, 1.0), height=LOW - 0.4)
X = np.linspace(-2, 2, 9)
HILLS = tc.Terrain(0.1 * np.sin(3 * X[:, None]) * X + LOW - 0.12, (-2, -2), (2, 2))


def model(structure=PRISM):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity()))


@pytest.mark.parametrize("ground", [SLOPE, HILLS])
def test_the_rows_are_distances_from_the_surface(ground):
    driven = model(PRISM.replace(pinned=[1]))
    row = build_constraint(ocp.AboveSurface(ground, 0.02, nodes=[1, 2, 5]), driven)
    assert len(row.names) == 2  # node 1 cannot move
    x = driven.initial_state + 0.1 * np.random.default_rng(0).normal(size=driven.nx)
    values = [
        x if symbol.shape[0] == driven.nx else np.zeros(symbol.shape) for symbol in row.symbols
    ]
    found = ca.Function("distances", list(row.symbols), [row.value])(*values).full().ravel()
    assert found == pytest.approx(
        -ground.depth(driven.nodes(x)[[2, 5]].T).full().ravel(), abs=1e-12
    )
    assert row.lower.tolist() == [0.02, 0.02]


@pytest.mark.parametrize("transcription", [ocp.Variational(12), ocp.MultipleShooting(12)])
def test_a_plan_stays_above_hills_that_are_in_its_way(transcription):
    lengths = {string: 0.75 * length for string, length in enumerate(PRISM.string_lengths[:3])}
    plans = [
        ocp.solve(
            ocp.Problem(
                tc.Model(
                    tc.Scene(PRISM, gravity=tc.Gravity((0, 0, -2.0)), control=tc.ForceDensity())
                ),
                0.25,
                goals=[ocp.StringLengths(lengths)],
                bounds=[ocp.ForceDensityLimits(0.0, 300.0), *bounds],
                costs=[ocp.Effort()],
            ),
            transcription,
        )
        for bounds in ([], [ocp.AboveSurface(HILLS, 0.03)])
    ]
    distances = [
        -HILLS.depth(plan.trajectory.nodes[1:].reshape(-1, 3).T).full().max() for plan in plans
    ]
    assert all(plan.success for plan in plans), [plan.message for plan in plans]
    assert distances[0] < 0.029
    assert distances[1] > 0.03 - 1e-5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ocp.AboveSurface(0.1),
            "AboveSurface.ground is 0.1: give a tenscasadi.Ground or Terrain",
        ),
        (lambda: ocp.AboveSurface(SLOPE, "high"), "AboveSurface.distance is not a real number"),
        (lambda: ocp.AboveSurface(SLOPE, nodes=3), "AboveSurface.nodes is 3: give a list"),
        (
            lambda: ocp.AboveSurface(SLOPE, nodes=[9]).check(PRISM),
            "AboveSurface.nodes[0] is 9: node indices run from 0 to 5",
        ),
        (
            lambda: ocp.AboveSurface(SLOPE, nodes=[1]).check(PRISM.replace(pinned=[1])),
            "AboveSurface.nodes has pinned nodes only",
        ),
    ],
)
def test_what_is_wrong_is_refused_by_name(make, message):
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        make()


def test_a_start_below_the_surface_is_refused():
    bounds = [ocp.AboveSurface(HILLS, 0.5), ocp.ForceDensityLimits(0.0, 9.0)]
    with pytest.raises(
        ValueError, match=r"Problem\.start has distance of node \d from the Terrain at"
    ):
        ocp.solve(
            ocp.Problem(model(), 1.0, goals=[ocp.AtRest()], bounds=bounds), ocp.Variational(2)
        )
