"""Domes and the bicycle wheel: geometry, classes, self-stress."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure import shapes


@pytest.mark.parametrize("make", [shapes.geiger_dome, shapes.levy_dome])
@pytest.mark.parametrize(("segments", "hoops"), [(6, 1), (8, 3)])
def test_dome_is_in_equilibrium(make, segments: int, hoops: int) -> None:
    s = make(segments, hoops, 12.0, 2.0, 1.8, prestress=5.0, stiffness=1e6)
    gamma = gamma_of(s)
    assert gamma.min() == pytest.approx(5.0, rel=1e-6)
    assert unbalanced(s, gamma) < 1e-7
    np.testing.assert_array_equal(np.bincount(s.bars.ravel()), 1)
    np.testing.assert_allclose(s.bar_lengths, 1.8)
    pinned = s.nodes[list(s.pinned)]
    np.testing.assert_allclose(np.hypot(pinned[:, 0], pinned[:, 1]), 12.0)
    np.testing.assert_allclose(pinned[:, 2], 0.0, atol=1e-15)
    assert s.nodes[0].tolist() == [0.0, 0.0, 2.0]


def test_geiger_dome_has_one_self_stress_and_levy_dome_no_mechanism() -> None:
    assert len(self_stress(shapes.geiger_dome(8, 2))) == 1
    levy = shapes.levy_dome(8, 2)
    free = int((~levy.fixed).sum())
    assert len(self_stress(levy)) == len(levy.strings) + len(levy.bars) - free


def test_wheel_carries_its_spokes_by_the_rim() -> None:
    s = shapes.bicycle_wheel(9, 1.0, 0.3, prestress=5.0)
    np.testing.assert_allclose(gamma_of(s), 5.0)
    assert unbalanced(s, gamma_of(s)) < 1e-12
    assert len(self_stress(s)) == 1
    assert np.bincount(s.bars.ravel()).tolist() == [2] * 9 + [1, 1]
