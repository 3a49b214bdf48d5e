"""Costs over a horizon against sums over simulated motions, by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven

import ocp
import tenscasadi as tc
from ocp.control.mppi import _Decision

CROSS = driven(tc.shapes.d_bar(pinned=[0]))
PERIOD, COUNT, STEPS = 0.1, 4, 5


def costs(**asked):
    """Those of three samples, and their force densities and motions."""
    controller = ocp.Mppi(
        ocp.Problem(CROSS, 0.8, **{"bounds": [ocp.ForceDensityLimits(0.0, 20.0)], **asked}),
        PERIOD,
        0.4,
        3,
        steps=STEPS,
        position_scale=0.1,
    )
    tried = np.random.default_rng(0).uniform(2.0, 6.0, (3, COUNT, 2))
    runs = [
        tc.simulate(CROSS, 0.4, PERIOD / STEPS, control=gamma, compiled=False) for gamma in tried
    ]
    return controller._evaluate(0.7, CROSS.initial_state, tried), tried, runs


def at_ends(run):
    return run.nodes[STEPS::STEPS], run.velocities[STEPS::STEPS]


def test_running_costs_are_those_of_the_periods_ends_in_time():
    wanted = [
        ocp.Tracking({1: lambda t: (ca.sin(t), None, None)}, 2.0),
        ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities)),
    ]
    found, _, runs = costs(costs=wanted)
    times = 0.7 + PERIOD * np.arange(1, COUNT + 1)
    for cost, run in zip(found, runs, strict=True):
        nodes, velocities = at_ends(run)
        assert cost == pytest.approx(
            PERIOD
            * (
                2.0 * (nodes[:, 1, 0] - np.sin(times)) ** 2 + (velocities**2).sum(axis=(1, 2))
            ).sum(),
            rel=1e-9,
        )


def test_effort_under_rest_lengths_is_that_of_force_densities():
    elastic = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0)
    model = tc.Model(tc.Scene(elastic, control=tc.RestLength()))
    problem = ocp.Problem(model, 0.8, costs=[ocp.Effort(0.5)])
    controller = ocp.Mppi(problem, PERIOD, 0.4, 3, steps=STEPS, position_scale=0.1, noise=0.01)
    tried = (
        model.initial_control * np.linspace(0.98, 1.0, 3)[:, None, None] * np.ones((3, COUNT, 1))
    )
    found = controller._evaluate(0.0, model.initial_state, tried)
    for cost, rest in zip(found, tried, strict=True):
        run = tc.simulate(model, 0.4, PERIOD / STEPS, control=rest, compiled=False)
        ends = zip(run.states[STEPS::STEPS], rest, strict=True)
        squared = [np.sum(model.force_density(x, u) ** 2) for x, u in ends]
        assert cost == pytest.approx(0.5 * PERIOD * np.sum(squared), rel=1e-9)


def test_costs_of_force_densities_are_those_of_plans():
    found, tried, _ = costs(costs=[ocp.Effort(0.5), ocp.Smoothness(0.1), ocp.Prestress([1.0, 2.0])])
    for cost, gamma in zip(found, tried, strict=True):
        smooth = (np.diff(gamma, axis=0) ** 2).sum() / PERIOD
        assert cost == pytest.approx(
            PERIOD * (0.5 * (gamma**2).sum() + ((gamma - [1.0, 2.0]) ** 2).sum()) + 0.1 * smooth,
            rel=1e-9,
        )


def test_goals_count_on_the_way_and_at_the_end():
    found, _, runs = costs(
        goals=[ocp.NodePositions({1: (0.2, None, None)}), ocp.AtRest()],
        costs=[ocp.AtEnd("x", lambda end: 3 * end.nodes[0, 1])],
    )
    for cost, run in zip(found, runs, strict=True):
        nodes, velocities = at_ends(run)
        missed = ((nodes[:, 1, 0] - 0.2) / 0.1) ** 2 + ((velocities / (10 * 0.1 / 0.8)) ** 2).sum(
            axis=(1, 2)
        )
        assert cost == pytest.approx(missed.mean() + missed[-1] + 3 * nodes[-1, 1, 0], rel=1e-9)


def test_only_what_oversteps_a_limit_costs():
    def cost(**limits):
        bound = ocp.Constraint("x", lambda now: now.nodes[0, 1], **limits)
        return costs(bounds=[ocp.ForceDensityLimits(0.0, 20.0), bound], costs=[ocp.Effort(1e-9)])[0]

    _, _, runs = costs()
    largest = [at_ends(run)[0][:, 1, 0] for run in runs]
    assert cost(upper=2.0).max() < 1e-3
    limit = CROSS.structure.nodes[1, 0] + 1e-3
    beyond = [np.maximum(x - limit, 0.0).mean() / limit for x in largest]
    assert max(beyond) > 0.01
    assert cost(upper=limit) == pytest.approx(1e5 * np.array(beyond), rel=1e-6, abs=1e-3)


def test_limits_of_rates_hold_from_the_last_decision_on():
    rate = ocp.RestLengthRateLimits(0.01, stiffness=1000.0)
    first, tried, _ = costs(bounds=[ocp.ForceDensityLimits(0.0, 20.0), rate])
    assert first.min() > 100.0
    steady = np.full_like(tried, 3.0)
    controller = ocp.Mppi(
        ocp.Problem(
            CROSS,
            bounds=[ocp.ForceDensityLimits(0.0, 20.0), ocp.RestLengthRateLimits(50.0, 1000.0)],
        ),
        PERIOD,
        0.4,
        3,
    )
    assert controller._evaluate(0.0, CROSS.initial_state, steady).max() == 0.0
    controller._last = _Decision(
        0.0, CROSS.initial_state, np.array([2e5, 3.0])
    )  # another γ was decided before: its rest length is far away
    assert controller._evaluate(0.0, CROSS.initial_state, steady).min() > 100.0


@pytest.mark.slow  # to compile
def test_models_of_matrices_have_the_same_costs():
    chain = tc.Structure(
        [(k, 0, 0.1 * (-1) ** k) for k in range(9)],
        bars=[(k, k + 1) for k in range(8)],
        strings=[(k, k + 2) for k in range(7)],
        pinned=[0],
    )
    asked = {
        "goals": [ocp.NodePositions({8: (7.5, 0.0, None)})],
        "bounds": [ocp.ForceDensityLimits(0.0, 9.0), ocp.TensionLimits(upper=1.0)],
    }
    found = []
    for coordinates in ("reduced", "full"):
        model = tc.Model(tc.Scene(chain, control=tc.ForceDensity()), coordinates=coordinates)
        assert model.ode.is_a("MXFunction")
        problem = ocp.Problem(
            model, costs=[ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities))], **asked
        )
        controller = ocp.Mppi(problem, 0.05, 0.1, samples=4)
        found.append(controller._evaluate(0.0, model.initial_state, controller._draw()))
    assert found[0].min() > 1.0
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_parameters_have_the_values_of_the_problem():
    parametric = tc.Model(
        tc.Scene(CROSS.structure, control=tc.ForceDensity(), parameters=tc.Parameters("bar_mass"))
    )
    heavy = driven(CROSS.structure.replace(bar_mass=3.0))
    found = []
    for model, given in ((heavy, None), (parametric, {"bar_mass": 3.0})):
        asked = {
            "bounds": [ocp.ForceDensityLimits(0.0, 9.0)],
            "costs": [ocp.Tracking({1: lambda t: (t, None, None)})],
            "parameters": given,
        }
        controller = ocp.Mppi(ocp.Problem(model, **asked), samples=4)
        found.append(controller._evaluate(0.3, model.initial_state, controller._draw()))
    assert found[1] == pytest.approx(found[0], rel=1e-9)
