"""SUNDIALS' integrators CVODES and IDAS with error control.

CVODES integrates ordinary differential equations, IDAS differential-algebraic equations with
multipliers. CasADi gives exact Jacobians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.equation_of_motion import compute_forces, forward_dynamics
from tenscasadi.integrators.events import build_mode_ode, count_switches, split_mode
from tenscasadi.integrators.scheme import (
    Complex,
    NamedScheme,
    RelativeTolerance,
    equations,
    extent,
)
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Boolean, Count, Positive

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True)
class Sundials(NamedScheme):
    """Base class of backward differentiation formulas by SUNDIALS.

    They are implicit multistep methods of variable order (1 to 5) and step, for stiff scenes. They
    are not compiled, since SUNDIALS itself takes most of the time; compiled equations and Jacobians
    save at most a quarter of it. Events are located only with `locate_events`; otherwise the error
    control detects them. CasADi 3.8.2's own events are experimental there and miss crossings.
    """

    rtol: RelativeTolerance = 1e-8
    atol: Positive | None = None
    max_steps: Count = 100_000
    locate_events: Boolean = False
    order: ClassVar[int] = 5
    adaptive: ClassVar[bool] = True
    implicit: ClassVar[bool] = True
    plugin: ClassVar[str]

    def _build_step(self, ode: ca.Function) -> ca.Function:
        x, u = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1))
        return self._step(
            {"x": x, "u": u, "ode": ode(x, u)}, self.rtol if self.atol is None else self.atol, None
        )

    def _build_advance(self, model: Model, power: ca.Function | None) -> ca.Function:
        return self._step(
            self.equations(model, power), self.absolute(model), self.algebraic_start(model)
        )

    def advance_in_mode(self, model: Model, work: ca.Function | None, parts: int) -> ca.Function:
        """Build one step of a model with fixed slack and contact states.

        Function (z, w, h) → states (nz, parts) at the ends of equal parts of the step h [s]. z is
        the initial state, and w = (u, mode) has the control, the parameters and the fixed modes.
        `work` is `build_mode_ode` with work, or None.
        """
        shares = [(k + 1) / parts for k in range(parts)]
        return self._step(
            self.equations(model, work, held=True),
            self.absolute(model),
            self.algebraic_start(model),
            shares,
        )

    def _step(
        self,
        equations: dict[str, Any],
        atol: float,
        start: ca.Function | None,
        shares: Sequence[float] = (1.0,),
    ) -> ca.Function:
        """Build one step of the equations of any length h.

        It is a Function (x, u, h) → states. `equations` are those of the method `equations`, `atol`
        is the absolute tolerance [m and m/s], and `start` the Function of `algebraic_start`. The
        integration variable is t/h. The states are those at the fractions `shares` of the step.
        """
        h, u = ca.MX.sym("h"), equations["u"]
        scaled = {key: value for key, value in equations.items() if key != "u"} | {
            "p": ca.vertcat(u, h),
            "ode": h * equations["ode"],
        }
        integrate = self.integrator(scaled, list(shares), atol)
        x = ca.MX.sym("x", equations["x"].shape[0])
        guess = (
            {} if start is None else {"z0": start(x[: start.size1_in(0)], u[: start.size1_in(1)])}
        )
        return ca.Function(
            "step",
            [x, u, h],
            [integrate(x0=x, p=ca.vertcat(u, h), **guess)["xf"]],
            ["x", "u", "h"],
            ["x_next"],
        )

    def amplification(self, z: Complex) -> Complex:
        """Return zeros, as if every step were stable.

        The integrator controls its stability by its own steps. z is step · λ, see
        `Scheme.amplification`.
        """
        return np.zeros(np.shape(z), dtype=complex)

    def equations(
        self, model: Model, power: ca.Function | None, held: bool = False
    ) -> dict[str, Any]:
        """Build the equations for CasADi's integrator, a dictionary.

        Its symbols are the state x and the input u, and `ode` is ẋ. With a Function `power`, x has
        one more entry, the work of forces. With `held`, slack and contact states are fixed, see
        `advance_in_mode`.
        """
        ode = (power or build_mode_ode(model)) if held else equations(model, power)
        x, u = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1))
        return {"x": x, "u": u, "ode": ode(x, u)}

    def algebraic_start(self, model: Model) -> ca.Function | None:
        """Build the initial guess of the algebraic variables.

        These are the multipliers of bars and joints in `Idas`. Function (z, u) → guess; None
        without such variables. z is the state, and u the control with the parameters.
        """
        return None

    def integrator(self, equations: dict[str, Any], grid: list[float], atol: float) -> ca.Function:
        """Build CasADi's integrator from 0 to the times `grid` [s].

        `equations` are those of the method of this name, and `atol` is the absolute tolerance.
        Raises ValueError if the multipliers are undetermined.
        """
        try:
            return ca.integrator(
                "integrate", self.plugin, equations, 0.0, grid, self._options(atol)
            )
        except RuntimeError as error:
            if "rank-deficient" not in str(error):
                raise
            raise ValueError(
                f"{type(self).__name__} does not support redundant constraints: use another scheme, such as Cvodes()"
            ) from None

    def absolute(self, model: Model) -> float:
        """Return the absolute tolerance [m and m/s].

        It is `atol`, or rtol times the extent of the structure.
        """
        return self.rtol * extent(model) if self.atol is None else self.atol

    def _options(self, atol: float) -> dict[str, Any]:
        return {
            "reltol": self.rtol,
            "abstol": atol,
            "max_num_steps": self.max_steps,
            "show_eval_warnings": False,
            "disable_internal_warnings": True,
        }


@dataclass(frozen=True)
class Cvodes(Sundials, kind="Cvodes"):
    """CVODES of SUNDIALS for stiff scenes.

    It integrates the model's ordinary differential equation with error control, by backward
    differentiation formulas of order 1 to 5 with exact Jacobians. The integrator chooses its steps
    and is not compiled. A correction changes the states of the trajectory. The integrator itself
    continues from a corrected state only at about every fiftieth grid time, since each restart
    reduces its order.

    Parameters
    ----------
    rtol : float
        Largest error of a step relative to each state entry, 1e-15 ≤ rtol < 1.
    atol : float, optional
        Additional error [m and m/s]; None: `rtol` times the structure's extent.
    max_steps : int
        Largest number of the integrator's steps within a grid step of `simulate`.
    locate_events : bool
        Whether `simulate` restarts the integrator where strings go slack or taut and nodes meet or
        leave the ground, as `DormandPrince853` with `rtol` does. Otherwise the error control
        detects the change.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds.

    See Also
    --------
    Idas : The same formulas with the multipliers as unknowns.

    Notes
    -----
    Located events reduce errors by a factor of 0.4 to 8.5, 2 in the median. They take 4 to 10 times
    as long, since each event restarts the integrator at order 1. A smaller `rtol` gains more for
    less, so they are off by default. For the same work, `DormandPrince853` with `rtol` is more
    accurate than either; it always locates events. The measured scenes are a bouncing ball, a
    string that goes slack and taut, a damped one, and a falling prism with 48 events. They were run
    at rtol from 1e-4 to 1e-10 with 200 grid times.

    References
    ----------
    .. [1] A. C. Hindmarsh et al., SUNDIALS: Suite of nonlinear and differential/algebraic equation
       solvers, ACM Transactions on Mathematical Software 31, 2005, 363-396.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1e6, prestress=30.0)))
    >>> tc.simulate(model, 0.1, scheme=tc.Cvodes(rtol=1e-6)).message
    'finished 100 times 0.001 s apart, by Cvodes'
    """

    plugin: ClassVar[str] = "cvodes"


@dataclass(frozen=True)
class Idas(Sundials, kind="Idas"):
    """IDAS of SUNDIALS for stiff scenes.

    It integrates the index-reduced form of a model with multipliers, with error control, by
    backward differentiation formulas of order 1 to 5. The unknowns are accelerations with λ and Ω,
    and the constraints enter by their second derivatives (Eqs. 85-87 before the multipliers are
    eliminated). The integrator chooses its steps and is not compiled. It rejects redundant
    constraints, which leave the multipliers undetermined.

    Parameters
    ----------
    rtol : float
        Largest error of a step relative to each state entry, 1e-15 ≤ rtol < 1.
    atol : float, optional
        Additional error [m and m/s]; None: `rtol` times the structure's extent.
    max_steps : int
        Largest number of the integrator's steps within a grid step of `simulate`.
    locate_events : bool
        Whether `simulate` restarts the integrator where strings go slack or taut and nodes meet or
        leave the ground, as `DormandPrince853` with `rtol` does. Otherwise the error control
        detects the change.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds.

    See Also
    --------
    Cvodes : The same formulas on the ordinary differential equation.

    Notes
    -----
    Located events reduce errors by a factor of 0.4 to 24, 2 in the median. They take 3 to 10 times
    as long, measured as for `Cvodes`.

    References
    ----------
    .. [1] A. C. Hindmarsh et al., SUNDIALS: Suite of nonlinear and differential/algebraic equation
       solvers, ACM Transactions on Mathematical Software 31, 2005, 363-396.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1e6, prestress=30.0)))
    >>> tc.simulate(model, 0.1, scheme=tc.Idas(rtol=1e-6)).message
    'finished 100 times 0.001 s apart, by Idas'
    """

    plugin: ClassVar[str] = "idas"

    def _options(self, atol: float) -> dict[str, Any]:
        # λ jumps with the damping of a contact, which is no error of the motion. IDACalcIC looks
        # for a consistent start within 1e-6 of a step; within a whole one it fails before contacts.
        return super()._options(atol) | {"suppress_algebraic": True, "first_time": 1e-6}

    def equations(
        self, model: Model, power: ca.Function | None, held: bool = False
    ) -> dict[str, Any]:
        """Build the differential-algebraic equations for CasADi's integrator.

        They are Eqs. 85-87 before the multipliers are eliminated.

        Parameters
        ----------
        model : Model
            Model to integrate.
        power : casadi.Function or None
            Function (x, u) → power [W] whose work is one more state; None: no work.
        held : bool
            See `advance_in_mode`; `power` is then its `work`.

        Returns
        -------
        dict
            Symbols x, z = (λ, Ω) and u, and expressions ode and alg of them.

        Raises
        ------
        ValueError
            If constraints are redundant.
        """
        mech = model.mechanism
        if not mech.constrained:
            return super().equations(model, power, held)
        if model.redundancy:
            raise ValueError(
                f"{type(self).__name__} does not support redundant constraints: use another scheme, such as Cvodes(): {model.redundancy}"
            )
        kind: Any = ca.MX if mech.large else ca.SX
        state, w = (
            kind.sym("x", model.nx + (power is not None)),
            kind.sym("u", model.nw + held * count_switches(model)),
        )
        u, mode = split_mode(model, w) if held else (w, None)
        mech = model.with_masses(u)
        z = kind.sym("z", mech.bars + 3 * mech.joints)
        x = state[: model.nx]
        N, V, time = model.unpack(x)
        given = model.extend_inputs(x, u)
        lam, Omega = z[: mech.bars].T, ca.reshape(z[mech.bars :], 3, mech.joints)
        B, Bd = mech.bar_vectors(N), mech.bar_vectors(V)
        F, moved = compute_forces(model, N, V, given, time, mode, mech)
        A = mech.with_inverse(F + nodal_forces(mech, B, lam, Omega)) + moved
        stretching = ca.sum1(Bd * Bd) + ca.sum1(B * mech.bar_vectors(A))  # Eq. 28
        gaping = (
            mech.project_onto_constraints(ca.mtimes(A, sparse(mech.P)) - model.targets(time)[2])
            + Omega
            - mech.project_onto_constraints(Omega)
        )
        xdot = [model.pack(V, A, model.internal_rates(x, u, mode), 1)] + (
            [] if power is None else [power(state[: power.size1_in(0)], w)[-1]]
        )
        rows = ca.densify(ca.vertcat(stretching.T, ca.vec(gaping)))
        equations = ca.Function("equations", [state, z, w], [ca.vertcat(*xdot), rows])
        symbols = [
            ca.MX.sym(name, value.shape[0]) for name, value in (("x", state), ("z", z), ("u", w))
        ]
        ode, alg = equations(*symbols)
        return {"x": symbols[0], "z": symbols[1], "u": symbols[2], "ode": ode, "alg": alg}

    def algebraic_start(self, model: Model) -> ca.Function | None:
        """Build the initial guess of the multipliers.

        They are the multipliers λ of the bars [N/m], and Ω of the joint constraints N P = D, which
        include pins in full coordinates [N].

        Parameters
        ----------
        model : Model
            Model to integrate.

        Returns
        -------
        casadi.Function or None
            Function (x, u) → (λ, Ω), a column; None without constraints.
        """
        mech = model.mechanism
        if not mech.constrained:
            return None
        x, u = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nw)
        N, V, time = model.unpack(x)
        w = model.extend_inputs(x, u)
        _, lam, Omega = forward_dynamics(model, N, V, w, time)
        return ca.Function("start", [x, u], [ca.densify(ca.vertcat(lam.T, ca.vec(Omega)))])
