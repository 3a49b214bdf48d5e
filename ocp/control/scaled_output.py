"""Scaled output of tracking controllers, and its Jacobian."""

from __future__ import annotations

from itertools import combinations

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import column_norms


def build_scaled_output(model: Model, place: float, speed: float) -> ca.Function:
    """Build the tracked output y(x), scaled, with its Jacobian.

    The output is the coordinates in units of `place` [m] and the velocities in units of `speed`
    [m/s]. Rest lengths and speeds of winches are included, scaled likewise, because tensions of a
    self-stress change no coordinate. Unsupported structures may translate and rotate: their output
    is the distances between nodes, and the rates of these distances.
    """
    x = ca.SX.sym("x", model.nx)
    if model.scene.structure.held.any() or model.scene.ground is not None:
        q, v, *_ = model.split(x)
    else:
        N = model.nodes(x).T
        bars = {frozenset(bar) for bar in model.structure.bars.tolist()}
        pairs = [
            (a, b) for a, b in combinations(range(N.shape[1]), 2) if frozenset((a, b)) not in bars
        ]
        q = column_norms(N[:, [b for _, b in pairs]] - N[:, [a for a, _ in pairs]])
        v = ca.jtimes(q, x, ca.vertcat(model.split(x).velocities, ca.DM.zeros(model.nx - model.nq)))
    typical = float(model.scene.structure.string_lengths.mean())
    parts = [
        part.scale / typical * (speed if part.unit.endswith("/s") else place)
        for part in model.scene.internal_states
    ]
    own = model.split(x).internal / ca.DM(np.concatenate([np.zeros(0), *parts]))
    value = ca.vertcat(q / place, v / speed, own)
    return ca.Function("scaled_output", [x], [value, ca.jacobian(value, x)], {"cse": True})
