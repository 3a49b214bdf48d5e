"""Small motions about a state: the linearised equations, natural modes that respect bars and joints, and a mode as a motion to draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array, instance, positive_number, whole_number


@dataclass(frozen=True, eq=False)
class Linearization:
    """ẋ ≈ ode(x₀, u₀) + A (x − x₀) + B (u − u₀), and the tangent basis in which its physical motion lives."""

    A: Array  # (nx, nx)
    B: Array  # (nx, nu)
    residual: Array  # (nx,) ode(x₀, u₀): zero in equilibrium
    tangent: Array  # (nq, d) orthonormal basis of displacements that bars and joints allow


@dataclass(frozen=True, eq=False)
class Modes:
    """Natural modes about an equilibrium, without the rigid-body motions that nothing restores.

    `frequency` (k,), Hz, increasing; negative where the equilibrium is unstable (−√(−eigenvalue)/2π). `shape` (k, n, 3): displacements
    of physical nodes, mass-normalised. `rigid`: how many such motions there are. `residual`: the largest acceleration at
    the state, m/s²: 0 in equilibrium.
    """

    frequency: Array
    shape: Array
    rigid: int
    residual: float


def linearize(model: Model, x: Any = None, u: Any = None) -> Linearization:
    """Exact derivatives of `model.ode` at a state (nx,) and control (nu,); None: the initial ones. Raises TypeError, ValueError.

    A and B act on all coordinates of the state; only perturbations along `tangent` keep bars and joints (Eqs. 26-29, 84).
    """
    instance("model", model, Model, "a tenscasadi.Model")
    state, control = model.arguments(model.initial_state if x is None else x, u)
    sx, su = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    rate = model.ode(sx, su)
    evaluate = ca.Function("linearize", [sx, su], [ca.jacobian(rate, sx), ca.jacobian(rate, su), rate])
    A, B, residual = (value.full() for value in evaluate(state, control))
    return Linearization(A, B, residual.ravel(), _tangent(model, state))


def modes(model: Model, x: Any = None, u: Any = None) -> Modes:
    """Natural modes of small undamped vibration about an equilibrium at rest; arguments as for `linearize`.

    With T an M-orthonormal basis of the displacements that bars and joints allow: eigenvalues of
    −Tᵀ M (∂N̈/∂N) T, which holds the stiffness of strings, their prestress and that of the bars. The density of force that a
    `ForceDensity` control commands is held constant. Raises TypeError, ValueError.
    """
    linear = linearize(model, x, u)
    state, _ = model.arguments(model.initial_state if x is None else x, u)
    nq = model.nq
    free = np.flatnonzero(model.mechanism.free.ravel())
    M = np.kron(model.mechanism.M.toarray(), np.eye(3))[np.ix_(free, free)]
    T = linear.tangent
    L = scipy.linalg.cholesky(T.T @ M @ T, lower=True)
    T = scipy.linalg.solve_triangular(L, T.T, lower=True).T  # M-orthonormal
    K = -T.T @ M @ linear.A[nq : 2 * nq, :nq] @ T
    rigid = _neutral(K, T.T @ M @ _rigid(model, np.asarray(state).ravel(), linear.tangent))
    if rigid.shape[1]:
        elastic = scipy.linalg.null_space(rigid.T)
        K, T = elastic.T @ K @ elastic, T @ elastic
    values, vectors = np.linalg.eigh((K + K.T) / 2)
    displacement = np.zeros((len(values), model.nx))
    displacement[:, :nq] = (T @ vectors).T
    shape = model.nodes(displacement) - model.nodes(np.zeros(model.nx))
    frequency = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    return Modes(frequency, shape, rigid.shape[1], float(np.abs(linear.residual[nq : 2 * nq]).max(initial=0.0)))


def mode_motion(model: Model, modes: Modes, index: int, amplitude: float | None = None, rows: int = 41) -> Trajectory:
    """One period of mode `index` about the model's initial shape, as a trajectory of `rows` rows for plots and animations.

    `amplitude`: how far the furthest node moves, m; None: a twentieth of the structure's size. Nodes move in straight lines, as modes do,
    so bar lengths are off in the second order of the amplitude, and `bar_length_error` says by how much. An unstable mode is drawn
    with the period that it would have. Raises TypeError, ValueError.
    """
    instance("model", model, Model, "a tenscasadi.Model")
    instance("modes", modes, Modes, "the result of tenscasadi.modes(model)")
    if whole_number("index", index, 0) >= len(modes.frequency):
        raise ValueError(f"index is {index}: modes are numbered from 0 to {len(modes.frequency) - 1}")
    count = whole_number("rows", rows, 3)
    shape = modes.shape[index]
    if shape.shape != model.structure.nodes.shape:
        raise ValueError(f"modes.shape has {shape.shape[0]} nodes: give the modes of this model, which has {len(model.structure.nodes)}")
    size = float(np.ptp(model.structure.nodes, axis=0).max())
    reach = size / 20 if amplitude is None else positive_number("amplitude", amplitude)
    omega = 2 * np.pi * max(abs(float(modes.frequency[index])), 1e-9)
    time = np.linspace(0.0, 2 * np.pi / omega, count)
    moved = shape * (reach / np.linalg.norm(shape, axis=1).max())
    nodes = model.structure.nodes + np.sin(omega * time)[:, None, None] * moved
    velocities = omega * np.cos(omega * time)[:, None, None] * moved
    states = np.array([model.state(*row) for row in zip(nodes, velocities, strict=True)])
    controls = np.tile(model.initial_control, (count, 1))
    message = f"mode {index}, {modes.frequency[index]:.4g} Hz"
    return record_trajectory(model, time, states, controls, step=float(time[1]), message=message)


def _neutral(K: Array, motions: Array) -> Array:
    """An orthonormal basis of the combinations of `motions` (columns) that K leaves without restoring force."""
    basis = scipy.linalg.orth(motions) if motions.size else motions
    _, size, right = np.linalg.svd(K @ basis)
    free = np.ones(basis.shape[1], dtype=bool)
    free[: len(size)] = size <= 1e-9 * float(np.linalg.norm(K))
    return np.asarray(basis @ right.T[:, free])


def _tangent(model: Model, state: ca.DM) -> Array:
    """An orthonormal basis of the displacements that keep bar lengths and joints at a state."""
    x = ca.MX.sym("x", model.nx)
    kept = model.constraints(x)
    jacobian = ca.Function("rows", [x], [ca.jacobian(ca.vertcat(kept.bars, kept.joints), x)])(state).full()[:, : model.nq]
    return np.asarray(scipy.linalg.null_space(jacobian)) if len(jacobian) else np.eye(model.nq)


def _rigid(model: Model, state: Array, tangent: Array) -> Array:
    """An orthonormal basis of the rigid-body motions within the span of `tangent`: those that the supports allow."""
    mech = model.mechanism
    columns = model.nodes(state)[mech.physical]
    centre = columns.mean(axis=0)
    fields = [np.broadcast_to(axis, columns.shape) for axis in np.eye(3)] + [np.cross(axis, columns - centre) for axis in np.eye(3)]
    motions = scipy.linalg.orth(np.stack([field.ravel() for field in fields], axis=1))
    held = np.flatnonzero(~mech.free.ravel())
    allowed = motions @ scipy.linalg.null_space(motions[held]) if len(held) else motions
    free = allowed[np.flatnonzero(mech.free.ravel())]
    outside = free - tangent @ (tangent.T @ free)  # rigid motions that pins of full coordinates stop
    return np.asarray(free @ scipy.linalg.null_space(outside, rcond=1e-9)) if np.abs(outside).max(initial=0.0) > 1e-9 else np.asarray(free)
