"""Linear-quadratic regulators along a motion."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from planning import leaning_arm

import tenscasadi as tc
from tenscasadi.dynamics.regulator import plan_gains, riccati_gains


def advanced(model, x, gamma, h):
    step = tc.DormandPrince853().step(model.ode)
    for _ in range(4):
        x = np.asarray(step(x, gamma, h / 4).full()).ravel()
    return x


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


def test_feedback_keeps_an_arm_up_that_falls_over_without():
    problem = leaning_arm(2, 0.5, weight=True)
    model, count, T = problem.model, 60, 1.0
    states, lengths = np.tile(model.initial_state, (count + 1, 1)), np.full(count, T / count)
    gamma = np.full((count, model.nu), 3.0)
    gains = plan_gains(model, states, gamma, lengths, np.eye(model.nu))
    push = np.zeros(model.nx)
    push[0] = 1e-3
    ends = []
    for feedback in (0.0, 1.0):
        x = states[0] + push
        for k, h in enumerate(lengths):
            x = advanced(model, x, gamma[k] - feedback * gains[k] @ (x - states[k]), h)
        ends.append(np.abs(x - states[-1])[: model.nq].max())
    assert ends[0] > 0.1
    assert ends[1] < 1e-4
