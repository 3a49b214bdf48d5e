"""Linear steps along a trajectory."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from planning import prism

import tenscasadi as tc
from tenscasadi.dynamics.linear_steps import linear_steps, riccati_gains, transitions

STEPS = 20


@pytest.fixture(scope="module")
def moving():
    """Return a model, states of a motion under a constant γ, that, and lengths of intervals that are not the same."""
    model = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
    lengths = np.linspace(0.001, 0.002, STEPS)
    gamma = np.linspace(20.0, 30.0, model.nu)
    states = [model.initial_state]
    for h in lengths:
        states.append(advanced(model, states[-1], gamma, h))
    return model, np.array(states), np.tile(gamma, (STEPS, 1)), lengths


def advanced(model, x, gamma, h):
    step = tc.DormandPrince853().step(model.ode)
    for _ in range(4):
        x = np.asarray(step(x, gamma, h / 4).full()).ravel()
    return x


def test_steps_agree_with_differences(moving):
    model, states, gamma, lengths = moving
    k, tiny = 7, 1e-5
    left, right = list(linear_steps(model, states[:-1], states[1:], gamma, lengths))[k]
    by_state, by_control = np.split(np.linalg.solve(left, right), [model.nx], axis=1)
    random = np.random.default_rng(0)
    for _ in range(3):
        dx, du = random.normal(size=model.nx), random.normal(size=model.nu)
        ends = [
            advanced(model, states[k] + sign * tiny * dx, gamma[k] + sign * tiny * du, lengths[k])
            for sign in (1, -1)
        ]
        assert by_state @ dx + by_control @ du == pytest.approx(
            (ends[0] - ends[1]) / (2 * tiny), rel=1e-5, abs=1e-5
        )


def test_spans_of_steps_multiply(moving):
    model, states, gamma, lengths = moving
    given = model, states[:-1], states[1:], gamma, lengths
    A, B = transitions(*given)
    twice_A, twice_B = transitions(*given, substeps=2)
    assert twice_A == pytest.approx(A[1::2] @ A[::2])
    assert twice_B == pytest.approx(A[1::2] @ B[::2] + B[1::2])


def test_gains_of_a_long_time_are_those_of_the_algebraic_equation():
    random = np.random.default_rng(1)
    A, B, C = (
        1.3 * random.normal(size=(4, 4)) / 2,
        random.normal(size=(4, 2)),
        random.normal(size=(3, 4)),
    )
    R = np.diag([2.0, 3.0])
    P = scipy.linalg.solve_discrete_are(A, B, C.T @ C, R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    count = 200
    gains = riccati_gains(
        np.tile(A, (count, 1, 1)),
        np.tile(B, (count, 1, 1)),
        [np.eye(4)] * (count + 1),
        [C] * (count + 1),
        np.zeros((4, 4)),
        R,
    )
    assert gains[0] == pytest.approx(expected, rel=1e-9)
