"""The small changes of a state that bars and joints allow."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ocp.targets.invariants import rigid_rows
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

RANK = 1e-9  # of the largest singular value: constraints below it repeat others


class Tangents:
    """Orthonormal bases of the small changes of a state that bars and joints allow, of places and velocities together."""

    def __init__(self, model: Model) -> None:
        x = ca.SX.sym("x", model.nx)
        rows = ca.vertcat(
            ca.SX(0, 1), *(group.value for group in rigid_rows(model, x)), model.unpack(x)[2]
        )
        self._jacobian = ca.Function("jacobian", [x], [ca.densify(ca.jacobian(rows, x))])
        self._size = model.nx

    @staticmethod
    def of(model: Model) -> Tangents:
        """Return those of a model, which keeps them."""
        kept: dict[Any, Any] = model.functions
        if "tangents" not in kept:
            kept["tangents"] = Tangents(model)
        known: Tangents = kept["tangents"]
        return known

    def __call__(self, state: Array) -> Array:
        """Return the basis (nx, d) at a state (nx,)."""
        J = np.asarray(self._jacobian(state).full())
        if not J.shape[0]:
            return np.eye(self._size)
        _, values, right = np.linalg.svd(J)
        return np.asarray(right[int(np.sum(values > RANK * values.max(initial=0.0))) :].T)
