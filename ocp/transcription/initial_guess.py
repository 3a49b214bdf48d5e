"""Where a solver starts: nodes led from the start to the target on the constraints, and the force densities that follow them best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.interpolate
import scipy.optimize

from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from tenscasadi.design.statics import EquilibriumError, equilibrium_force_density
from tenscasadi.integrators.stabilization import projection
from tenscasadi.scene.loads import Gravity
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array

ROUNDS = 20  # of an active-set method, which mostly needs five
BLEND = 1e-3  # how much the reference force densities weigh against following the path, both in scaled units


@dataclass(frozen=True, eq=False)
class Guess:
    """states (intervals + 1, nx), force_density (intervals, α) N/m and duration s."""

    states: Array
    force_density: Array
    duration: float


def make_guess(problem: Problem, target: Target, intervals: int) -> Guess:
    """Nodes from start to target by a quintic in time, projected onto bars and joints; γ by inverse dynamics within its limits.

    The accelerations that a path asks for are linear in γ, so the γ that follow it best are a small least-squares problem with
    bounds for every interval. What it leaves open (self-stress) follows the equilibrium force densities of start and target.
    """
    duration = (problem.shortest + problem.longest) / 2
    return follow(problem, target, _line(target, problem.model.nq, intervals, duration), duration)


def follow(problem: Problem, target: Target, positions: Array, duration: float) -> Guess:
    """The motion along free coordinates (K + 1, nq) at equal times, put onto bars and joints, and the force densities that follow it best."""
    states = _motion(problem, target, positions, duration)
    return Guess(states, _inverse_dynamics(problem, states, _reference(problem, states), duration / (len(states) - 1)), duration)


def settled(problem: Problem, states: Array) -> Array:
    """Force densities (K, α) that hold states (K + 1, nx) at rest, as nearly as they can."""
    return _inverse_dynamics(problem, states, _reference(problem, states), 1.0)


def _line(target: Target, nq: int, intervals: int, duration: float) -> Array:
    """Free coordinates (K + 1, nq) from start to target, through the waypoints."""
    start, end = target.start, target.start if target.state is None else target.state
    s = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    rise, fall = s**3 * (10 - 15 * s + 6 * s**2), -4 * s**3 + 7 * s**4 - 3 * s**5
    out = s - 6 * s**3 + 8 * s**4 - 3 * s**5  # leaves with the start's velocity; `fall` arrives with the target's
    q = start[:nq] + rise * (end - start)[:nq] + duration * (out * start[nq : 2 * nq] + fall * end[nq : 2 * nq])
    stops = [(stop.share, stop.target.state) for stop in target.stops if stop.target.state is not None]
    if stops:
        places = [start[:nq], *(state[:nq] for _, state in stops), end[:nq]]
        rates = [(1, duration * state[nq : 2 * nq]) for state in (start, end)]
        q = scipy.interpolate.CubicSpline([0.0, *(share for share, _ in stops), 1.0], places, bc_type=tuple(rates))(s[:, 0])
    return np.asarray(q)


def _motion(problem: Problem, target: Target, q: Array, duration: float) -> Array:
    model, nq, intervals = problem.model, problem.model.nq, len(q) - 1
    start = target.start
    clock = start[2 * nq :] + np.linspace(0.0, duration, intervals + 1)[:, None][:, : model.nx - 2 * nq]
    project = projection(model, 10).map(intervals + 1)
    still = np.column_stack([q, np.zeros_like(q), clock])
    q = np.asarray(project(still.T).full()).T[:, :nq]
    v = np.empty_like(q)
    v[0], v[-1] = start[nq : 2 * nq], (start if target.state is None else target.state)[nq : 2 * nq]
    v[1:-1] = (q[2:] - q[:-2]) * (intervals / (2 * duration))
    states = np.asarray(project(np.column_stack([q, v, clock]).T).full()).T
    states[0] = start
    if target.state is not None:
        states[-1] = target.state
    if not np.all(np.isfinite(states)):  # a bar vanished on the way
        return np.repeat(start[None], intervals + 1, axis=0)
    return states


def _reference(problem: Problem, states: Array) -> Array:
    """Equilibrium γ (intervals, α) from that of the start to that of the target; the lower limits where there is none."""
    lower, upper = problem.force_density_limits
    model = problem.model
    structure = model.scene.structure
    count = len(structure.nodes)
    ends = []
    for state in (states[0], states[-1]):
        try:
            nodes = model.nodes(state)[:count]
            shape = structure if np.array_equal(nodes, structure.nodes) else structure.replace(nodes=nodes)
            gamma = equilibrium_force_density(shape, _weights(structure, model.scene.gravity), minimum=0.0)
        except (EquilibriumError, ValueError):
            gamma = lower
        ends.append(np.clip(gamma, lower, upper))
    s = (np.arange(len(states) - 1)[:, None] + 0.5) / (len(states) - 1)
    return np.asarray((1 - s) * ends[0] + s * ends[1])


def _weights(structure: Structure, gravity: Gravity | None) -> Array | None:
    if gravity is None:
        return None
    return np.outer(np.asarray(structure.mass_matrix().sum(axis=1)).ravel(), gravity.acceleration)


def _inverse_dynamics(problem: Problem, states: Array, reference: Array, interval: float) -> Array:
    """γ (intervals, α) within the limits whose accelerations come nearest to those of the path, in the sense of the kinetic energy."""
    model = problem.model
    nq = model.nq
    kind: Any = ca.SX if model.ode.is_a("SXFunction") else ca.MX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    acceleration = model.ode(x, u)[nq : 2 * nq]
    linear = ca.Function("linear", [x, u], [ca.densify(acceleration), ca.densify(ca.jacobian(acceleration, u))])
    middle = (states[:-1] + states[1:]) / 2
    wanted = (states[1:, nq : 2 * nq] - states[:-1, nq : 2 * nq]) / interval
    lower, upper = problem.force_density_limits
    count = len(middle)
    free, slopes = (value.full().T for value in linear.map(count)(middle.T, np.zeros((model.nu, count))))
    A = slopes.reshape(count, model.nu, nq).transpose(0, 2, 1)
    size = np.maximum(np.linalg.norm(A, 2, axis=(1, 2)), 1e-300)[:, None]
    A = np.concatenate([A / size[:, None], np.broadcast_to(np.sqrt(BLEND) * np.eye(model.nu), (count, model.nu, model.nu))], axis=1)
    b = np.concatenate([(wanted - free) / size, np.sqrt(BLEND) * reference], axis=1)
    return _bounded_least_squares(A, b, lower, upper)


def _bounded_least_squares(A: Array, b: Array, lower: Array, upper: Array) -> Array:
    """x (n, m) with the least |A x − b| of each A (n, k, m), b (n, k), lower ≤ x ≤ upper.

    All n at once by a primal-dual active-set method (Hintermüller, Ito, Kunisch, SIAM J. Optim. 2002, 13, 865), which may cycle: what it has not
    settled is left to SciPy.
    """
    H, c = A.transpose(0, 2, 1) @ A, (A.transpose(0, 2, 1) @ b[:, :, None])[:, :, 0]
    held = lower == upper
    side = np.where(held, -1, np.zeros(c.shape))
    x = np.zeros_like(c)
    for _ in range(ROUNDS):
        fixed = np.where(side < 0, lower, np.where(side > 0, upper, 0.0))
        free = side == 0
        masked = H * (free[:, :, None] & free[:, None, :]) + (~free)[:, :, None] * np.eye(c.shape[1])
        x = np.linalg.solve(masked, np.where(free, c - (H @ fixed[:, :, None])[:, :, 0], fixed)[:, :, None])[:, :, 0]
        slope = (H @ x[:, :, None])[:, :, 0] - c
        down, up = (x < lower) | ((side < 0) & (slope >= 0)) | held, (x > upper) | ((side > 0) & (slope <= 0))
        before, side = side, np.where(down, -1, np.where(up & ~held, 1, 0))
        open_ = np.any(before != side, axis=1)
        if not open_.any():
            return np.asarray(x)
    loose = ~held  # lsq_linear wants room between its bounds
    for k in np.flatnonzero(open_):
        inner = scipy.optimize.lsq_linear(A[k][:, loose], b[k] - A[k][:, held] @ lower[held], (lower[loose], upper[loose]), method="bvls")
        x[k] = lower
        x[k, loose] = inner.x
    return np.asarray(x)
