"""Linearized equations of motion and natural modes about a state."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from tenscasadi.dynamics.linearization import EquationDerivatives, displacements
from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.operating_point import OperatingPoint, split_point
from tenscasadi.statics.solver.constrained_eigenproblem import (
    SaddlePoint,
    fastest_rate,
    lowest_eigenpairs,
)
from tenscasadi.structure.class_one import distances
from tenscasadi.structure.names import add_names
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.linear_algebra import DENSE
from tenscasadi.util.validate import NEGLIGIBLE, Array, finite_array, instance, whole_number


@dataclass(frozen=True, eq=False)
class Linearization(ReadOnlyArrays):
    """Equations of motion, linearized about a state and control.

    ẋ ≈ ode(x₀, u₀) + A (x − x₀) + B (u − u₀).

    Attributes
    ----------
    A : ndarray (nx, nx)
        Derivative of ẋ with respect to the state x.
    B : ndarray (nx, nu)
        Derivative of ẋ with respect to the control u.
    residual : ndarray (nx,)
        ẋ = ode(x₀, u₀); zero in equilibrium.
    tangent : ndarray (nq, d)
        Orthonormal basis of the displacements that bars and joints allow. Only motions within it
        are physical.
    by_parameters : ndarray (nx, np)
        Derivative of ẋ with respect to the model's parameters.

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
    by_parameters: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class Modes(ReadOnlyArrays):
    """Natural modes of vibration about an equilibrium.

    Rigid-body motions without a restoring force are excluded.

    Attributes
    ----------
    frequency : ndarray (k,)
        Natural frequencies in increasing order [Hz]. An unstable mode has a negative one: −√(−λ)/2π
        for an eigenvalue λ < 0.
    shape : ndarray (k, n, 3)
        Displacements of the nodes in each mode, normalized by mass.
    rigid : int
        Number of excluded rigid-body motions.
    residual : float
        Largest acceleration at the state [m/s²]; zero in equilibrium.

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


def linearize(
    model: Model | OperatingPoint, x: Any = None, u: Any = None, parameters: Any = None
) -> Linearization:
    """Linearize a model's equations at a state and control.

    The derivatives are exact.

    A and B act on all coordinates of the state. Only perturbations along `tangent` satisfy bars and
    joints.

    Parameters
    ----------
    model : Model or Equilibrium
        The model, or an equilibrium of it.
    x : array_like (nx,), or Equilibrium, optional
        State to linearize about; None: the initial state.
    u : array_like (nu,), optional
        Control to linearize about; None: the initial control.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    Linearization
        Derivatives, rate at the state, and basis of the allowed displacements.

    Raises
    ------
    TypeError
        If an argument has a wrong type, or is a CasADi symbol: for expressions, use
        `ca.jacobian(model.ode(x, u), x)`.
    ValueError
        If an argument has a wrong shape, or the equations have no derivative at the state, as where
        a bar has no length.

    Notes
    -----
    The constraints are those of bars (Eqs. 26-29 of the paper) and joints (Eq. 84). `tangent` spans
    the null space of their derivative with respect to the coordinates.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pendulum = tc.Structure([(0, 0, 0), (0, 0, -2)], [(0, 1)], pinned=(0,))
    >>> linear = tc.linearize(tc.Model(tc.Scene(pendulum, gravity=tc.Gravity())))
    >>> linear.tangent.shape
    (3, 2)
    """
    model, state, inputs = _numbers(model, x, u, parameters)
    control, p = np.split(inputs, [model.nu])
    found = EquationDerivatives.of(model).at(state[None], control[None], p)
    J, residual = found.jacobian(0), found.rates[0]
    _reject_degenerate(model, state, J, residual)
    A, B, by_parameters = np.split(J, [model.nx, model.nx + model.nu], axis=1)
    return Linearization(A, B, residual, displacements(model, state), by_parameters)


def modes(
    model: Model | OperatingPoint,
    x: Any = None,
    u: Any = None,
    count: int | None = None,
    parameters: Any = None,
) -> Modes:
    """Compute the natural modes about an equilibrium.

    The modes are small undamped vibrations about an equilibrium at rest.

    Strings act with their stiffness and prestress, bars with the force that they carry. A
    `ForceDensity` control is held constant.

    Parameters
    ----------
    model : Model or Equilibrium
        The model, or an equilibrium of it.
    x : array_like (nx,), or Equilibrium, optional
        State of equilibrium; None: the initial state.
    u : array_like (nu,), optional
        Control of equilibrium; None: the initial control.
    count : int, optional
        Number of modes, from the lowest frequency on; unstable ones are the lowest. None: all of a
        structure of up to 600 coordinates (`model.nq`), the 20 lowest of a larger one.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    Modes
        Frequencies [Hz] and mode shapes.

    Raises
    ------
    TypeError
        If an argument has a wrong type, or is a CasADi symbol.
    ValueError
        If an argument has a wrong shape, or the equations have no derivative at the state, as where
        a bar has no length.

    Warns
    -----
    UserWarning
        If `count` is None and the structure has more than 600 coordinates: not all modes are
        computed.

    Notes
    -----
    M is the mass matrix and T an M-orthonormal basis of the displacements that bars and joints
    allow. The squares of the angular frequencies are the eigenvalues of −Tᵀ M (∂N̈/∂N) T.

    Above 600 coordinates they are those of K v = ω² M v, J v = 0. J is the derivative of the
    constraints and K that of all forces at constant multipliers. Both matrices are sparse.
    Shift-invert Lanczos finds the lowest eigenvalues [1]_, and the signs of the pivots count the
    unstable ones [2]_. Dense matrices serve at any size if nearly all modes are requested, bars
    leave few motions, or the matrices are badly conditioned.

    The load of redundant bars is not unique, and the transverse stiffness depends on it. The modes
    are those of the smallest multipliers.

    References
    ----------
    .. [1] T. Ericsson and A. Ruhe, The spectral transformation Lanczos method, Mathematics of
       Computation 35 (1980), 1251-1268.
    .. [2] B. N. Parlett, The Symmetric Eigenvalue Problem, section 3.3: Sylvester's law of inertia.

    Examples
    --------
    A rod of 2 m that hangs from one end swings at √(3 g / 2 L) / 2π in both directions:

    >>> import tenscasadi as tc
    >>> pendulum = tc.Structure([(0, 0, 0), (0, 0, -2)], [(0, 1)], pinned=(0,))
    >>> modes = tc.modes(tc.Model(tc.Scene(pendulum, gravity=tc.Gravity())))
    >>> [round(float(frequency), 4) for frequency in modes.frequency]
    [0.4317, 0.4317]
    """
    model, state, inputs = _numbers(model, x, u, parameters)
    number = 20 if count is None else whole_number("count", count, 1)
    mech = model.mechanism
    constraints = mech.bars + int(mech.active.sum())
    found = None
    if model.nq > DENSE and model.nq - constraints > 2 * number:
        if count is None:
            message = f"modes computes the {number} lowest modes of a structure of more than {DENSE} coordinates: give count= for another number"
            warnings.warn(message, UserWarning, stacklevel=2)
        with suppress(np.linalg.LinAlgError):  # then by dense matrices, in more time
            found = _lowest_modes(model, state, inputs, number)
        count = number
    values, vectors, rigid, residual = found or _all_modes(model, state, inputs)
    values, vectors = values[:count], vectors[:, :count]
    displacement = np.zeros((len(values), model.nx))
    model.split(displacement)[0][:] = vectors.T
    shape = model.nodes(displacement) - model.nodes(np.zeros(model.nx))
    frequency = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    return Modes(frequency, shape, rigid, residual)


def _numbers(model: Any, x: Any, u: Any, parameters: Any) -> tuple[Model, Array, Array]:
    """Check a model, and read a state x (nx,) and inputs (nw,).

    The inputs are the control u (nu,) and the parameters. None stands for the initial values.
    """
    if isinstance(model, OperatingPoint):
        model, x = model.model, model if x is None else x
    instance("model", model, Model, "a tenscasadi.Model or Equilibrium")
    x, u, parameters = split_point(model, x, u, parameters)
    state = model.initial_state if x is None else finite_array("x", x, (model.nx,))
    return model, state, model.stack_inputs(u, parameters)


def _reject_degenerate(model: Model, state: Array, *values: Any) -> None:
    """Raise ValueError unless all values are finite.

    They are those at a state (nx,). The message names a member of zero length.
    """
    if all(np.all(np.isfinite(value)) for value in values):
        return
    structure, nodes = model.structure, model.nodes(state)
    reason = "the forces or the accelerations there are not finite"
    for kind, pairs in (("bar", structure.bars), ("string", structure.strings)):
        short = np.flatnonzero(distances(nodes, pairs) == 0.0)
        if len(short):
            reason = f"{kind} {short[0]} has no length, its nodes {pairs[short[0]][0]} and {pairs[short[0]][1]} coincide"
            break
    text = f"x is a state at which the equations of motion have no derivative: {reason}; give a state without it"
    raise ValueError(add_names(text, structure))


def _all_modes(model: Model, state: Array, inputs: Array) -> tuple[Array, Array, int, float]:
    """Compute all modes about a state by dense matrices.

    The state is (nx,), and the inputs are (nw,). Returns ω² (k,) [rad²/s²], shapes (nq, k), the
    number of rigid-body motions, and the largest acceleration.
    """
    nq, control, p = model.nq, inputs[: model.nu], inputs[model.nu :]
    linear = linearize(model, state, control, p)
    M = EquationDerivatives.of(model).mass(p).toarray()
    T = linear.tangent
    L = scipy.linalg.cholesky(T.T @ M @ T, lower=True)
    T = scipy.linalg.solve_triangular(L, T.T, lower=True).T  # M-orthonormal
    K = -T.T @ M @ linear.A[nq : 2 * nq, :nq] @ T
    motions = _find_rigid_motions(model, state)
    outside = motions - linear.tangent @ (linear.tangent.T @ motions)
    rigid = _neutral(K, T.T @ M @ _project_motions(motions, outside))
    if rigid.shape[1]:
        elastic = scipy.linalg.null_space(rigid.T)
        K, T = elastic.T @ K @ elastic, T @ elastic
    values, vectors = np.linalg.eigh((K + K.T) / 2)
    acceleration = float(np.abs(model.split(linear.residual)[1]).max(initial=0.0))
    return values, T @ vectors, rigid.shape[1], acceleration


def _lowest_modes(
    model: Model, state: Array, inputs: Array, count: int
) -> tuple[Array, Array, int, float]:
    """Compute the modes of lowest frequency by sparse matrices.

    They are `count` modes at a state (nx,) with inputs (nw,). The result is that of `_all_modes`.
    Raises LinAlgError where the matrices are too badly conditioned.
    """
    K, M, J, acceleration = _stiffness(model, state, inputs)
    motions = _find_rigid_motions(model, state)
    motions = _project_motions(motions, J @ motions)
    if motions.shape[1]:
        motions = motions @ np.linalg.inv(np.linalg.cholesky(motions.T @ (M @ motions))).T
        restored, _ = SaddlePoint(M, J).solve(
            K @ motions
        )  # the acceleration that each motion meets
        values, vectors = np.linalg.eigh(restored.T @ (M @ restored))
        motions = (
            motions
            @ vectors[:, np.sqrt(np.maximum(values, 0.0)) <= NEGLIGIBLE * fastest_rate(K, M)]
        )
    values, shapes = lowest_eigenpairs(K, M, J, motions, count)
    return values, shapes, motions.shape[1], float(np.abs(acceleration).max(initial=0.0))


def _stiffness(model: Model, state: Array, inputs: Array) -> tuple[Any, Any, Any, Array]:
    """Build the sparse eigenproblem of the modes, and the accelerations.

    It is that at a state (nx,) with inputs (nw,). K, M (nq×nq) and J (m×nq) define K v = ω² M v, J
    v = 0.
    """
    derivatives = EquationDerivatives.of(model)
    M, J, force, bias = derivatives.system_at(state, inputs)
    _reject_degenerate(model, state, J.data, force, bias)
    # M a + Jᵀ (−μ) = F, J a = −c
    acceleration, opposite = SaddlePoint(M, J).solve(force, -bias)
    K = -derivatives.slopes_at(state, inputs, -opposite, acceleration)[: model.nq, : model.nq]
    _reject_degenerate(model, state, K.data, acceleration)
    return sp.csc_array((K + K.T) / 2), M, J, acceleration


def _neutral(K: Array, motions: Array) -> Array:
    """Find combinations of displacements without a restoring force.

    K is the stiffness (nq, nq). The result is an orthonormal basis; its vectors and `motions` are
    columns.
    """
    basis = scipy.linalg.orth(motions) if motions.size else motions
    _, size, right = np.linalg.svd(K @ basis)
    free = np.ones(basis.shape[1], dtype=bool)
    free[: len(size)] = size <= NEGLIGIBLE * float(np.linalg.norm(K))
    return np.asarray(basis @ right.T[:, free])


def _find_rigid_motions(model: Model, state: Array) -> Array:
    """Find the rigid-body motions that pinned coordinates allow.

    They are those at a state (nx,). The result is an orthonormal basis (nq, ≤ 6).
    """
    mech = model.mechanism
    columns = model.columns(model.nodes(state))
    fields = [np.broadcast_to(axis, columns.shape) for axis in np.eye(3)] + [
        np.cross(axis, columns - columns.mean(axis=0)) for axis in np.eye(3)
    ]
    motions = scipy.linalg.orth(np.stack([mech.local(field.ravel()) for field in fields], axis=1))
    held = np.flatnonzero(~(mech.free | mech.dependent[:, None]).ravel())
    allowed = motions @ scipy.linalg.null_space(motions[held]) if len(held) else motions
    return np.asarray(allowed[mech.free_index])


def _project_motions(motions: Array, outside: Array) -> Array:
    """Find the rigid-body motions that satisfy all constraints.

    `motions` (nq, k) are columns to combine. `outside` (m, k) are the constraint violations of each
    motion, due to pins in full coordinates.
    """
    return (
        np.asarray(motions @ scipy.linalg.null_space(outside, rcond=1e-9))
        if np.abs(outside).max(initial=0.0) > 1e-9
        else motions
    )
