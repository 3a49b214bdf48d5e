"""Collocation methods for stiff strings and large steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.integrators.events import count_switches
from tenscasadi.integrators.scheme import Complex, NamedScheme, equations
from tenscasadi.integrators.stage_iteration import (
    solve_stages,
    stage_states,
)
from tenscasadi.util.validate import Array, Count, Positive, one_of, whole

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True)
class Collocation(NamedScheme, kind="Collocation"):
    """Implicit Runge-Kutta methods at Gauss's or Radau's points.

    They suit stiff strings and large steps. A polynomial satisfies the equations of motion at
    `degree` points of each step. Stability does not limit the step. A step across an event, such
    as a slack string or a contact, loses the order, as with all fixed steps.

    Parameters
    ----------
    degree : int
        Number of points in a step, 1 to 9.
    points : {"gauss", "radau"}
        "gauss": order 2·degree, symplectic, without damping of vibrations. "radau": order
        2·degree − 1, which damps the fastest vibrations within a step.
    tolerance : float
        Iterations end when no state changes by more than this [m and m/s].
    iterations : int
        Largest number of iterations. A step that has not converged is NaN, which ends the run
        with a message.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds.

    Notes
    -----
    Up to degree 4, triangular iteration solves the stages of a model one by one. It takes 15 to 20
    iterations with stiff strings and fails if bars turn by more than about a radian in a step. The
    iteration uses the secant of friction while nodes slow down, then its derivative. In scenes with
    slack strings or contacts, a step that fails is split into halves, down to a 1024th. Impacts
    with friction need that. Newton's method for all stages solves other equations and degrees.

    References
    ----------
    .. [1] E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, sections IV.5 and IV.8.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> stiff = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1e6, prestress=30.0)))
    >>> tc.stable_step(stiff, scheme=tc.Collocation(3, "radau"))
    inf
    >>> bool(tc.simulate(stiff, 0.1, step=0.01, scheme=tc.Collocation(3, "radau"), compiled=False).success)
    True
    """

    degree: Annotated[int, whole(1, 9)] = 2
    points: Annotated[Literal["gauss", "radau"], one_of("gauss", "radau")] = "gauss"
    tolerance: Positive = 1e-10
    iterations: Count = 60
    adaptive: ClassVar[bool] = False
    implicit: ClassVar[bool] = True

    @property
    def order(self) -> int:
        """Order of convergence.

        It is 2·degree for Gauss's points, one less for Radau's.
        """
        return 2 * self.degree - (self.points == "radau")

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (s, s) and b (s,) of the method.

        They are integrals of Lagrange's polynomials, (IV.5.6).
        """
        c = np.array(
            ca.collocation_points(self.degree, "legendre" if self.points == "gauss" else "radau")
        )
        powers = np.arange(self.degree)
        inverse = np.linalg.inv(
            c[:, None] ** powers
        ).T  # row j: coefficients of the polynomial that is 1 at point j
        A = (c[:, None] ** (powers + 1) / (powers + 1)) @ inverse.T
        return A, inverse @ (1 / (powers + 1))

    def _build_step(self, ode: ca.Function) -> ca.Function:
        return self._close(self._newton(ode), "x")

    def _close(self, step: ca.Function, name: str) -> ca.Function:
        """Insert the tolerance as a constant into a step Function.

        (x, u, h, tolerance) becomes (x, u, h). The state's name is `name`, x or z.
        """
        symbols = [ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3)]
        return ca.Function(
            "step", symbols, [step(*symbols, self.tolerance)], [name, "u", "h"], [f"{name}_next"]
        )

    def _newton(self, ode: ca.Function) -> ca.Function:
        """Build a step by Newton's method for all stages.

        `ode` (x, u) → ẋ are the equations of motion. Function (x, u, h, tolerance) → x_next. x is
        the state, u the control with the parameters, and h the step [s].
        """
        A, b = self.coefficients
        nx, s = ode.size1_in(0), self.degree
        x, u, h, Z = (
            ca.MX.sym("x", nx),
            ca.MX.sym("u", ode.size1_in(1)),
            ca.MX.sym("h"),
            ca.MX.sym("Z", nx * s),
        )
        tolerance = ca.MX.sym("tolerance")
        scale = (
            tolerance / Collocation.tolerance
        )  # of the unknowns, since the solver's own tolerance is a constant
        columns = ca.horzsplit(ca.reshape(scale * Z, nx, s))
        slopes = ca.horzcat(*(ode(x + column, u) for column in columns))
        residual = scale * Z - h * ca.vec(
            ca.mtimes(slopes, ca.DM(A.T))
        )  # in increments of the state, (IV.8.2), for a good scaling at any stiffness
        inputs = ca.vertcat(x, u, h, tolerance)
        problem: Any = {"x": Z, "p": inputs, "g": residual}
        options: Any = {
            "linear_solver": "qr",
            "abstol": 1e-300,
            "abstolStep": Collocation.tolerance,
            "max_iter": self.iterations,
            "error_on_fail": False,
        }
        solve = ca.rootfinder("stages", "fast_newton", problem, options)
        guess = h * ca.vec(ca.mtimes(ode(x, u), ca.DM(A.sum(axis=1)).T))
        found = solve(guess / scale, inputs)
        left = ca.Function("left", [Z, x, u, h, tolerance], [ca.norm_inf(residual)])(
            found, x, u, h, tolerance
        )
        found = scale * found
        # Generated code does not report convergence. Stiff forces amplify the last error.
        solved = left <= 1e-5 * (ca.norm_inf(x) + ca.norm_inf(found))
        after = x + ca.mtimes(ca.reshape(found, nx, s), ca.DM(np.linalg.solve(A.T, b)))  # (IV.8.2b)
        return ca.Function(
            "newton",
            [x, u, h, tolerance],
            [ca.if_else(solved, after, np.nan)],
            ["x", "u", "h", "tolerance"],
            ["x_next"],
        )

    def _build_advance(self, model: Model, power: ca.Function | None) -> ca.Function:
        # equals `step(model.ode)` at a fraction of the cost
        return self._close(self.advance_within(model, power), "z")

    def advance_within(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build the step of `advance` with the tolerance as input.

        One compiled loop then serves all tolerances.

        Parameters
        ----------
        model : Model
            Model whose state is advanced.
        power : casadi.Function, optional
            See `advance`.

        Returns
        -------
        casadi.Function
            Function (z, u, h, tolerance) → z_next.

        Raises
        ------
        TypeError
            If `model` is no Model.
        """
        check_model(model)
        # otherwise sweeps converge slowly
        if self.degree > 4 or model.nq == 0 or model.has_coupled_rates:
            step = self._newton(equations(model, power))
        else:
            step = self._advance_by_sweeps(model, power)
        return _halve_unsolved(step) if count_switches(model) else step

    def _advance_by_sweeps(self, model: Model, power: ca.Function | None) -> ca.Function:
        """Build a step by triangular iteration over the stages.

        Function (z, u, h, tolerance) → z_next. With a Function `power`, z has one more entry, its
        integral. z is the state, u the control with the parameters, and h the step [s].
        """
        A, b = self.coefficients
        nx = model.nx
        z, u, h = ca.MX.sym("z", nx + (power is not None)), ca.MX.sym("u", model.nw), ca.MX.sym("h")
        tolerance = ca.MX.sym("tolerance")
        x = z[:nx]
        _, v, _, clock = model.split(x)
        rates, change = solve_stages(model, A, self.iterations)(x, u, h, tolerance)
        moved = ca.vertcat(
            h * v + h**2 * ca.mtimes(rates[: model.nq, :], ca.DM(A.T @ b)),
            h * ca.mtimes(rates, ca.DM(b)),
            ca.DM.ones(clock.shape[0]) * h,
        )
        if power is not None:
            watts = [power(state, u) for state in stage_states(model, A, x, rates, h)]
            moved = ca.vertcat(moved, h * ca.mtimes(ca.horzcat(*watts), ca.DM(b)))
        # the last sweep's change, up to rounding
        solved = change <= ca.fmax(100 * tolerance, 1e-9 * ca.norm_inf(x))
        return ca.Function(
            "swept",
            [z, u, h, tolerance],
            [ca.if_else(solved, z + moved, np.nan)],
            ["z", "u", "h", "tolerance"],
            ["z_next"],
        )

    def amplification(self, z: Complex) -> Complex:
        """Compute the amplification factor of one step.

        It multiplies y where y' = λ y.

        Parameters
        ----------
        z : ndarray of complex
            step · λ, of any shape.

        Returns
        -------
        ndarray of complex
            R(z) = det(I − zA + z 1 bᵀ)/det(I − zA), of the shape of z.
        """
        A, b = self.coefficients
        z = np.asarray(z, dtype=complex)[..., None, None]
        one = np.eye(self.degree)
        return np.asarray(
            np.linalg.det(one - z * A + z * np.tile(b, (self.degree, 1)))
            / np.linalg.det(one - z * A),
            dtype=complex,
        )


def _halve_unsolved(whole: ca.Function) -> ca.Function:
    """Build a step that is divided into halves if `whole` fails.

    `whole` is a Function (z, u, h, tolerance) → z_next that returns NaN if it fails. The result has
    the same form. The halves are divided likewise, up to ten times. Near an impact the modes of
    strings and contacts, or sticking and sliding, may alternate between iterations. In a short step
    the forces hardly change and each iteration converges. Other steps cost as much as before.
    """
    symbols = [ca.MX.sym(whole.name_in(i), whole.size1_in(i)) for i in range(4)]
    z, u, h, tolerance = symbols
    after = ca.MX.sym("after", z.shape[0])
    kept = ca.Function("kept", [*symbols, after], [after])
    step = whole
    for _ in range(10):
        middle = step(z, u, h / 2, tolerance)
        halves = ca.Function("halves", [*symbols, after], [step(middle, u, h / 2, tolerance)])
        found = whole(*symbols)
        good = ca.logic_or(
            ca.fabs(found[0]) < np.inf, ca.logic_not(ca.fabs(z[0]) < np.inf)
        )  # no trials after a failure
        chosen = ca.Function.if_else("whole_or_halves", kept, halves)(good, *symbols, found)
        step = ca.Function("step", symbols, [chosen], whole.name_in(), whole.name_out())
    return step
