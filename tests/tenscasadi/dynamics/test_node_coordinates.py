"""States from nodes and back."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from comparison import BOTH
from scenes import PRISM, every_term

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.structure import Structure


def test_state_and_nodes_are_inverse_and_take_symbols() -> None:
    structure = Structure(**PRISM, pinned=(0,))
    rng = np.random.default_rng(7)
    for coordinates in ("reduced", "full"):
        model = Model(Scene(structure), coordinates)  # type: ignore[arg-type]
        nodes = np.where(
            structure.fixed, structure.nodes, structure.nodes + rng.normal(size=(6, 3))
        )
        velocities = np.where(structure.fixed, 0, rng.normal(size=(6, 3)))
        x = model.state(nodes, velocities)
        assert np.allclose(model.nodes(x), nodes)
        assert np.allclose(model.velocities(np.stack([x, x])), np.stack([velocities, velocities]))
        symbol = ca.MX.sym("x", model.nx)
        N = ca.Function("N", [symbol], [model.nodes(symbol), model.tension(symbol)])(x)
        assert np.allclose(N[0].full(), nodes)
        assert np.allclose(N[1].full().ravel(), model.tension(x))


@BOTH
@pytest.mark.parametrize("clock", [False, True])
def test_positions_velocities_and_clock_are_told_apart(
    clock: bool, coordinates: mechanism.Coordinates
) -> None:
    model = Model(every_term() if clock else Scene(Structure(**PRISM)), coordinates)
    x = np.arange(float(model.nx))
    parts = model.split(np.stack([x, 2 * x]))
    assert [part.shape[-1] for part in parts] == [model.nq, model.nq, 0, int(clock)]
    assert np.array_equal(np.concatenate([part[1] for part in parts]), 2 * x)
    for symbolic, expected in zip(
        model.split(ca.DM(np.stack([x, 2 * x], axis=1))), parts, strict=True
    ):
        assert np.array_equal(symbolic.full().T, expected)
    model.split(x)[1][:] = 0.0  # views: a state may be changed through its parts
    assert np.count_nonzero(x[model.nq : 2 * model.nq]) == 0
