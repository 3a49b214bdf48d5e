"""Where a solver starts: nodes led from the start to the target on the constraints, and the force densities that follow them best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np
import scipy.interpolate
import scipy.optimize
from numpy.typing import ArrayLike

from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from ocp.transcription.mesh import Profile, at, node_values
from tenscasadi.design.statics import EquilibriumError, equilibrium_force_density
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import projection
from tenscasadi.scene.loads import Gravity
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, finite_array, positive_number

ROUNDS = 20  # of an active-set method, which mostly needs five
BLEND = 1e-3  # how much the reference force densities weigh against following the path, both in scaled units


@dataclass(frozen=True, eq=False)
class Guess:
    """states (intervals + 1, nx), force_density (intervals, α) N/m and duration s."""

    states: Array
    force_density: Array
    duration: float


@runtime_checkable
class InitialGuess(Protocol):
    """Anything that a solver may be told to start from."""

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals."""


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """The force densities that make nodes follow a path best: accelerations are linear in γ, a small convex problem in each interval.

    path: nodes (P, n, 3), m, at equal times from the start to the end, projected onto bars and joints; None: from the start to the
    goals along a smooth line, which is what `solve` does by itself.
    """

    path: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.path is not None:
            array = finite_array("InverseDynamics.path", self.path, (None, None, 3))
            if len(array) < 2:
                raise ValueError(f"InverseDynamics.path has {len(array)} instants: give at least the start and the end")
            object.__setattr__(self, "path", array)

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals. Raises ValueError where the path has another number of nodes."""
        if self.path is None:
            return make_guess(problem, target, intervals)
        model, duration = problem.model, (problem.shortest + problem.longest) / 2
        path = finite_array("InverseDynamics.path", self.path, (None, len(model.structure.nodes), 3))
        before = np.linspace(0.0, 1.0, len(path))
        degree = min(3, len(path) - 1)
        columns = path.reshape(len(path), -1, 3)[:, model.mechanism.physical].reshape(len(path), -1)
        free = model.mechanism.free_index
        spline = scipy.interpolate.make_interp_spline(before, columns[:, free], k=degree)
        return follow(problem, target, np.asarray(spline(np.linspace(0.0, 1.0, intervals + 1))), duration)


@dataclass(frozen=True)
class Equilibrium:
    """Nothing moves: the start for all times, under the force densities that hold it as nearly as they can."""

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals."""
        duration = (problem.shortest + problem.longest) / 2
        states = np.repeat(target.start[None], intervals + 1, axis=0)
        model = problem.model
        _, _, clock = model.split(states)
        clock += np.linspace(0.0, duration, intervals + 1)[:, None][:, : clock.shape[1]]
        return Guess(states, settled(problem, states), duration)


@dataclass(frozen=True, eq=False)
class Arrays:
    """States (P, nx) and force densities (Q, α), N/m, at and between equal times; duration: s, None: the problem's, or its middle."""

    states: ArrayLike
    force_density: ArrayLike
    duration: float | None = None

    def __post_init__(self) -> None:
        for name in ("states", "force_density"):
            object.__setattr__(self, name, finite_array(f"Arrays.{name}", getattr(self, name), (None, None)))
        if self.duration is not None:
            object.__setattr__(self, "duration", positive_number("Arrays.duration", self.duration))

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals. Raises ValueError naming the array that does not fit the model."""
        model = problem.model
        states = finite_array("Arrays.states", self.states, (None, model.nx))
        gamma = finite_array("Arrays.force_density", self.force_density, (None, model.nu))
        if len(states) < 2 or not len(gamma):
            raise ValueError(f"Arrays has {len(states)} states and {len(gamma)} rows of force densities: give at least 2 and 1")
        middle = (problem.shortest + problem.longest) / 2 if self.duration is None else self.duration
        return resampled(problem, target, states, np.linspace(0, 1, len(states)), gamma, np.linspace(0, 1, len(gamma) + 1), intervals, middle)


def guess_of(value: InitialGuess | None, problem: Problem, target: Target, intervals: int) -> Guess:
    """The guess that a value stands for. Raises TypeError, ValueError, also for states that no projection puts onto bars and joints."""
    if value is None:
        return make_guess(problem, target, intervals)
    if isinstance(value, type) or not isinstance(value, InitialGuess):
        raise TypeError(f"guess is {value!r}: give ocp.InverseDynamics(), ocp.Equilibrium(), ocp.Arrays(states, force_density) or an ocp.Plan")
    return value.guess(problem, target, intervals)


def resampled(
    problem: Problem, target: Target, states: Array, state_shares: Array, gamma: Array, gamma_shares: Array, intervals: int, duration: float
) -> Guess:
    """States and force densities at shares of the duration, moved to equal intervals, within the limits, from the problem's start."""
    shares = np.linspace(0.0, 1.0, intervals + 1)
    on_grid = np.column_stack([np.interp(shares, state_shares, column) for column in states.T])
    if problem.model.mechanism.constrained:
        on_grid = np.asarray(projection(problem.model, 3).map(len(shares))(on_grid.T).full()).T
    if not problem.free_start:
        on_grid[0] = target.start
    lost = ~np.isfinite(on_grid).all(axis=1)
    if lost.any():
        share = shares[int(np.argmax(lost))]
        raise ValueError(f"guess has states at {share:.3g} of the duration that are no motion, such as bars without a length: give others")
    lower, upper = problem.force_density_limits
    held = np.clip(at(gamma, gamma_shares, (shares[:-1] + shares[1:]) / 2), lower, upper)
    return Guess(on_grid, held, float(np.clip(duration, problem.shortest, problem.longest)))


def on_mesh(model: Model, guess: Guess, fractions: Array, profile: Profile) -> Guess:
    """Return a guess on equal intervals, moved to another mesh and another profile."""
    intervals, nodes = len(guess.states) - 1, np.append(0.0, np.cumsum(fractions))
    if intervals == len(fractions) and np.ptp(fractions) < 1e-12:
        states, held = guess.states, guess.force_density
    else:
        before = np.linspace(0.0, 1.0, intervals + 1)
        states = np.column_stack([np.interp(nodes, before, column) for column in guess.states.T])
        if model.mechanism.constrained:
            states[1:-1] = np.asarray(projection(model, 3).map(len(nodes))(states.T).full()).T[1:-1]
        held = at(guess.force_density, before, (nodes[:-1] + nodes[1:]) / 2)
    return Guess(states, node_values(held, fractions) if profile.linear else held, guess.duration)


def make_guess(problem: Problem, target: Target, intervals: int) -> Guess:
    """Nodes from start to target by a quintic in time, projected onto bars and joints; γ by inverse dynamics within its limits.

    The accelerations that a path asks for are linear in γ, so the γ that follow it best are a small least-squares problem with
    bounds for every interval. What it leaves open (self-stress) follows the equilibrium force densities of start and target.
    """
    duration = (problem.shortest + problem.longest) / 2
    return follow(problem, target, _line(target, problem.model, intervals, duration), duration)


def follow(problem: Problem, target: Target, positions: Array, duration: float) -> Guess:
    """The motion along free coordinates (K + 1, nq) at equal times, put onto bars and joints, and the force densities that follow it best."""
    states = _motion(problem, target, positions, duration)
    return Guess(states, _inverse_dynamics(problem, states, _reference(problem, states), duration / (len(states) - 1)), duration)


def settled(problem: Problem, states: Array) -> Array:
    """Force densities (K, α) that hold states (K + 1, nx) at rest, as nearly as they can."""
    return _inverse_dynamics(problem, states, _reference(problem, states), 1.0)


def _line(target: Target, model: Model, intervals: int, duration: float) -> Array:
    """Free coordinates (K + 1, nq) from start to target, through the waypoints."""
    start, end = target.start, target.start if target.state is None else target.state
    s = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    rise, fall = s**3 * (10 - 15 * s + 6 * s**2), -4 * s**3 + 7 * s**4 - 3 * s**5
    out = s - 6 * s**3 + 8 * s**4 - 3 * s**5  # leaves with the start's velocity; `fall` arrives with the target's
    (q0, v0, _), (q1, v1, _) = model.split(start), model.split(end)
    q = q0 + rise * (q1 - q0) + duration * (out * v0 + fall * v1)
    waypoints = [(one.share, one.target.state) for one in target.waypoints if one.target.state is not None]
    if waypoints:
        places = [q0, *(model.split(state)[0] for _, state in waypoints), q1]
        rates = [(1, duration * v) for v in (v0, v1)]
        q = scipy.interpolate.CubicSpline([0.0, *(share for share, _ in waypoints), 1.0], places, bc_type=tuple(rates))(s[:, 0])
    return np.asarray(q)


def _motion(problem: Problem, target: Target, q: Array, duration: float) -> Array:
    model, intervals = problem.model, len(q) - 1
    start = target.start
    clock = model.split(start)[2] + np.linspace(0.0, duration, intervals + 1)[:, None][:, : model.nx - 2 * model.nq]
    project = projection(model, 10).map(intervals + 1)
    still = np.column_stack([q, np.zeros_like(q), clock])
    q, _, _ = model.split(np.asarray(project(still.T).full()).T)
    v = np.empty_like(q)
    v[0], v[-1] = (model.split(state)[1] for state in (start, start if target.state is None else target.state))
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
    _, acceleration, _ = model.split(model.ode(x, u))
    linear = ca.Function("linear", [x, u], [ca.densify(acceleration), ca.densify(ca.jacobian(acceleration, u))])
    middle = (states[:-1] + states[1:]) / 2
    wanted = np.diff(model.split(states)[1], axis=0) / interval
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
