"""How much small errors grow along a motion: the largest singular value of its state transition."""

from __future__ import annotations

import numpy as np

from ocp.boundary.dynamics import Dynamics
from ocp.boundary.tangents import Tangents
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

UNSTABLE = 1e3  # errors that grow more are told: vibrations and drift multiply them by ten or so
MOST_WORK = 2e10  # products of numbers, about a second: beyond, several intervals share a linearisation


def grown_errors(model: Model, time: Array, states: Array, force_density: Array) -> float:
    """Return how many times larger errors of a start can be at the end of a motion: in m, and m per duration of speed.

    The largest singular value of the state transition over time (K + 1,) along states (K + 1, nx) under γ (K, α) or (K + 1, α), over the changes of
    the start that bars and joints allow. In each interval the motion is linearised exactly at its middle, and the step is the (2, 2) Padé
    approximation of the exponential: of order 4, and stable wherever the linear motion is. inf where it overflows, NaN where it is not known.
    """
    if not np.all(np.isfinite(states)) or not np.all(np.isfinite(force_density)) or len(states) < 2:
        return np.nan
    stride = int(np.ceil((len(time) - 1) * float(model.nx) ** 3 / MOST_WORK))
    nodes = np.append(np.arange(0, len(time) - 1, stride), len(time) - 1)
    lengths = np.diff(time[nodes])
    gamma = profile_at(force_density, time, time[nodes[:-1]] + lengths / 2)
    middle = _middle(model, states[nodes], lengths)
    T, eye = float(time[-1] - time[0]), np.eye(model.nx)
    scale = np.concatenate([np.ones(model.nq), np.full(model.nq, T), np.ones(model.nx - 2 * model.nq)])
    dynamics = Dynamics.of(model)
    Q, _ = np.linalg.qr(scale[:, None] * Tangents.of(model)(states[0]))
    with np.errstate(all="ignore"):
        at = dynamics.linearise(middle, gamma)
        for k, h in enumerate(lengths):
            J = dynamics.pull(at, k, eye)[: model.nx].T * scale[:, None] / scale * h
            even, odd = eye + J @ J / 12, J / 2
            try:
                Q = np.linalg.solve(even - odd, (even + odd) @ Q)
            except np.linalg.LinAlgError:
                return np.nan
    if np.any(np.isnan(Q)):
        return np.nan
    return float(np.linalg.norm(Q, 2)) if np.all(np.isfinite(Q)) else np.inf


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
