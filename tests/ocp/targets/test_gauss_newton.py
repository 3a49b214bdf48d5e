"""Steps of the target search against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from ocp.targets.gauss_newton import solve_quadratics


@pytest.mark.parametrize("seed", range(10))
def test_quadratics_are_solved_as_by_scipy(seed):
    """Roots are roots; without a root, the costs are those of stationary points."""
    rng = np.random.default_rng(seed)
    equations, unknowns = int(rng.integers(1, 4)), int(rng.integers(3, 6))
    K = rng.normal(size=(equations, unknowns, unknowns))
    K += K.transpose(0, 2, 1)
    b = 0.1 * rng.normal(size=(equations, unknowns))
    c = -(b @ (root := rng.normal(size=unknowns)) + np.einsum("jkl,k,l->j", K, root, root) / 2)
    starts = root + 0.05 * rng.normal(size=(4, unknowns))
    costs, found = solve_quadratics(c, b, K, starts)
    for cost, d in zip(costs, found, strict=True):
        r = c + b @ d + np.einsum("jkl,k,l->j", K, d, d) / 2
        assert cost == pytest.approx(r @ r / 2, abs=1e-14)
        assert cost < 1e-18
    definite = np.eye(unknowns)[None] + 0.1 * np.abs(K[:1])
    definite = definite @ definite.transpose(0, 2, 1)
    costs, found = solve_quadratics(np.ones(1), b[:1], definite, starts)  # no root
    for cost, d in zip(costs, found, strict=True):
        exact = scipy.optimize.least_squares(
            lambda d: 1 + b[:1] @ d + np.einsum("jkl,k,l->j", definite, d, d) / 2, d
        )
        assert cost == pytest.approx(exact.cost, rel=1e-3)


@pytest.mark.parametrize("normal", [(2.0, -1.0), (1.0, 1.0), (3.0, 1.0, -2.0)])
def test_steps_from_nearly_zero_gradients_are_finite(normal):
    """The Jacobian grows from rounding and has rank one."""
    normal = np.array(normal)
    K = np.outer(normal, normal)[None]
    across = np.linalg.svd(normal[None])[2][1:]  # K is zero along these
    for gradient in np.logspace(-16, -6, 41):
        for c in np.logspace(-4, 0, 9):
            costs, found = solve_quadratics(np.array([-c]), gradient * normal[None], K, across)
            r = -c + gradient * found @ normal + (found @ normal) ** 2 / 2
            np.testing.assert_allclose(costs, r**2 / 2, atol=1e-14)
            assert (costs <= 0.51 * c**2).all()
