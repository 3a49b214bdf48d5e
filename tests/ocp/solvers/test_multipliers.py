"""Multipliers: what limits and goals cost, against what plans with other limits and goals cost; and what starting from them saves."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from planning import prism

import ocp
import tenscasadi as tc

MOST = 10.25  # N, which holds some of the time


MODEL = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))


def problem(to=1.15, most=MOST, least=5.0, goals=None, **changes):
    goals = [ocp.Shape(prism(to).nodes), ocp.AtRest()] if goals is None else goals
    bounds = [ocp.ForceDensityLimits(least, 100.0), ocp.TensionLimits(upper=most)]
    return ocp.Problem(
        MODEL, **{"goals": goals, "bounds": bounds, "costs": [ocp.Effort()], **changes}
    )


def slope(plan, name, value, change):
    """How the least cost changes with an argument of `problem`, by difference."""
    solver = ocp.Ipopt(tolerance=1e-10, warm_start=True)
    up, down = (
        ocp.solve(problem(**{name: value + step}), plan.transcription, solver, plan).objective
        for step in (change, -change)
    )
    return (up - down) / (2 * change)


SHARP = ocp.Ipopt(tolerance=1e-10)
TRANSCRIPTIONS = [
    ocp.MultipleShooting(10),
    ocp.Variational(12),
    ocp.Variational(12, control=ocp.PiecewiseLinear()),
]


@pytest.mark.parametrize("transcription", TRANSCRIPTIONS, ids=["shooting", "variational", "linear"])
def test_multipliers_are_what_giving_way_saves(transcription):
    plan = ocp.solve(problem(), transcription, SHARP)
    assert plan.success
    tension = sum(plan.duals[f"tension of string {k}"].sum() for k in range(9))
    assert tension > 0.1
    assert slope(plan, "most", MOST, 1e-3) == pytest.approx(-tension, rel=1e-3)
    density = sum(plan.duals[f"force density of string {k}"].sum() for k in range(9))
    assert density < -1.0  # lower limits hold
    assert slope(plan, "least", 5.0, 1e-3) == pytest.approx(-density, rel=1e-3)
    duals = {(one.name, one.side): one.dual for one in plan.report().active}
    assert duals["tension of string 6", "upper"] == pytest.approx(
        plan.duals["tension of string 6"].sum(), rel=1e-3
    )
    assert "costs" in str(plan.report())


def test_multipliers_of_goals_are_what_moving_them_costs():
    transcription, change = ocp.Variational(12), 1e-4
    plan = ocp.solve(problem(), transcription, SHARP)
    higher, lower = (ocp.Shape(prism(1.15 + step).nodes) for step in (change, -change))
    structure = prism(1.0)
    nodes = ca.DM(MODEL.nodes(MODEL.initial_state).T)
    distances = [goal.rows(structure, nodes, None).value.full().ravel() for goal in (higher, lower)]
    names = [name for name in plan.duals.names if name.startswith("Shape: ")]
    wanted = (distances[1] - distances[0]) / (2 * change)  # rows are what is, less what is wanted
    predicted = -sum(plan.duals[name][0] * rate for name, rate in zip(names, wanted, strict=True))
    assert abs(predicted) > 1.0
    assert slope(plan, "to", 1.15, change) == pytest.approx(predicted, rel=1e-3)


def test_waypoints_have_multipliers_too():
    def through(height):
        way = ocp.Waypoint([ocp.Shape(prism(height).nodes)], share=0.5)
        return problem(most=100.0, goals=[way, ocp.Shape(prism(1.1).nodes), ocp.AtRest()])

    plans = [ocp.solve(through(height), ocp.Variational(12), SHARP) for height in (1.07, 1.0701)]
    assert all(plan.success for plan in plans)
    names = [
        name
        for name in plans[0].duals.names
        if name.startswith("waypoint at 0.5 of the duration, Shape: ")
    ]
    pairs = [tuple(map(int, name.split("nodes ")[1].split(" and "))) for name in names]
    moved = [
        np.diff([np.linalg.norm(prism(h).nodes[a] - prism(h).nodes[b]) for h in (1.07, 1.0701)])[0]
        for a, b in pairs
    ]
    predicted = -sum(
        plans[0].duals[name][0] * distance for name, distance in zip(names, moved, strict=True)
    )
    assert plans[1].objective - plans[0].objective == pytest.approx(predicted, rel=2e-2)


WARM = {
    "shooting": ocp.MultipleShooting(10),
    "variational": ocp.Variational(12),
    "linear, unequal": ocp.Variational(
        (1.0, 2.0, 2.0, 3.0, 2.0, 2.0, 1.0), control=ocp.PiecewiseLinear()
    ),
}


@pytest.mark.parametrize("name", WARM)
def test_a_start_from_multipliers_saves_most_iterations(name):
    cold = ocp.solve(problem(), WARM[name], tolerance=0.1)
    nearby = problem(to=1.16, most=10.35)
    again, other = (
        ocp.solve(asked, WARM[name], ocp.Ipopt(warm_start=True), guess=cold, tolerance=0.1)
        for asked in (problem(), nearby)
    )
    assert cold.success
    assert again.success
    assert other.success
    assert again.iterations <= 2
    assert other.iterations <= cold.iterations / 2
    assert (
        ocp.solve(problem(), WARM[name], guess=cold, tolerance=0.1).iterations
        > 2 * again.iterations
    )  # without keeping to it
    assert other.objective == pytest.approx(
        ocp.solve(nearby, WARM[name], tolerance=0.1).objective, rel=1e-5
    )


def test_multipliers_of_another_grid_are_left_alone():
    coarse = ocp.solve(problem(), ocp.Variational(8))
    fine = ocp.solve(problem(), ocp.Variational(12), guess=coarse)
    assert fine.success
    assert fine.duals.names != coarse.duals.names


def test_multipliers_are_saved(tmp_path):
    plan = ocp.solve(problem(), ocp.Variational(8))
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert loaded.duals.names == plan.duals.names
    assert np.array_equal(loaded.duals.values, plan.duals.values)
    warm = ocp.solve(problem(), ocp.Variational(8), ocp.Ipopt(warm_start=True), guess=loaded)
    assert warm.iterations <= 2
    none = ocp.solve(problem(), ocp.Variational(8), ocp.Ipopt(max_iterations=2))
    assert none.duals is None
    assert ocp.Plan.load(none.save(tmp_path / "none.npz")).duals is None


def test_names_without_multiplier_are_refused():
    duals = ocp.solve(problem(), ocp.Variational(6)).duals
    with pytest.raises(TypeError, match=r"Duals\[name\] is 0: give one of Duals.names"):
        duals[0]
    with pytest.raises(
        KeyError, match=r"tension of string 9.*has no multiplier.*tension of string 0"
    ):
        duals["tension of string 9"]
    assert len(duals["tension of string 1"]) == 12
    assert not replace(duals, names=(), values=np.zeros(0)).names
