"""How far the end of a motion is from states that keep the limits of the plan's end."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from tenscasadi.util.validate import Array


class Broken(NamedTuple):
    """The limit of the end that is missed most: by how much, m, as coordinates that have to move, and what is to be said of it."""

    distance: float
    told: str


def broken_at_end(problem: Problem, ends: Array, controls: Array, duration: float) -> Broken:
    """Return the limit of the plan's end that the last of some ends, states (n, nx) under controls (n, α), misses most.

    What is missed counts by the change of the state that makes up for it to first order: the least
    of those at all ends, as squares have no slope where they are least. Speeds count with what they
    add up to over the plan.
    """
    model = problem.model
    speeds = np.ones(model.nx)
    speeds[model.nq : 2 * model.nq] = 1 / duration
    worst = Broken(0.0, "")
    for limited in path_constraints(problem, PathBound):
        if limited.ends != ("last",):
            continue
        excess, slope = _excess(limited, ends, controls, duration, speeds)
        found = excess > 0
        away = np.where(found, np.inf, 0.0)
        np.divide(excess, slope, out=away, where=found & (slope > 0))
        away[found & (slope == 0) & np.isfinite(excess)] = (
            0.0  # of what is decided alone: as planned
        )
        k = int(np.argmax(away))
        if away[k] > worst.distance:
            by = (
                f"breaks its limits by {excess[k]:.2g}, as much as {away[k]:.2g} m of motion make"
                if np.isfinite(excess[k])
                else "is not a number"
            )
            worst = Broken(float(away[k]), f"{limited.names[k]} {by}")
    return worst


def _excess(
    limited: PathConstraint, ends: Array, controls: Array, duration: float, speeds: Array
) -> tuple[Array, Array]:
    """Return by how much entries (m,) break their limits at the last end, inf where they are no number; and their largest slopes of all ends."""
    value = ca.densify(limited.value)
    function = ca.Function(
        "end", limited.symbols, [value, ca.densify(ca.jacobian(value, limited.symbols[0]))]
    )
    slopes = np.zeros(len(limited.names))
    entries = slopes
    for state, control in zip(ends, controls, strict=True):
        entries, J = (np.asarray(part.full()) for part in function(state, control, duration))
        slopes = np.fmax(slopes, np.linalg.norm(J * speeds, axis=1))
    entries = np.ravel(entries)
    excess = np.maximum(np.maximum(limited.lower - entries, entries - limited.upper), 0.0)
    return np.where(np.isfinite(entries), excess, np.inf), slopes
