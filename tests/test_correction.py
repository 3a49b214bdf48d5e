"""The joint projection: onto every constraint, by the smallest mass-weighted movement, keeping momentum."""

from __future__ import annotations

import numpy as np
import pytest
from references import certified

from tenscasadi.correction import Projection, projection
from tenscasadi.model import Model
from tenscasadi.scene import Scene
from tenscasadi.structure import Structure

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])
LOOP = Structure([(0, 0, 0), (1, 0.2, 0), (2, 0, 0.3), (1, -0.8, 0), (1, 0, 2)], [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3), (2, 4)],
                 node_mass=[0, 1, 0, 0, 0.5], bar_mass=[1, 2, 3, 4])  # fmt: skip


@BOTH
@pytest.mark.parametrize("pinned", [(), (0,), {0: "xyz", 2: "z"}], ids=str)
def test_a_disturbed_loop_of_bars_comes_back_to_rounding(pinned: object, coordinates: str) -> None:
    model = Model(Scene(LOOP.replace(pinned=pinned)), coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    x = model.initial_state + 1e-3 * rng.normal(size=model.nx)
    assert model.bar_length_error(x) > 1e-4
    y = projection(model)(x).full().ravel()
    assert model.bar_length_error(y) < 1e-15
    assert model.joint_error(y) < 1e-15
    stretching = np.sum(np.diff(model.nodes(y)[LOOP.bars], axis=1) * np.diff(model.velocities(y)[LOOP.bars], axis=1), axis=(1, 2))
    assert abs(stretching).max() < 1e-15
    assert np.allclose(projection(model)(y).full().ravel(), y, atol=1e-15)


@BOTH
def test_projection_keeps_centre_of_mass_and_momenta(coordinates: str) -> None:
    model = Model(Scene(LOOP), coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    x = projection(model)(model.initial_state + 0.1 * rng.normal(size=model.nx)).full().ravel()
    M = model.structure.mass_matrix().toarray()

    def invariants(x: np.ndarray, at: np.ndarray) -> np.ndarray:
        N, V = model.nodes(at), model.velocities(x)
        return np.concatenate([M.sum(0) @ model.nodes(x), M.sum(0) @ V, np.cross(N, M @ V).sum(axis=0)])

    disturbed = x.copy()
    disturbed[model.nq :] += 0.1 * rng.normal(size=model.nq)
    if coordinates == "full":  # copies of a node must start with one velocity for momenta of physical nodes to be defined
        disturbed = model.state(model.nodes(x), model.velocities(disturbed))
    y = projection(model)(disturbed).full().ravel()
    assert np.allclose(invariants(y, y), invariants(disturbed, y), atol=1e-13)


def test_projection_is_the_least_mass_weighted_movement() -> None:
    model = Model(Scene(LOOP))
    rng = np.random.default_rng(2)
    x = model.initial_state + 1e-5 * rng.normal(size=model.nx)
    y = projection(model)(x).full().ravel()
    M = np.kron(model.structure.mass_matrix().toarray(), np.eye(3))
    moved = (M @ (y - x)[: model.nq]).reshape(-1, 3)
    B = np.diff(model.nodes(y)[LOOP.bars], axis=1)[:, 0]
    rows = np.einsum("ij,ik->ijk", LOOP.C_b, B).reshape(4, -1)
    multiplier = np.linalg.lstsq(rows.T, moved.ravel(), rcond=None)[0]
    assert abs(rows.T @ multiplier - moved.ravel()).max() < 1e-4 * abs(moved).max()


@BOTH
def test_redundant_constraints_are_projected_too(coordinates: str) -> None:
    case = certified("redundant_triangle")
    with pytest.warns(UserWarning, match="depend on each other"):
        model = Model(case.scene, coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(3)
    y = projection(model)(model.initial_state + 1e-4 * rng.normal(size=model.nx)).full().ravel()
    assert model.bar_length_error(y) < 1e-14
    assert model.joint_error(y) < 1e-14


def test_nothing_to_keep_builds_nothing() -> None:
    net = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0)
    assert Projection().step(Model(Scene(net))) is None
    assert Projection().step(Model(Scene(LOOP))) is not None


@pytest.mark.parametrize("changes", [{"every": 0}, {"every": 1.5}, {"every": True}, {"iterations": 0}, {"iterations": "many"}])
def test_bad_options_are_refused_by_name(changes: dict[str, object]) -> None:
    with pytest.raises((ValueError, TypeError), match=rf"Projection\.{next(iter(changes))}"):
        Projection(**changes)  # type: ignore[arg-type]
