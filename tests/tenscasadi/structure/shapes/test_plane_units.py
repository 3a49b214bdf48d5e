"""D-bars and T-bars: geometry, numbering, self-stress, recursion."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.structure import shapes


def test_d_bar() -> None:
    s = shapes.d_bar(bar_length=2.0, angle=0.3, pinned=[0], stiffness=80.0, prestress=5.0)
    np.testing.assert_allclose(s.bar_lengths, 2.0, rtol=1e-15)
    np.testing.assert_allclose(s.string_lengths, [4 * np.cos(0.3), 4 * np.sin(0.3)])
    assert not s.nodes[:, 2].any()  # exactly in the plane
    assert s.bars.tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    assert s.strings.tolist() == [[0, 2], [1, 3]]
    assert dict(s.pinned) == {0: "xyz"}
    assert unbalanced(s, gamma_of(s)) < 1e-13
    assert s.class_one().P.shape == (8, 5)
    assert np.bincount(s.bars.ravel()).max() == 2


def test_t_bar() -> None:
    s = shapes.t_bar(length=3.0, width=1.0, prestress=5.0)
    np.testing.assert_allclose(s.bar_lengths, [1.5, 0.5, 1.5, 0.5])
    assert unbalanced(s, gamma_of(s)) < 1e-13
    assert np.bincount(s.bars.ravel()).max() == 4
    assert s.class_one().P.shape == (8, 3)


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_d_bar_recursion_is_in_equilibrium(iterations: int) -> None:
    s = shapes.d_bar(2.0, 0.3, iterations=iterations, prestress=4.0, stiffness=1e4)
    assert len(s.bars) == 4**iterations
    assert len(s.strings) == sum(2 * 4**level for level in range(iterations))
    np.testing.assert_allclose(s.bar_lengths, 2.0 / (2 * np.cos(0.3)) ** (iterations - 1))
    gamma = gamma_of(s)
    assert unbalanced(s, gamma) < 1e-9
    assert gamma.max() == pytest.approx(4.0 * iterations)
    assert np.bincount(s.bars.ravel()).max() == 2**iterations


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_t_bar_recursion_is_in_equilibrium(iterations: int) -> None:
    s = shapes.t_bar(2.0, 0.5, iterations=iterations, prestress=4.0, stiffness=1e4)
    along = s.bar_lengths[np.abs(np.diff(s.nodes[s.bars], axis=1)[:, 0, 1]) < 1e-12]
    np.testing.assert_allclose(along, 2.0 / 2**iterations)
    assert along.sum() == pytest.approx(2.0)
    assert len(s.strings) == 4 * (2**iterations - 1)
    assert unbalanced(s, gamma_of(s)) < 1e-9
