"""Linear-quadratic regulators along a trajectory, by the Riccati recursion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from tenscasadi.dynamics.linear_steps import transitions
from tenscasadi.dynamics.linearization import tangents
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


def plan_gains(
    model: Model, states: Array, controls: Array, lengths: Array, together: Array
) -> Array:
    """Compute gains G (K, m, nx) along a trajectory.

    The control is together (α, m) @ (c − G δx). It tracks states (K + 1, nx) under controls (K, α)
    in intervals of `lengths` (K,) [s]. The weights follow Bryson's rule: deviations of 1 % of the
    structure's size, of ten such per duration, and of a tenth of the mean control cost the same.
    Raises LinAlgError or ValueError if deviations grow too fast.
    """
    size = 0.01 * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0)))
    position, speed, clock = model.split(np.ones(model.nx))
    weights = np.concatenate([position / size, speed / (10 * size / lengths.sum()), clock])
    Z = [tangents(model, x) for x in states]
    C = [weights[:, None] * basis for basis in Z]
    A, B = transitions(model, states[:-1], states[1:], controls, lengths)
    scale = 0.1 * float(np.abs(controls).mean()) or 1.0
    R = np.eye(together.shape[1]) / scale**2
    return riccati_gains(A, B @ together, Z, C, C[-1].T @ C[-1], R)


def riccati_gains(
    A: Array, B: Array, Z: Sequence[Array], C: Sequence[Array], P: Array, R: Array
) -> Array:
    """Compute LQR gains (K, α, nx) by the Riccati recursion.

    They minimize Σ |C Zᵀδx|² + δuᵀ R δu plus the terminal cost P. A, B (K, ·, ·) are the steps, Z
    (K + 1) bases of the admissible changes of a state, and C (K + 1) weighted outputs in these
    bases.
    """
    gains = np.zeros((len(A), B.shape[2], A.shape[1]))
    for k in reversed(range(len(A))):
        a, b = Z[k + 1].T @ A[k] @ Z[k], Z[k + 1].T @ B[k]
        L = scipy.linalg.solve(R + b.T @ P @ b, b.T @ P @ a, assume_a="pos")
        closed = a - b @ L
        P = closed.T @ P @ closed + L.T @ R @ L + C[k].T @ C[k]
        P = (P + P.T) / 2
        gains[k] = L @ Z[k].T
    return gains
