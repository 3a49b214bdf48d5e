"""Linear-quadratic regulators along a motion: its steps linearised, and the gains that Riccati's recursion gives them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.linalg

from ocp.targets.dynamics import Dynamics
from ocp.targets.tangents import Tangents
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

PLACE, EFFORT = (
    0.01,
    0.1,
)  # of the structure's size, and of the mean force density: departures that count the same


def linear_steps(
    model: Model, states: Array, force_density: Array, lengths: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield L (nx, nx) and R (nx, nx + α) with L δx⁺ = R (δx, δγ) of the intervals between states (K + 1, nx) under γ (K, α).

    lengths (K,): of the intervals, s. Each is linearised exactly at its middle, and the step is the
    (2, 2) Padé approximation of the exponential: of order 4, and stable wherever the linear motion
    is.
    """
    dynamics, eye = Dynamics.of(model), np.eye(model.nx)
    at = dynamics.linearise(_middle(model, states, lengths), force_density)
    for k, h in enumerate(lengths):
        both = h * dynamics.pull(at, k, eye).T
        J, by_control = both[:, : model.nx], both[:, model.nx :]
        even, odd = eye + J @ J / 12, J / 2
        yield even - odd, np.column_stack([even + odd, by_control])


def plan_gains(
    model: Model, states: Array, force_density: Array, lengths: Array, together: Array
) -> Array:
    """Return gains G (K, m, nx) of a feedback that keeps to states (K + 1, nx) by force densities together (α, m) @ (c − G δx).

    A departure of a hundredth of the structure's size counts as much as one of a tenth of the mean
    force density, and as ten such in the duration. Raises LinAlgError or ValueError where
    departures grow too fast.
    """
    size = PLACE * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0)))
    place, speed, clock = model.split(np.ones(model.nx))
    wanted = np.concatenate([place / size, speed / (10 * size / lengths.sum()), clock])
    tangents, nx = Tangents.of(model), model.nx
    Z = [tangents(x) for x in states]
    C = [wanted[:, None] * basis for basis in Z]
    steps = np.array(
        [
            np.linalg.solve(left, np.column_stack([right[:, :nx], right[:, nx:] @ together]))
            for left, right in linear_steps(model, states, force_density, lengths)
        ]
    )
    effort = EFFORT * float(np.abs(force_density).mean()) or 1.0
    return riccati_gains(
        steps[:, :, :nx],
        steps[:, :, nx:],
        Z,
        C,
        C[-1].T @ C[-1],
        np.eye(together.shape[1]) / effort**2,
    )


def riccati_gains(
    A: Array, B: Array, Z: Sequence[Array], C: Sequence[Array], P: Array, R: Array
) -> Array:
    """Return the feedback (K, α, nx) of the least Σ |C Zᵀδx|² + δγᵀ R δγ by Riccati's recursion, from the cost P of the end.

    A, B (K, ·, ·): steps; Z (K + 1): bases of the changes of a state that are allowed; C (K + 1):
    what is kept small, in these coordinates.
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


def _middle(model: Model, states: Array, lengths: Array) -> Array:
    """Return the states (K, nx) in the middles of intervals of `lengths` (K,) s, on the cubics through their ends."""
    before, after = states[:-1], states[1:]
    result = (before + after) / 2
    q, v, _ = model.split(result)
    (q0, v0, _), (q1, v1, _) = model.split(before), model.split(after)
    h = lengths[:, None]
    q += h / 8 * (v0 - v1)
    v[:] = 1.5 * (q1 - q0) / h - (v0 + v1) / 4
    return np.asarray(result)
