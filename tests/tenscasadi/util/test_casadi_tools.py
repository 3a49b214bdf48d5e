"""CasADi Functions on NumPy arrays."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tenscasadi.util.casadi_tools import ArrayFunction


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
