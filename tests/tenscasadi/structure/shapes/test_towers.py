"""Towers and spines: geometry, classes, self-stress."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.structure import shapes


@pytest.mark.parametrize(("stages", "bars"), [(1, 3), (2, 4), (5, 3)])
def test_tower_of_class_two_stacks_prisms(stages: int, bars: int) -> None:
    s = shapes.prism_tower(stages, bars, 0.4, 1.2, prestress=10.0, stiffness=1e4)
    np.testing.assert_allclose(s.bar_lengths, shapes.prism(bars, 0.4, 1.2).bar_lengths[0])
    gamma = gamma_of(s)
    assert unbalanced(s, gamma) < 1e-9
    inner = gamma[bars : stages * bars]
    np.testing.assert_allclose(inner, 20.0)
    assert s.nodes[:, 2].max() == pytest.approx(1.2 * stages)
    if stages > 1:
        assert np.bincount(s.bars.ravel()).max() == 2


@pytest.mark.parametrize(("stages", "bars"), [(1, 4), (2, 3), (3, 4), (6, 3), (2, 8)])
def test_tower_of_class_one_overlaps(stages: int, bars: int) -> None:
    s = shapes.prism_tower(stages, bars, joint_class=1, prestress=10.0, stiffness=1e5)
    np.testing.assert_array_equal(np.bincount(s.bars.ravel()), 1)
    np.testing.assert_allclose(s.bar_lengths, s.bar_lengths[0])
    assert gamma_of(s).min() == pytest.approx(10.0)
    assert unbalanced(s, gamma_of(s)) < 1e-8
    heights = s.nodes[::bars, 2]
    if stages > 1:
        overlap = heights[1] - heights[2]
        assert 0.0 < overlap < 0.3
        np.testing.assert_allclose(heights[1:-1:2] - heights[2::2], overlap)


@pytest.mark.parametrize("pinned", [[0, 1, 2], {0: "z", 1: "xyz"}])
def test_supports_keep_the_self_stress_of_class_one(pinned) -> None:
    """Pins add self-stresses, among which that of the free tower is taken."""
    free = shapes.prism_tower(4, joint_class=1, prestress=10.0, stiffness=1e5)
    held = shapes.prism_tower(4, joint_class=1, prestress=10.0, stiffness=1e5, pinned=pinned)
    np.testing.assert_allclose(held.rest_length, free.rest_length, rtol=1e-9)


def test_overlap_grows_with_the_twist() -> None:
    overlaps = []
    for degrees in (152.0, 160.0, 170.0):
        s = shapes.prism_tower(joint_class=1, twist=np.radians(degrees))
        overlaps.append(s.nodes[3, 2] - s.nodes[6, 2])
    assert 0.0 < overlaps[0] < overlaps[1] < overlaps[2]
    with pytest.raises(ValueError, match=r"twist is 3\.5: no overlap"):
        shapes.prism_tower(joint_class=1, twist=3.5)


@pytest.mark.parametrize("vertebrae", [1, 2, 5])
def test_spine_keeps_its_vertebrae_apart(vertebrae: int) -> None:
    s = shapes.spine(vertebrae, 1.0, 1.5, 0.9, prestress=None if vertebrae == 1 else 6.0)
    assert len(s.bars) == 6 * vertebrae
    assert len(s.strings) == 8 * (vertebrae - 1)
    assert not any(a // 4 == b // 4 for a, b in s.strings.tolist())
    if vertebrae > 1:
        gamma = gamma_of(s)
        assert unbalanced(s, gamma) < 1e-9
        np.testing.assert_allclose(gamma[4] / gamma[0], 0.9 / 0.6)
    with pytest.raises(ValueError, match="pitch is 2: it must be less"):
        shapes.spine(pitch=2.0)
