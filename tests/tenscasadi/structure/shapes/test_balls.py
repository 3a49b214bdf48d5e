"""Balls: regular, balanced, and of the forms that are known."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure import shapes


def test_ball_is_regular_and_balanced() -> None:
    s = shapes.six_bar_ball(bar_length=2.0, prestress=12.0)
    np.testing.assert_allclose(s.bar_lengths, 2.0, rtol=1e-15)
    np.testing.assert_allclose(s.string_lengths, np.sqrt(6) / 4 * 2.0, rtol=1e-15)
    assert s.bars.tolist() == [[2 * i, 2 * i + 1] for i in range(6)]
    assert len(s.strings) == 24
    np.testing.assert_array_equal(np.bincount(s.strings.ravel()), 4)
    np.testing.assert_allclose(gamma_of(s), 12.0, rtol=1e-12)
    assert unbalanced(s, 12.0) < 1e-12
    assert len(self_stress(s)) == 1
    np.testing.assert_allclose(s.nodes.mean(axis=0), 0.0, atol=1e-16)
    axes = (s.nodes[1::2] - s.nodes[::2]) / 2.0
    np.testing.assert_allclose(axes, np.repeat(np.eye(3), 2, axis=0), atol=1e-16)
    middles = 0.5 * (s.nodes[1::2] + s.nodes[::2])
    np.testing.assert_allclose(
        np.linalg.norm(middles[1::2] - middles[::2], axis=1), 1.0
    )  # half a bar length apart
    assert middles[0, 2] == middles[2, 0] == middles[4, 1] == -0.5


def test_expanded_octahedron_of_the_golden_ratio_is_an_icosahedron() -> None:
    golden = (1 + np.sqrt(5)) / 2
    s = shapes.expanded_octahedron(bar_length=golden, ratio=1 / golden)
    distance = np.linalg.norm(s.nodes[:, None] - s.nodes[None], axis=2)
    assert np.sum(np.isclose(distance, 1.0)) == 60  # the 30 edges, from both ends
    np.testing.assert_allclose(s.string_lengths, 1.0)
    np.testing.assert_allclose(s.bar_lengths, golden)
    with pytest.raises(ValueError, match=r"prestress needs the ratio 0\.5"):
        shapes.expanded_octahedron(ratio=0.6, prestress=1.0)


@pytest.mark.parametrize(
    ("make", "faces", "bar"),
    [
        (shapes.truncated_tetrahedron, 12, -0.5746094703),
        (shapes.truncated_icosahedron, 60, -((3 - np.sqrt(5)) / 2)),  # −1/φ²
    ],
)
def test_truncated_polyhedron_is_super_stable_at_equal_force_densities(make, faces, bar) -> None:
    s = make(bar_length=2.0)
    np.testing.assert_allclose(s.bar_lengths, 2.0)
    np.testing.assert_allclose(np.linalg.norm(s.nodes, axis=1), np.linalg.norm(s.nodes[0]))
    np.testing.assert_array_equal(np.bincount(s.strings.ravel()), 3)
    np.testing.assert_array_equal(np.bincount(s.bars.ravel()), 1)
    np.testing.assert_allclose(s.string_lengths[:faces], s.string_lengths[0])
    D = s.C_s.T @ s.C_s + bar * s.C_b.T @ s.C_b
    np.testing.assert_allclose(D @ s.nodes, 0.0, atol=1e-9)
    values = np.linalg.eigvalsh(D)
    assert np.sum(np.abs(values) < 1e-9) == 4
    assert values[4] > 0.1


@pytest.mark.parametrize("ratio", [0.3, 2.5])
def test_truncated_polyhedron_keeps_the_ratio_of_forces(ratio: float) -> None:
    s = shapes.truncated_icosahedron(force_ratio=ratio, prestress=3.0, stiffness=1e4)
    gamma = gamma_of(s)
    np.testing.assert_allclose(gamma[60:] / gamma[0], ratio)
    assert gamma.min() == pytest.approx(3.0)
    assert unbalanced(s, gamma) < 1e-9
    corners = s.nodes.reshape(12, 5, 3)
    np.testing.assert_allclose(
        s.strings[:60].reshape(12, 5, 2)[0], [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)]
    )
    middle = corners.mean(axis=1, keepdims=True)
    assert np.ptp(np.linalg.norm(corners - middle, axis=2)) < 1e-12  # regular pentagons
