"""First and second derivatives of the steps of an interval, put together from those of their stages by products of matrices.

With D_i the derivatives of stage i's state by what the interval starts from, and μ_i the adjoint of
its acceleration, the Hessian of μᵀΦ is Σ D_iᵀ ∇²(μ_iᵀ α) D_i: only the acceleration α of one stage
is differentiated as an expression. All intervals are done at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ocp.transcription.stage_functions import Places, Slopes, end_curve, stage_curve
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta, select_stages
from tenscasadi.util.validate import Array

NEWTON = 30  # most iterations for the stages of implicit steps
ROUNDING = 1e-13  # of the stages' α


class Nystrom(NamedTuple):
    """A method for second-order equations: q_i = q + c_i ν + Σ ā_ij α_j and ν_i = ν + Σ a_ij α_j, and after the step the same with 1, b̄ and b."""

    c: Array
    a: Array
    a_bar: Array
    b: Array
    b_bar: Array

    @classmethod
    def of(cls, scheme: ExplicitRungeKutta | Collocation) -> Nystrom:
        """Return that of a Runge-Kutta method (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, (II.14.13))."""
        if isinstance(scheme, Collocation):
            a, b = scheme.coefficients
        else:
            tableau = scheme.tableau
            kept, s = sorted(select_stages(tableau)), len(tableau.b)
            a = np.array([[*row, *[0.0] * (s - len(row))] for row in tableau.a]).reshape(s, s)[
                np.ix_(kept, kept)
            ]
            b = np.array(tableau.b)[kept]
        return cls(a.sum(axis=1), a, a @ a, b, b @ a)

    @property
    def implicit(self) -> bool:
        """Whether stages depend on themselves or later ones. The first stage of others stands at the start."""
        return bool(np.triu(self.a).any())


@dataclass(eq=False)
class _Stage:
    """A function of y = (z, …), z = (q, ν), at one stage, or at the end.

    sensitivity: ∂z/∂p (K, np, 2nq), transposed; None at the start, where z is the head of p. rest
    (ny − 2nq, np − 2nq): ∂y/∂p of all that follows z in y, by all that follows z in p.
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
class _Step:
    """The stages of a step, and their α (K, s·nq) with ∂α/∂p (K, np, s·nq), transposed.

    inverse: None, or (I − ∂α/∂α)⁻¹ (K, s·nq, s·nq), transposed, of the equations α_i = α(z_i) of
    implicit methods.
    """

    stages: list[_Stage]
    values: Array
    alphas: Array
    inverse: Array | None = None


@dataclass(eq=False)
class _Motion:
    """The intervals at one point: steps and the end. h, v (K, ·): step, first velocities."""

    h: Array
    v: Array
    steps: list[_Step]
    end: _Stage


class _Start(NamedTuple):
    """Where a step starts: z = (q, ν), clock, controls and h of the intervals, steps before, and ∂z/∂p, None at the first."""

    q: Array
    nu: Array
    t: Array
    controls: Array
    h: Array
    passed: int
    before: Array | None


class StepDerivatives:
    """Derivatives of steps and a projection, from (x, c, T) to the state at the end, for `count` intervals at once.

    groups (α, m): force densities are groups · w. linear: w runs from c₀ to c₁ within the interval,
    c = (c₀, c₁); else w = c. free_time: whether derivatives by the duration T are wanted too.
    """

    def __init__(
        self,
        model: Model,
        groups: Array,
        scheme: ExplicitRungeKutta | Collocation,
        substeps: int,
        linear: bool,
        free_time: bool,
        count: int,
    ) -> None:
        self._nq, self._count, self._substeps, self._free_time = (
            model.nq,
            count,
            substeps,
            free_time,
        )
        self._clock, self._controls, self._linear = (
            int(model.scene.has_clock),
            groups.shape[1],
            linear,
        )
        self._method = Nystrom.of(scheme)
        places = Places(model.nq, model.scene.has_clock, self._controls, free_time)
        self._stage, self._end = (
            stage_curve(model, groups, places, count),
            end_curve(model, places, count),
        )
        # p = (q, ν, t, c, h), in which and in the α all states are linear
        self.size = model.nx + self._controls * (1 + linear) + free_time
        # room for ∂z/∂p in the states of each step, of explicit methods behind the first stage; and
        # for half of H times it
        self._first = 0 if self._method.implicit else 1
        self._room = np.empty(
            (substeps, count, self.size, len(self._method.b) + 1 - self._first, 2 * model.nq)
        )
        self._products = np.empty(self._room.shape[1:])
        self._last: tuple[tuple[Array, ...], _Motion] | None = None

    def jacobian(
        self, x: Array, controls: Array, duration: Array, share: Array, out: Array | None = None
    ) -> Array:
        """Return the Jacobian of the end by (x, c[, T]), transposed (K, size, nx), at x (K, nx), c (K, ·), T and its share (K, 1)."""
        now = self._linearised(x, controls, duration, share)
        J = now.end.through(now.end.slopes.jacobian, out)
        self._by_velocity(J, now, share)
        return J

    def hessian(
        self, x: Array, controls: Array, duration: Array, share: Array, weights: Array
    ) -> Array:
        """Return the Hessian (K, size, size) of the sums of weights (K, nx) times the end."""
        now, nq = self._linearised(x, controls, duration, share), self._nq
        S = np.zeros((self._count, self.size, self.size))  # half of the matrix
        gradient, stage, half = (
            now.end.gradient(weights),
            now.end,
            self._end.half(now.end.slopes, weights),
        )
        wide = self._count, self.size, -1
        for step, room in zip(reversed(now.steps), self._room[::-1], strict=True):
            if self._method.implicit and step is not now.steps[-1]:
                self._products[:, :, -1] = 0.0  # no stage stands where the step ends
            else:
                self._add_rest(S, stage, half)
                stage.through(half[:, :, : 2 * nq], self._products[:, :, -1])
            gradient, half = self._backwards(gradient, step, S)
            stage = step.stages[0]
            S += np.matmul(self._products.reshape(wide), room.reshape(wide).transpose(0, 2, 1))
        if not self._method.implicit:
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
        if self._last is None or not all(
            np.array_equal(old, new) for old, new in zip(self._last[0], inputs, strict=True)
        ):
            copies = tuple(
                np.array(value) for value in inputs
            )  # what comes in may be a solver's memory
            self._last = copies, self._forwards(*copies)
        return self._last[1]

    def _forwards(self, x: Array, controls: Array, duration: Array, share: Array) -> _Motion:
        method, nq = self._method, self._nq
        h = duration * share / self._substeps
        q, nu, t = x[:, :nq], h * x[:, nq : 2 * nq], x[:, 2 * nq :]
        before: Array | None = None
        steps = []
        for passed, room in enumerate(self._room):
            start = _Start(q, nu, t, controls, h, passed, before)
            steps.append(
                self._implicit(start, room) if method.implicit else self._explicit(start, room)
            )
            values = steps[-1].values
            before = _advanced(
                before, steps[-1].alphas, 1.0, method.b_bar, method.b, room[:, :, -1]
            )
            q, nu, t = (
                q + nu + _sum(values, method.b_bar, nq),
                nu + _sum(values, method.b, nq),
                t + h,
            )
        slopes = self._end.at(np.hstack([q, nu, t, self._held(controls, self._substeps), h]))
        return _Motion(
            h, x[:, nq : 2 * nq], steps, _Stage(before, self._rest(self._substeps), slopes)
        )

    def _explicit(self, start: _Start, room: Array) -> _Step:
        """Go from stage to stage."""
        method, nq, count = self._method, self._nq, len(self._method.b)
        values, alphas = (
            np.zeros((self._count, count * nq)),
            np.empty((self._count, self.size, count * nq)),
        )
        stages = []
        for i, c in enumerate(method.c):
            slopes = self._stage_at(start, values, i)
            D = (
                start.before
                if i == 0
                else _advanced(
                    start.before, alphas, c, method.a_bar[i, :i], method.a[i, :i], room[:, :, i - 1]
                )
            )
            stages.append(_Stage(D, self._rest(start.passed + c), slopes))
            alphas[:, :, i * nq : (i + 1) * nq] = stages[-1].through(slopes.jacobian)
            values[:, i * nq : (i + 1) * nq] = slopes.value
        return _Step(stages, values, alphas)

    def _implicit(self, start: _Start, room: Array) -> _Step:
        """Find all stages at once by Newton's method."""
        method, nq, count = self._method, self._nq, len(self._method.b)
        values = np.tile(self._stage_at(start, np.zeros((self._count, count * nq)), 0).value, count)
        for _ in range(NEWTON):
            slopes = [self._stage_at(start, values, i) for i in range(count)]
            by_alpha = np.empty((self._count, count, nq, count, nq))
            for j in range(count):
                for i, own in enumerate(slopes):
                    by_alpha[:, j, :, i] = (
                        method.a_bar[i, j] * own.jacobian[:, :nq]
                        + method.a[i, j] * own.jacobian[:, nq : 2 * nq]
                    )
            inverse: Any = np.linalg.inv(
                np.eye(count * nq) - by_alpha.reshape(self._count, count * nq, count * nq)
            )
            change = np.matmul(
                (np.hstack([own.value for own in slopes]) - values)[:, None], inverse
            )[:, 0]
            if not np.abs(change).max() > ROUNDING * np.abs(values).max():
                break
            values = values + change
        rests = [self._rest(start.passed + c) for c in method.c]
        alphas = np.zeros((self._count, self.size, count * nq))
        none = np.zeros(count)
        held = [
            _Stage(
                _advanced(start.before, alphas, c, none, none, room[:, :, i]), rests[i], slopes[i]
            )
            for i, c in enumerate(method.c)
        ]
        alphas = np.matmul(
            np.concatenate([stage.through(stage.slopes.jacobian) for stage in held], axis=2),
            inverse,
        )
        for i, c in enumerate(method.c):
            _advanced(start.before, alphas, c, method.a_bar[i], method.a[i], room[:, :, i])
        return _Step(held, values, alphas, inverse)

    def _stage_at(self, start: _Start, values: Array, i: int) -> Slopes:
        """Evaluate stage i where the α of all are values (K, s·nq)."""
        method, nq, c = self._method, self._nq, self._method.c[i]
        q, nu = (
            start.q + c * start.nu + _sum(values, method.a_bar[i], nq),
            start.nu + _sum(values, method.a[i], nq),
        )
        return self._stage.at(
            np.hstack(
                [
                    q,
                    nu,
                    start.t + c * start.h,
                    self._held(start.controls, start.passed + c),
                    start.h,
                ]
            )
        )

    def _backwards(self, after: Array, step: _Step, S: Array) -> tuple[Array, Array]:
        """Return the gradient by z before a step from that by z after it, and half of the first stage's Hessian; the others' go to `products`."""
        method, nq, count = self._method, self._nq, len(self._method.b)
        pulled, half = [np.zeros_like(after)] * count, after
        asked = [
            method.b_bar[i] * after[:, :nq] + method.b[i] * after[:, nq:] for i in range(count)
        ]
        if step.inverse is not None:
            asked = np.split(
                np.matmul(step.inverse, np.hstack(asked)[:, :, None])[:, :, 0], count, axis=1
            )
        for i in reversed(range(count)):
            stage, adjoint = step.stages[i], asked[i]
            for k in range(i + 1, count) if step.inverse is None else ():
                adjoint = (
                    adjoint
                    + method.a_bar[k, i] * pulled[k][:, :nq]
                    + method.a[k, i] * pulled[k][:, nq:]
                )
            pulled[i], half = stage.gradient(adjoint), self._stage.half(stage.slopes, adjoint)
            if i >= self._first:
                self._add_rest(S, stage, half)
                stage.through(half[:, :, : 2 * nq], self._products[:, :, i - self._first])
        gradient = after + sum(pulled)
        gradient[:, nq:] += after[:, :nq] + sum(
            c * own[:, :nq] for c, own in zip(method.c, pulled, strict=True)
        )
        return gradient, half

    def _add_rest(self, S: Array, stage: _Stage, half: Array) -> None:
        """Add half of the Hessian by all that follows z."""
        z = 2 * self._nq
        S[:, z:, z:] += np.matmul(np.matmul(stage.rest.T, half[:, z:, z:]), stage.rest)

    def _held(self, controls: Array, passed: float) -> Array:
        share = passed / self._substeps
        return (
            (1 - share) * controls[:, : self._controls] + share * controls[:, self._controls :]
            if self._linear
            else controls
        )

    def _rest(self, passed: float) -> Array:
        """∂(t, w[, h])/∂(t, c[, h])."""
        m, clock, share = self._controls, self._clock, passed / self._substeps
        columns = self.size - 2 * self._nq
        rest = np.zeros((clock + m + self._free_time, columns))
        rest[:clock, :clock] = 1.0
        rest[clock : clock + m, clock : clock + m] = (1 - share if self._linear else 1.0) * np.eye(
            m
        )
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


def _advanced(
    before: Array | None, alphas: Array, passed: float, to_q: Array, to_v: Array, out: Array
) -> Array:
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
    result = (
        np.zeros((*values.shape[:-1], nq))
        if not used.size
        else weights[used[0]] * values[..., used[0] * nq : (used[0] + 1) * nq]
    )
    for k in used[1:]:
        result += weights[k] * values[..., k * nq : (k + 1) * nq]
    return result
