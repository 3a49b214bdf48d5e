"""Explicit Runge-Kutta methods: order, errors, stability limits, and what they refuse."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from tenscasadi.integrators.runge_kutta import (
    DormandPrince54,
    DormandPrince853,
    RungeKutta4,
    build_step,
    build_trial,
)
from tenscasadi.integrators.scheme import Scheme, stability_limit
from tenscasadi.integrators.tableaux import DORMAND_PRINCE_54, DORMAND_PRINCE_853, Tableau


def swing() -> ca.Function:
    """A driven pendulum: smooth and nonlinear."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    return ca.Function("swing", [x, u], [ca.vertcat(x[1], -ca.sin(x[0]) + u)], ["x", "u"], ["xdot"])


def run(
    scheme: Scheme, ode: ca.Function, x: list[float], u: float, t_end: float, steps: int
) -> np.ndarray:
    step = scheme.step(ode)
    for _ in range(steps):
        x = step(x, u, t_end / steps)
    return np.array(x).ravel()


@pytest.mark.parametrize(
    ("scheme", "steps", "error"),
    [(RungeKutta4(), 20, 1e-5), (DormandPrince54(), 10, 1e-5), (DormandPrince853(), 3, 1e-6)],
)
def test_order_on_a_smooth_ode(scheme: Scheme, steps: int, error: float) -> None:
    reference = run(DormandPrince853(), swing(), [1.0, 0.5], 0.3, 2.0, 100)
    errors = [
        np.abs(run(scheme, swing(), [1.0, 0.5], 0.3, 2.0, n * steps) - reference).max()
        for n in (1, 2, 4)
    ]
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert abs(orders[-1] - scheme.order) < 0.5, orders
    assert errors[0] < error


@pytest.mark.parametrize(
    ("tableau", "evaluations"), [(DORMAND_PRINCE_54, 6), (DORMAND_PRINCE_853, 12)]
)
def test_embedded_errors_are_of_lower_order_and_cost_nothing_at_fixed_step(
    tableau: Tableau, evaluations: int
) -> None:
    step, trial = build_step(tableau, swing()), build_trial(tableau, swing())
    calls = [
        step.instruction_MX(k).which_function()
        for k in range(step.n_instructions())
        if step.instruction_id(k) == ca.OP_CALL
    ]
    assert len(calls) == evaluations
    x, u = [1.0, 0.5], 0.3
    assert np.array(trial(x, u, 0.2)[0]) == pytest.approx(np.array(step(x, u, 0.2)), rel=1e-15)
    assert np.array(trial(x, u, 0.2)[2]) == pytest.approx(np.array(swing()(x, u)))
    estimates = np.array([np.linalg.norm(trial(x, u, h)[1].full(), axis=0) for h in (0.2, 0.1)])
    expected = {1: [5], 2: [6, 4]}[len(tableau.errors)]
    assert np.log2(estimates[0] / estimates[1]) == pytest.approx(expected, abs=0.4)
    assert all(abs(sum(row)) < 1e-14 for row in tableau.errors)


def test_step_has_names_and_no_control_is_fine() -> None:
    step = RungeKutta4().step(swing())
    assert (step.name_in(), step.name_out()) == (["x", "u", "h"], ["x_next"])
    x = ca.MX.sym("x", 2)
    free = RungeKutta4().step(ca.Function("free", [x, ca.MX(0, 1)], [-x]))
    assert free.size_in(1) == (0, 1)
    assert float(free([1, 2], [], 0.1)[1]) == pytest.approx(2 * np.exp(-0.1), rel=1e-6)


def test_a_step_is_the_stability_polynomial_on_a_linear_ode() -> None:
    A = np.random.default_rng(1).normal(size=(4, 4))
    x = ca.SX.sym("x", 4)
    step = RungeKutta4().step(ca.Function("linear", [x, ca.SX(0, 1)], [ca.mtimes(ca.DM(A), x)]))
    expected = sum(
        c * np.linalg.matrix_power(0.3 * A, k)
        for k, c in enumerate(RungeKutta4.tableau.stability_polynomial())
    ) @ np.ones(4)
    assert np.allclose(np.array(step(np.ones(4), [], 0.3)).ravel(), expected, rtol=1e-13)
    assert np.allclose(expected, expm(0.3 * A) @ np.ones(4), atol=1e-2)


def test_stability_limits() -> None:
    scheme = RungeKutta4()
    assert scheme.tableau.stability_polynomial() == pytest.approx([1, 1, 1 / 2, 1 / 6, 1 / 24])
    assert scheme.tableau.c == (0, 0.5, 0.5, 1)
    assert scheme.imaginary_limit == pytest.approx(2 * np.sqrt(2), abs=1e-8)
    assert scheme.real_limit == pytest.approx(2.7852935634, abs=1e-8)
    directions = 10 * np.exp(1j * np.linspace(np.pi / 2, np.pi, 7))
    limits = stability_limit(scheme, directions)
    assert np.all(np.abs(scheme.amplification(0.999 * limits * directions)) <= 1)
    assert np.all(np.abs(scheme.amplification(1.001 * limits * directions)) > 1)
    # what grows by itself is limited like a vibration of the same rate
    assert stability_limit(scheme, np.array([0.5 + 0j]))[0] == pytest.approx(
        2 * scheme.imaginary_limit
    )


def test_schemes_are_values() -> None:
    assert RungeKutta4() == RungeKutta4()
    assert hash(RungeKutta4()) == hash(RungeKutta4())
    with pytest.raises(AttributeError):
        RungeKutta4().order = 5  # type: ignore[misc]


def test_what_is_no_ode_is_refused() -> None:
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
    with pytest.raises(TypeError, match="ode is"):
        RungeKutta4().step(lambda x, u: x)  # type: ignore[arg-type]
    for wrong in (
        ca.Function("f", [x], [x]),
        ca.Function("f", [x, u], [x[0]]),
        ca.Function("f", [x, u], [x, u]),
    ):
        with pytest.raises(ValueError, match="ode is"):
            RungeKutta4().step(wrong)
