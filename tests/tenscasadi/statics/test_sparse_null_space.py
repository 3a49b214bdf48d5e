"""The sparse null space against SciPy's dense one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import null_space

from tenscasadi.statics.sparse_null_space import sparse_null_space


def check(A: Any, tolerance: float = 1e-9) -> int:
    """Compare with the dense null space of the same tolerance and return its dimension."""
    dense = null_space(A.toarray(), rcond=tolerance)
    basis = sparse_null_space(A, tolerance)
    assert basis.shape == dense.T.shape
    assert basis @ basis.T == pytest.approx(np.eye(len(basis)), abs=1e-12)
    assert abs(A @ basis.T).max(initial=0.0) < 1e-12
    return len(basis)


@pytest.mark.parametrize("seed", range(20))
def test_random_nets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(5, 120, 2)
    A = sp.random_array(
        (int(n), int(m)), density=float(rng.uniform(0.005, 0.1)), rng=rng, data_sampler=rng.normal
    ).tocsc()
    copies = rng.integers(0, m, int(m) // 3)
    check(sp.hstack([A, A[:, copies] @ sp.diags_array(rng.normal(size=len(copies)))]).tocsc())


def test_without_rows_columns_or_entries() -> None:
    for shape in ((0, 3), (3, 0), (3, 2)):
        assert check(sp.csc_array(shape)) == shape[1]


def test_band_matrix_of_many_blocks() -> None:
    """A net of 30 × 20 nodes: bandwidth and number of blocks are large, too."""
    x = sp.diags_array([np.ones(30), -np.ones(29)], offsets=[0, 1], shape=(29, 30))
    y = sp.diags_array([np.ones(20), -np.ones(19)], offsets=[0, 1], shape=(19, 20))
    A = sp.vstack([sp.kron(x, sp.eye_array(20)), sp.kron(sp.eye_array(30), y)]).tocsc()
    assert check(A) == 1
    assert check(sp.csc_array(A.T)) == 29 * 19


def test_tolerance_decides_the_rank() -> None:
    A = sp.csc_array([[1.0, 1.0], [1.0, 1.0 + 1e-6]])
    assert len(sparse_null_space(A, 1e-9)) == 0
    assert len(sparse_null_space(A, 1e-5)) == 1
