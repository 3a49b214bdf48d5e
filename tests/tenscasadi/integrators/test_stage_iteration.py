"""Triangular iteration: Crout's factors."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.integrators.stage_iteration import factor_crout


def test_crout() -> None:
    A = np.random.default_rng(1).normal(size=(4, 4)) + 4 * np.eye(4)
    L = factor_crout(A)
    U = np.linalg.solve(L, A)
    assert np.triu(L, 1) == pytest.approx(np.zeros((4, 4)))
    assert np.tril(U) == pytest.approx(np.eye(4), abs=1e-12)
