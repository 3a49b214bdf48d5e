"""Linearized time steps along a trajectory, and LQR gains for them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.validate import Array

linalg = lazy_module("scipy.linalg")


def linear_steps(
    model: Model, starts: Array, ends: Array, controls: Array, lengths: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield linearized time steps of K intervals.

    A step is L δx⁺ = R (δx, δu), with L (nx, nx) and R (nx, nx + nu). Intervals run from states
    `starts` (K, nx) to `ends` (K, nx) under controls (K, nu) in `lengths` (K,) [s]. Each is
    linearized at its midpoint. The step is the (2, 2) Padé approximation of the exponential. It has
    order 4 and preserves stability.
    """
    nx, eye = model.nx, np.eye(model.nx)
    at = EquationDerivatives.of(model).at(_middles(model, starts, ends, lengths), controls)
    for k, h in enumerate(lengths):
        both = h * at.jacobian(k)
        J, by_control = both[:, :nx], both[:, nx : nx + model.nu]
        even, odd = eye + J @ J / 12, J / 2
        yield even - odd, np.column_stack([even + odd, by_control])


def transitions(
    model: Model, starts: Array, ends: Array, controls: Array, lengths: Array, substeps: int = 1
) -> tuple[Array, Array]:
    """Compute state-transition and input matrices of K time spans.

    They are ∂x⁺/∂x (K, nx, nx) and ∂x⁺/∂u (K, nx, nu), with the state x⁺ at the end of a span. Each
    span consists of `substeps` linear steps, whose arguments are those of `linear_steps` for K ·
    substeps intervals. The control is constant in a span.
    """
    nx = model.nx
    steps = np.array(
        [np.linalg.solve(*step) for step in linear_steps(model, starts, ends, controls, lengths)]
    ).reshape(-1, substeps, nx, nx + model.nu)
    A, B = steps[:, 0, :, :nx], steps[:, 0, :, nx:]
    for k in range(1, substeps):
        A, B = steps[:, k, :, :nx] @ A, steps[:, k, :, :nx] @ B + steps[:, k, :, nx:]
    return A, B


def riccati_gains(
    A: Array, B: Array, Z: Sequence[Array], C: Sequence[Array], P: Array, R: Array
) -> Array:
    """Compute LQR gains (K, nu, nx) by the Riccati recursion.

    The gains map state deviations δx to control corrections. They minimize Σ |C Zᵀδx|² + δuᵀ R δu
    plus the terminal cost P over K steps δx⁺ = A δx + B δu. A is (K, nx, nx) and B (K, nx, nu). Z
    (K + 1 matrices) are bases of the admissible state deviations, and C are weighted output
    matrices in these bases. P is in the last basis.
    """
    gains = np.zeros((len(A), B.shape[2], A.shape[1]))
    for k in reversed(range(len(A))):
        a, b = Z[k + 1].T @ A[k] @ Z[k], Z[k + 1].T @ B[k]
        L = linalg.solve(R + b.T @ P @ b, b.T @ P @ a, assume_a="pos")
        closed = a - b @ L
        P = closed.T @ P @ closed + L.T @ R @ L + C[k].T @ C[k]
        P = (P + P.T) / 2
        gains[k] = L @ Z[k].T
    return gains


def _middles(model: Model, starts: Array, ends: Array, lengths: Array) -> Array:
    """Compute the states (K, nx) at the middle of intervals.

    The interpolation is cubic between the states `starts` and `ends` (K, nx), `lengths` (K,) s
    apart.
    """
    result = (starts + ends) / 2
    q, v, *_ = model.split(result)
    (q0, v0, *_), (q1, v1, *_) = model.split(starts), model.split(ends)
    h = lengths[:, None]
    q += h / 8 * (v0 - v1)
    v[:] = 1.5 * (q1 - q0) / h - (v0 + v1) / 4
    return np.asarray(result)
