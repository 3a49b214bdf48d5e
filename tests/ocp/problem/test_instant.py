"""Instants: lengths, rates and rest lengths of expressions and of numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism
from rising import MODEL

import tenscasadi as tc
from ocp.problem.instant import Instant


def test_instants_are_numbers_too():
    now = Instant(MODEL, ca.MX(MODEL.initial_state), ca.MX(np.ones(9)), 0)
    assert ca.evalf(now.lengths).full().ravel() == pytest.approx(MODEL.structure.string_lengths)
    assert np.abs(ca.evalf(now.rates).full()).max() == 0.0


def test_segments_add_up_to_a_rest_length():
    model = driven(prism(1.0, string_mass=0.1), segments=2)
    now = Instant(model, ca.MX(model.initial_state), ca.MX(np.full(9, 5.0)), 0)
    rest = ca.evalf(now.rest_lengths(np.full(9, 500.0))).full().ravel()
    assert rest == pytest.approx(model.scene.structure.string_lengths * (1 - 5.0 / 500.0))


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_momenta_are_those_of_a_turning_bar(coordinates):
    bar = tc.Structure([(0, 0, 0), (2, 0, 0)], bars=[(0, 1)], bar_mass=3.0)
    model = tc.Model(tc.Scene(bar), coordinates=coordinates)
    x = model.state(bar.nodes, [(0, 0, 0), (0, 4, 0)])  # 2 rad/s, center at 2 m/s
    now = Instant(model, ca.MX(x), ca.MX(0, 1), 0)
    center, velocity, momentum = (
        ca.evalf(value).full().ravel()
        for value in (now.center_of_mass, now.center_of_mass_velocity, now.angular_momentum)
    )
    np.testing.assert_allclose(center, (1, 0, 0))
    np.testing.assert_allclose(velocity, (0, 2, 0))
    np.testing.assert_allclose(momentum, (0, 0, 3.0 * 4 / 12 * 2.0), atol=1e-15)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_accelerations_are_differences_of_velocities(coordinates):
    model = tc.Model(MODEL.scene, coordinates=coordinates)
    rng, h = np.random.default_rng(0), 1e-6
    x, u = model.initial_state + 0.1 * rng.normal(size=model.nx), rng.uniform(1, 9, model.nu)
    rate = model.ode(x, u).full().ravel()
    found = ca.evalf(Instant(model, ca.MX(x), ca.MX(u), 0).accelerations).full().T
    expected = (model.velocities(x + h * rate) - model.velocities(x - h * rate)) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_accelerations_include_gravity_and_segments():
    model = driven(prism(1.0, string_mass=0.1), segments=2)
    now = Instant(model, ca.MX(model.initial_state), ca.MX(np.zeros(9)), 0)
    assert ca.evalf(now.accelerations).full() == pytest.approx(np.zeros((3, 6)))
    falling = tc.Model(tc.Scene(prism(1.0), gravity=tc.Gravity(), control=tc.ForceDensity()))
    now = Instant(falling, ca.MX(falling.initial_state), ca.MX(np.zeros(9)), 0)
    expected = np.tile([[0.0], [0.0], [-9.81]], 6)
    np.testing.assert_allclose(ca.evalf(now.accelerations).full(), expected, atol=1e-2)
