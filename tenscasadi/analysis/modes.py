"""Small motions about a state: the linearised equations, natural modes that respect bars and joints, and a mode as a motion to draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array, instance, positive_number, whole_number


@dataclass(frozen=True, eq=False)
class Linearization:
    """A model's equations to first order about a state and control: ẋ ≈ ode(x₀, u₀) + A (x − x₀) + B (u − u₀).

    Attributes
    ----------
    A : ndarray (nx, nx)
        Derivative of the state's rate by the state.
    B : ndarray (nx, nu)
        Derivative of the state's rate by the control.
    residual : ndarray (nx,)
        The rate ode(x₀, u₀); zero in equilibrium.
    tangent : ndarray (nq, d)
        Orthonormal basis of the displacements that bars and joints allow. Only motions within it are physical.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> linear = tc.linearize(tc.Model(tc.Scene(tc.shapes.prism(prestress=30.0))))
    >>> linear.A.shape, linear.tangent.shape
    ((36, 36), (18, 15))
    """

    A: Array
    B: Array
    residual: Array
    tangent: Array


@dataclass(frozen=True, eq=False)
class Modes:
    """Natural modes about an equilibrium, without the rigid-body motions that nothing restores.

    Attributes
    ----------
    frequency : ndarray (k,)
        Natural frequencies in increasing order, Hz. An unstable mode has a negative one: −√(−λ)/2π for an eigenvalue λ < 0.
    shape : ndarray (k, n, 3)
        Displacements of the nodes in each mode, normalised by mass.
    rigid : int
        Number of rigid-body motions that were left out.
    residual : float
        Largest acceleration at the state, m/s²; zero in equilibrium.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> modes = tc.modes(tc.Model(tc.Scene(tc.shapes.prism(prestress=30.0))))
    >>> modes.shape.shape, modes.rigid
    ((9, 6, 3), 6)
    """

    frequency: Array
    shape: Array
    rigid: int
    residual: float


def linearize(model: Model, x: Any = None, u: Any = None) -> Linearization:
    """Compute the exact derivatives of a model's equations at a state and control.

    A and B act on all coordinates of the state. Only perturbations along `tangent` keep the bars' lengths and the joints closed.

    Parameters
    ----------
    model : Model
        The model.
    x : array_like (nx,), optional
        State to linearise about; None: the initial state.
    u : array_like (nu,), optional
        Control to linearise about; None: the initial control.

    Returns
    -------
    Linearization
        The derivatives, the rate at the state, and the basis of displacements that are allowed.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type or shape.

    Notes
    -----
    Bars keep their length (Eqs. 26-29 of the paper) and joints stay closed (Eq. 84); `tangent` spans the null space of the derivative
    of these constraints by the coordinates.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pendulum = tc.Structure([(0, 0, 0), (0, 0, -2)], [(0, 1)], pinned=(0,))
    >>> linear = tc.linearize(tc.Model(tc.Scene(pendulum, gravity=tc.Gravity())))
    >>> linear.tangent.shape
    (3, 2)
    """
    instance("model", model, Model, "a tenscasadi.Model")
    state, control = model.arguments(model.initial_state if x is None else x, u)
    sx, su = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    rate = model.ode(sx, su)
    evaluate = ca.Function("linearize", [sx, su], [ca.jacobian(rate, sx), ca.jacobian(rate, su), rate])
    A, B, residual = (value.full() for value in evaluate(state, control))
    return Linearization(A, B, residual.ravel(), _tangent(model, state))


def modes(model: Model, x: Any = None, u: Any = None) -> Modes:
    """Compute the natural modes of small undamped vibrations about an equilibrium at rest.

    Strings act with their stiffness and prestress, bars with the force that they carry. A `ForceDensity` control is held constant.

    Parameters
    ----------
    model : Model
        The model.
    x : array_like (nx,), optional
        State of equilibrium; None: the initial state.
    u : array_like (nu,), optional
        Control of equilibrium; None: the initial control.

    Returns
    -------
    Modes
        Frequencies, Hz, and mode shapes.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type or shape.

    Notes
    -----
    With M the mass matrix and T an M-orthonormal basis of the displacements that bars and joints allow, the squares of the angular
    frequencies are the eigenvalues of −Tᵀ M (∂N̈/∂N) T.

    Examples
    --------
    A rod of 2 m that hangs from one end swings at √(3 g / 2 L) / 2π in both directions:

    >>> import tenscasadi as tc
    >>> pendulum = tc.Structure([(0, 0, 0), (0, 0, -2)], [(0, 1)], pinned=(0,))
    >>> modes = tc.modes(tc.Model(tc.Scene(pendulum, gravity=tc.Gravity())))
    >>> [round(float(frequency), 4) for frequency in modes.frequency]
    [0.4317, 0.4317]
    """
    linear = linearize(model, x, u)
    state, _ = model.arguments(model.initial_state if x is None else x, u)
    nq = model.nq
    M = model.mechanism.free_mass.toarray()
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
    model.split(displacement)[0][:] = (T @ vectors).T
    shape = model.nodes(displacement) - model.nodes(np.zeros(model.nx))
    frequency = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    return Modes(frequency, shape, rigid.shape[1], float(np.abs(model.split(linear.residual)[1]).max(initial=0.0)))


def mode_motion(model: Model, modes: Modes, index: int, amplitude: float | None = None, rows: int = 41) -> Trajectory:
    """Return one period of a natural mode about the model's initial shape as a trajectory, for plots and animations.

    Nodes move in straight lines, so bar lengths are off in the second order of the amplitude; `bar_length_error` says by how much.
    An unstable mode gets the period that its rate of growth would give a vibration.

    Parameters
    ----------
    model : Model
        The model that the modes belong to.
    modes : Modes
        Result of `modes(model)`.
    index : int
        Number of the mode, from 0.
    amplitude : float, optional
        Way of the node that moves furthest, m; None: a twentieth of the structure's size.
    rows : int
        Number of times in the trajectory.

    Returns
    -------
    Trajectory
        The motion over one period.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, there is no such mode, or the modes are those of another structure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(prestress=30.0)))
    >>> motion = tc.mode_motion(model, tc.modes(model), index=0, amplitude=0.02)
    >>> motion.nodes.shape
    (41, 6, 3)
    """
    instance("model", model, Model, "a tenscasadi.Model")
    instance("modes", modes, Modes, "the result of tenscasadi.modes(model)")
    if whole_number("index", index, 0) >= len(modes.frequency):
        raise ValueError(f"index is {index}: modes are numbered from 0 to {len(modes.frequency) - 1}")
    count = whole_number("rows", rows, 3)
    shape = modes.shape[index]
    if shape.shape != model.structure.nodes.shape:
        raise ValueError(f"modes.shape has {shape.shape[0]} nodes: give the modes of this model, which has {len(model.structure.nodes)}")
    reach = extent(model) / 20 if amplitude is None else positive_number("amplitude", amplitude)
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
    """Return an orthonormal basis of the combinations of `motions` (columns) that K leaves without restoring force."""
    basis = scipy.linalg.orth(motions) if motions.size else motions
    _, size, right = np.linalg.svd(K @ basis)
    free = np.ones(basis.shape[1], dtype=bool)
    free[: len(size)] = size <= 1e-9 * float(np.linalg.norm(K))
    return np.asarray(basis @ right.T[:, free])


def _tangent(model: Model, state: ca.DM) -> Array:
    """Return an orthonormal basis of the displacements that keep bar lengths and joints at a state."""
    x = ca.MX.sym("x", model.nx)
    kept = model.constraints(x)
    jacobian = ca.Function("rows", [x], [ca.jacobian(ca.vertcat(kept.bars, kept.joints), x)])(state).full()
    jacobian, _, _ = model.split(jacobian)
    return np.asarray(scipy.linalg.null_space(jacobian)) if len(jacobian) else np.eye(model.nq)


def _rigid(model: Model, state: Array, tangent: Array) -> Array:
    """Return an orthonormal basis of the rigid-body motions within the span of `tangent`: those that the supports allow."""
    mech = model.mechanism
    columns = model.nodes(state)[mech.physical]
    centre = columns.mean(axis=0)
    fields = [np.broadcast_to(axis, columns.shape) for axis in np.eye(3)] + [np.cross(axis, columns - centre) for axis in np.eye(3)]
    motions = scipy.linalg.orth(np.stack([field.ravel() for field in fields], axis=1))
    held = np.flatnonzero(~mech.free.ravel())
    allowed = motions @ scipy.linalg.null_space(motions[held]) if len(held) else motions
    free = allowed[mech.free_index]
    outside = free - tangent @ (tangent.T @ free)  # rigid motions that pins of full coordinates stop
    return np.asarray(free @ scipy.linalg.null_space(outside, rcond=1e-9)) if np.abs(outside).max(initial=0.0) > 1e-9 else np.asarray(free)
