"""The solver of quadratic programs that exported controllers use: the same points as another solver's, also at corners and without room."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from ocp.solvers.interior_point_qp import solve_qp


def solved(H, g, G, b):
    return solve_qp(*(ca.MX(ca.DM(value)) for value in (H, g, G, b)), ca.MX(len(g), 1))


def value(expression):
    return ca.Function("value", [], [expression])()["o0"].full().ravel()


@pytest.mark.parametrize("seed", range(6))
def test_it_finds_what_another_solver_finds(seed):
    rng = np.random.default_rng(seed)
    n, m = 12, 30
    root = rng.normal(size=(n, n))
    H, g = root.T @ root + 0.1 * np.eye(n), 50 * rng.normal(size=n)
    G = np.vstack([rng.normal(size=(m, n)), -np.eye(n)])
    b = np.append(rng.uniform(0, 1, m), np.zeros(n))  # corners: many limits meet at 0
    reference = ca.conic(
        "qp", "daqp", {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(m + n, n)}
    )(h=H, g=g, a=G, lba=-np.inf, uba=b)
    assert value(solved(H, g, G, b)) == pytest.approx(reference["x"].full().ravel(), abs=1e-5)


def test_an_entry_without_room_stays():
    x = value(
        solved(
            np.eye(2),
            [-3.0, -2.0],
            np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]),
            [1.0, -1.0, 5.0],
        )
    )
    assert x == pytest.approx([1.0, 2.0], abs=1e-5)


def test_limits_that_contradict_each_other_leave_numbers():
    assert np.all(
        np.isfinite(value(solved(np.eye(1), [0.0], np.array([[1.0], [-1.0]]), [-1.0, -1.0])))
    )
