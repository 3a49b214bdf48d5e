"""Joints, supports and redundant constraints against a plain KKT solve."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from comparison import BOTH, accelerations, relative

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure


def by_kkt(
    structure: Structure, nodes: np.ndarray, velocities: np.ndarray, F: np.ndarray
) -> np.ndarray:
    """N̈ (n, 3) from the textbook saddle-point system on physical coordinates, by a pseudo-inverse: forces F (n, 3)."""
    n = len(nodes)
    M = np.kron(structure.mass_matrix().toarray(), np.eye(3))
    rows, rates = [], []
    for a, b in structure.bars:
        row = np.zeros((n, 3))
        row[b], row[a] = nodes[b] - nodes[a], nodes[a] - nodes[b]
        rows.append(row.ravel())
        rates.append(-np.sum((velocities[b] - velocities[a]) ** 2))
    for k in np.flatnonzero(structure.fixed.ravel()):
        rows.append(np.eye(3 * n)[k])
        rates.append(0.0)
    A = np.array(rows).reshape(-1, 3 * n)
    K = np.block([[M, A.T], [A, np.zeros((len(A), len(A)))]])
    return (np.linalg.pinv(K, rcond=1e-13) @ np.concatenate([F.ravel(), rates]))[: 3 * n].reshape(
        n, 3
    )


RING = [(0, 1), (1, 2), (2, 3), (3, 0)]


REDUNDANT = {
    "both ends pinned": Structure([(0, 0, 0), (1, 0, 0), (0.5, 0.7, 0)], [(0, 1), (1, 2)], pinned=(0, 1)),
    "adjacent pins of a D-bar": Structure([(0, 0, 0), (1, 0.2, 0), (2, 0, 0), (1, -0.8, 0)], RING, [(0, 2), (1, 3)], pinned=(0, 1)),
    "triangle on two pins": Structure([(0, 0, 0), (1, 0, 0), (0.4, 0, 0.8)], [(0, 1), (1, 2), (2, 0)], pinned=(0, 1)),
    "planar K4": Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [*RING, (0, 2), (1, 3)]),
    "folded D-bar": Structure([(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 0, 1e-300)], RING, pinned=(0,)),
}  # fmt: skip


@BOTH
@pytest.mark.parametrize("name", REDUNDANT)
def test_redundant_constraints_are_named_and_solved(
    name: str, coordinates: mechanism.Coordinates
) -> None:
    structure = REDUNDANT[name]
    with pytest.warns(RedundantConstraints, match="bars 0|joints"):
        model = Model(Scene(structure, gravity=Gravity((3, -4, 5))), coordinates)
    rng = np.random.default_rng(2)
    velocities = np.zeros_like(structure.nodes)
    if name == "planar K4":  # consistent rates: a rigid motion
        spin = rng.normal(size=3)
        velocities = np.cross(spin, structure.nodes)
    x = model.state(structure.nodes, velocities)
    weight = np.outer(structure.mass_matrix().sum(axis=1), (3, -4, 5))
    if len(structure.strings):
        S = np.diff(structure.nodes[structure.strings], axis=1)[:, 0]
        weight = weight + structure.C_s.T @ (-model.force_density(x)[:, None] * S)
    expected = by_kkt(structure, structure.nodes, velocities, weight)
    assert abs(accelerations(model, x) - expected).max() < 1e-12 * max(1.0, abs(expected).max())


@BOTH
@pytest.mark.parametrize(("gap", "tolerance"), [(1e-3, 1e-7), (1e-6, 1e-3)])
def test_nearly_aligned_bars_stay_close_to_the_saddle_point_solution(
    gap: float, tolerance: float, coordinates: mechanism.Coordinates
) -> None:
    structure = Structure([(0, 0, 0), (1, gap, 0), (2, 0, 0)], [(0, 1), (1, 2)], pinned=(0, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(Scene(structure, gravity=Gravity((0, 0, -9.81))), coordinates)
    x = model.initial_state
    F = np.outer(structure.mass_matrix().sum(axis=1), (0, 0, -9.81))
    assert (
        relative(
            accelerations(model, x), by_kkt(structure, structure.nodes, 0 * structure.nodes, F)
        )
        < tolerance
    )


@BOTH
@pytest.mark.parametrize(
    "pinned", [(), (0,), {0: "xyz", 1: "z"}, {0: "xyz", 3: "xy"}, {0: "x", 1: "y", 2: "z"}], ids=str
)
def test_class_k_chain_with_supports_matches_a_saddle_point_solve(
    pinned: object, coordinates: mechanism.Coordinates
) -> None:
    rng = np.random.default_rng(1)
    structure = Structure(
        rng.normal(size=(6, 3)), bars=[(0, 1), (1, 2), (2, 3)], strings=[(0, 4), (3, 4), (4, 5), (1, 5)], node_mass=[0.1, 0, 0.3, 0, 0.2, 0.5],
        bar_mass=[1, 2, 3], bar_radius=0.1, pinned=pinned, rest_length=0.5,
    )  # fmt: skip
    model = Model(Scene(structure, gravity=Gravity((1, 2, -9))), coordinates)
    velocities = np.where(structure.fixed, 0.0, rng.normal(size=(6, 3)))
    x = model.state(structure.nodes, velocities)
    S = np.diff(structure.nodes[structure.strings], axis=1)[:, 0]
    pull = structure.C_s.T @ (-model.force_density(x)[:, None] * S)
    weight = np.outer(structure.mass_matrix().sum(axis=1), (1, 2, -9))
    assert (
        relative(
            accelerations(model, x), by_kkt(structure, structure.nodes, velocities, pull + weight)
        )
        < 1e-10
    )


@BOTH
def test_a_pinned_string_node_needs_no_mass(coordinates: mechanism.Coordinates) -> None:
    mast = Structure(
        [(0, 0, 0), (0, 0, 2), (1, 0, 0)], [(0, 1)], [(1, 2)], pinned=(0, 2), rest_length=1.5
    )
    model = Model(Scene(mast, gravity=Gravity((1, 2, -9))), coordinates)
    pull = mast.C_s.T @ (
        -model.force_density(model.initial_state)[:, None]
        * np.diff(mast.nodes[mast.strings], axis=1)[:, 0]
    )
    weight = np.outer(mast.mass_matrix().sum(axis=1), (1, 2, -9))
    expected = by_kkt(mast, mast.nodes, 0 * mast.nodes, pull + weight)
    assert relative(accelerations(model, model.initial_state), expected) < 1e-12
    assert np.allclose(
        model.multipliers(model.initial_state).joint_force[:, -1], -(pull + weight)[2]
    )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("second", [1, 3], ids=["joined", "apart"])
def test_masses_that_rounding_cannot_hold_together_are_refused_by_name(
    second: int, coordinates: mechanism.Coordinates
) -> None:
    def build(ratio: float) -> Model:
        mass = [ratio, 1.0, 1.0]
        structure = Structure(
            [(0, 0, 0), (1, 0, 0), (1.5, 0.5, 0), (3, 0, 0), (4, 0, 0)],
            [(0, 1), (second, 2), (3, 4)],
            bar_mass=mass,
        )
        return Model(Scene(structure), coordinates)

    with pytest.raises(
        ValueError, match=r"Structure\.bar_mass: bar 0 is \S+ times as heavy as bar"
    ):
        build(1e16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = build(1e11)
    nodes = model.structure.nodes
    run = simulate(
        model, 0.2, 0.01, state=model.state(nodes, np.cross([0, 0, 1.0], nodes)), compiled=False
    )
    assert run.success
    assert run.bar_length_error.max() < 1e-7
