"""The ground's push and friction."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from tenscasadi.scene.ground import Ground


def test_ground_pushes_below_its_plane_and_never_pulls() -> None:
    ground = Ground(stiffness=100.0, damping=10.0, height=0.5)
    N = ca.DM([[0, 0, 0], [0, 0, 0], [0.6, 0.4, 0.4]])
    V = ca.DM([[0, 1, 1], [0, 0, 0], [-1, -1, 5]])
    W = ground.forces(N, V).full()
    assert np.allclose(W, [[0, 0, 0], [0, 0, 0], [0, 20, 0]])  # apart; 100·0.1 + 10·1; leaving fast: no pull
    assert float(ground.energy(N)) == pytest.approx(2 * 100 * 0.01 / 2)
    assert not ground.conservative
    assert Ground().conservative


def test_friction_opposes_slip_and_is_bounded_by_coulomb() -> None:
    ground = Ground(stiffness=100.0, friction=0.5, slip_speed=1e-3)
    N = ca.DM([0, 0, -0.1])
    sliding = ground.forces(N, ca.DM([3, 4, 0])).full().ravel()
    assert np.allclose(sliding, [-3, -4, 10], rtol=1e-6)  # μ f = 5 N against the direction (3, 4)/5
    creeping = ground.forces(N, ca.DM([1e-5, 0, 0])).full().ravel()
    assert creeping[0] == pytest.approx(-5 * 1e-2, rel=1e-3)


def test_a_tilted_ground_pushes_along_its_normal() -> None:
    ground = Ground(stiffness=10.0, normal=(3, 0, 4))
    W = ground.forces(ca.DM([-3, 0, -4]), ca.DM.zeros(3)).full().ravel()
    assert np.allclose(W, 10 * 5 * np.array([0.6, 0, 0.8]))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Ground(stiffness=0), r"Ground\.stiffness"),
        (lambda: Ground(damping=-1), r"Ground\.damping"),
        (lambda: Ground(friction=-0.1), r"Ground\.friction"),
        (lambda: Ground(height=float("nan")), r"Ground\.height"),
        (lambda: Ground(normal=(0, 0, 0)), r"Ground\.normal"),
        (lambda: Ground(slip_speed=0), r"Ground\.slip_speed"),
    ],
)
def test_what_makes_no_ground_is_refused_by_name(make: Callable[[], object], field: str) -> None:
    with pytest.raises(ValueError, match=field):
        make()
