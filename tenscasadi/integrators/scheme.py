"""Integration schemes as values: each turns a model, or x' = ode(x, u), into one step x⁺ = step(x, u, h), a CasADi Function."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, instance, positive_number, shown

Complex = NDArray[np.complex128]


class NamedScheme(Value):
    """Scheme that files know by its kind."""


@runtime_checkable
class Scheme(Protocol):
    """Members of every integration scheme. A scheme is a frozen value: it holds options, never state."""

    @property
    def order(self) -> int:
        """Order p of convergence: the error after a fixed time falls like step^p."""

    @property
    def adaptive(self) -> bool:
        """Whether the scheme takes steps of its own size between the times of the grid that `simulate` lays."""

    @property
    def implicit(self) -> bool:
        """Whether each step solves equations that hold forces, by iterations of unknown number: stability bounds no step then."""

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """Build one step of a model with u held: Function "step" (z, u, h) -> z_next, z = x.

        Where the model has parameters, u is the control and below it these, `model.nw` entries.
        With `power` (x, u) -> W, z holds one entry more: the work that it has done, J. TypeError
        for anything but a Model.
        """

    def step(self, ode: ca.Function) -> ca.Function:
        """Build one step of any x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next. TypeError where the scheme needs a model."""

    def amplification(self, z: Complex) -> Complex:
        """Compute R(z): the factor by which one step multiplies y when y' = λ y and z = step · λ."""


_MEMBERS = ("order", "adaptive", "implicit", "advance", "step", "amplification")


def check_relative_tolerance(field: str, value: Any) -> float:
    """Return `value` as a float, 1e-15 or more and less than 1. Raises TypeError, ValueError."""
    rtol = positive_number(field, value)
    if rtol < 1e-15 or rtol >= 1:
        raise ValueError(
            f"{field} is {rtol:g}: give 1e-15 or more, which is rounding, and less than 1"
        )
    return rtol


def extent(model: Model) -> float:
    """Return the largest distance along an axis between two nodes of the structure, m; 1 where there is one node. Raises TypeError."""
    instance("model", model, Model, "a tenscasadi.Model")
    return float(np.ptp(model.structure.nodes, axis=0).max()) or 1.0


def add_work(ode: ca.Function, power: ca.Function) -> ca.Function:
    """Return (z, u) -> zdot: the ode with the work of `power` (x, u) -> W as one more state, so that a scheme integrates both alike."""
    x, u, work = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("work")
    return ca.Function(
        "ode_and_work",
        [ca.vertcat(x, work), u],
        [ca.vertcat(ode(x, u), power(x, u))],
        ["z", "u"],
        ["zdot"],
    )


def equations(model: Model, power: ca.Function | None) -> ca.Function:
    """Return the model's ode (x, w) -> xdot, w the control and below it the parameters; with `power` (x, w) -> W as `add_work` does."""
    ode = model.stacked(model.ode)
    return ode if power is None else add_work(ode, power)


def check_ode(ode: ca.Function) -> None:
    """Raise TypeError or ValueError unless `ode` is a CasADi Function (x, u) -> xdot with columns x and xdot of one length."""
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
    """Raise TypeError unless `scheme` is a scheme (and not, for instance, the class without parentheses)."""
    if isinstance(scheme, type) or not isinstance(scheme, Scheme):
        lacks = [name for name in _MEMBERS if not hasattr(scheme, name)]
        why = (
            ""
            if isinstance(scheme, type) or len(lacks) == len(_MEMBERS)
            else f" and lacks {', '.join(lacks)}"
        )
        raise TypeError(
            f"{field} is {shown(scheme)}{why}: give an integration scheme, such as RungeKutta4()"
        )


def stability_limit(scheme: Scheme, direction: Complex, reach: float = 50.0) -> Array:
    """Return the largest r such that |R(s z)| ≤ 1 for 0 ≤ s ≤ r, along each `direction` z; infinite where that holds up to r |z| = `reach`.

    `direction` is an array (k,) of non-zero complex numbers, for instance eigenvalues: r is then
    the largest stable step. A direction that grows by itself (real part > 0) counts as one on the
    imaginary axis: growth of the motion is no instability of the scheme.
    """
    z = np.where(direction.real > 0, 1j * np.abs(direction), direction)
    unit = z / np.abs(z)
    # The neutral tolerance admits rounding, and methods whose |R| exceeds one on the imaginary axis
    # by less than any run would notice.
    grid = np.linspace(0, reach, 2001)
    unstable = np.abs(scheme.amplification(np.multiply.outer(unit, grid))) > 1 + 1e-9
    first = np.argmax(unstable, axis=1)
    low, high = grid[np.maximum(first - 1, 0)], grid[first]
    for _ in range(40):
        middle = (low + high) / 2
        outside = np.abs(scheme.amplification(unit * middle)) > 1 + 1e-9
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    return np.where(unstable.any(axis=1), low / np.abs(z), np.inf)
