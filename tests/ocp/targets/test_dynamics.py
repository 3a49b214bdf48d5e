"""The equation of motion in numbers: as the model's own expressions, and their derivatives."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scenes import every_term

import tenscasadi as tc
from ocp.targets.dynamics import Dynamics

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


@pytest.mark.parametrize("name", MODELS)
def test_rates_and_derivatives_are_those_of_the_model(name):
    model = MODELS[name]
    rng = np.random.default_rng(0)
    states = (
        tc.projection(model)
        .map(3)((model.initial_state + 0.05 * rng.normal(size=(3, model.nx))).T)
        .full()
        .T
    )
    controls = rng.uniform(0.2, 2.0, (3, model.nu))
    dynamics = Dynamics.of(model)
    found = dynamics.linearise(states, controls)
    by_control = dynamics.by_control(found)
    x, u = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(model.ode(x, u), ca.vertcat(x, u))])
    for k in range(3):
        rate, exact = (
            model.ode(states[k], controls[k]).full().ravel(),
            slopes(states[k], controls[k]).full(),
        )
        assert found.rates[k] == pytest.approx(rate, rel=1e-9, abs=1e-9)
        pulls = rng.normal(size=(model.nx, 2))
        assert dynamics.pull(found, k, pulls) == pytest.approx(
            exact.T @ pulls, rel=1e-7, abs=1e-7 * np.abs(exact).max()
        )
        own = exact[model.nq : 2 * model.nq, model.nx :]
        assert by_control[k] == pytest.approx(own, rel=1e-7, abs=1e-7 * np.abs(exact).max())


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
    u = np.array([1.0, 2.0])
    found = Dynamics.of(model).linearise(model.initial_state[None], u[None])
    assert found.rates[0] == pytest.approx(
        model.ode(model.initial_state, u).full().ravel(), abs=1e-9
    )
