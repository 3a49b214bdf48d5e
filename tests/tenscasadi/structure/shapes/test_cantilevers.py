"""Cantilevers: Michell's truss and the arm."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.structure import shapes


def volume(s) -> float:
    """Σ |force| · length under a unit force in −y at node 0, by the planar equilibrium."""
    pairs = np.concatenate([s.strings, s.bars])
    along = s.nodes[pairs[:, 1]] - s.nodes[pairs[:, 0]]
    A = np.zeros((2, len(s.nodes), len(pairs)))
    for k, ((a, b), vector) in enumerate(zip(pairs, along, strict=True)):
        A[:, a, k], A[:, b, k] = vector[:2], -vector[:2]
    free = ~s.fixed[:, :2].any(axis=1)
    load = np.zeros((2, len(s.nodes)))
    load[1, 0] = 1.0
    density = np.linalg.solve(A[:, free].reshape(-1, len(pairs)), load[:, free].ravel())
    assert np.all(density[: len(s.strings)] > 0)
    assert np.all(density[len(s.strings) :] < 0)
    return float(np.abs(density) @ np.sum(along**2, axis=1))


def test_michell_cantilever_converges_to_the_least_volume() -> None:
    limit = 2 * np.log(5.0)
    errors = []
    for order in (1, 2, 4, 8, 16):
        found = volume(shapes.michell_cantilever(order, 1.0, 0.2))
        a = 0.2 ** (1 / order)
        assert found == pytest.approx(order * (1 / a - a), rel=1e-12)
        errors.append(found - limit)
    assert errors[-1] < 0.006
    np.testing.assert_allclose(np.divide(errors[1:-1], errors[2:]), 4.0, rtol=0.03)  # order 2


def test_michell_cantilever_has_the_least_volume_at_its_angle() -> None:
    best = volume(shapes.michell_cantilever(4))
    for factor in (0.97, 1.03):
        angle = (np.pi / 2 - 2 * np.arctan(0.2**0.25)) * factor
        assert volume(shapes.michell_cantilever(4, angle=angle)) > best


@pytest.mark.parametrize(("cells", "sides"), [(1, 3), (4, 3), (2, 6)])
def test_arm_is_in_equilibrium(cells: int, sides: int) -> None:
    s = shapes.arm(cells, sides, 0.8, 0.25, prestress=9.0)
    assert unbalanced(s, gamma_of(s)) < 1e-9
    assert gamma_of(s).min() == pytest.approx(9.0)
    np.testing.assert_allclose(s.bar_lengths, np.hypot(0.4, 0.25))
    assert s.nodes[(sides + 1) * cells].tolist() == pytest.approx([0.8 * cells, 0.0, 0.0])
    assert len(s.pinned) == sides + 1
