"""How much small errors grow along a motion: the largest singular value of its state transition."""

from __future__ import annotations

import numpy as np

from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.linear_steps import linear_steps
from tenscasadi.dynamics.linearization import tangents
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

UNSTABLE = 1e3  # errors that grow more are told: vibrations and drift multiply them by ten or so
MOST_WORK = (
    2e10  # products of numbers, about a second: beyond, several intervals share a linearisation
)


def grown_errors(model: Model, time: Array, states: Array, force_density: Array) -> float:
    """Return how many times larger errors of a start can be at the end of a motion: in m, and m per duration of speed.

    The largest singular value of the state transition over time (K + 1,) along states (K + 1, nx)
    under γ (K, α) or (K + 1, α), over the changes of the start that bars and joints allow, of the
    `linear_steps`. inf where it overflows, NaN where it is not known.
    """
    if not np.all(np.isfinite(states)) or not np.all(np.isfinite(force_density)) or len(states) < 2:
        return np.nan
    stride = int(np.ceil((len(time) - 1) * float(model.nx) ** 3 / MOST_WORK))
    nodes = np.append(np.arange(0, len(time) - 1, stride), len(time) - 1)
    lengths = np.diff(time[nodes])
    gamma = profile_at(force_density, time, time[nodes[:-1]] + lengths / 2)
    T = float(time[-1] - time[0])
    scale = np.concatenate(
        [np.ones(model.nq), np.full(model.nq, T), np.ones(model.nx - 2 * model.nq)]
    )
    Q, _ = np.linalg.qr(scale[:, None] * tangents(model, states[0]))
    with np.errstate(all="ignore"):
        try:
            for left, right in linear_steps(
                model, states[nodes[:-1]], states[nodes[1:]], gamma, lengths
            ):
                Q = scale[:, None] * np.linalg.solve(
                    left, right[:, : model.nx] @ (Q / scale[:, None])
                )
        except np.linalg.LinAlgError:
            return np.nan
    if np.any(np.isnan(Q)):
        return np.nan
    return float(np.linalg.norm(Q, 2)) if np.all(np.isfinite(Q)) else np.inf
