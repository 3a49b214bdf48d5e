"""The sparse null space against SciPy's dense one, and where single fronts do not show a null vector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import null_space

from tenscasadi.util.sparse_null_space import RankError, sparse_null_space


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


def test_a_null_vector_that_no_front_shows() -> None:
    """Each row by itself fixes a column; together they leave (1, 1/2, 1/4, ...) to 2^-n."""
    for n in (50, 300):
        A = sp.diags_array([np.full(n, 0.5), -np.ones(n - 1)], offsets=[0, -1]).tocsc()
        assert check(A[np.random.default_rng(0).permutation(n)]) == 1


def test_a_rank_that_cannot_be_told_is_refused() -> None:
    row = sp.diags_array([np.full(60, 0.5), -np.ones(59)], offsets=[0, -1])
    with pytest.raises(RankError, match="show in no part alone"):
        sparse_null_space(sp.block_diag([row] * 30), 1e-9)
