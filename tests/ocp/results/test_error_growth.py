"""How errors grow along plans: against analytic motions, and against differences of replays that start a little otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, leaning_arm, raising

import ocp
import tenscasadi as tc
from ocp.results.error_growth import measure_error_growth
from tenscasadi.dynamics.linearization import tangents


def test_a_free_mass_drifts():
    """From speeds of m per duration to as many m: [[1, 1], [0, 1]], whose largest singular value is the golden ratio."""
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 2.0], pinned=[0]
    )
    model = driven(structure)
    time = np.linspace(0.0, 0.7, 8)
    states = np.repeat(model.initial_state[None], 8, axis=0)
    assert measure_error_growth(model, time, states, np.zeros((7, 1))) == pytest.approx(
        (1 + np.sqrt(5)) / 2
    )


@pytest.mark.parametrize("intervals", [12, 40])
def test_an_inverted_pendulum_falls(intervals):
    """x¨ = σ² x about the top, σ² = 3 g / 2 l of a bar: [[cosh σT, sinh σT / σT], [σT sinh σT, cosh σT]]."""
    structure = tc.Structure(
        [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0)],
        [(0, 1)],
        [(1, 2)],
        pinned={0: "xyz", 1: "y", 2: "xyz"},
    )
    model = driven(structure, gravity=tc.Gravity())
    T, angle = 2.0, np.sqrt(1.5 * 9.81) * 2.0
    time = np.linspace(0.0, T, intervals + 1)
    grown = measure_error_growth(
        model,
        time,
        np.repeat(model.initial_state[None], intervals + 1, axis=0),
        np.zeros((intervals, 1)),
    )
    expected = np.linalg.norm(
        [[np.cosh(angle), np.sinh(angle) / angle], [angle * np.sinh(angle), np.cosh(angle)]], 2
    )
    assert grown == pytest.approx(expected, rel=1e-2)


@pytest.fixture(scope="module")
def arm():
    """Three hinged bars on top of each other, at first straight."""
    return ocp.solve(leaning_arm(3, 0.8), ocp.Variational(20, accuracy=1e-6))


@pytest.mark.slow
def test_growth_is_that_of_replays_that_start_otherwise(arm):
    """The largest ratio over the changes of the start that bars allow, by central differences in each."""
    model, T = arm.model, float(arm.time[-1])
    start = arm.trajectory.states[0]
    scale = np.repeat([1.0, T], model.nq)
    basis, _ = np.linalg.qr(scale[:, None] * tangents(model, start))

    def end(change):
        x = np.asarray(tc.build_projection(model, 5)(start + change / scale).full()).ravel()
        return tc.simulate(
            model, T, T / 400, tc.DormandPrince853(), x, arm.force_density, compiled=False
        ).states[-1]

    h = 1e-6
    slopes = np.column_stack(
        [scale * (end(h * column) - end(-h * column)) / (2 * h) for column in basis.T]
    )
    assert arm.error_growth == pytest.approx(np.linalg.norm(slopes, 2), rel=1e-2)
    assert arm.error_growth > 1e3


def test_growth_of_calm_plans_is_small(arm):
    assert "errors grow" not in arm.message  # as its open-loop replay meets the goals
    assert not arm.tracked
    calm = ocp.solve(raising(), ocp.Variational(20))
    assert calm.error_growth < 10


def test_tracked_replay_counts_where_errors_grow():
    plan = ocp.solve(leaning_arm(3, 0.8), ocp.Variational(20), tolerance=3e-3)
    assert plan.success, plan.message
    assert plan.tracked
    assert plan.replay_error <= 3e-3 < plan.open_loop_error
    assert "its tracked replay ends" in plan.message
    assert "it counts, as errors grow 9.8e+03-fold in open loop" in plan.message
    for cure in ("ocp.track(plan)", "ocp.Mpc"):
        assert cure in plan.message


def test_success_in_closed_loop(arm):
    loose = ocp.solve(leaning_arm(3, 0.8), ocp.Variational(20), tolerance=3e-3, tracked=True)
    assert loose.success, loose.message
    assert "tracked replay" in loose.message
    kept = loose.replay(tracked=True)
    assert abs(kept.nodes[-1, 3, :2] - [0.8, 0.1]).max() <= 3e-3
    assert loose.replay_error == pytest.approx(
        abs(kept.nodes[-1, 3, :2] - [0.8, 0.1]).max(), abs=1e-9
    )
    alone = loose.replay()
    assert abs(alone.nodes[-1, 3, :2] - [0.8, 0.1]).max() > 1e-2


def test_growth_of_what_is_not_known():
    model = driven(tc.shapes.prism())
    states = np.full((3, model.nx), np.nan)
    assert np.isnan(
        measure_error_growth(model, np.array([0.0, 1.0, 2.0]), states, np.zeros((2, model.nu)))
    )
