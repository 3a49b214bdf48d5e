"""Implicit Runge-Kutta methods: collocation at Gauss's or Radau's points, for stiff strings and large steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import count_switches
from tenscasadi.integrators.scheme import Complex, NamedScheme, check_ode, equations
from tenscasadi.integrators.stage_iteration import solve_stages, stage_states
from tenscasadi.util.validate import Array, choice, instance, positive_number, whole_number

_TOLERANCE = 1e-10  # m and m/s


@dataclass(frozen=True)
class Collocation(NamedScheme, kind="Collocation"):
    """Collocation: implicit Runge-Kutta methods at Gauss's or Radau's points, for stiff strings and large steps.

    A polynomial satisfies the equations of motion at `degree` points of each step. No step is too
    large for stability. Where a step passes the end of a string's slack or a contact the order is
    lost, as with all fixed steps.

    Parameters
    ----------
    degree : int
        Points in a step, 1 to 9.
    points : {"gauss", "radau"}
        "gauss": order 2·degree, symplectic, vibrations keep their amplitude. "radau": order 2·degree − 1, the fastest vibrations die out
        within a step.
    tolerance : float
        Iterations end when they move no state by more than this, m and m/s.
    iterations : int
        Largest number of iterations. Where the equations do not hold then, the next state is NaN,
        which ends a run with a message.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds.

    Notes
    -----
    Steps of a model up to degree 4 are found stage by stage (triangular iteration), which takes 15
    to 20 iterations with stiff strings and fails where bars turn by more than about a radian in a
    step. Friction is met with its secant while nodes still slow down, and with its slope then.
    Where strings can go slack or nodes meet the ground, a step that is not found is taken in two
    halves, and these likewise, down to a 1024th: impacts with friction need that. Steps of other
    equations and degrees are found by Newton's method for all stages at once.

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

    degree: int = 2
    points: Literal["gauss", "radau"] = "gauss"
    tolerance: float = _TOLERANCE
    iterations: int = 60
    adaptive: ClassVar[bool] = False
    implicit: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if whole_number("Collocation.degree", self.degree, 1) > 9:
            raise ValueError(f"Collocation.degree is {self.degree}: give 1 to 9")
        choice("Collocation.points", self.points, "gauss", "radau")
        object.__setattr__(
            self, "tolerance", positive_number("Collocation.tolerance", self.tolerance)
        )
        whole_number("Collocation.iterations", self.iterations, 1)

    @property
    def order(self) -> int:
        """Order of convergence: 2·degree for Gauss's points, one less for Radau's."""
        return 2 * self.degree - (self.points == "radau")

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """A (s, s) and b (s,) of the Runge-Kutta method: integrals of Lagrange's polynomials, (IV.5.6)."""
        c = np.array(
            ca.collocation_points(self.degree, "legendre" if self.points == "gauss" else "radau")
        )
        powers = np.arange(self.degree)
        inverse = np.linalg.inv(
            c[:, None] ** powers
        ).T  # row j: the coefficients of the polynomial that is 1 at point j
        A = (c[:, None] ** (powers + 1) / (powers + 1)) @ inverse.T
        return A, inverse @ (1 / (powers + 1))

    def step(self, ode: ca.Function) -> ca.Function:
        """Build one step of any ordinary differential equation with its control held.

        Parameters
        ----------
        ode : casadi.Function
            Function (x, u) → ẋ with columns x and ẋ of the same length.

        Returns
        -------
        casadi.Function
            Function "step" (x, u, h) → x_next, with h the length of the step, s.

        Raises
        ------
        TypeError
            If `ode` is no casadi.Function.
        ValueError
            If its inputs and outputs are others.
        """
        check_ode(ode)
        return self._close(self._newton(ode), "x")

    def _close(self, step: ca.Function, name: str) -> ca.Function:
        """Return the Function (x, u, h) of a Function (x, u, h, tolerance)."""
        symbols = [ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3)]
        return ca.Function(
            "step", symbols, [step(*symbols, self.tolerance)], [name, "u", "h"], [f"{name}_next"]
        )

    def _newton(self, ode: ca.Function) -> ca.Function:
        """Return (x, u, h, tolerance) → x_next, by Newton's method for all stages at once."""
        A, b = self.coefficients
        nx, s = ode.size1_in(0), self.degree
        x, u, h, Z = (
            ca.MX.sym("x", nx),
            ca.MX.sym("u", ode.size1_in(1)),
            ca.MX.sym("h"),
            ca.MX.sym("Z", nx * s),
        )
        tolerance = ca.MX.sym("tolerance")
        scale = tolerance / _TOLERANCE  # of the unknowns: the solver's own tolerance is a constant
        columns = ca.horzsplit(ca.reshape(scale * Z, nx, s))
        slopes = ca.horzcat(*(ode(x + column, u) for column in columns))
        residual = scale * Z - h * ca.vec(
            ca.mtimes(slopes, ca.DM(A.T))
        )  # in increments of the state, (IV.8.2): well scaled however stiff
        inputs = ca.vertcat(x, u, h, tolerance)
        problem: Any = {"x": Z, "p": inputs, "g": residual}
        options: Any = {
            "linear_solver": "qr",
            "abstol": 1e-300,
            "abstolStep": _TOLERANCE,
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
        # Generated code does not tell; stiff forces magnify the error of the last step.
        solved = left <= 1e-5 * (ca.norm_inf(x) + ca.norm_inf(found))
        after = x + ca.mtimes(ca.reshape(found, nx, s), ca.DM(np.linalg.solve(A.T, b)))  # (IV.8.2b)
        return ca.Function(
            "newton",
            [x, u, h, tolerance],
            [ca.if_else(solved, after, np.nan)],
            ["x", "u", "h", "tolerance"],
            ["x_next"],
        )

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build one step of a model with its control held: that of `step(model.ode)`, found in a fraction of the time.

        Parameters
        ----------
        model : Model
            Model whose state is advanced.
        power : casadi.Function, optional
            Function (x, u) → power, W, whose work is integrated beside the state; None: no work.

        Returns
        -------
        casadi.Function
            Function "step" (z, u, h) → z_next, with h the length of the step, s. z is the state x
            (nx,); with `power` it holds one entry more, the work done, J. Below the control, u
            holds the parameters, if there are any.

        Raises
        ------
        TypeError
            If `model` is no Model.
        """
        return self._close(self.advance_within(model, power), "z")

    def advance_within(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build the step of `advance` with the tolerance as an input, so that one compiled loop serves all tolerances.

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
        instance("model", model, Model, "a tenscasadi.Model")
        if self.degree > 4 or model.nq == 0:  # sweeps converge slowly
            step = self._newton(equations(model, power))
        else:
            step = self._swept(model, power)
        return _halve_unsolved(step) if any(count_switches(model)) else step

    def _swept(self, model: Model, power: ca.Function | None) -> ca.Function:
        """Return (z, u, h, tolerance) → z_next, by sweeps through the stages."""
        A, b = self.coefficients
        nx = model.nx
        z, u, h = ca.MX.sym("z", nx + (power is not None)), ca.MX.sym("u", model.nw), ca.MX.sym("h")
        tolerance = ca.MX.sym("tolerance")
        x = z[:nx]
        _, v, clock = model.split(x)
        k, change = solve_stages(model, A, self.iterations)(x, u, h, tolerance)
        moved = ca.vertcat(
            h * v + h**2 * ca.mtimes(k, ca.DM(A.T @ b)),
            h * ca.mtimes(k, ca.DM(b)),
            ca.DM.ones(clock.shape[0]) * h,
        )
        if power is not None:
            watts = [power(state, u) for state in stage_states(model, A, x, k, h)]
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
        """Compute the factor by which one step multiplies y when y' = λ y.

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
    """Return a step (z, u, h, tolerance) → z_next that is taken in two halves where `whole` gives no finite state, and these likewise.

    Near an impact the modes of strings and contacts, or sliding and sticking, may change in turns
    from iteration to iteration; in a short enough step the forces hardly change, and the iterations
    of each converge. Other steps cost as much as before.
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
        )  # after a failure nothing is tried
        chosen = ca.Function.if_else("whole_or_halves", kept, halves)(good, *symbols, found)
        step = ca.Function("step", symbols, [chosen], whole.name_in(), whole.name_out())
    return step
