"""Limits of one instant that contradict each other.

Most limits are linear in the controls at a given state: a linear program tells whether controls
exist that meet all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.optimize

from ocp.problem.bounds.bound import PathBound, PathConstraint
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from tenscasadi.util.validate import Array

CLEAR = 1e-3  # of a limit: smaller contradictions are left to the solver


class Conflict(NamedTuple):
    """Limit of an instant that cannot be met with all others.

    Attributes
    ----------
    name : str
        Limited quantity.
    needed : Any
        Which entries of the state (nx,) it depends on.
    message : str
        Limit, and the nearest value that the other limits leave.
    fixed : bool
        Whether no control changes the quantity.
    excess : float
        Relative violation of the limit, if all others are violated as much.
    """

    name: str
    needed: Any
    message: str
    fixed: bool
    excess: float


class _LimitRow(NamedTuple):
    """One-sided limit slope · u ≤ room, relative to its size."""

    slope: Array
    room: float
    limit: float
    name: str
    unit: str
    sign: float
    size: float
    needed: Any


def find_conflict(
    problem: Problem, state: Array, moment: str, fixed: Any = None
) -> Conflict | None:
    """Find the limit that is violated most at a state, whatever the controls; None if there is none.

    moment: "start" or "end" of an interval. fixed: which entries of the state are known (nx,); only
    quantities that depend on no other entries count. None: all are known.
    """
    moments = {moment, "last"} if moment == "end" else {moment}
    rows = [
        row
        for one in path_constraints(problem, PathBound, implied=True)
        if moments.intersection(one.ends)
        for row in _read_linear_rows(one, state)
        if fixed is None or fixed[row.needed].all()
    ]
    if not rows:
        return None
    lower, upper = problem.control_limits
    A, b = np.array([row.slope for row in rows]), np.array([row.room for row in rows])
    best = scipy.optimize.linprog(
        np.append(np.zeros(len(lower)), 1.0),
        A_ub=np.column_stack([A, -np.ones(len(b))]),
        b_ub=b,
        bounds=np.vstack([np.column_stack([lower, upper]), [0.0, np.inf]]),
    )
    if best.x is None or best.x[-1] < CLEAR:
        return None
    excess = A @ best.x[:-1] - b
    k = int(np.argmax(excess))
    row = rows[k]
    side = "at most" if row.sign > 0 else "at least"
    value = row.limit + row.sign * row.size * excess[k]
    return Conflict(
        row.name,
        row.needed,
        f"{row.name} has to be {side} {row.limit:g} {row.unit}".rstrip() + f", and is {value:.4g}",
        not row.slope.any(),
        float(excess[k]),
    )


def _read_linear_rows(limited: PathConstraint, state: Array) -> list[_LimitRow]:
    """Read the limits that are linear in the controls at a state."""
    value, control = ca.densify(limited.value), limited.symbols[1]
    linear = ~np.array(ca.which_depends(value, control, 2, True), dtype=bool)
    function = ca.Function(
        "linear", limited.symbols, [value, ca.densify(ca.jacobian(value, control))]
    )
    at_none, slope = (np.asarray(part.full()) for part in function(state, 0, 0))
    needed = np.zeros((len(at_none), len(state)), dtype=bool)
    pattern = np.array(limited.function.jac_sparsity(0, 0).get_triplet(), dtype=np.intp)
    needed[tuple(pattern)] = True
    finite = linear & np.isfinite(at_none[:, 0]) & np.isfinite(slope).all(axis=1)
    rows = []
    for sign, limits in ((1.0, limited.upper), (-1.0, limited.lower)):
        for k in np.flatnonzero(finite & np.isfinite(limits)):
            limit, size = float(limits[k]), max(abs(float(limits[k])), 1e-9)
            room = float(sign * (limit - at_none[k, 0]) / size)
            own = limited.names[k], limited.unit, sign, size, needed[k]
            rows.append(_LimitRow(sign * slope[k] / size, room, limit, *own))
    return rows
