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


class _Sensitivity(NamedTuple):
    """Derivatives of z = (q, ν) by p, transposed: `plain` of q and ν at the start in closed form, and `moved` (K, np, ·) by the α before.

    moved: of the last entries of z alone where the first ones do not depend on an α. passed: steps since the start.
    """

    moved: Array
    passed: float

    def through(self, matrix: Array, rest: Array) -> Array:
        """Return Dᵀ matrix (K, np, n), D (ny, np) the derivatives of y, of a matrix (K, ny, n); rest (nr, ·): D of what follows z in y."""
        width = self.moved.shape[2]
        count, _, columns = matrix.shape
        half = (matrix.shape[1] - len(rest)) // 2
        result: Array
        if width:
            result = np.matmul(self.moved, matrix[:, 2 * half - width : 2 * half])
        else:
            result = np.zeros((count, 2 * half + rest.shape[1], columns))
        result[:, :half] += matrix[:, :half]
        result[:, half : 2 * half] += matrix[:, half : 2 * half]
        result[:, half : 2 * half] += self.passed * matrix[:, :half]
        result[:, 2 * half :] += np.matmul(rest.T, matrix[:, 2 * half :])
        return result

    def add_times(self, S: Array, factor: Array) -> None:
        """Add factor (K, np, 2nq) times D's rows of z to S (K, np, np)."""
        width, half = self.moved.shape[2], factor.shape[2] // 2
        if width:
            S += np.matmul(factor[:, :, 2 * half - width :], self.moved.transpose(0, 2, 1))
        S[:, :, : 2 * half] += factor
        S[:, :, half : 2 * half] += self.passed * factor[:, :, :half]


@dataclass(eq=False)
class _Stage:
    """One stage of one step: its state's sensitivity, its α's slopes; `rest`: see `_Sensitivity.through`."""

    state: _Sensitivity
    rest: Array
    slopes: Slopes


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
        self._last: tuple[tuple[Array, ...], _Motion] | None = None

    def jacobian(self, x: Array, controls: Array, duration: Array, share: Array) -> Array:
        """Return the Jacobian of the end by (x, c[, T]), transposed (K, size, nx), at x (K, nx), c (K, ·), T and its share (K, 1)."""
        now = self._linearised(x, controls, duration, share)
        J = now.end.state.through(now.end.slopes.jacobian, now.end.rest)
        self._by_velocity(J, now, share)
        return J

    def hessian(self, x: Array, controls: Array, duration: Array, share: Array, weights: Array) -> Array:
        """Return the Hessian (K, size, size) of the sums of weights (K, nx) times the end."""
        now, nq = self._linearised(x, controls, duration, share), self._nq
        S = np.zeros((self._count, self.size, self.size))  # half of the matrix
        gradient = self._pulled(now.end, weights, self._end.half(now.end.slopes, weights), S)
        for stages in reversed(now.steps):
            gradient = self._backwards(gradient, stages, S)
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
        method, nq, count = self._method, self._nq, self._count
        stages = len(method.b)
        h = duration * share / self._substeps
        q, nu, t = x[:, :nq], h * x[:, nq : 2 * nq], x[:, 2 * nq :]
        moved = np.zeros((count, self.size, 0))
        steps = []
        for step in range(self._substeps):
            alphas, values = np.empty((count, self.size, stages * nq)), np.empty((count, stages * nq))
            own: list[_Stage] = []
            for i in range(stages):
                passed = step + method.c[i]
                state = _Sensitivity(_advanced(moved, alphas, method.c[i], method.a_bar[i, :i], method.a[i, :i], nq), passed)
                q_i = q + method.c[i] * nu + _sum(values, method.a_bar[i, :i], nq)
                nu_i = nu + _sum(values, method.a[i, :i], nq)
                slopes = self._stage.at(np.hstack([q_i, nu_i, t + method.c[i] * h, self._held(controls, passed), h]))
                own.append(_Stage(state, self._rest(passed), slopes))
                alphas[:, :, i * nq : (i + 1) * nq] = state.through(slopes.jacobian, own[-1].rest)
                values[:, i * nq : (i + 1) * nq] = slopes.value
            steps.append(own)
            moved = _advanced(moved, alphas, 1.0, method.b_bar, method.b, nq)
            q, nu, t = q + nu + _sum(values, method.b_bar, nq), nu + _sum(values, method.b, nq), t + h
        passed = float(self._substeps)
        slopes = self._end.at(np.hstack([q, nu, t, self._held(controls, passed), h]))
        return _Motion(h, x[:, nq : 2 * nq], steps, _Stage(_Sensitivity(moved, passed), self._rest(passed), slopes))

    def _backwards(self, after: Array, stages: list[_Stage], S: Array) -> Array:
        """Return the gradient by z before a step from that by z after it, and add half of the Hessians of the stages to S."""
        method, nq = self._method, self._nq
        pulled: list[Array] = [after] * len(stages)
        for i in reversed(range(len(stages))):
            adjoint = method.b_bar[i] * after[:, :nq] + method.b[i] * after[:, nq:]
            for k in range(i + 1, len(stages)):
                adjoint = adjoint + method.a_bar[k, i] * pulled[k][:, :nq] + method.a[k, i] * pulled[k][:, nq:]
            pulled[i] = self._pulled(stages[i], adjoint, self._stage.half(stages[i].slopes, adjoint), S)
        gradient = after + sum(pulled)
        gradient[:, nq:] += after[:, :nq] + sum(c * own[:, :nq] for c, own in zip(method.c, pulled, strict=True))
        return gradient

    def _pulled(self, stage: _Stage, weights: Array, half: Array, S: Array) -> Array:
        """Return the gradient (K, 2nq) by z of weights times a stage's function, and add DᵀLD to S."""
        z = 2 * self._nq
        stage.state.add_times(S, stage.state.through(half[:, :, :z], stage.rest))  # (L D)ᵀ D
        S[:, z:, z:] += np.matmul(np.matmul(stage.rest.T, half[:, z:, z:]), stage.rest)
        gradient: Array = np.matmul(stage.slopes.jacobian[:, :z], weights[:, :, None])[:, :, 0]
        return gradient

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


def _advanced(moved: Array, alphas: Array, passed: float, to_q: Array, to_v: Array, nq: int) -> Array:
    """Return the part of ∂z/∂p by the α at a later stage or step, as `_Sensitivity.moved` has it."""
    if not (to_v.any() or moved.shape[2]):
        return moved
    if not (to_q.any() or moved.shape[2]):
        return _sum(alphas, to_v, nq)
    result = np.empty((*alphas.shape[:2], 2 * nq))
    result[:, :, :nq], result[:, :, nq:] = _sum(alphas, to_q, nq), _sum(alphas, to_v, nq)
    width = moved.shape[2]
    if width:
        result[:, :, 2 * nq - width :] += moved
        result[:, :, :nq] += passed * moved[:, :, width - nq :]
    return result


def _sum(values: Array, weights: Array, nq: int) -> Array:
    """Return the sum of weights times blocks of nq columns (the last axis)."""
    used = np.flatnonzero(weights)
    result = np.zeros((*values.shape[:-1], nq)) if not used.size else weights[used[0]] * values[..., used[0] * nq : (used[0] + 1) * nq]
    for k in used[1:]:
        result += weights[k] * values[..., k * nq : (k + 1) * nq]
    return result
