"""Contradictory limits at one instant.

At a given state, most limits are linear in the controls. A linear program then decides whether any
controls satisfy all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.optimize

from ocp.problem.bounds.bound import PathBound, PathConstraint
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.problem.rows import RESOLUTION
from tenscasadi.util.validate import Array


class Conflict(NamedTuple):
    """Limit that contradicts the other limits at a state.

    Attributes
    ----------
    name : str
        Name of the constrained quantity.
    needed : ndarray of bool, shape (nx,)
        Whether the quantity depends on an entry of the state.
    message : str
        Limit, and the nearest value that the other limits permit.
    fixed : bool
        Whether the quantity is independent of the controls.
    excess : float
        Relative violation of the limit, if the largest violation of all limits is minimized.
    """

    name: str
    needed: Any
    message: str
    fixed: bool
    excess: float


class _LimitRow(NamedTuple):
    """One-sided linear limit slope · u ≤ room on the controls u.

    Attributes
    ----------
    slope, room : ndarray (α,), float
        Gradient and right-hand side, both divided by ``size``.
    limit, name, unit : float, str, str
        Limit, name and unit of the quantity.
    sign : float
        1 for an upper limit, −1 for a lower one.
    size : float
        Magnitude of the limit.
    needed : ndarray of bool (nx,)
        Whether the quantity depends on each entry of the state.
    """

    slope: Array
    room: float
    limit: float
    name: str
    unit: str
    sign: float
    size: float
    needed: Any


class _LinearLimits(NamedTuple):
    """Limits that are linear in the controls.

    Attributes
    ----------
    limited : PathConstraint
        The m constrained quantities with their limits.
    linear : ndarray of bool, shape (m,)
        Whether each quantity is linear in the controls.
    needed : ndarray of bool, shape (m, nx)
        Whether each quantity depends on each entry of the state.
    function : casadi.Function
        From the symbols to the value (m,) and its Jacobian (m, nu) in the controls.
    """

    limited: PathConstraint
    linear: Any
    needed: Any
    function: ca.Function

    @staticmethod
    def of(limited: PathConstraint) -> _LinearLimits:
        """Differentiate a constraint with respect to the controls."""
        (state, control, *_), value = limited.symbols, ca.densify(limited.value)
        needed = np.zeros((value.shape[0], state.shape[0]), dtype=bool)
        pattern = np.array(limited.function.jac_sparsity(0, 0).get_triplet(), dtype=np.intp)
        needed[tuple(pattern)] = True
        gradient = ca.densify(ca.jacobian(value, control))
        return _LinearLimits(
            limited,
            ~np.array(ca.which_depends(value, control, 2, True), dtype=bool),
            needed,
            ca.Function("linear", limited.symbols, [value, gradient]),
        )

    def list_rows(self, state: Array) -> list[_LimitRow]:
        """List the finite limits with their coefficients at a state."""
        at_none, slope = (part.full() for part in self.function(state, 0, 0))
        finite = self.linear & np.isfinite(at_none[:, 0]) & np.isfinite(slope).all(axis=1)
        rows = []
        for sign, limits in ((1.0, self.limited.upper), (-1.0, self.limited.lower)):
            for k in np.flatnonzero(finite & np.isfinite(limits)):
                limit, size = float(limits[k]), max(abs(float(limits[k])), 1e-9)
                room = float(sign * (limit - at_none[k, 0]) / size)
                own = self.limited.names[k], self.limited.unit, sign, size, self.needed[k]
                rows.append(_LimitRow(sign * slope[k] / size, room, limit, *own))
        return rows


class LimitCheck:
    """Check of all limits of a problem at single instants.

    Bounds enter by the weaker constraints that they imply (`PathBound.imply`).
    """

    def __init__(self, problem: Problem) -> None:
        self._control_limits = problem.control_limits
        constraints = path_constraints(problem, PathBound, implied=True)
        self._linear = [_LinearLimits.of(one) for one in constraints]

    def find_conflict(self, state: Array, moment: str, fixed: Any = None) -> Conflict | None:
        """Find the most violated limit at a state.

        A linear program chooses controls that minimize the largest relative violation of all
        limits. Returns None if this violation is negligible. ``moment`` is "start" or "end" of an
        interval. ``fixed`` (nx,) marks the known entries of the state (None: all of them);
        quantities that depend on other entries are ignored.
        """
        moments = {moment, "last"} if moment == "end" else {moment}
        rows = [
            row
            for one in self._linear
            if moments.intersection(one.limited.ends)
            for row in one.list_rows(state)
            if fixed is None or fixed[row.needed].all()
        ]
        if not rows:
            return None
        lower, upper = self._control_limits
        A, b = np.array([row.slope for row in rows]), np.array([row.room for row in rows])
        best = scipy.optimize.linprog(
            np.append(np.zeros(len(lower)), 1.0),
            A_ub=np.column_stack([A, -np.ones(len(b))]),
            b_ub=b,
            bounds=np.vstack([np.column_stack([lower, upper]), [0.0, np.inf]]),
        )
        if best.x is None or best.x[-1] < RESOLUTION:
            return None
        excess = A @ best.x[:-1] - b
        k = int(np.argmax(excess))
        row = rows[k]
        side = "at most" if row.sign > 0 else "at least"
        value = row.limit + row.sign * row.size * excess[k]
        return Conflict(
            row.name,
            row.needed,
            f"{row.name} has to be {side} {row.limit:g} {row.unit}".rstrip()
            + f", and is {value:.4g}",
            not row.slope.any(),
            float(excess[k]),
        )
