"""First and second derivatives of the steps of an interval, put together from those of their stages by products of matrices.

With D_i the derivatives of stage i's state by what the interval starts from, and μ_i the adjoint of its acceleration, the Hessian of μᵀΦ is
Σ D_iᵀ ∇²(μ_iᵀ α) D_i: only the acceleration α of one stage is differentiated as an expression. All intervals are done at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ocp.transcription.stage_functions import Places, Slopes, end_curve, stage_curve
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import needed_stages
from tenscasadi.integrators.tableaux import Tableau
from tenscasadi.util.validate import Array


class Nystrom(NamedTuple):
    """A method for second-order equations: q_i = q + c_i ν + Σ ā_ij α_j and ν_i = ν + Σ a_ij α_j, and after the step the same with 1, b̄ and b."""

    c: Array
    a: Array
    a_bar: Array
    b: Array
    b_bar: Array

    @classmethod
    def of(cls, tableau: Tableau) -> Nystrom:
        """Return that of a Runge-Kutta method (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, (II.14.13))."""
        kept, s = sorted(needed_stages(tableau)), len(tableau.b)
        a = np.array([[*row, *[0.0] * (s - len(row))] for row in tableau.a]).reshape(s, s)[np.ix_(kept, kept)]
        b = np.array(tableau.b)[kept]
        return cls(a.sum(axis=1), a, a @ a, b, b @ a)


@dataclass(eq=False)
class _Stage:
    """A function of y = (z, …), z = (q, ν), at one stage, or at the end.

    sensitivity: ∂z/∂p (K, np, 2nq), transposed; None at the start, where z is the head of p. rest (ny − 2nq, np − 2nq): ∂y/∂p of all that
    follows z in y, by all that follows z in p.
    """

    sensitivity: Array | None
    rest: Array
    slopes: Slopes

    def through(self, matrix: Array, out: Array | None = None) -> Array:
        """Return Dᵀ matrix (K, np, n) of a matrix (K, ny, n), with D = ∂y/∂p."""
        z = matrix.shape[1] - len(self.rest)
        if self.sensitivity is None:
            result = np.zeros((len(matrix), z + self.rest.shape[1], matrix.shape[2]))
            result[:, :z] = matrix[:, :z]
        else:
            result = np.matmul(self.sensitivity, matrix[:, :z], out=out)
        result[:, z:] += np.matmul(self.rest.T, matrix[:, z:])
        return result

    def gradient(self, weights: Array) -> Array:
        """Return the derivatives (K, 2nq) by z of the sum of weights times the function."""
        z = self.slopes.jacobian.shape[1] - len(self.rest)
        result: Array = np.matmul(self.slopes.jacobian[:, :z], weights[:, :, None])[:, :, 0]
        return result


@dataclass(eq=False)
class _Motion:
    """The intervals at one point: steps, each its stages, and the end. h, v (K, ·): step, first velocities."""

    h: Array
    v: Array
    steps: list[list[_Stage]]
    end: _Stage


class StepDerivatives:
    """Derivatives of explicit steps and a projection, from (x, c, T) to the state at the end, for `count` intervals at once.

    groups (α, m): force densities are groups · w. linear: w runs from c₀ to c₁ within the interval, c = (c₀, c₁); else w = c.
    free_time: whether derivatives by the duration T are wanted too.
    """

    def __init__(self, model: Model, groups: Array, tableau: Tableau, substeps: int, linear: bool, free_time: bool, count: int) -> None:
        self._nq, self._count, self._substeps, self._free_time = model.nq, count, substeps, free_time
        self._clock, self._controls, self._linear = int(model.scene.has_clock), groups.shape[1], linear
        self._method = Nystrom.of(tableau)
        places = Places(model.nq, model.scene.has_clock, self._controls, free_time)
        self._stage, self._end = stage_curve(model, groups, places, count), end_curve(model, places, count)
        # p = (q, ν, t, c, h), in which and in the α all states are linear
        self.size = model.nx + self._controls * (1 + linear) + free_time
        # room for ∂z/∂p in the states of each step behind its first stage, which stands where the step before ends; and for half of H times it
        self._room = np.empty((substeps, count, self.size, len(self._method.b), 2 * model.nq))
        self._products = np.empty(self._room.shape[1:])
        self._last: tuple[tuple[Array, ...], _Motion] | None = None

    def jacobian(self, x: Array, controls: Array, duration: Array, share: Array, out: Array | None = None) -> Array:
        """Return the Jacobian of the end by (x, c[, T]), transposed (K, size, nx), at x (K, nx), c (K, ·), T and its share (K, 1)."""
        now = self._linearised(x, controls, duration, share)
        J = now.end.through(now.end.slopes.jacobian, out)
        self._by_velocity(J, now, share)
        return J

    def hessian(self, x: Array, controls: Array, duration: Array, share: Array, weights: Array) -> Array:
        """Return the Hessian (K, size, size) of the sums of weights (K, nx) times the end."""
        now, nq = self._linearised(x, controls, duration, share), self._nq
        S = np.zeros((self._count, self.size, self.size))  # half of the matrix
        gradient, stage, half = now.end.gradient(weights), now.end, self._end.half(now.end.slopes, weights)
        for stages, room in zip(reversed(now.steps), self._room[::-1], strict=True):
            self._add_rest(S, stage, half)
            stage.through(half[:, :, : 2 * nq], self._products[:, :, -1])
            gradient, half = self._backwards(gradient, stages, S)
            stage, wide = stages[0], (self._count, self.size, -1)
            S += np.matmul(self._products.reshape(wide), room.reshape(wide).transpose(0, 2, 1))
        self._add_rest(S, stage, half)
        S[:, :, : 2 * nq] += stage.through(half[:, :, : 2 * nq])
        H = S + S.transpose(0, 2, 1)
        self._by_velocity(H, now, share)
        self._by_velocity(H.transpose(0, 2, 1), now, share)
        if self._free_time:
            mixed = gradient[:, nq:] * share / self._substeps  # of ν = h v
            H[:, nq : 2 * nq, -1] += mixed
            H[:, -1, nq : 2 * nq] += mixed
        return H

    def _linearised(self, *inputs: Array) -> _Motion:
        """Return the motion at a point, kept for the Hessian that solvers ask for after the Jacobian."""
        if self._last is None or not all(np.array_equal(old, new) for old, new in zip(self._last[0], inputs, strict=True)):
            copies = tuple(np.array(value) for value in inputs)  # what comes in may be a solver's memory
            self._last = copies, self._forwards(*copies)
        return self._last[1]

    def _forwards(self, x: Array, controls: Array, duration: Array, share: Array) -> _Motion:
        method, nq = self._method, self._nq
        h = duration * share / self._substeps
        q, nu, t = x[:, :nq], h * x[:, nq : 2 * nq], x[:, 2 * nq :]
        before: Array | None = None
        steps = []
        for step, room in enumerate(self._room):
            alphas, values = np.empty((self._count, self.size, len(method.b) * nq)), np.empty((self._count, len(method.b) * nq))
            own: list[_Stage] = []
            for i, c in enumerate(method.c):
                passed = step + c
                D = before if i == 0 else _advanced(before, alphas, c, method.a_bar[i, :i], method.a[i, :i], room[:, :, i - 1])
                q_i, nu_i = q + c * nu + _sum(values, method.a_bar[i, :i], nq), nu + _sum(values, method.a[i, :i], nq)
                slopes = self._stage.at(np.hstack([q_i, nu_i, t + c * h, self._held(controls, passed), h]))
                own.append(_Stage(D, self._rest(passed), slopes))
                alphas[:, :, i * nq : (i + 1) * nq] = own[-1].through(slopes.jacobian)
                values[:, i * nq : (i + 1) * nq] = slopes.value
            steps.append(own)
            before = _advanced(before, alphas, 1.0, method.b_bar, method.b, room[:, :, -1])
            q, nu, t = q + nu + _sum(values, method.b_bar, nq), nu + _sum(values, method.b, nq), t + h
        slopes = self._end.at(np.hstack([q, nu, t, self._held(controls, self._substeps), h]))
        return _Motion(h, x[:, nq : 2 * nq], steps, _Stage(before, self._rest(self._substeps), slopes))

    def _backwards(self, after: Array, stages: list[_Stage], S: Array) -> tuple[Array, Array]:
        """Return the gradient by z before a step from that by z after it, and half of the first stage's Hessian; the others' go to `products`."""
        method, nq = self._method, self._nq
        pulled, half = [after] * len(stages), after
        for i in reversed(range(len(stages))):
            adjoint = method.b_bar[i] * after[:, :nq] + method.b[i] * after[:, nq:]
            for k in range(i + 1, len(stages)):
                adjoint = adjoint + method.a_bar[k, i] * pulled[k][:, :nq] + method.a[k, i] * pulled[k][:, nq:]
            pulled[i], half = stages[i].gradient(adjoint), self._stage.half(stages[i].slopes, adjoint)
            if i:
                self._add_rest(S, stages[i], half)
                stages[i].through(half[:, :, : 2 * nq], self._products[:, :, i - 1])
        gradient = after + sum(pulled)
        gradient[:, nq:] += after[:, :nq] + sum(c * own[:, :nq] for c, own in zip(method.c, pulled, strict=True))
        return gradient, half

    def _add_rest(self, S: Array, stage: _Stage, half: Array) -> None:
        """Add half of the Hessian by all that follows z."""
        z = 2 * self._nq
        S[:, z:, z:] += np.matmul(np.matmul(stage.rest.T, half[:, z:, z:]), stage.rest)

    def _held(self, controls: Array, passed: float) -> Array:
        share = passed / self._substeps
        return (1 - share) * controls[:, : self._controls] + share * controls[:, self._controls :] if self._linear else controls

    def _rest(self, passed: float) -> Array:
        """∂(t, w[, h])/∂(t, c[, h])."""
        m, clock, share = self._controls, self._clock, passed / self._substeps
        columns = self.size - 2 * self._nq
        rest = np.zeros((clock + m + self._free_time, columns))
        rest[:clock, :clock] = 1.0
        rest[clock : clock + m, clock : clock + m] = (1 - share if self._linear else 1.0) * np.eye(m)
        if self._linear:
            rest[clock : clock + m, clock + m : clock + 2 * m] = share * np.eye(m)
        if self._free_time:
            rest[:clock, -1], rest[-1, -1] = passed, 1.0
        return rest

    def _by_velocity(self, rows: Array, now: _Motion, share: Array) -> None:
        """Turn derivatives by ν and h, rows of arrays (K, size, …), into those by v and T, in place: ν = h v, h = T share / substeps."""
        own = rows[:, self._nq : 2 * self._nq]
        if self._free_time:
            rows[:, -1] += np.matmul(now.v[:, None], own)[:, 0]
            rows[:, -1] *= share / self._substeps
        own *= now.h[:, :, None]


def _advanced(before: Array | None, alphas: Array, passed: float, to_q: Array, to_v: Array, out: Array) -> Array:
    """Write ∂z/∂p at a later stage or step to out (K, np, 2nq): z advances by the α, q by what `passed` and ν make too."""
    nq = out.shape[2] // 2
    q, v = out[:, :, :nq], out[:, :, nq:]
    q[:], v[:] = _sum(alphas, to_q, nq), _sum(alphas, to_v, nq)
    if before is None:
        k = np.arange(nq)
        out[:, k, k] += 1.0
        out[:, nq + k, k] += passed
        out[:, nq + k, nq + k] += 1.0
    else:
        out += before
        q += passed * before[:, :, nq:]
    return out


def _sum(values: Array, weights: Array, nq: int) -> Array:
    """Return the sum of weights times blocks of nq columns (the last axis)."""
    used = np.flatnonzero(weights)
    result = np.zeros((*values.shape[:-1], nq)) if not used.size else weights[used[0]] * values[..., used[0] * nq : (used[0] + 1) * nq]
    for k in used[1:]:
        result += weights[k] * values[..., k * nq : (k + 1) * nq]
    return result
