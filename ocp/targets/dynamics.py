"""The equation of motion in numbers, with derivatives that stay sparse: M q̈ = F + Jᵀ μ, J q̈ + c = 0."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.targets.row_reduction import separate_parts
from tenscasadi.dynamics.equation_of_motion import applied_forces
from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import REFINEMENTS, REGULARISATION, ArrayFunction, block_inverse
from tenscasadi.util.validate import Array

REDUNDANT = 1e8  # entry of an inverse beyond which constraints repeat each other
FEW = 6  # parts of a mass matrix that are inverted as dense blocks: all bars hang together


class Linearised(NamedTuple):
    """Motion, linearised at P states.

    rates: ẋ (P, nx). weighted, inverse: J M⁻¹ (P, c, nq) and (J M⁻¹ Jᵀ)⁻¹ (P, c, c), through which
    accelerations depend on forces. slopes: entries (P, ·) of the derivatives of F + Jᵀ μ and J q̈ +
    c by state and control; q̈ and μ stand still.
    """

    rates: Array
    weighted: Array
    inverse: Array
    slopes: Array


class Dynamics:
    """Forces F on the free coordinates, and constraints of bars and joints with gradients J, of a model.

    The system of the multipliers is inverted in numbers, point by point: expressions of the
    accelerations' derivatives would be dense.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        nq, nx = model.nq, model.nx
        # Without a clock all forces are scalar code; functions of time may not be.
        kind: Any = ca.SX if model.ode.is_a("SXFunction") or not model.scene.has_clock else ca.MX
        x, u, a = kind.sym("x", nx), kind.sym("u", model.nu), kind.sym("a", nq)
        N, V, time = model.unpack(x)
        F, _ = applied_forces(model, N, V, u, time)
        force = model.split(model.pack(F, F, 0))[0]
        constraints = model.constraints(x)
        rates = ca.densify(ca.vertcat(kind(0, 1), constraints.bar_rates, constraints.joint_rates))
        count = rates.shape[0]
        mu = kind.sym("mu", count)
        _, v, clock = model.split(x)
        J = ca.jacobian(rates, x)[:, nq : 2 * nq]
        onwards = ca.vertcat(
            v, kind.zeros(nq, 1), *([1] if clock.shape[0] else [])
        )  # the state's rate while nothing accelerates
        bias = ca.jtimes(rates, x, onwards) if count else rates
        pushed = force + ca.mtimes(J.T, mu)
        kept = ca.mtimes(J, a) + bias
        slopes = ca.jacobian(ca.vertcat(pushed, kept), ca.vertcat(x, u))
        self._places = tuple(
            np.array(entries, dtype=np.intp) for entries in J.sparsity().get_triplet()
        )
        row, column = (
            np.array(entries, dtype=np.intp) for entries in slopes.sparsity().get_triplet()
        )
        self._order = np.lexsort((row, column))  # row by row of the transpose
        pointers = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=nx + model.nu))])
        self._transposed = sp.csr_array(
            (np.zeros(len(row)), row[self._order], pointers), shape=(nx + model.nu, nq + count)
        )
        self._values = ca.Function(
            "values", [x, u], [ca.vec(ca.densify(part)) for part in (force, bias, J.nz[:])]
        )
        self._slopes = ca.Function("slopes", [x, u, mu, a], [ca.vec(ca.densify(slopes.nz[:]))])
        mass = model.mechanism.free_mass
        held = sp.diags_array(
            np.where(mass.diagonal() == 0, mass.diagonal().max(initial=0.0) or 1.0, 0.0)
        )  # nodes without mass are pinned
        self._inverse_mass = block_inverse(mass + held, np.ones(nq, bool))
        parts = separate_parts(self._inverse_mass.toarray())
        self._blocks = (
            [(index, self._inverse_mass[index][:, index].toarray()) for index, _ in parts]
            if len(parts) <= FEW
            else []
        )

    @staticmethod
    def of(model: Model) -> Dynamics:
        """Return the dynamics of a model, which keeps them for each thread: their buffers serve one call at a time."""
        key = "dynamics", threading.get_ident()
        kept: dict[Any, Any] = model.functions
        if key not in kept:
            kept[key] = Dynamics(model)
        known: Dynamics = kept[key]
        return known

    def linearise(self, states: Array, controls: Array) -> Linearised:
        """Return what moves at states (P, nx) under controls (P, nu)."""
        P, nq = len(states), self.model.nq
        forces, bias, entries = ArrayFunction(self._values.map(P))(states, controls)
        accelerations, mu, count = forces @ self._inverse_mass, bias, bias.shape[1]
        weighted, inverse = np.zeros((P, count, nq)), np.zeros((P, count, count))
        if count:
            J = np.zeros((P, count, nq))
            J[:, self._places[0], self._places[1]] = entries
            weighted[:] = (J.reshape(-1, nq) @ self._inverse_mass).reshape(J.shape)
            inverse[:] = _inverted(J @ weighted.transpose(0, 2, 1))
            mu = -_times(inverse, _times(J, accelerations) + bias)
            accelerations = accelerations + _times(weighted.transpose(0, 2, 1), mu)
        (slopes,) = ArrayFunction(self._slopes.map(P))(states, controls, mu, accelerations)
        _, v, clock = self.model.split(states)
        return Linearised(
            np.column_stack([v, accelerations, np.ones_like(clock)]),
            weighted,
            inverse,
            slopes[:, self._order],
        )

    def _accelerated(self, forces: Array) -> Array:
        """Return M⁻¹ forces (nq, m)."""
        if not self._blocks:
            return np.asarray(self._inverse_mass @ forces)
        result = np.empty_like(forces)
        for index, block in self._blocks:
            result[index] = block @ forces[index]
        return result

    def by_control(self, at: Linearised) -> Array:
        """Return the derivatives (P, nq, nu) of the accelerations by the control."""
        model, transposed = self.model, self._transposed
        begin, P = transposed.indptr[model.nx], len(at.rates)
        forces = np.zeros((P, transposed.shape[1], model.nu))
        strings = np.repeat(np.arange(model.nu), np.diff(transposed.indptr[model.nx :]))
        forces[:, transposed.indices[begin:], strings] = at.slopes[:, begin:]
        forces, kept = np.split(forces, [model.nq], axis=1)
        back = at.inverse @ (at.weighted @ forces + kept)
        free = self._accelerated(forces.transpose(1, 0, 2).reshape(model.nq, P * model.nu)).reshape(
            model.nq, P, model.nu
        )
        return np.asarray(free.transpose(1, 0, 2) - at.weighted.transpose(0, 2, 1) @ back)

    def pull(self, at: Linearised, k: int, pulls: Array) -> Array:
        """Return what `pulls` (nx, m) on ẋ at state k are on state and control (nx + nu, m): their product with the derivatives of ẋ."""
        nq = self.model.nq
        on = pulls[nq : 2 * nq]
        back = at.inverse[k] @ (at.weighted[k] @ on)
        self._transposed.data = at.slopes[k]
        result = self._transposed @ np.concatenate(
            [self._accelerated(on) - at.weighted[k].T @ back, -back]
        )
        result[nq : 2 * nq] += pulls[:nq]
        return np.asarray(result)


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _inverted(S: Array) -> Array:
    """Return the inverses of symmetric positive semidefinite S (P, c, c); of those that are singular, as constraints repeat, pseudoinverses."""
    diagonal = np.diagonal(S, axis1=1, axis2=2)
    scale = 1 / np.sqrt(diagonal + 1e-14 * diagonal.sum(axis=1, keepdims=True))
    scales = scale[:, :, None] * scale[:, None, :]
    eye = np.eye(S.shape[1])
    inverse = np.linalg.inv(S * scales + REGULARISATION * eye)
    regular = ~(
        np.diagonal(inverse, axis1=1, axis2=2).max(axis=1) >= REDUNDANT
    )  # also where nothing is a number
    rough = inverse[regular]
    for _ in range(REFINEMENTS):
        inverse[regular] += rough @ (eye - (S * scales)[regular] @ inverse[regular])
    inverse[~regular] = np.linalg.pinv((S * scales)[~regular], rcond=REGULARISATION, hermitian=True)
    return np.asarray(inverse * scales)
