"""Block triangular elimination against dense solutions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from ocp.transcription.elimination import Elimination, SparseRows


def random_matrix(rng, stages, width, fixed):
    """A shuffled block lower triangular matrix, and which of its entries are constant."""
    size = stages * width
    dense = np.zeros((size, size))
    constant = np.zeros((size, size), dtype=bool)
    for k in range(stages):
        own = slice(k * width, (k + 1) * width)
        block = rng.normal(size=(width, width)) * (rng.uniform(size=(width, width)) < 0.6)
        dense[own, own] = block + 4.0 * np.eye(width)
        constant[own, own][:fixed, :fixed] = True
        if k:
            before = slice((k - 1) * width, k * width)
            dense[own, before] = rng.normal(size=(width, width)) * (rng.uniform(size=width) < 0.5)
    rows, columns = rng.permutation(size), rng.permutation(size)
    return dense[rows][:, columns], constant[rows][:, columns]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    stages=st.integers(1, 6),
    width=st.integers(1, 24),
    border=st.integers(0, 3),
    columns=st.sampled_from([0, 1, 3, 70]),
)
def test_solutions_are_those_of_dense_matrices(seed, stages, width, border, columns):
    rng = np.random.default_rng(seed)
    A, constant = random_matrix(rng, stages, width, width // 2)
    size = len(A)
    outside = rng.normal(size=(size, border)) * (rng.uniform(size=(size, border)) < 0.5)
    rows, cols = np.nonzero(np.hstack([A, outside]))
    fixed = np.hstack([constant, outside != 0])[rows, cols]
    own = Elimination(rows, cols, size, fixed, np.hstack([A, outside])[rows, cols], border)
    sides = sp.csr_array(rng.normal(size=(5, size + border)) * (rng.uniform(size=5) < 0.7)[:, None])
    for _ in range(2):
        own.factor(np.hstack([A, outside])[rows, cols])
        bordered = np.eye(size + border)
        bordered[:size, :size] = A[own.by_row][:, own.by_column]
        bordered[:size, size:] = outside[own.by_row]
        b, weights = rng.normal(size=size + border), rng.normal(size=(5, columns))
        assert np.allclose(own.solve(b.copy()), np.linalg.solve(bordered, b), atol=1e-8)
        solution = np.linalg.solve(bordered.T, b)
        assert np.allclose(own.solve_transposed(b.copy()), solution, atol=1e-8)
        many = np.linalg.solve(bordered.T, sides.toarray().T @ weights)[size:]
        given = SparseRows(sides.data, sides.indices, sides.indptr, sides.shape)
        assert np.allclose(own.reduce(given, weights), many, atol=1e-8)
        A = np.where(constant | (A == 0), A, A * rng.uniform(0.9, 1.1, A.shape))


def test_blocks_of_two_patterns_form_two_groups():
    """Two cycles of five unknowns, each with one more entry, in turns on the diagonal."""
    cycle = np.eye(5) + np.roll(np.eye(5), 1, axis=1)
    above, below = cycle.copy(), cycle.copy()
    above[0, 4], below[1, 0] = 1.0, 1.0
    A = block_diag(above, below, above, below)
    rows, columns = np.nonzero(A)
    own = Elimination(rows, columns, len(A), np.zeros(len(rows), dtype=bool), A[rows, columns])
    assert len(own._groups) == 2


def test_singular_patterns_are_rejected():
    with pytest.raises(ValueError, match="singular"):
        Elimination(np.array([0, 1]), np.array([0, 0]), 2, np.zeros(2, dtype=bool), np.ones(2))
