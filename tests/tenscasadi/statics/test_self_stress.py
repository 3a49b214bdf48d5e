"""Self-stresses and mechanisms against published counts and dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from statics_cases import (
    general_prism,
    general_prism_stress,
    polygon,
    random_structure,
    row_of,
)

import tenscasadi as tc
from tenscasadi.statics.self_stress import mechanisms, rigid_body_motions, self_stress
from tenscasadi.structure import shapes
from tenscasadi.structure.equilibrium_matrix import equilibrium_matrix


def dense_matrix(s: tc.Structure) -> np.ndarray:
    """The equilibrium matrix by the definition N K, dense."""
    C = np.concatenate([s.C_s, s.C_b])
    signs = np.repeat([1.0, -1.0], [len(s.strings), len(s.bars)])
    return np.einsum("mx,mn->nxm", C @ s.nodes, C)[~s.fixed] * signs


def lengthening(s: tc.Structure, motions: np.ndarray) -> float:
    """Largest first-order elongation of any member in any motion."""
    pairs = np.concatenate([s.strings, s.bars])
    vectors = s.nodes[pairs[:, 1]] - s.nodes[pairs[:, 0]]
    moved = motions[:, pairs[:, 1]] - motions[:, pairs[:, 0]]
    return float(np.abs(np.einsum("kmx,mx->km", moved, vectors)).max(initial=0.0))


def test_self_stress_has_the_signs_of_the_paper() -> None:
    s = shapes.d_bar()
    basis = self_stress(s)
    assert basis.shape == (1, 6)
    stress = basis[0] / basis[0, 0]
    np.testing.assert_allclose(stress, 1.0, rtol=1e-12)  # γ and λ equal, λ > 0 in compression
    for shape in (
        shapes.prism(5),
        shapes.six_bar_ball(),
        shapes.six_bar_ball(pinned=[0, 3, 7]),
        shapes.t_bar(),
    ):
        for row in self_stress(shape):
            gamma, lam = np.split(row, [len(shape.strings)])
            K = (
                shape.C_s.T @ np.diag(gamma) @ shape.C_s - shape.C_b.T @ np.diag(lam) @ shape.C_b
            )  # Eq. 60
            assert np.abs((shape.nodes.T @ K)[~shape.fixed.T]).max() < 1e-12
    assert (
        len(self_stress(shapes.six_bar_ball(pinned=range(12)))) == 30
    )  # everything is pinned: any stress will do


@pytest.mark.parametrize("seed", range(30))
def test_self_stresses_span_the_null_space(seed: int) -> None:
    s, *_ = random_structure(seed)
    stresses, dense = self_stress(s), null_space(dense_matrix(s), rcond=1e-9)
    np.testing.assert_allclose(stresses.T @ stresses, dense @ dense.T, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_mechanisms_span_the_rest_of_the_motions(seed: int) -> None:
    s, *_ = random_structure(seed)
    found = mechanisms(s)
    flat = found.reshape(len(found), s.nodes.size)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(found)), atol=1e-12)
    assert lengthening(s, found) < 1e-9
    assert np.abs(flat @ rigid_body_motions(s)).max(initial=0.0) < 1e-12
    still = null_space(dense_matrix(s).T, rcond=1e-9).shape[1]
    assert len(found) == still - (0 if len(s.pinned) else 6)


@pytest.mark.parametrize("bars", [3, 4, 5, 6, 9])
@pytest.mark.parametrize("top", [1.0, 0.4])
def test_prism_has_one_self_stress_and_2n_minus_5_mechanisms(bars: int, top: float) -> None:
    s = general_prism(bars, top, height=1.7)
    stress = self_stress(s)
    assert stress.shape == (1, 4 * bars)
    np.testing.assert_allclose(
        stress[0] / stress[0, -1], general_prism_stress(bars, top), rtol=1e-12
    )
    assert mechanisms(s).shape == (2 * bars - 5, 2 * bars, 3)


@pytest.mark.parametrize("count", [4, 6, 8, 12])
def test_polygon_of_strings_with_diameters(count: int) -> None:
    s = polygon(count)
    stress = self_stress(s)
    assert len(stress) == 1
    np.testing.assert_allclose(
        stress[0] / stress[0, 0],
        np.repeat([1.0, 1 - np.cos(2 * np.pi / count)], [count, count // 2]),
        rtol=1e-12,
    )
    assert len(mechanisms(s)) == count // 2 - 2


def test_supports_take_the_motions_that_they_hold() -> None:
    hanging = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    assert rigid_body_motions(hanging).shape == (6, 2)  # it swings in two directions
    assert len(mechanisms(hanging)) == 0
    stretched = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0
    )
    assert rigid_body_motions(stretched).shape == (9, 0)
    np.testing.assert_allclose(np.abs(mechanisms(stretched)[:, 1]).sum(axis=0), [0, 1, 1])
    rail = stretched.replace(rollers={1: (0, 1, 1)})
    (motion,) = mechanisms(rail)
    np.testing.assert_allclose(np.abs(motion[1]), [0, 0.5**0.5, 0.5**0.5], atol=1e-12)


def test_six_hundred_bars() -> None:
    """Prisms side by side have one self-stress each."""
    count = 200
    s = row_of(shapes.prism(), count)
    stresses = self_stress(s)
    assert stresses.shape == (count, 12 * count)
    assert abs(stresses @ equilibrium_matrix(s).T).max() < 1e-12


def test_mechanisms_of_a_large_net() -> None:
    s = shapes.membrane(16, 15, node_mass=1.0)
    found = mechanisms(s)
    assert lengthening(s, found) < 1e-9
    rank = np.linalg.matrix_rank(dense_matrix(s), tol=1e-9)
    assert len(found) == s.nodes.size - rank - rigid_body_motions(s).shape[1]
