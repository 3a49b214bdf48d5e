"""CasADi helpers: systems with repeated rows, constant matrices, scalar code, Functions on NumPy arrays."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp

from tenscasadi.util.casadi_tools import (
    ArrayFunction,
    block_inverse,
    call_as_sx,
    constant_row,
    drop_rounding,
    is_diagonal,
    scale_and_multiply,
    sparse,
)


def test_arrays_go_in_and_come_out_in_columns():
    x, y = ca.MX.sym("x", 2, 3), ca.MX.sym("y")
    direct = ArrayFunction(ca.Function("f", [x, y], [x.T * y, ca.densify(ca.sum1(x)), ca.DM(0, 1)]))
    X = np.arange(6.0).reshape(3, 2)  # a row for each column of x
    turned, sums, nothing = direct(X, 2)
    assert turned == pytest.approx(2 * X.T)
    assert sums.ravel() == pytest.approx(X.sum(axis=1))
    assert nothing.size == 0


def test_results_stay_when_it_is_called_again():
    x = ca.SX.sym("x", 2)
    direct = ArrayFunction(ca.Function("f", [x], [x**2]))
    first = direct(np.array([1, 2]))[0]
    second = direct(np.array([[3.0, 0.0], [4.0, 0.0]])[:, 0])[0]
    assert (first.tolist(), second.tolist()) == ([[1.0, 4.0]], [[9.0, 16.0]])


@pytest.mark.parametrize("kind", [ca.SX, ca.MX, ca.DM])
def test_weighted_products(kind):
    rng = np.random.default_rng(0)
    Z, w, C = (
        rng.normal(size=(3, 4)),
        rng.normal(size=(1, 4)),
        np.array([[1.0, 0, -1], [0, 2, 0], [0, 0, 0], [0, 3, 1]]),
    )
    if kind is ca.DM:
        found = scale_and_multiply(ca.DM(Z), ca.DM(w), C)
    else:
        a, b = kind.sym("Z", 3, 4), kind.sym("w", 1, 4)
        found = ca.Function("f", [a, b], [scale_and_multiply(a, b, C)])(Z, w)
    assert found.full() == pytest.approx(Z @ np.diag(w[0]) @ C)


def test_small_structures_are_called_as_scalar_code():
    x = ca.MX.sym("x", 2)
    for large in (False, True):
        (value,) = call_as_sx(large, lambda z: (ca.sin(z) * z,), x)
        outer = ca.Function("f", [x], [value])
        assert (
            any(outer.instruction_id(k) == ca.OP_CALL for k in range(outer.n_instructions()))
            is not large
        )
        assert outer([1.0, 2.0]).full().ravel() == pytest.approx(np.sin([1.0, 2.0]) * [1.0, 2.0])
    assert call_as_sx(False, lambda z: (z + 1,), ca.DM(1)) == (2,)


def test_constant_matrices():
    matrix = np.array([[1.0, 0.0, 1e-17], [0.0, 2.0, 0.0]])
    assert sparse(matrix).nnz() == 3
    assert drop_rounding(matrix).nnz == 2
    assert is_diagonal(drop_rounding(matrix))
    assert not is_diagonal(drop_rounding(matrix[:, ::-1]))
    assert constant_row([2.0, 2.0]).shape == (1, 1)
    assert constant_row([2.0, 3.0]).shape == (1, 2)


def test_inverses_by_blocks_leave_out_what_is_held():
    M = np.array([[2.0, 0, 1, 0], [0, 4, 0, 0], [1, 0, 3, 0], [0, 0, 0, 0]])
    inverse = block_inverse(M, [True, True, True, False]).toarray()
    assert inverse[:3, :3] == pytest.approx(np.linalg.inv(M[:3, :3]))
    assert not inverse[3].any()
    assert not inverse[:, 3].any()
    assert block_inverse(M, [False] * 4).nnz == 0


def test_blocks_of_several_sizes_lie_among_each_other():
    random = np.random.default_rng(0)
    order = random.permutation(17)
    blocks = [random.normal(size=(size, size)) for size in (1, 2, 3, 2, 1, 3, 5)]
    M = sp.block_diag([block @ block.T + np.eye(len(block)) for block in blocks]).toarray()[order][
        :, order
    ]
    free = np.flatnonzero(random.uniform(size=17) > 0.2)
    expected = np.zeros((17, 17))
    expected[np.ix_(free, free)] = np.linalg.inv(M[np.ix_(free, free)])
    assert block_inverse(sp.csr_array(M), np.isin(np.arange(17), free)).toarray() == pytest.approx(
        expected, abs=1e-13
    )
