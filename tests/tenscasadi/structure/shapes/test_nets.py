"""Nets: geometry, numbering, faces."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.structure import shapes


@pytest.mark.parametrize(("p", "q"), [(3, 2), (8, 5), (5, 4)])
def test_membrane(p: int, q: int) -> None:
    s = shapes.membrane(p, q, radius=0.7, length=2.0, node_mass=0.3)
    assert len(s.nodes) == p * q
    assert len(s.bars) == 0
    assert len(s.strings) == p * q + 2 * p * (q - 1)
    np.testing.assert_allclose(np.hypot(s.nodes[:, 0], s.nodes[:, 1]), 0.7)
    np.testing.assert_allclose(
        np.unique(np.round(s.nodes[:, 2], 12)), np.linspace(-1, 1, q), atol=1e-12
    )
    np.testing.assert_allclose(s.string_lengths[: p * q], 2 * 0.7 * np.sin(np.pi / p))  # rings
    np.testing.assert_allclose(
        s.string_lengths[p * q :], s.string_lengths[-1]
    )  # helices, both hands equal
    faces = shapes.membrane_faces(p, q)
    assert faces.shape == (2 * p * (q - 1), 3)
    edges = {frozenset(pair) for pair in s.strings.tolist()}
    assert all(frozenset((f[i], f[i - 1])) in edges for f in faces.tolist() for i in range(3))
    a, b, c = (s.nodes[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    assert np.all(np.sum(normal * (a + b + c) * [1, 1, 0], axis=1) > 0)  # outwards
    volume = (
        np.sum(a * np.cross(b, c)) / 6
    )  # the side's part of the enclosed volume: two thirds of it for a cylinder about the origin
    assert 0 < volume < np.pi * 0.7**2 * 2.0


def test_hyperbolic_paraboloid_is_in_equilibrium_on_straight_lines() -> None:
    s = shapes.hyperbolic_paraboloid(cells=5, side=4.0, rise=1.5, prestress=7.0)
    x, y, z = s.nodes.T
    np.testing.assert_allclose(z, 1.5 * x * y / 4.0, atol=1e-14)
    assert z.max() == pytest.approx(1.5)
    np.testing.assert_allclose(gamma_of(s), 7.0)
    assert unbalanced(s, gamma_of(s)) < 1e-12
    assert sorted(s.pinned) == np.flatnonzero((abs(x) == 2.0) | (abs(y) == 2.0)).tolist()
    assert len(s.strings) == 2 * 4 * 5
    np.testing.assert_allclose(np.ptp(s.nodes[s.strings[:20], 0], axis=1), 0.0)  # along y first
