"""Where the grid of a plan is too coarse, and one that is fine enough."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import projection
from tenscasadi.util.validate import Array

FINE = 10  # steps for one interval of the plan, to tell its defect
MOST_PARTS = 4  # that an interval is cut into at once
CAUTION = 0.3  # of the tolerance is aimed at


def finer(model: Model, time: Array, states: Array, force_density: Array, too_large: float) -> Array:
    """Relative lengths of intervals: those of a plan, each cut into as many parts as its share of an error asks for.

    too_large: how many times the error exceeds what is allowed.
    """
    gap = defects(model, time, states, force_density)
    gap = np.where(np.isfinite(gap), gap, np.nanmax(gap, initial=1.0))
    allowed = CAUTION / max(too_large, 1e-300) * max(float(gap.sum()), 1e-300) / len(gap)
    parts = np.clip(np.ceil((gap / allowed) ** 0.25), 1, MOST_PARTS).astype(int)  # halving the steps of a method of order 4
    if parts.max() == 1:
        parts[:] = 2
    return np.repeat(np.diff(time) / parts, parts)


def defects(model: Model, time: Array, states: Array, force_density: Array) -> Array:
    """How far, m, the planned state at the end of each interval (K,) is from the one that fine steps from its start lead to.

    time (K + 1,), states (K + 1, nx), force_density (K, α) or (K + 1, α). Speeds count with what they add up to over the plan.
    """
    count, lengths = len(time) - 1, np.diff(time)
    advance = RungeKutta4().step(model.ode).map(count)
    now = ca.DM(states[:-1].T)
    for k in range(FINE):
        gamma = profile_at(force_density, time, time[:-1] + (k + 0.5) / FINE * lengths)
        now = advance(now, gamma.T, lengths[None] / FINE)
    if model.mechanism.constrained:
        now = projection(model, 3).map(count)(now)
    gap = np.asarray(now.full()).T - states[1:]
    places, speeds, _ = model.split(np.abs(gap))
    return np.asarray(np.maximum(places.max(axis=1), speeds.max(axis=1) * float(time[-1])))
