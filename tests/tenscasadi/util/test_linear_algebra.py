"""Singular linear systems."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tenscasadi.util.linear_algebra import (
    AndersonMixing,
    find_blocks,
    null_space,
    semidefinite_inverse,
    solve_semidefinite,
)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_systems_are_solved_where_rows_repeat_each_other(kind):
    B = np.array([[1.0, 0, 2, 0], [0, 3, 0, 0], [2, 0, 4, 0]])  # rank 2
    A, x = B @ B.T, np.array([1.0, -2.0, 0.5])
    unknown = kind.sym("A", 3, 3)
    solve = ca.Function("solve", [unknown], [solve_semidefinite(unknown, ca.DM(A @ x))])
    assert A @ solve(A).full().ravel() == pytest.approx(A @ x, rel=1e-12)


def test_repeated_rows_have_a_solution():
    """That of solve_semidefinite, for right-hand sides that repeat themselves likewise."""
    rows = np.random.default_rng(0).standard_normal((2, 4))
    A = np.stack([rows.T @ rows + np.eye(4), rows.T @ rows])  # the second has rank 2
    for matrix, inverse in zip(A, semidefinite_inverse(A), strict=True):
        b = matrix @ [1.0, 2.0, 3.0, 4.0]
        solution = solve_semidefinite(ca.DM(matrix), ca.DM(b)).full().ravel()
        assert matrix @ inverse @ b == pytest.approx(b, rel=1e-8)
        assert matrix @ inverse @ b == pytest.approx(matrix @ solution, rel=1e-8)


def test_parts_that_share_nothing_are_taken_apart():
    rng = np.random.default_rng(0)
    A = np.zeros((80, 90))
    parts = [(slice(0, 30), slice(0, 40)), (slice(30, 70), slice(40, 60))]
    for rows, columns in parts:
        A[rows, columns] = rng.normal(size=A[rows, columns].shape)
    A[2] = A[1]
    A[40] = 0.0
    rows, columns = rng.permutation(80), rng.permutation(90)
    A = A[rows][:, columns]
    assert [
        (len(own), len(other))
        for own, other in sorted(find_blocks(A), key=lambda part: -len(part[1]))
    ] == [(30, 40), (39, 20)]
    free = null_space(A, 1e-3)
    rank = np.linalg.matrix_rank(A)
    assert free.shape == (90, 90 - rank)
    assert free.T @ free == pytest.approx(np.eye(90 - rank), abs=1e-12)
    assert np.abs(A @ free).max() < 1e-12


def test_mixing_solves_linear_fixed_points_in_few_steps():
    """In three dimensions, three secants are exact; the plain iteration leaves 0.7⁵ of the error."""
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    A, b = basis @ np.diag([0.3, 0.8, 0.5]) @ basis.T, rng.normal(size=3)
    x, mixing = np.zeros((3, 1)), AndersonMixing()
    for _ in range(5):
        x = x + mixing.step(b[:, None] - A @ x)
    assert x[:, 0] == pytest.approx(np.linalg.solve(A, b), rel=1e-8)
