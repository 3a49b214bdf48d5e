"""Growth of small initial errors along a motion."""

from __future__ import annotations

import numpy as np

from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.linear_steps import linear_steps
from tenscasadi.dynamics.linearization import tangents
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.internal_states import join_scales
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.util.validate import Array

# growth above which a motion counts as unstable; vibration and drift alone cause factors near ten
UNSTABLE = 1e3
MOST_WORK = (
    # multiplications, about a second; beyond, several intervals share a linearization
    2e10
)


def measure_error_growth(model: Model, time: Array, states: Array, force_density: Array) -> float:
    """Compute the worst-case growth of initial errors.

    It is the largest singular value of the state-transition matrix along the trajectory, restricted
    to changes of the initial state that bars and joints permit. Positions count in m, velocities in
    m per duration, and internal states relative to their scale, times the size of the structure.
    The matrix is the product of the `linear_steps`.

    Parameters
    ----------
    model : Model
        Model of the motion.
    time : ndarray, shape (K + 1,)
        Mesh points [s].
    states : ndarray, shape (K + 1, nx)
        States at the mesh points.
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Controls: piecewise constant, or piecewise linear.

    Returns
    -------
    float
        Growth factor; inf if it overflows, NaN if it is unknown.
    """
    if not np.all(np.isfinite(states)) or not np.all(np.isfinite(force_density)) or len(states) < 2:
        return np.nan
    stride = int(np.ceil((len(time) - 1) * float(model.nx) ** 3 / MOST_WORK))
    nodes = np.append(np.arange(0, len(time) - 1, stride), len(time) - 1)
    lengths = np.diff(time[nodes])
    gamma = profile_at(force_density, time, time[nodes[:-1]] + lengths / 2)
    T = float(time[-1] - time[0])
    length = measure_diagonal(model.structure.nodes) or 1.0
    own = length / join_scales(model.scene.internal_states)
    scale = np.concatenate(
        [np.ones(model.nq), np.full(model.nq, T), own, np.ones(int(model.has_clock))]
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
