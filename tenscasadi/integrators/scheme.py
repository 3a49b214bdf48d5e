"""Interface and stability of integration schemes.

A scheme turns a model, or x' = ode(x, u), into one step x⁺ = step(x, u, h), a CasADi Function.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.schema.value import Value
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import Array, Check, format_value, instance, positive_number

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

Complex = NDArray[np.complex128]


class NamedScheme(Value):
    """Base class of schemes with a name in files."""

    def step(self, ode: ca.Function) -> ca.Function:
        """Build one step of an ordinary differential equation.

        The control is constant over the step.

        Parameters
        ----------
        ode : casadi.Function
            Function (x, u) → ẋ with columns x and ẋ of the same length.

        Returns
        -------
        casadi.Function
            Function "step" (x, u, h) → x_next with the step h [s].

        Raises
        ------
        TypeError
            If `ode` is no casadi.Function.
        ValueError
            If its inputs and outputs differ from these.
        """
        check_ode(ode)
        return self._build_step(ode)

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build one step of a model with constant control.

        Parameters
        ----------
        model : Model
            Model whose state is advanced.
        power : casadi.Function, optional
            Function (x, u) → power [W] whose work is integrated; None: no work.

        Returns
        -------
        casadi.Function
            Function "step" (z, u, h) → z_next with the step h [s]. The state z is x (nx,). With
            `power`, one more entry is the work done [J]. The input u is the control followed by
            the parameters.

        Raises
        ------
        TypeError
            If `model` is no Model.
        """
        check_model(model)
        return self._build_advance(model, power)

    def _build_step(self, ode: ca.Function) -> ca.Function:
        raise NotImplementedError

    def _build_advance(self, model: Model, power: ca.Function | None) -> ca.Function:
        raise NotImplementedError


@runtime_checkable
class Scheme(Protocol):
    """Interface of integration schemes.

    A scheme is a frozen value that holds options, never state.
    """

    @property
    def order(self) -> int:
        """Order p of convergence.

        The error after a fixed time is proportional to step^p.
        """

    @property
    def adaptive(self) -> bool:
        """Whether the scheme controls its error by the step size.

        Its steps subdivide those of the grid of `simulate`.
        """

    @property
    def implicit(self) -> bool:
        """Whether a step solves implicit equations with forces.

        Stability then does not limit the step.
        """

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build one step of a model with constant input.

        Function "step" (z, u, h) → z_next with z = x. If the model has parameters, u (nw,) is the
        control followed by these. With `power` (x, u) → W, z has one more entry, the work done
        [J]. TypeError unless `model` is a Model.
        """

    def step(self, ode: ca.Function) -> ca.Function:
        """Build one step of an ode with constant u.

        Function "step" (x, u, h) → x_next. TypeError if the scheme needs a model.
        """

    def amplification(self, z: Complex) -> Complex:
        """Compute the amplification factor R(z) of one step.

        One step multiplies y by R(z) where y' = λ y and z = step · λ.
        """


_MEMBERS = ("order", "adaptive", "implicit", "advance", "step", "amplification")


def check_relative_tolerance(field: str, value: Any) -> float:
    """Check that a relative tolerance is in [1e-15, 1).

    Returns it as a float. Messages name the `field` that has the value. Raises TypeError,
    ValueError.
    """
    rtol = positive_number(field, value)
    if rtol < 1e-15 or rtol >= 1:
        raise ValueError(
            f"{field} is {rtol:g}: give 1e-15 or more, which is rounding, and less than 1"
        )
    return rtol


RelativeTolerance = Annotated[float, Check(check_relative_tolerance)]


def extent(model: Model) -> float:
    """Compute the extent of the structure [m].

    It is the largest distance between two nodes along an axis, 1 for a single node. Raises
    TypeError.
    """
    check_model(model)
    return measure_extent(model.structure.nodes) or 1.0


def add_work(ode: ca.Function, power: ca.Function) -> ca.Function:
    """Append the work of forces to an ordinary differential equation.

    `ode` is (x, u) → ẋ, and `power` (x, u) → W. The result is (z, u) → ż with z = (x, work), so the
    scheme integrates the work like a state.
    """
    x, u, work = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("work")
    return ca.Function(
        "ode_and_work",
        [ca.vertcat(x, work), u],
        [ca.vertcat(ode(x, u), power(x, u))],
        ["z", "u"],
        ["zdot"],
    )


def equations(model: Model, power: ca.Function | None) -> ca.Function:
    """Build the model's right-hand side (x, w) → ẋ.

    The input w is the control followed by the parameters. `power` (x, w) → W adds a state, see
    `add_work`.
    """
    ode = model.with_stacked_input(model.ode)
    return ode if power is None else add_work(ode, power)


def check_ode(ode: ca.Function) -> None:
    """Raise TypeError, ValueError unless `ode` is (x, u) → ẋ.

    The columns x and ẋ must have the same length.
    """
    instance("ode", ode, ca.Function, "a casadi.Function (x, u) -> xdot")
    if (
        ode.n_in() != 2
        or ode.n_out() != 1
        or ode.size_out(0) != ode.size_in(0)
        or ode.size2_in(0) != 1
    ):
        raise ValueError(
            f"ode is {ode}: give a casadi.Function (x, u) -> xdot with columns x and xdot of the same length"
        )


def check_scheme(scheme: Any, field: str = "scheme") -> None:
    """Raise TypeError unless `scheme` is an integration scheme.

    The message names `field`. A class without parentheses is not a scheme.
    """
    if isinstance(scheme, NamedScheme):  # quicker than the protocol
        return
    if isinstance(scheme, type) or not isinstance(scheme, Scheme):
        lacks = [name for name in _MEMBERS if not hasattr(scheme, name)]
        why = (
            ""
            if isinstance(scheme, type) or len(lacks) == len(_MEMBERS)
            else f" and lacks {', '.join(lacks)}"
        )
        raise TypeError(
            f"{field} is {format_value(scheme)}{why}: give an integration scheme, such as RungeKutta4()"
        )


def stability_limit(scheme: Scheme, direction: Complex, reach: float = 50.0) -> Array:
    """Compute the extent of the stability region along directions.

    For each `direction` z, it is the largest r with |R(s z)| ≤ 1 for 0 ≤ s ≤ r, and infinite
    beyond r |z| = `reach`.

    `direction` (k,) are nonzero complex numbers, for instance eigenvalues; r is then the largest
    stable step. A growing direction (real part > 0) is replaced by one on the imaginary axis,
    since growth of the motion itself is no instability of the scheme.
    """
    z = np.where(direction.real > 0, 1j * np.abs(direction), direction)
    unit = z / np.abs(z)
    # 1e-9 admits rounding, and negligible growth on the imaginary axis.
    grid = np.linspace(0, reach, 2001)
    unstable = np.abs(scheme.amplification(np.multiply.outer(unit, grid))) > 1 + 1e-9
    first = np.argmax(unstable, axis=1)
    low, high = grid[np.maximum(first - 1, 0)], grid[first]
    for _ in range(40):
        middle = (low + high) / 2
        outside = np.abs(scheme.amplification(unit * middle)) > 1 + 1e-9
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    return np.where(unstable.any(axis=1), low / np.abs(z), np.inf)
