"""Explicit Runge-Kutta methods and the steps they take."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import TYPE_CHECKING, ClassVar

import casadi as ca
import numpy as np

from tenscasadi.integrators.scheme import (
    Complex,
    NamedScheme,
    RelativeTolerance,
    equations,
    extent,
    stability_limit,
)
from tenscasadi.integrators.tableaux import (
    CLASSICAL,
    DORMAND_PRINCE_54,
    DORMAND_PRINCE_853,
    Tableau,
)
from tenscasadi.util.validate import (
    Array,
    Count,
    NonNegative,
    format_value,
)

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

SEVERAL = 3  # weights: more are faster as one product of matrices, in building and in running


class ExplicitRungeKutta(NamedScheme):
    """Base class of explicit Runge-Kutta methods, given by a `tableau`."""

    tableau: ClassVar[Tableau]
    implicit: ClassVar[bool] = False

    @property
    def adaptive(self) -> bool:
        """Whether the scheme controls its error by the step size."""
        return False

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (s, s) and b (s,) of the stages that affect the result."""
        tableau, kept = self.tableau, sorted(select_stages(self.tableau))
        A = np.zeros((len(tableau.b),) * 2)
        for row, weights in zip(A, tableau.a, strict=True):
            row[: len(weights)] = weights
        return A[np.ix_(kept, kept)], np.array(tableau.b)[kept]

    def _build_step(self, ode: ca.Function) -> ca.Function:
        return build_step(self.tableau, ode)

    def _build_advance(self, model: Model, power: ca.Function | None) -> ca.Function:
        return self.step(equations(model, power))

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
            R(z), the method's stability polynomial, of the shape of z.
        """
        return np.asarray(
            np.polynomial.polynomial.polyval(z, self.tableau.stability_polynomial()), dtype=complex
        )

    @property
    def imaginary_limit(self) -> float:
        """Largest stable step · ω of an undamped vibration at ω [rad/s]."""
        return float(stability_limit(self, np.array([1j]))[0])  # type: ignore[arg-type]

    @property
    def real_limit(self) -> float:
        """Largest stable step · |λ| for real eigenvalues λ < 0 [1/s]."""
        return float(stability_limit(self, np.array([-1.0 + 0j]))[0])  # type: ignore[arg-type]


@dataclass(frozen=True)
class RungeKutta4(ExplicitRungeKutta, kind="RungeKutta4"):
    """Classical explicit Runge-Kutta method of order 4.

    A step takes four evaluations of the equations of motion. It is stable for step · ω_max < 2.83,
    with ω_max the highest angular frequency [rad/s].

    See Also
    --------
    stable_step : The largest stable step of a model.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, Table
    II.1.2.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> tc.simulate(model, 0.1, step=1e-3, scheme=tc.RungeKutta4(), compiled=False).message
    'finished 100 steps of 0.001 s'
    >>> round(tc.RungeKutta4().imaginary_limit, 4)
    2.8284
    """

    tableau: ClassVar[Tableau] = CLASSICAL
    order: ClassVar[int] = 4


@dataclass(frozen=True)
class EmbeddedRungeKutta(ExplicitRungeKutta):
    """Base class of explicit Runge-Kutta pairs with an error estimate.

    They take fixed steps, or choose their steps if `rtol` is given.
    """

    rtol: RelativeTolerance | None = None
    atol: NonNegative | None = None
    max_attempts: Count = 100_000
    order: ClassVar[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.atol is not None and self.rtol is None:
            raise ValueError(
                f"{type(self).__name__}.atol is {format_value(self.atol)}, but rtol is None: give both for control of the error, or neither"
            )

    @property
    def adaptive(self) -> bool:
        """Whether the scheme controls its error, as with `rtol`."""
        return self.rtol is not None

    def tolerances(self, model: Model) -> tuple[float, float]:
        """Return rtol and atol [m and m/s] for a model.

        Raises TypeError, and ValueError for fixed steps.
        """
        if self.rtol is None:
            raise ValueError(
                f"{type(self).__name__}.rtol is None: give a tolerance for control of the error"
            )
        return self.rtol, extent(model) * self.rtol if self.atol is None else self.atol


@dataclass(frozen=True)
class DormandPrince54(EmbeddedRungeKutta, kind="DormandPrince54"):
    """Dormand and Prince's explicit Runge-Kutta method of order 5.

    A step takes six evaluations of the equations of motion. Fixed steps are stable for step ·
    ω_max < 1 (vibrations at ω_max [rad/s]) and step · rate < 3.3 (overdamped motion).

    Parameters
    ----------
    rtol : float, optional
        Largest error of a step relative to each state entry, 1e-15 ≤ rtol < 1. None: fixed steps
        without error control.
    atol : float, optional
        Additional error [m and m/s]; None: `rtol` times the structure's extent.
    max_attempts : int
        Largest number of attempts, accepted or not, within a grid step of `simulate`.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds, or if `atol` is given without `rtol`.

    See Also
    --------
    DormandPrince853 : Order 8, cheaper for accurate runs.

    Notes
    -----
    With `rtol` the scheme chooses its steps. Errors are root mean squares over all coordinates and
    velocities. Over many steps they accumulate, by a factor that depends on the motion. Steps end
    where strings go slack or taut and where nodes meet or leave the ground. This keeps the order
    across such events.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, Table
    II.5.2 and section II.4.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> run = tc.simulate(model, 0.1, scheme=tc.DormandPrince54(rtol=1e-6), compiled=False)
    >>> bool(run.success), bool(run.bar_length_error.max() < 1e-6)
    (True, True)
    """

    tableau: ClassVar[Tableau] = DORMAND_PRINCE_54
    order: ClassVar[int] = 5


@dataclass(frozen=True)
class DormandPrince853(EmbeddedRungeKutta, kind="DormandPrince853"):
    """Dormand and Prince's explicit Runge-Kutta method of order 8.

    The error estimate is that of DOP853. A step takes twelve evaluations of the equations of
    motion. Fixed steps are stable for step · ω_max < 5.96, with ω_max the highest angular
    frequency [rad/s].

    Parameters
    ----------
    rtol : float, optional
        Largest error of a step relative to each state entry, 1e-15 ≤ rtol < 1. None: fixed steps
        without error control.
    atol : float, optional
        Additional error [m and m/s]; None: `rtol` times the structure's extent.
    max_attempts : int
        Largest number of attempts, accepted or not, within a grid step of `simulate`.

    Raises
    ------
    TypeError, ValueError
        If an option has another type or is out of bounds, or if `atol` is given without `rtol`.

    See Also
    --------
    DormandPrince54 : Order 5, cheaper for rough runs, with notes on error control.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section
    II.5.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> run = tc.simulate(model, 0.1, scheme=tc.DormandPrince853(rtol=1e-9), compiled=False)
    >>> bool(run.success), bool(run.bar_length_error.max() < 1e-9)
    (True, True)
    """

    tableau: ClassVar[Tableau] = DORMAND_PRINCE_853
    order: ClassVar[int] = 8


def build_step(tableau: Tableau, ode: ca.Function) -> ca.Function:
    """Build one step of a Runge-Kutta method.

    `ode` (x, u) → ẋ are the equations of motion, and `tableau` the coefficients. Function "step"
    (x, u, h) → x_next.
    """
    x, u, h = ca.MX.sym("x", ode.sparsity_in(0)), ca.MX.sym("u", ode.sparsity_in(1)), ca.MX.sym("h")
    slopes = _slopes(tableau, ode, x, u, h, select_stages(tableau))
    return ca.Function(
        "step", [x, u, h], [_advance(x, h, tableau.b, slopes)], ["x", "u", "h"], ["x_next"]
    )


def build_trial(tableau: Tableau, ode: ca.Function) -> ca.Function:
    """Build one step with error estimates.

    `ode` (x, u) → ẋ are the equations of motion. Function "trial" (x, u, h) → (x_next, errors,
    slope, slope_next). The errors are (nx, rows of `tableau.errors`). The slopes ẋ are those at x
    and x_next.
    """
    x, u, h = ca.MX.sym("x", ode.sparsity_in(0)), ca.MX.sym("u", ode.sparsity_in(1)), ca.MX.sym("h")
    slopes = _slopes(tableau, ode, x, u, h, set(range(len(tableau.b))))
    errors = ca.horzcat(*(_advance(ca.MX(x.shape[0], 1), h, row, slopes) for row in tableau.errors))
    after = _advance(x, h, tableau.b, slopes)
    end = slopes[-1] if repeats_last(tableau) else ode(after, u)
    outputs = [after, ca.densify(errors), slopes[0], end]
    return ca.Function(
        "trial", [x, u, h], outputs, ["x", "u", "h"], ["x_next", "errors", "slope", "slope_next"]
    )


def repeats_last(tableau: Tableau) -> bool:
    """Return whether the method is "first same as last".

    The last stage in `tableau` is then the first one of the next step.
    """
    return tableau.a[-1] == tableau.b[:-1] and tableau.b[-1] == 0


def _slopes(
    tableau: Tableau, ode: ca.Function, x: ca.MX, u: ca.MX, h: ca.MX, needed: set[int]
) -> list[ca.MX]:
    # Calls keep the code as small as that of `ode`. It compiles and runs faster than an unrolled
    # graph.
    slopes: list[ca.MX] = []
    for i, row in enumerate(tableau.a):
        slopes.append(ode(_advance(x, h, row, slopes), u) if i in needed else ca.MX(x.shape[0], 1))
    return slopes


def select_stages(tableau: Tableau) -> set[int]:
    """Find the stages that affect the result of a step.

    They are given by their indices. The last stage in the `tableau` of a "first same as last" pair
    is for its error estimate alone.
    """
    needed: set[int] = set()
    for i in reversed(range(len(tableau.a))):
        if any(row[i] for row in (tableau.b, *(tableau.a[k] for k in needed))):
            needed.add(i)
    return needed


def _advance(x: ca.MX, h: ca.MX, weights: tuple[float, ...], slopes: list[ca.MX]) -> ca.MX:
    """Compute x + h Σ weight · ẋ over the stages.

    The step of length h starts at the state x. `slopes` are the time derivatives ẋ of the stages,
    one for each of the `weights`. Stages of equal weight are added first, since each product is a
    pass over the state. Many weights become one matrix product.
    """
    used = {
        weight: reduce(add, (slopes[k] for k in equal))
        for weight, equal in equal_weights(weights).items()
    }
    if len(used) > SEVERAL:
        return x + ca.mtimes(ca.horzcat(*used.values()), h * ca.DM(list(used)))
    for weight, slope in used.items():
        x = x + (weight * h) * slope
    return x


def equal_weights(weights: tuple[float, ...]) -> dict[float, list[int]]:
    """Group the stages of a Runge-Kutta method by their nonzero weight.

    Returns the indices of the stages with each weight.
    """
    return {
        weight: [k for k, own in enumerate(weights) if own == weight]
        for weight in weights
        if weight
    }
