"""The small changes of a state that bars and joints allow."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.boundary.invariants import invariants
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

RANK = 1e-9  # of the largest singular value: constraints below it repeat others


class Tangents:
    """Orthonormal bases of the small changes of a state that bars and joints allow, of places and velocities together."""

    def __init__(self, model: Model, start: Array) -> None:
        x = ca.SX.sym("x", model.nx)
        rigid = [group.value for group in invariants(model, start, x, 0) if group.kind in ("bar", "joint", "clock")]
        self._jacobian = ca.Function("jacobian", [x], [ca.densify(ca.jacobian(ca.vertcat(ca.SX(0, 1), *rigid), x))])
        self._size = model.nx

    def __call__(self, state: Array) -> Array:
        """Return the basis (nx, d) at a state (nx,)."""
        J = np.asarray(self._jacobian(state).full())
        if not J.shape[0]:
            return np.eye(self._size)
        _, values, right = np.linalg.svd(J)
        return np.asarray(right[int(np.sum(values > RANK * values.max(initial=0.0))) :].T)
