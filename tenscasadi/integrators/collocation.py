"""Implicit Runge-Kutta methods: collocation at Gauss's or Radau's points, for stiff strings and large steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Complex, check_ode, with_work
from tenscasadi.integrators.triangular import stage_states, stages
from tenscasadi.util.validate import Array, instance, positive_number, whole_number

_SWEPT = 4  # degree up to which sweeps converge fast
_SLACK, _ROUNDING = 100.0, 1e-9  # what the last sweep may have moved: times the tolerance, or relative to the state
_LEFT = 1e-5  # of the state: what the equations may be off by after Newton's method; stiff forces magnify what is left of its last step


@dataclass(frozen=True)
class Collocation:
    """A polynomial of `degree` that satisfies the equations at as many points of each step, solved by Newton's method: no limit on the step.

    points "gauss": order 2·degree, symplectic, vibrations keep their amplitude; "radau": order 2·degree − 1, the fastest vibrations die
    out within a step (Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.5). Where a step passes the end of a string's
    slack or a contact the order is lost, as with all fixed steps. Iterations end when they move no state by more than `tolerance`
    (m, m/s) or after `iterations`; where the equations do not hold then, the next state is NaN, which ends a run with a message.

    Steps of a model up to degree 4 are found stage by stage (see `triangular`), which takes 15 to 20 iterations with stiff strings and
    fails where bars turn by more than about a radian in a step; any other ode and degree by Newton's method for all stages at once.
    """

    degree: int = 2
    points: Literal["gauss", "radau"] = "gauss"
    tolerance: float = 1e-10
    iterations: int = 60
    adaptive: ClassVar[bool] = False
    implicit: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if whole_number("Collocation.degree", self.degree, 1) > 9:
            raise ValueError(f"Collocation.degree is {self.degree}: give 1 to 9")
        if self.points not in ("gauss", "radau"):
            raise ValueError(f'Collocation.points is {self.points!r}: give "gauss" or "radau"')
        object.__setattr__(self, "tolerance", positive_number("Collocation.tolerance", self.tolerance))
        whole_number("Collocation.iterations", self.iterations, 1)

    @property
    def order(self) -> int:
        """2·degree for Gauss's points, one less for Radau's."""
        return 2 * self.degree - (self.points == "radau")

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """A (s, s) and b (s,) of the Runge-Kutta method: integrals of Lagrange's polynomials (ibid. (IV.5.6))."""
        c = np.array(ca.collocation_points(self.degree, "legendre" if self.points == "gauss" else "radau"))
        powers = np.arange(self.degree)
        inverse = np.linalg.inv(c[:, None] ** powers).T  # row j: the coefficients of the polynomial that is 1 at point j
        A = (c[:, None] ** (powers + 1) / (powers + 1)) @ inverse.T
        return A, inverse @ (1 / (powers + 1))

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next. TypeError, ValueError: not such an ode."""
        check_ode(ode)
        A, b = self.coefficients
        nx, s = ode.size1_in(0), self.degree
        x, u, h, Z = ca.MX.sym("x", nx), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("h"), ca.MX.sym("Z", nx * s)
        columns = ca.horzsplit(ca.reshape(Z, nx, s))
        slopes = ca.horzcat(*(ode(x + column, u) for column in columns))
        residual = Z - h * ca.vec(ca.mtimes(slopes, ca.DM(A.T)))  # in increments of the state, (IV.8.2): well scaled however stiff
        problem: Any = {"x": Z, "p": ca.vertcat(x, u, h), "g": residual}
        options: Any = {"linear_solver": "qr", "abstol": 1e-300, "abstolStep": self.tolerance, "max_iter": self.iterations, "error_on_fail": False}
        solve = ca.rootfinder("stages", "fast_newton", problem, options)
        guess = h * ca.vec(ca.mtimes(ode(x, u), ca.DM(A.sum(axis=1)).T))
        found = solve(guess, ca.vertcat(x, u, h))
        left = ca.Function("left", [Z, x, u, h], [ca.norm_inf(residual)])(found, x, u, h)
        solved = left <= _LEFT * (ca.norm_inf(x) + ca.norm_inf(found))  # generated code does not tell
        after = x + ca.mtimes(ca.reshape(found, nx, s), ca.DM(np.linalg.solve(A.T, b)))  # (IV.8.2b)
        after = ca.if_else(solved, after, np.nan)
        return ca.Function("step", [x, u, h], [after], ["x", "u", "h"], ["x_next"])

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """One step of a model: see `Scheme.advance`. The same step as that of `step(model.ode)`, found in a fraction of the time."""
        instance("model", model, Model, "a tenscasadi.Model")
        if self.degree > _SWEPT or model.nq == 0:
            return self.step(model.ode if power is None else with_work(model.ode, power))
        A, b = self.coefficients
        nx, nq = model.nx, model.nq
        z, u, h = ca.MX.sym("z", nx + (power is not None)), ca.MX.sym("u", model.nu), ca.MX.sym("h")
        x, v = z[:nx], z[nq : 2 * nq]
        k, change = stages(model, A, self.iterations, self.tolerance)(x, u, h)
        moved = ca.vertcat(h * v + h**2 * ca.mtimes(k, ca.DM(A.T @ b)), h * ca.mtimes(k, ca.DM(b)), ca.DM.ones(nx - 2 * nq) * h)
        if power is not None:
            watts = [power(state, u) for state in stage_states(model, A, x, k, h)]
            moved = ca.vertcat(moved, h * ca.mtimes(ca.horzcat(*watts), ca.DM(b)))
        solved = change <= ca.fmax(_SLACK * self.tolerance, _ROUNDING * ca.norm_inf(x))
        return ca.Function("step", [z, u, h], [ca.if_else(solved, z + moved, np.nan)], ["z", "u", "h"], ["z_next"])

    def amplification(self, z: Complex) -> Complex:
        """R(z) = det(I − zA + z 1 bᵀ)/det(I − zA)."""
        A, b = self.coefficients
        z = np.asarray(z, dtype=complex)[..., None, None]
        one = np.eye(self.degree)
        return np.asarray(np.linalg.det(one - z * A + z * np.tile(b, (self.degree, 1))) / np.linalg.det(one - z * A), dtype=complex)
