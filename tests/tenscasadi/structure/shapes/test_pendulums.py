"""Pendulums: geometry and pins."""

from __future__ import annotations

import numpy as np

from tenscasadi.structure import shapes


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
