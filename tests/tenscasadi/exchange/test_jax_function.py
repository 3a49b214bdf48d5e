"""Equations of motion in JAX: values and derivatives are those of CasADi."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import tenscasadi as tc

jax = pytest.importorskip("jax", reason="tenscasadi[jax] is not installed")
PRISM = tc.shapes.prism(stiffness=1000.0, damping=2.0, prestress=50.0)
GROUND = tc.Ground(height=0.05, stiffness=1e3, damping=5.0, friction=0.5)
SCENES = {
    "force densities": tc.Scene(PRISM, control=tc.ForceDensity()),
    "ground": tc.Scene(PRISM, gravity=tc.Gravity(), ground=GROUND),
    "rest lengths": tc.Scene(PRISM, control=tc.RestLength(), slack=tc.Smooth(1e-3)),
    "parameters": tc.Scene(PRISM, parameters=tc.Parameters("stiffness", scale=["bar_mass"])),
    "joints, wind": tc.Scene(
        tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=100.0),
        forces=tc.NodalForce(lambda t: np.ones((4, 3)) * np.sin(t)),
    ),
}


@pytest.fixture(autouse=True)
def double_precision():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def inputs(model, rows):
    rng = np.random.default_rng(0)
    x = model.initial_state + 0.05 * rng.standard_normal((rows, model.nx))
    u = np.tile(model.initial_control, (rows, 1)) * rng.uniform(0.9, 1.1, (rows, model.nu))
    p = np.tile(model.parameters.nominal, (rows, 1)) * rng.uniform(0.9, 1.1, (rows, model.np))
    return (x, u, p) if model.np else (x, u)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in ("ground", "parameters") else pytest.mark.slow)
        for name in SCENES
    ],
)
def test_rates_and_derivatives_equal_those_of_casadi(name):
    model = tc.Model(SCENES[name], coordinates="reduced")
    rows = inputs(model, 3)
    function = tc.to_jax(model)
    rates = np.array(jax.vmap(function)(*rows))
    jacobian = np.array(jax.jacfwd(function)(*(row[0] for row in rows)))  # compiling takes longer
    exact = model.ode.jacobian()
    for k in range(3):
        given = [row[k] for row in rows]
        expected = model.ode(*given).full().ravel()
        assert rates[k] == pytest.approx(expected, rel=1e-12, abs=1e-12 * abs(expected).max())
    slope = exact(*(row[0] for row in rows), 0)[0].full()
    assert jacobian == pytest.approx(slope, rel=1e-12, abs=1e-12 * abs(slope).max())


@pytest.mark.slow
def test_gradient_of_a_rollout_is_finite():
    model = tc.Model(SCENES["force densities"])
    function = tc.to_jax(model)

    def height(u):
        x = jax.lax.fori_loop(0, 20, lambda _, x: x + 1e-3 * function(x, u), model.initial_state)
        return x[2]

    u = model.initial_control
    slope = np.array(jax.jit(jax.jacfwd(height))(u))
    moved = (height(u + 1e-3 * np.eye(9)[3]) - height(u - 1e-3 * np.eye(9)[3])) / 2e-3
    assert slope[3] == pytest.approx(float(moved), rel=1e-5)


def test_wrong_calls_are_named():
    model = tc.Model(SCENES["force densities"])
    with pytest.raises(TypeError, match="got 1 arrays: give x, u"):
        tc.to_jax(model)(model.initial_state)
    with pytest.raises(TypeError, match="model"):
        tc.to_jax(SCENES["ground"])


def test_missing_jax_is_named_with_its_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax.numpy", None)
    with pytest.raises(ImportError, match=r"to_jax requires JAX: pip install 'tenscasadi\[jax\]'"):
        tc.to_jax(tc.Model(SCENES["force densities"]))
