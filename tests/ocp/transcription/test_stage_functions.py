"""The acceleration of a stage: that of the model, and of the solution of its linear system."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, prism

import tenscasadi as tc
from ocp.transcription.stage_functions import Places, end_curve, stage_curve

MEETING = tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity())
MODELS = {
    "alone": driven(prism(1.0)),
    "reduced": tc.Model(MEETING),
    "full": tc.Model(MEETING, coordinates="full"),
}


@pytest.mark.parametrize("kind", MODELS)
def test_values_are_those_of_the_model(kind):
    """α is h² times the acceleration, the end is the state after a projection."""
    model, count, h = MODELS[kind], 2, 0.05
    nq, rng = model.nq, np.random.default_rng(0)
    x = model.initial_state + 0.05 * rng.standard_normal((count, model.nx))
    u = rng.uniform(1, 20, (count, model.nu))
    inputs = np.hstack([x[:, :nq], h * x[:, nq:], u, np.full((count, 1), h)])
    places = Places(nq, False, model.nu, False)
    rate = np.array([model.ode(*given).full().ravel() for given in zip(x, u, strict=True)])
    assert stage_curve(model, np.eye(model.nu), places, count).at(inputs).value == pytest.approx(
        h**2 * rate[:, nq:], rel=1e-10, abs=1e-12
    )
    projected = np.array([tc.build_projection(model, 1)(state).full().ravel() for state in x])
    assert end_curve(model, places, count).at(inputs).value == pytest.approx(
        projected, rel=1e-10, abs=1e-12
    )
