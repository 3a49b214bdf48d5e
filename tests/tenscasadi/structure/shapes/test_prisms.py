"""Prisms: geometry and numbering as documented, and the self-stress."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure import shapes


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


@pytest.mark.parametrize("bars", [3, 5, 8])
def test_prism_with_diagonals_has_a_range_of_twists(bars: int) -> None:
    for share in (0.05, 0.25, 0.9):
        turn = np.pi / 2 + (1 + share) * np.pi / bars
        s = shapes.prism(bars, twist=turn, diagonals=True, prestress=10.0, stiffness=1e5)
        assert gamma_of(s).min() == pytest.approx(10.0)
        assert unbalanced(s, gamma_of(s)) < 1e-9
    assert s.strings[3 * bars :].tolist() == [[(i + 1) % bars, bars + i] for i in range(bars)]
    for share in (-0.1, 1.1):
        turn = np.pi / 2 + (1 + share) * np.pi / bars
        with pytest.raises(ValueError, match="no symmetric self-stress"):
            shapes.prism(bars, twist=turn, diagonals=True, prestress=10.0)
