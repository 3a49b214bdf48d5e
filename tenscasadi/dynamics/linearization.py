"""First derivatives of the equations of motion.

The equations are M q̈ = F + Jᵀ μ, J q̈ + c = 0. q are the free node coordinates. M is their mass
matrix, and F are the forces along them. J is the Jacobian of the constraints, μ are their
multipliers, and c is their drift. In shapes, c is the number of constraints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.dynamics.equation_of_motion import compute_forces
from tenscasadi.util.casadi_tools import (
    ArrayFunction,
    block_inverse,
    diagonal_row,
    is_expression,
)
from tenscasadi.util.linear_algebra import null_space, semidefinite_inverse
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True, eq=False)
class LinearDynamics:
    """Linearized dynamics at K states.

    The equations are M q̈ = F + Jᵀ μ, J q̈ + c = 0.

    Attributes
    ----------
    model : Model
        Model with nx states, nq coordinates and nw = nu + np inputs.
    rates : ndarray (K, nx)
        Time derivatives ẋ of the states.
    multipliers : ndarray (K, c)
        Multipliers μ of the constraints [N].
    inverse_mass : array (nq, nq)
        M⁻¹, dense or sparse.
    weighted, inverse : ndarray (K, c, nq), (K, c, c)
        J M⁻¹ and (J M⁻¹ Jᵀ)⁻¹, by which accelerations depend on forces.
    slopes : ndarray (K, ·)
        Nonzero derivatives of F + Jᵀ μ − M q̈ and J q̈ + c, at constant q̈ and μ.
    pattern : sparse array (nx + nw, nq + c)
        Sparsity of these entries, row by row. The methods write into its data.
    internal : ndarray (K, na, nx + nw)
        Derivatives of the internal states' time derivatives.
    """

    model: Model
    rates: Array
    multipliers: Array
    inverse_mass: Any
    weighted: Array
    inverse: Array
    slopes: Array
    pattern: sp.csr_array
    internal: Array

    def tangent(self, k: int, changes: Array) -> Array:
        """Compute changes (nx, m) of the state derivative ẋ.

        They are due to m `changes` (nx + nw, m) of the state x and the input w = (u, p), to first
        order. k is the number of the state.
        """
        nq, result = self.model.nq, np.zeros((self.model.nx, changes.shape[1]))
        self.pattern.data = self.slopes[k]
        forces, kept = np.split(self.pattern.T @ changes, [nq])
        result[:nq] = changes[nq : 2 * nq]
        back = self.inverse[k] @ (self.weighted[k] @ forces + kept)
        result[nq : 2 * nq] = self.inverse_mass @ forces - self.weighted[k].T @ back
        if self.model.na:
            result[2 * nq : 2 * nq + self.model.na] = self.internal[k] @ changes
        return result

    def adjoint(self, k: int, weights: Array) -> Array:
        """Compute gradients (nx + nw, m) of weightsᵀ ẋ.

        They are with respect to the state x and the input w = (u, p), at state number k. The m
        columns of `weights` (nx, m) are weights of ẋ.
        """
        nq, forces = self.model.nq, weights[self.model.nq : 2 * self.model.nq]
        back = self.inverse[k] @ (self.weighted[k] @ forces)
        self.pattern.data = self.slopes[k]
        free = self.inverse_mass @ forces - self.weighted[k].T @ back
        result = self.pattern @ np.concatenate([free, -back])
        result[nq : 2 * nq] += weights[:nq]
        if self.model.na:
            result += self.internal[k].T @ weights[2 * nq : 2 * nq + self.model.na]
        return np.asarray(result)

    def jacobian(self, k: int) -> Array:
        """Compute the Jacobian (nx, nx + nw) of ẋ.

        The derivatives are with respect to the state x and the input w = (u, p), at state number k.
        """
        return self.adjoint(k, np.eye(self.model.nx)).T

    def accelerations_by_control(self) -> Array:
        """Compute the control Jacobians (K, nq, nu) of the accelerations."""
        model, nq = self.model, self.model.nq
        row = np.repeat(np.arange(len(self.pattern.indptr) - 1), np.diff(self.pattern.indptr))
        own = np.flatnonzero((row >= model.nx) & (row < model.nx + model.nu))
        changes = np.zeros((len(self.rates), self.pattern.shape[1], model.nu))
        changes[:, self.pattern.indices[own], row[own] - model.nx] = self.slopes[:, own]
        forces, kept = changes[:, :nq], changes[:, nq:]
        back = self.inverse @ (self.weighted @ forces + kept)
        free = (self.inverse_mass @ np.concatenate(list(forces), axis=1)).reshape(
            nq, len(forces), model.nu
        )
        return np.asarray(free.transpose(1, 0, 2) - self.weighted.transpose(0, 2, 1) @ back)


class EquationDerivatives:
    """Equations of motion of a model and their first derivatives.

    The equations are M q̈ = F + Jᵀ μ, J q̈ + c = 0. The system of the multipliers μ is solved in
    numbers, because expressions of the derivatives of accelerations would be dense. For the symbols
    see the top of the module.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._constant_inverse: Any = None
        nq, nx = model.nq, model.nx
        kind = _symbol_kind(model)
        x, w, a = kind.sym("x", nx), kind.sym("w", model.nw), kind.sym("a", nq)
        N, V, time = model.unpack(x)
        F, _ = compute_forces(model, N, V, model.extend_inputs(x, w), time)
        force = model.mechanism.generalized_forces(F)
        constraints = model.constraints(x)
        rates = ca.densify(ca.vertcat(kind(0, 1), constraints.bar_rates, constraints.joint_rates))
        self.constraints = rates.shape[0]
        mu = kind.sym("mu", self.constraints)
        _, v, own, clock = model.split(x)
        J = ca.jacobian(rates, x)[:, nq : 2 * nq]
        # the constraints do not depend on internal states
        drift = ca.vertcat(v, kind.zeros(nq + own.shape[0], 1), *([1] if clock.shape[0] else []))
        bias = ca.jtimes(rates, x, drift) if self.constraints else rates
        give = _compute_length_error(model, N, w)
        balance = force + ca.mtimes(J.T, mu)
        if model.mechanism.masses is not None:
            balance -= ca.mtimes(model.with_masses(w, inverse=False).free_mass, a)
        kept = ca.mtimes(J, a) + bias - give * mu
        slopes = ca.jacobian(ca.vertcat(balance, kept), ca.vertcat(x, w))
        self._places, pattern = J.sparsity().get_triplet(), slopes.sparsity()
        # entries column by column are those of the transpose row by row
        self._pattern = sp.csr_array(
            (np.zeros(pattern.nnz()), pattern.row(), pattern.colind()), shape=slopes.shape[::-1]
        )
        self._values = ca.Function(
            "values", [x, w], [ca.vec(ca.densify(part)) for part in (force, bias, give, J.nz[:])]
        )
        self._slopes = ca.Function("slopes", [x, w, mu, a], [ca.densify(slopes.nz[:])])
        changes = ca.densify(model.internal_rates(x, w))
        by_all = ca.densify(ca.jacobian(changes, ca.vertcat(x, w)))
        self._internal = ca.Function("internal", [x, w], [changes, ca.vec(by_all.T)])

    @staticmethod
    def of(model: Model) -> EquationDerivatives:
        """Return the derivatives of a model, which caches them."""
        return model.keep("equation derivatives", lambda: EquationDerivatives(model))

    def at(self, states: Array, controls: Array, parameters: Any = None) -> LinearDynamics:
        """Linearize at states (K, nx) with controls (K, nu).

        `parameters` are those of `Model.multipliers`; nominal if None.
        """
        K, nq, c = len(states), self.model.nq, self.constraints
        p = self.model.parameters.values(parameters)
        inputs = np.column_stack([controls, np.tile(p, (K, 1))])
        forces, bias, give, entries = ArrayFunction(self._values.map(K))(states, inputs)
        inverse_mass = self._inverse_mass(p)
        accelerations, mu = forces @ inverse_mass, bias
        weighted, inverse = np.zeros((K, c, nq)), np.zeros((K, c, c))
        if c:
            J = np.zeros((K, c, nq))
            J[:, self._places[0], self._places[1]] = entries
            weighted[:] = (J.reshape(K * c, nq) @ inverse_mass).reshape(J.shape)
            system = J @ weighted.transpose(0, 2, 1)
            system[:, np.arange(c), np.arange(c)] -= give
            inverse[:] = semidefinite_inverse(system)
            mu = -_times(inverse, _times(J, accelerations) + bias)
            accelerations = accelerations + _times(weighted.transpose(0, 2, 1), mu)
        (slopes,) = ArrayFunction(self._slopes.map(K))(states, inputs, mu, accelerations)
        v, clock = self.model.split(states).velocities, self.model.split(states).clock
        own, internal = np.zeros((K, 0)), np.zeros((K, self.model.na, 0))
        if self.model.na:
            own, internal = ArrayFunction(self._internal.map(K))(states, inputs)
            internal = internal.reshape(K, self.model.na, -1)
        rates = np.column_stack([v, accelerations, own, np.ones_like(clock)])
        pattern = self._pattern.copy()
        slopes = slopes.reshape(K, pattern.nnz)
        return LinearDynamics(
            self.model, rates, mu, inverse_mass, weighted, inverse, slopes, pattern, internal
        )

    def system_at(self, state: Array, inputs: Array) -> tuple[Any, Any, Array, Array]:
        """Compute M, J, F and c of the equations of motion.

        The shapes are (nq, nq), (c, nq), (nq,) and (c,); M and J are sparse. `state` (nx,) is the
        state, and `inputs` (nw,) are the control followed by the parameters.
        """
        values = self._values(state, inputs)
        force, bias, _, entries = (value.full().ravel() for value in values)
        J = sp.csc_array((entries, self._places), shape=(self.constraints, self.model.nq))
        return self.mass(inputs[self.model.nu :]), J, force, bias

    def slopes_at(self, state: Array, inputs: Array, mu: Array, accelerations: Array) -> Any:
        """Compute the sparse Jacobian of the equations at constant q̈ and μ.

        It is the derivative (nq + c, nx + nw) of F + Jᵀ μ − M q̈ and J q̈ + c with respect to state
        and inputs. `inputs` (nw,) are the control followed by the parameters, `mu` is μ (c,), and
        `accelerations` are q̈ (nq,).
        """
        pattern = self._pattern.copy()
        pattern.data = self._slopes(state, inputs, mu, accelerations).full().ravel()
        return sp.csc_array(pattern.T)

    def mass(self, p: Array) -> Any:
        """Compute the sparse mass matrix (nq, nq) [kg].

        p (np,) are the parameters.
        """
        w = ca.DM(np.append(np.zeros(self.model.nu), p))
        M = self.model.with_masses(w, inverse=False).free_mass
        return sp.csc_array(M.sparse() if is_expression(M) else M)

    def _inverse_mass(self, p: Array) -> Any:
        """Invert the mass matrix for parameters p (np,).

        The inverse (nq, nq) [1/kg] is dense if sparse products would be slower.
        """
        if self._constant_inverse is not None:
            return self._constant_inverse
        mass, nq = self.mass(p), self.model.nq
        diagonal = mass.diagonal()  # nodes without mass are pinned: any mass gives the same motion
        some = np.where(diagonal == 0, diagonal.max(initial=0.0) or 1.0, 0.0)
        inverse = block_inverse(sp.csr_array(mass + sp.diags_array(some)), np.ones(nq, bool))
        inverse = inverse.toarray() if 10 * inverse.nnz > nq * nq else inverse
        if self.model.mechanism.masses is None:
            self._constant_inverse = inverse
        return inverse


def tangents(model: Model, state: Array) -> Array:
    """Compute an orthonormal basis (nx, d) of admissible state changes.

    They satisfy the constraints of bars and joints, and do not change the clock. `state` (nx,) is
    the state at which the constraints are linearized; d is the number of degrees of freedom of the
    tangent space.
    """
    return _free_directions(_constraint_jacobian(model, state))


def displacements(model: Model, state: Array) -> Array:
    """Compute an orthonormal basis (nq, d) of admissible displacements.

    To first order at `state` (nx,), these d displacements satisfy the constraints of bars and
    joints.
    """
    count = model.mechanism.bars + int(model.mechanism.active.sum())
    return _free_directions(_constraint_jacobian(model, state)[:count, : model.nq])


def _free_directions(J: Array) -> Array:
    """Compute an orthonormal basis of the null space of J.

    J has one row for each constraint; rows may be redundant. The basis vectors are columns.
    """
    return null_space(J, 1e-9 * float(np.linalg.norm(J)))


def _constraint_jacobian(model: Model, state: Array) -> Array:
    """Compute the Jacobian of all constraints with respect to the state.

    Its rows are bars, joints, their rates, and the clock. `state` is (nx,).
    """

    def build() -> ca.Function:
        x = _symbol_kind(model).sym("x", model.nx)
        own = model.constraints(x)
        rows = ca.vertcat(
            own.bars, own.joints, own.bar_rates, own.joint_rates, model.split(x).clock
        )
        return ca.Function("jacobian", [x], [ca.densify(ca.jacobian(rows, x))])

    return np.asarray(model.keep("constraint jacobian", build)(state).full())


def _symbol_kind(model: Model) -> Any:
    """Return the type of CasADi symbols for a model's expressions.

    It is SX (scalars), or MX (matrices) if functions of time need that.
    """
    return ca.SX if not model.has_clock or model.ode.is_a("SXFunction") else ca.MX


def _compute_length_error(model: Model, N: Any, w: Any) -> Any:
    """Compute the error (c×1) of bar constraints at constant lengths.

    It is (bᵀb − l²)/l² · diag(G), if λ̂ is computed with constant lengths l instead of those of the
    bar vectors b; otherwise 0. G is C_b M⁻ C_bᵀ. N (3×n) are node positions, and w is the stacked
    input with the masses. Entries of joints are 0.
    """
    mech, count = model.mechanism, model.mechanism.bars
    none = type(N).zeros(int(mech.active.sum()), 1)
    if not mech.constant_length:
        return ca.vertcat(type(N).zeros(count, 1), none)
    B, squares = mech.bar_vectors(N), ca.DM(mech.lengths**2).T
    give = (ca.sum1(B * B) / squares - 1) * diagonal_row(model.with_masses(w).G[0])
    return ca.vertcat(give.T, none)


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
