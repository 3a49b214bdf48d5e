"""Keeping to a plan: a time-varying linear-quadratic regulator from exact derivatives along it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ocp.boundary.invariants import invariants
from ocp.boundary.sensitivities import Motion
from ocp.control.departures import departures
from ocp.plan.plan import Plan
from ocp.problem.string_bounds import ForceDensityLimits
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import LARGEST, Array, finite_array, instance, positive_number, whole_number


@dataclass(frozen=True, eq=False)
class Tracker:
    """γ = γ_plan − K (x − x_plan), within limits; a controller for `ocp.run`.

    time (K + 1,), states (K + 1, nx), force_density (K, α): the plan at the decisions; gains (K, α, nx); lower, upper (α,) N/m.
    After the plan its last gain holds its last state.
    """

    model: Model
    time: Array
    states: Array
    force_density: Array
    gains: Array
    lower: Array
    upper: Array

    def __repr__(self) -> str:
        return f"Tracker({len(self.gains)} decisions, {self.force_density.shape[1]} strings, {self.time[-1]:g} s)"

    @property
    def period(self) -> float:
        """Seconds from one decision to the next."""
        return float(self.time[1] - self.time[0])

    def control(self, time: float, state: Array) -> Array:
        """γ (α,), N/m, at `time` s after the beginning and a state (nx,)."""
        time, state = positive_number("time", time, zero=True), finite_array("state", state, (self.model.nx,))
        k = min(int(time / self.period + 1e-9), len(self.gains) - 1)
        after = time > self.time[-1] - 1e-9
        away = state - self.states[-1 if after else k]
        self.model.split(away)[2][:] = 0.0
        return np.asarray(np.clip(self.force_density[k] - self.gains[k] @ away, self.lower, self.upper))


def track(
    plan: Plan,
    *,
    decisions: int | None = None,
    place: float | None = None,
    effort: float | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> Tracker:
    """The regulator of a plan by Riccati's recursion: least Σ (δq/place)² + (δv/speed)² + (δγ/effort)² of small departures.

    δq are departures of coordinates; of free structures, of the distances between nodes. Derivatives are those of the integrated steps,
    reduced to the changes that bars and joints allow. decisions: how many, None: one per interval. place: m, None: 1 % of the structure's
    size; speed: 10 place in the duration. effort: N/m, None: a tenth of the plan's mean γ. lower, upper: what the force densities are
    clipped to, N/m, as in `ForceDensityLimits`; None: those of the plan's problem (a loaded plan: 0 and none).
    Raises TypeError, ValueError.
    """
    instance("plan", plan, Plan, "an ocp.Plan")
    model, T = plan.known_model("track"), float(plan.time[-1])
    count = len(plan.time) - 1 if decisions is None else whole_number("decisions", decisions, 1)
    size = 0.01 * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0))) if place is None else positive_number("place", place)
    force = 0.1 * float(plan.force_density.mean()) or 1.0 if effort is None else positive_number("effort", effort)
    known = (0.0, np.inf) if plan.problem is None else plan.problem.force_density_limits
    limits = ForceDensityLimits(known[0] if lower is None else lower, known[1] if upper is None else upper)
    limits.check(model.scene.structure)
    time = np.linspace(0.0, T, count + 1)
    gamma = profile_at(plan.force_density, plan.time, (time[:-1] + time[1:]) / 2)
    motion = Motion(model, count, 2)
    states, points = motion.states(plan.trajectory.states[0], gamma, T / count)
    if not np.all(np.abs(states) <= LARGEST):
        raise ValueError(f"decisions is {count}: steps of {T / count / 2:g} s diverge along the plan, give more decisions")
    A, B = motion.derivatives(points, gamma, T / count)
    kept = departures(model, size, 10 * size / T)
    tangents = Tangents(model, states[0])
    Z = [tangents(x) for x in states]
    C = [np.asarray(kept(x)[1].full()) @ basis for x, basis in zip(states, Z, strict=True)]
    return Tracker(model, time, states, gamma, _gains(A, B, Z, C, force**-2), *limits.limits(model.scene.structure))


class Tangents:
    """Orthonormal bases of the small changes of a state that bars and joints allow, of places and velocities together."""

    def __init__(self, model: Model, start: Array) -> None:
        x = ca.SX.sym("x", model.nx)
        rigid = [group.value for group in invariants(model, start, x, 0) if group.kind in ("bar", "joint", "clock")]
        self._jacobian = ca.Function("jacobian", [x], [ca.densify(ca.jacobian(ca.vertcat(ca.SX(0, 1), *rigid), x))])
        self._size = model.nx

    def __call__(self, state: Array) -> Array:
        """(nx, d) at a state (nx,)."""
        J = np.asarray(self._jacobian(state).full())
        if not J.shape[0]:
            return np.eye(self._size)
        _, values, right = np.linalg.svd(J)
        return np.asarray(right[int(np.sum(values > 1e-9 * values.max(initial=0.0))) :].T)


def _gains(A: Array, B: Array, Z: list[Array], C: list[Array], effort: float) -> Array:
    """Feedback (K, α, nx) by Riccati's recursion in the reduced coordinates Zᵀ δx, from the end."""
    gains = np.zeros((len(A), B.shape[2], A.shape[1]))
    P = C[-1].T @ C[-1]
    R = effort * np.eye(B.shape[2])
    for k in reversed(range(len(A))):
        a, b = Z[k + 1].T @ A[k] @ Z[k], Z[k + 1].T @ B[k]
        L = scipy.linalg.solve(R + b.T @ P @ b, b.T @ P @ a, assume_a="pos")
        closed = a - b @ L
        P = closed.T @ P @ closed + L.T @ R @ L + C[k].T @ C[k]
        P = (P + P.T) / 2
        gains[k] = L @ Z[k].T
    return gains
