"""Integration schemes as values: each turns a model, or x' = ode(x, u), into one step x⁺ = step(x, u, h), a CasADi Function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.tableaux import CLASSICAL, DORMAND_PRINCE_54, DORMAND_PRINCE_853, Tableau
from tenscasadi.util.validate import Array, instance, positive_number, whole_number

Complex = NDArray[np.complex128]


@runtime_checkable
class Scheme(Protocol):
    """What every integration scheme offers. A scheme is a frozen value: it holds options, never state."""

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
        """One step of a model with u held: Function "step" (z, u, h) -> z_next, z = x.

        With `power` (x, u) -> W, z holds one entry more: the work that it has done, J. TypeError for anything but a Model.
        """

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of any x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next. TypeError where the scheme needs a model."""

    def amplification(self, z: Complex) -> Complex:
        """R(z): the factor by which one step multiplies y when y' = λ y and z = step · λ."""


_MEMBERS = ("order", "adaptive", "implicit", "advance", "step", "amplification")


class ExplicitRungeKutta:
    """What the explicit Runge-Kutta methods share: all is in their `tableau`."""

    tableau: ClassVar[Tableau]
    implicit: ClassVar[bool] = False

    @property
    def adaptive(self) -> bool:
        """Whether the scheme chooses its steps in `simulate`."""
        return False

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next. TypeError, ValueError: not such an ode."""
        check_ode(ode)
        return self.tableau.step(ode)

    def advance(self, model: Model, power: ca.Function | None = None) -> ca.Function:
        """One step of a model: see `Scheme.advance`."""
        instance("model", model, Model, "a tenscasadi.Model")
        return self.step(model.ode if power is None else with_work(model.ode, power))

    def amplification(self, z: Complex) -> Complex:
        """R(z): the method's stability polynomial."""
        return np.asarray(np.polynomial.polynomial.polyval(z, self.tableau.stability_polynomial()), dtype=complex)

    @property
    def imaginary_limit(self) -> float:
        """Largest stable step · ω of an undamped vibration at ω rad/s."""
        return float(stability_limit(self, np.array([1j]))[0])  # type: ignore[arg-type]

    @property
    def real_limit(self) -> float:
        """Largest stable step · rate of an overdamped motion."""
        return float(stability_limit(self, np.array([-1.0 + 0j]))[0])  # type: ignore[arg-type]


@dataclass(frozen=True)
class RungeKutta4(ExplicitRungeKutta):
    """The classical explicit Runge-Kutta method: order 4, four evaluations a step, stable for step · ω_max < 2.83."""

    tableau: ClassVar[Tableau] = CLASSICAL
    order: ClassVar[int] = 4


@dataclass(frozen=True)
class EmbeddedRungeKutta(ExplicitRungeKutta):
    """Explicit methods with an estimate of their error: fixed steps, or steps of their own size when `rtol` is given.

    rtol: largest error of a step relative to each entry of the state; None: fixed steps and no control of errors. atol: what is added
    to it, m and m/s; None: rtol times the structure's extent. Errors are root mean squares over all coordinates and velocities; after
    many steps the motion is off by more, by a factor that depends on the motion.
    Steps end where strings go slack or taut and where nodes meet or leave the ground, so that the order is kept across such events.
    max_attempts: steps and repetitions, between two times of the grid that `simulate` lays, before the run is given up.
    """

    rtol: float | None = None
    atol: float | None = None
    max_attempts: int = 100_000
    order: ClassVar[int]

    def __post_init__(self) -> None:
        name = type(self).__name__
        if self.rtol is not None:
            object.__setattr__(self, "rtol", relative_tolerance(f"{name}.rtol", self.rtol))
        if self.atol is not None:
            if self.rtol is None:
                raise ValueError(f"{name}.atol is {self.atol}, but rtol is None: give both for control of the error, or neither")
            object.__setattr__(self, "atol", positive_number(f"{name}.atol", self.atol, zero=True))
        whole_number(f"{name}.max_attempts", self.max_attempts, 1)

    @property
    def adaptive(self) -> bool:
        """Whether the scheme chooses its steps in `simulate`."""
        return self.rtol is not None

    def tolerances(self, model: Model) -> tuple[float, float]:
        """rtol and atol for a model. ValueError for fixed steps."""
        if self.rtol is None:
            raise ValueError(f"{type(self).__name__}.rtol is None: give a tolerance for control of the error")
        return self.rtol, extent(model) * self.rtol if self.atol is None else self.atol


@dataclass(frozen=True)
class DormandPrince54(EmbeddedRungeKutta):
    """Dormand and Prince's explicit method of order 5: six evaluations a step, stable for step · ω_max < 1 (3.3 for overdamped motion).

    `rtol`, `atol`, `max_attempts`: control of the error, see `EmbeddedRungeKutta`; None: fixed steps.
    """

    tableau: ClassVar[Tableau] = DORMAND_PRINCE_54
    order: ClassVar[int] = 5


@dataclass(frozen=True)
class DormandPrince853(EmbeddedRungeKutta):
    """Dormand and Prince's explicit method of order 8, as in DOP853: twelve evaluations a step, stable for step · ω_max < 5.96.

    `rtol`, `atol`, `max_attempts`: control of the error, see `EmbeddedRungeKutta`; None: fixed steps.
    """

    tableau: ClassVar[Tableau] = DORMAND_PRINCE_853
    order: ClassVar[int] = 8


def relative_tolerance(field: str, value: Any) -> float:
    """`value` as a float ≥ 1e-15 and < 1. Raises TypeError, ValueError."""
    rtol = positive_number(field, value)
    if rtol < 1e-15 or rtol >= 1:
        raise ValueError(f"{field} is {rtol:g}: give 1e-15 or more, which is rounding, and less than 1")
    return rtol


def extent(model: Model) -> float:
    """The largest distance along an axis between two nodes of the structure, m; 1 where there is one node. TypeError for anything but a Model."""
    instance("model", model, Model, "a tenscasadi.Model")
    return float(np.ptp(model.structure.nodes, axis=0).max()) or 1.0


def with_work(ode: ca.Function, power: ca.Function) -> ca.Function:
    """(z, u) -> zdot: the ode with the work of `power` (x, u) -> W as one more state, so that a scheme integrates both alike."""
    x, u, work = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("work")
    return ca.Function("ode_and_work", [ca.vertcat(x, work), u], [ca.vertcat(ode(x, u), power(x, u))], ["z", "u"], ["zdot"])


def check_ode(ode: ca.Function) -> None:
    """TypeError or ValueError unless `ode` is a CasADi Function (x, u) -> xdot with columns x and xdot of one length."""
    instance("ode", ode, ca.Function, "a casadi.Function (x, u) -> xdot")
    if ode.n_in() != 2 or ode.n_out() != 1 or ode.size_out(0) != ode.size_in(0) or ode.size2_in(0) != 1:
        raise ValueError(f"ode is {ode}: give a casadi.Function (x, u) -> xdot with columns x and xdot of the same length")


def check_scheme(scheme: Scheme) -> None:
    """TypeError unless `scheme` is a scheme (and not, for instance, the class without parentheses)."""
    if isinstance(scheme, type) or not isinstance(scheme, Scheme):
        lacks = [name for name in _MEMBERS if not hasattr(scheme, name)]
        why = "" if isinstance(scheme, type) or len(lacks) == len(_MEMBERS) else f" and lacks {', '.join(lacks)}"
        raise TypeError(f"scheme is {scheme!r}{why}: give an integration scheme, such as RungeKutta4()")


def stability_limit(scheme: Scheme, direction: Complex, reach: float = 50.0) -> Array:
    """Largest r such that |R(s z)| ≤ 1 for all 0 ≤ s ≤ r, along each `direction` z; infinite where no instability shows up to r |z| = `reach`.

    `direction` is an array (k,) of non-zero complex numbers, for instance eigenvalues: r is then the largest stable step.
    A direction that grows by itself (real part > 0) counts as one on the imaginary axis: growth of the motion is no instability of the scheme.
    """
    z = np.where(direction.real > 0, 1j * np.abs(direction), direction)
    unit = z / np.abs(z)
    # The neutral tolerance admits rounding, and methods whose |R| exceeds one on the imaginary axis by less than any run would notice.
    grid = np.linspace(0, reach, 2001)
    unstable = np.abs(scheme.amplification(np.multiply.outer(unit, grid))) > 1 + 1e-9
    first = np.argmax(unstable, axis=1)
    low, high = grid[np.maximum(first - 1, 0)], grid[first]
    for _ in range(40):
        middle = (low + high) / 2
        outside = np.abs(scheme.amplification(unit * middle)) > 1 + 1e-9
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    return np.where(unstable.any(axis=1), low / np.abs(z), np.inf)
