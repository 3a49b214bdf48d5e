"""The equation of motion in numbers: as the model's own expressions, and their derivatives."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scenes import every_term

import tenscasadi as tc
from tenscasadi.dynamics.linearization import EquationDerivatives, displacements, tangents

BAR = tc.Structure(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1)], [(1, 2)], node_mass=[0, 0, 1], pinned=[2]
)
ROLLER = tc.shapes.d_bar(pinned={0: "xyz", 2: "z"})
MODELS = {
    "bars that stand alone": tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity())),
    "bars that meet, a pin": tc.Model(
        tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity(), gravity=tc.Gravity())
    ),
    "joints": tc.Model(
        tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity(), gravity=tc.Gravity()),
        coordinates="full",
    ),
    "axes held": tc.Model(tc.Scene(ROLLER, control=tc.ForceDensity())),
    "no bars": tc.Model(
        tc.Scene(
            tc.Structure([(0, 0, 0), (1, 0, 0)], [], [(0, 1)], node_mass=1.0, pinned=[0]),
            control=tc.ForceDensity(),
        )
    ),
    "a clock": tc.Model(
        tc.Scene(
            BAR,
            control=tc.ForceDensity(),
            forces=tc.NodalForce(lambda t: ca.DM.ones(3, 3).T * ca.sin(t)),
        )
    ),
    "every term": tc.Model(every_term()),
}


STIFF = tc.shapes.prism(prestress=20.0, damping=2.0)
MODELS |= {
    "parameters": tc.Model(
        tc.Scene(STIFF, parameters=tc.Parameters("stiffness", "rest_length", "bar_mass"))
    ),
    "parameters of joined bars": tc.Model(
        tc.Scene(
            tc.shapes.d_bar(pinned=[0]),
            control=tc.RestLength(),
            gravity=tc.Gravity(),
            parameters=tc.Parameters("stiffness", "bar_mass", "node_mass"),
        ),
        coordinates="full",
    ),
    "constant lengths": tc.Model(tc.Scene(STIFF), bar_length="constant"),
    "constant lengths, joints": tc.Model(
        tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()),
        coordinates="full",
        bar_length="constant",
    ),
    "moving supports": tc.Model(
        tc.Scene(
            BAR,
            control=tc.ForceDensity(),
            supports=tc.SupportMotion({2: lambda t: ca.vertcat(1, 1 + ca.sin(t), t**2)}),
        )
    ),
}


def states_near_the_start(model, rng, count=3):
    near = model.initial_state + 0.01 * rng.normal(size=(count, model.nx))
    masses = model.mechanism.masses
    inputs = [] if masses is None else [np.tile(model.parameters.nominal[:, None], count)]
    return tc.build_projection(model).map(count)(near.T, *inputs).full().T


@pytest.mark.parametrize("name", MODELS)
def test_rates_and_derivatives_are_those_of_the_model(name):
    """Off the constraints, too: bars have not their lengths."""
    model = MODELS[name]
    rng = np.random.default_rng(0)
    states = states_near_the_start(model, rng)
    states[2, : model.nq] *= 1.01
    controls = rng.uniform(0.2, 2.0, (3, model.nu))
    p = model.parameters.nominal * rng.uniform(0.8, 1.2, model.np)
    found = EquationDerivatives.of(model).at(states, controls, p)
    by_control = found.accelerations_by_control()
    ode = model.with_stacked_input(model.ode)
    x, w = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nw)
    jacobian = ca.Function("jacobian", [x, w], [ca.jacobian(ode(x, w), ca.vertcat(x, w))])
    for k in range(3):
        inputs = np.append(controls[k], p)
        exact = jacobian(states[k], inputs).full()
        near = {"rel": 1e-7, "abs": 1e-7 * np.abs(exact).max()}
        assert found.rates[k] == pytest.approx(
            ode(states[k], inputs).full().ravel(), rel=1e-9, abs=1e-9
        )
        assert found.jacobian(k) == pytest.approx(exact, **near)
        changes, weights = rng.normal(size=(exact.shape[1], 2)), rng.normal(size=(model.nx, 2))
        assert found.tangent(k, changes) == pytest.approx(exact @ changes, **near)
        assert found.adjoint(k, weights) == pytest.approx(exact.T @ weights, **near)
        own = exact[model.nq : 2 * model.nq, model.nx : model.nx + model.nu]
        assert by_control[k] == pytest.approx(own, **near)


@pytest.mark.parametrize("name", ["every term", "parameters of joined bars"])
def test_derivatives_are_those_of_differences(name):
    model = MODELS[name]
    rng = np.random.default_rng(1)
    (state,) = states_near_the_start(model, rng, 1)
    u = rng.uniform(0.2, 2.0, model.nu)
    p = np.array(model.parameters.nominal)
    J = EquationDerivatives.of(model).at(state[None], u[None], p).jacobian(0)
    ode, z, tiny = model.with_stacked_input(model.ode), np.concatenate([state, u, p]), 1e-6
    for change in rng.normal(size=(4, z.size)):
        ends = [z + sign * tiny * change for sign in (1, -1)]
        plus, minus = (ode(end[: model.nx], end[model.nx :]).full().ravel() for end in ends)
        assert J @ change == pytest.approx(
            (plus - minus) / (2 * tiny), rel=1e-5, abs=1e-6 * np.abs(J).max()
        )


def test_redundant_constraints_move_as_the_model():
    structure = tc.Structure(
        [(0, 0, 0), (2, 0, 0), (1, 1, 0)],
        [(0, 1)],
        [(0, 2), (1, 2)],
        node_mass=[0, 0, 1],
        pinned=[0, 1],
    )
    with pytest.warns(tc.RedundantConstraints):
        model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()), coordinates="full")
    u, x = np.array([1.0, 2.0]), model.initial_state
    found = EquationDerivatives.of(model).at(x[None], u[None])
    assert found.rates[0] == pytest.approx(model.ode(x, u).full().ravel(), abs=1e-9)
    change = np.zeros(model.nx)
    model.split(change)[0][:] = displacements(model, x)[:, 0]
    plus, minus = (model.ode(x + sign * 1e-6 * change, u).full().ravel() for sign in (1, -1))
    moved = found.tangent(0, np.append(change, [0, 0])[:, None])[:, 0]
    assert moved == pytest.approx((plus - minus) / 2e-6, abs=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_tangents_keep_bars_and_joints(name):
    model = MODELS[name]
    (x,) = states_near_the_start(model, np.random.default_rng(2), 1)
    Z, residuals = tangents(model, x), lambda x: np.concatenate(model.constraints(x))
    assert pytest.approx(np.eye(Z.shape[1])) == Z.T @ Z
    count = len(residuals(x))
    assert Z.shape[1] >= 2 * model.nq - count
    for change in Z.T:
        difference = residuals(x + 1e-6 * change) - residuals(x - 1e-6 * change)
        assert np.abs(difference).max(initial=0.0) < 1e-11
    moves = displacements(model, x)
    assert np.linalg.norm(moves - Z[: model.nq] @ (np.linalg.pinv(Z[: model.nq]) @ moves)) < 1e-6
