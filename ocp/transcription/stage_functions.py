"""The acceleration of one stage of a step, and its first and second derivatives, as small Functions of many intervals at once.

In scaled variables ν = h v and α = h² a the states of all stages and steps of an interval are
linear in what it starts from and in the α. Only α itself is expression code; λ̂ and Ω are unknowns
of their own in it, found and differentiated by linear algebra: no factorisation is unrolled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.constraint_forces import (
    assemble_system,
    nodal_forces,
    recover_multipliers,
    residual_rates,
    residuals,
)
from tenscasadi.dynamics.equation_of_motion import lifted_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.casadi_tools import ArrayFunction, sparse
from tenscasadi.util.linear_algebra import semidefinite_inverse
from tenscasadi.util.validate import Array


class Slopes(NamedTuple):
    """A function of y at K points and its first derivatives: value (K, n), jacobian (K, ny, n), transposed.

    carried: None, or what `Curve.half` needs of them again.
    """

    value: Array
    jacobian: Array
    carried: Any = None


class Places(NamedTuple):
    """Where the entries of y = (z, t, w, h) stand, z = (q, ν): the clock t is there where the model has one, h where the duration is free."""

    nq: int
    clock: bool
    controls: int
    free_time: bool

    @property
    def z(self) -> slice:
        """Positions and scaled velocities."""
        return slice(2 * self.nq)

    @property
    def clocks(self) -> slice:
        """The clock."""
        return slice(2 * self.nq, 2 * self.nq + self.clock)

    @property
    def w(self) -> slice:
        """Force densities of the groups."""
        return slice(self.clocks.stop, self.clocks.stop + self.controls)

    @property
    def h(self) -> slice:
        """Length of the step."""
        return slice(self.w.stop, self.w.stop + self.free_time)

    @property
    def size(self) -> int:
        """Of y."""
        return 2 * self.nq + self.clock + self.controls + self.free_time

    def symbols(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Return y, q, ν, t, w and h; where h is no part of y, a symbol below it."""
        q, nu, t, w, h = (
            ca.SX.sym(*entry)
            for entry in (
                ("q", self.nq),
                ("nu", self.nq),
                ("t", self.clock),
                ("w", self.controls),
                ("h", 1),
            )
        )
        return ca.vertcat(q, nu, t, w, h), q, nu, t, w, h


class Curve:
    """A function f(y, s) with s that solves S(y) s = b(y), s without entries where there is nothing to solve; f is affine in s.

    inputs: y, with h below where it is no part of y.
    """

    def __init__(
        self, count: int, places: Places, inputs: Any, f: Any, s: Any, S: Any, b: Any
    ) -> None:
        self._places, self._solved = places, s.shape[0]
        y = inputs[: places.size]
        rest = ca.densify(ca.mtimes(S, s) - b) if self._solved else ca.SX(0, 1)
        dense = [f, ca.jacobian(f, y), ca.jacobian(f, s), ca.jacobian(rest, y)]
        self._first = _mapped(count, [inputs, s], dense)
        if self._solved:
            self._system = _mapped(count, [inputs], [S, b])
            self._inverse = _diagonal_inverse if S.sparsity().is_diag() else semidefinite_inverse
        weights, others = ca.SX.sym("weights", f.shape[0]), ca.SX.sym("others", self._solved)
        H = ca.hessian(ca.dot(weights, f) + ca.dot(others, rest), ca.vertcat(y, s))[0]
        z, r, after = places.z.stop, places.size, H.shape[0]
        # of the symmetric matrix as much as makes it whole with its transpose: triangles, and
        # blocks above the diagonal
        half = ca.vertcat(
            ca.horzcat(_triangle(H[:z, :z]), H[:z, z:r]),
            ca.horzcat(ca.SX(r - z, z), _triangle(H[z:r, z:r])),
        )
        self._second = _mapped(count, [inputs, s, weights, others], [half, H[:r, r:after]])

    def at(self, inputs: Array) -> Slopes:
        """Return the function and its slopes at inputs (K, …)."""
        if not self._solved:
            value, slopes, _, _ = self._first(inputs, np.zeros((len(inputs), 0)))
            return Slopes(
                value[:, 0], slopes, (inputs, np.zeros((len(inputs), 0)), None, None, None)
            )
        S, b = self._system(inputs)
        inverse = self._inverse(S)
        s = np.matmul(b, inverse)[:, 0]
        value, slopes, by_s, rest = self._first(inputs, s)
        moved = -np.matmul(rest, inverse)  # ∂s/∂y, transposed
        return Slopes(
            value[:, 0], slopes + np.matmul(moved, by_s), (inputs, s, inverse, by_s, moved)
        )

    def half(self, slopes: Slopes, weights: Array) -> Array:
        """Return L (K, ny, ny), with L + Lᵀ the Hessian of weightsᵀ f, without entries below its blocks (z, z) and (r, r); transposed."""
        inputs, s, inverse, by_s, moved = slopes.carried
        if not self._solved:
            return self._second(inputs, s, weights, s)[0]
        others = -np.matmul(np.matmul(by_s, weights[:, :, None]).transpose(0, 2, 1), inverse)[:, 0]
        half, mixed = self._second(inputs, s, weights, others)
        return _folded(half + np.matmul(moved, mixed), self._places.z.stop)


class Chain:
    """One curve after the other: the first's values are the second's inputs."""

    def __init__(self, first: Curve, second: Curve, z: int) -> None:
        self._first, self._second, self._z = first, second, z

    def at(self, inputs: Array) -> Slopes:
        """Return the function and its slopes at inputs (K, …)."""
        one = self._first.at(inputs)
        step = np.ones(
            (len(inputs), 1)
        )  # no part of the second curve, whose variables are not scaled
        two = self._second.at(np.hstack([one.value, step]))
        return Slopes(two.value, np.matmul(one.jacobian, two.jacobian), (one, two))

    def half(self, slopes: Slopes, weights: Array) -> Array:
        """Return L as `Curve.half` does."""
        one, two = slopes.carried
        half = self._first.half(one, np.matmul(two.jacobian, weights[:, :, None])[:, :, 0])
        inner = np.matmul(one.jacobian, self._second.half(two, weights))
        return _folded(half + np.matmul(inner, one.jacobian.transpose(0, 2, 1)), self._z)


def stage_curve(model: Model, groups: Array, places: Places, count: int) -> Curve:
    """Return α = h² a(q, ν/h, t, w), the accelerations of the free coordinates under force densities groups · w."""
    inputs, q, nu, t, w, h = places.symbols()
    s = ca.SX.sym("s", model.mechanism.system_size or model.mechanism.bars)
    N, V, time = model.unpack(ca.vertcat(q, nu / h, t))
    A, S, b = lifted_dynamics(model, N, V, ca.mtimes(sparse(groups), w), time, s)
    return Curve(count, places, inputs, h**2 * model.split(model.pack(V, A, 1))[1], s, S, b)


def end_curve(model: Model, places: Places, count: int) -> Curve | Chain:
    """Return the state (q, ν/h, t), moved onto bars and joints where there are any."""
    inputs, q, nu, t, _, h = places.symbols()
    end, none = ca.vertcat(q, nu / h, t), (ca.SX(0, 1), ca.SX(0, 0), ca.SX(0, 1))
    if not model.mechanism.system_size:
        return Curve(
            count,
            places,
            inputs,
            build_projection(model, 1)(end) if model.mechanism.constrained else end,
            *none,
        )
    own = Places(model.nq, places.clock, 0, False)
    states, q, v, t, _, _ = own.symbols()
    placed = _projected(model, end, positions=True)
    moving = _projected(model, ca.vertcat(q, v, t), positions=False)
    return Chain(
        Curve(count, places, inputs, *placed), Curve(count, own, states, *moving), places.z.stop
    )


def _projected(model: Model, x: Any, positions: bool) -> tuple[Any, Any, Any, Any]:
    """Return f, s, S and b of a `Curve`: the state with positions, or velocities, moved by one step of `build_projection`."""
    mech, s = model.mechanism, ca.SX.sym("s", model.mechanism.system_size)
    N, V, time = model.unpack(x)
    D, Dd, _ = model.targets(time)
    B = mech.bar_vectors(N)
    r, R = residuals(mech, N, B, D) if positions else residual_rates(mech, V, B, Dd)
    moved = mech.with_inverse(nodal_forces(mech, B, *recover_multipliers(mech, B, r, s)))
    after = model.pack(N + moved, V, time) if positions else model.pack(N, V + moved, time)
    return after, s, *assemble_system(mech, B, r, R)


def _mapped(count: int, inputs: list[Any], outputs: list[Any]) -> Callable[..., list[Array]]:
    """Return outputs of `count` instances as arrays (count, columns, rows)."""
    values = ca.Function("f", inputs, ca.cse([ca.SX(value) for value in outputs]))
    symbols = values.mx_in()
    function = ca.Function(
        "dense", symbols, [ca.densify(value) for value in values.call(symbols)]
    )  # zeros are no instructions
    shapes = [
        (count, function.size2_out(k), function.size1_out(k)) for k in range(function.n_out())
    ]
    whole = ArrayFunction(function.map(count))
    return lambda *arrays: [
        value.reshape(shape) for value, shape in zip(whole(*arrays), shapes, strict=True)
    ]


def _folded(half: Array, z: int) -> Array:
    """Return L, transposed, with what it has below its blocks (z, z) and (r, r) added above them."""
    half[:, z:, :z] += half[:, :z, z:].transpose(0, 2, 1)
    half[:, :z, z:] = 0.0
    return half


def _triangle(matrix: Any) -> Any:
    return ca.tril(matrix, False) + ca.diag(ca.diag(matrix)) / 2


def _diagonal_inverse(S: Array) -> Array:
    """Return the inverse of diagonal matrices (K, n, n)."""
    result: Array = np.eye(S.shape[1]) / np.einsum("kii->ki", S)[:, None]
    return result
