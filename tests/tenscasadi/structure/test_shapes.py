"""Shapes: geometry and numbering as documented, and the self-stress each says it has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


def unbalanced(s: Structure, gamma: Any) -> float:
    """Largest nodal force that remains when each bar takes the force that suits it best, in N."""
    N = s.nodes.T
    strings = (
        -N @ s.C_s.T @ np.diag(np.broadcast_to(gamma, len(s.strings))) @ s.C_s
    )  # forces on nodes, 3×n
    B = N @ s.C_b.T
    columns = np.stack([np.outer(B[:, k], s.C_b[k]).ravel() for k in range(len(s.bars))], axis=1)
    lam = np.linalg.lstsq(columns, -strings.ravel(), rcond=None)[0]
    free = (strings.ravel() + columns @ lam).reshape(3, -1).T * ~s.fixed
    return float(np.abs(free).max())


def gamma_of(s: Structure) -> Any:
    return s.stiffness * (1 - s.rest_length / s.string_lengths)


@pytest.mark.parametrize("bars", range(3, 9))
def test_prism_is_in_equilibrium_at_its_twist(bars: int) -> None:
    s = shapes.prism(bars, radius=0.6, height=1.3, prestress=10.0)
    gamma = gamma_of(s)
    assert gamma.min() == pytest.approx(10.0, rel=1e-12)
    assert np.ptp(gamma[: 2 * bars]) < 1e-12
    np.testing.assert_allclose(gamma[2 * bars :], 2 * np.sin(np.pi / bars) * gamma[0], rtol=1e-12)
    assert unbalanced(s, gamma) < 1e-12
    assert len(self_stress(s)) == 1
    assert len(self_stress(shapes.prism(bars, twist=np.pi / 2 + np.pi / bars + 0.01))) == 0
    np.testing.assert_allclose(s.bar_lengths, s.bar_lengths[0], rtol=1e-14)
    assert np.ptp(s.string_lengths[2 * bars :]) < 1e-14


def test_vertical_strings_of_the_three_bar_prism_carry_root_three() -> None:
    gamma = gamma_of(shapes.prism(prestress=30.0))
    np.testing.assert_allclose(gamma, [30.0] * 6 + [30.0 * np.sqrt(3)] * 3, rtol=1e-12)


def test_prism_numbering() -> None:
    s = shapes.prism(4, radius=0.5, height=2.0, twist=1.0)
    np.testing.assert_allclose(s.nodes[:4, 2], 0.0)
    np.testing.assert_allclose(s.nodes[4:, 2], 2.0)
    np.testing.assert_allclose(np.hypot(s.nodes[:, 0], s.nodes[:, 1]), 0.5)
    assert s.strings.tolist() == [
        [0, 1],
        [1, 2],
        [2, 3],
        [3, 0],
        [4, 5],
        [5, 6],
        [6, 7],
        [7, 4],
        [0, 4],
        [1, 5],
        [2, 6],
        [3, 7],
    ]
    assert s.bars.tolist() == [[0, 5], [1, 6], [2, 7], [3, 4]]
    angles = np.arctan2(s.nodes[:, 1], s.nodes[:, 0])
    turn = (angles[s.bars[:, 1]] - angles[s.bars[:, 0]]) % (2 * np.pi)
    np.testing.assert_allclose(turn, 1.0)
    np.testing.assert_allclose(
        (angles[4:] - angles[:4]) % (2 * np.pi), (1.0 - np.pi / 2) % (2 * np.pi)
    )


def test_prism_of_the_paper() -> None:
    s = shapes.prism(radius=1 / np.sqrt(3), height=1.0, twist=2 * np.pi / 3)
    np.testing.assert_allclose(s.bar_lengths, np.sqrt(2))  # 1.4142 m in Sect. 7.1
    np.testing.assert_allclose(s.string_lengths, 1.0)


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


def test_d_bar() -> None:
    s = shapes.d_bar(bar_length=2.0, angle=0.3, pinned=[0], stiffness=80.0, prestress=5.0)
    np.testing.assert_allclose(s.bar_lengths, 2.0, rtol=1e-15)
    np.testing.assert_allclose(s.string_lengths, [4 * np.cos(0.3), 4 * np.sin(0.3)])
    assert not s.nodes[:, 2].any()  # exactly in the plane
    assert s.bars.tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    assert s.strings.tolist() == [[0, 2], [1, 3]]
    assert dict(s.pinned) == {0: "xyz"}
    assert unbalanced(s, gamma_of(s)) < 1e-14
    assert s.class_one().P.shape == (8, 5)
    assert np.bincount(s.bars.ravel()).max() == 2


def test_t_bar() -> None:
    s = shapes.t_bar(length=3.0, width=1.0, prestress=5.0)
    np.testing.assert_allclose(s.bar_lengths, [1.5, 0.5, 1.5, 0.5])
    assert unbalanced(s, gamma_of(s)) < 1e-14
    assert np.bincount(s.bars.ravel()).max() == 4
    assert s.class_one().P.shape == (8, 3)


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


def test_pendulums() -> None:
    s = shapes.pendulum(length=2.0, angle=np.pi / 6, bar_mass=3.0)
    np.testing.assert_allclose(s.nodes, [(0, 0, 0), (1, 0, -np.sqrt(3))])
    assert dict(s.pinned) == {0: "xyz"}
    assert s.bar_mass.tolist() == [3.0]
    d = shapes.double_pendulum(lengths=(1.0, 2.0), angles=(np.pi / 2, 0.0))
    np.testing.assert_allclose(d.nodes, [(0, 0, 0), (1, 0, 0), (1, 0, -2)], atol=1e-15)
    assert not d.nodes[:, 1].any()  # exactly in the plane
    assert dict(d.pinned) == {0: "xyz"}
    assert dict(shapes.double_pendulum(pinned=()).pinned) == {}


@pytest.mark.parametrize(
    "make",
    [
        shapes.prism,
        shapes.d_bar,
        shapes.t_bar,
        shapes.six_bar_ball,
        shapes.membrane,
        shapes.pendulum,
    ],
)
def test_keywords_reach_the_structure(make: Callable[..., Structure]) -> None:
    s = make(stiffness=7.0, damping=0.5, bar_radius=0.01)
    assert np.all(s.stiffness == 7.0)
    assert np.all(s.damping == 0.5)
    assert np.all(s.bar_radius == 0.01)
    np.testing.assert_array_equal(s.rest_length, s.string_lengths)  # not prestressed unless asked
    assert make.__doc__ is not None
    assert "0" in make.__doc__  # numbered
