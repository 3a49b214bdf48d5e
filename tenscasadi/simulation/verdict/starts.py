"""Consistency of initial states with bars and joints."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.verdict.thresholds import EPSILON
from tenscasadi.util.casadi_tools import ArrayFunction, symbol_kind
from tenscasadi.util.validate import Array


def start_violation(model: Model) -> ca.Function:
    """Build the relative constraint violation of a state.

    Function (x) → the largest of four relative errors, beyond rounding. Length errors are relative
    to the bar, gaps of joints to the longest bar. Their rates are relative to the largest relative
    speed of the ends of a bar, at least the longest bar per second.
    """

    def build() -> ca.Function:
        x = symbol_kind(model.ode).sym("x", model.nx)
        rows = model.constraints(x)
        q, v, *_ = model.split(x)
        lengths = ca.DM(model.mechanism.lengths)
        size = float(model.mechanism.lengths.max(initial=0.0)) or extent(model)
        moving = model.mechanism.bar_vectors(model.unpack(x)[1])
        speed = ca.fmax(size, ca.sqrt(ca.mmax(ca.vertcat(0, ca.sum1(moving * moving).T))))
        scales = (lengths, speed, size, speed)  # in the order of the constraints
        largest = [ca.mmax(ca.vertcat(0, ca.fabs(part))) for part in (q, v)] * 2
        shares = [
            ca.fmax(ca.fabs(row) - EPSILON * entry, 0) / scale
            for row, entry, scale in zip(rows, largest, scales, strict=True)
            if row.numel()
        ]
        return ca.Function("violation", [x], [ca.mmax(ca.vertcat(0, *shares))])

    return model.keep("violation", build)


def start_violations(model: Model, starts: Array) -> Array:
    """Compute the relative constraint violations of initial states.

    `starts` are the states (n, nx), the result is (n,).
    """
    if not len(starts):
        return np.zeros(0)
    function = model.keep(
        ("violations", len(starts)), lambda: ArrayFunction(start_violation(model).map(len(starts)))
    )
    return np.asarray(function(starts)[0][:, 0])


def constraint_violation(model: Model, state: Array) -> float:
    """Compute the relative constraint violation of a state (nx,).

    See `start_violation`.
    """
    return float(start_violations(model, np.reshape(state, (1, -1)))[0])


def describe_violation(violation: float) -> str:
    """Describe a relative constraint violation and the cure."""
    return (
        f"off the lengths of its bars or its joints, or about to leave them, relatively by {violation:.2g}: "
        "start from tenscasadi.build_projection(model)(state)"
    )


def off_constraints(model: Model, state: Array, tolerance: float) -> str:
    """Describe the constraint violation of a state and the cure.

    The state is (nx,). Returns "" if the violation is within `tolerance`.
    """
    violation = constraint_violation(model, state)
    return "" if violation <= tolerance else describe_violation(violation)
