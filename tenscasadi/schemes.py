"""Integration schemes as values: each turns x' = ode(x, u) into one step x⁺ = step(x, u, h), a CasADi Function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.validate import Array, finite_array, instance

Complex = NDArray[np.complex128]


@runtime_checkable
class Scheme(Protocol):
    """What every integration scheme offers. A scheme is a frozen value: it holds options, never state."""

    @property
    def order(self) -> int:
        """Order p of convergence: the error after a fixed time falls like step^p."""

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next."""

    def amplification(self, z: Complex) -> Complex:
        """R(z): the factor by which one step multiplies y when y' = λ y and z = step · λ."""


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method with s stages for an ode without explicit time.

    `a` holds s rows, row i with the i weights of the earlier stages; `b` holds the s weights of the result.
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or any(len(row) != i for i, row in enumerate(self.a)):
            rows = [len(row) for row in self.a]
            raise ValueError(f"a has rows of {rows} weights: give rows of {list(range(len(self.b)))} for {len(self.b)} stages (b)")
        for i, row in enumerate((*self.a, self.b)):
            finite_array("b" if i == len(self.a) else f"a[{i}]", row, (len(row),))

    @property
    def c(self) -> tuple[float, ...]:
        """Times of the stages, as fractions of the step: the row sums of `a`."""
        return tuple(sum(row) for row in self.a)

    def stability_polynomial(self) -> Array:
        """Coefficients, lowest power first, of R(z) = 1 + Σ z^(k+1) bᵀ aᵏ 1, shape (s + 1,)."""
        stages = len(self.b)
        a = np.array([list(row) + [0.0] * (stages - len(row)) for row in self.a])
        coefficients, vector = [1.0], np.ones(stages)
        for _ in range(stages):
            coefficients.append(float(np.dot(self.b, vector)))
            vector = a @ vector
        return np.array(coefficients)

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of the method: Function "step" (x, u, h) -> x_next that calls `ode` once a stage."""
        # Calls instead of inlined copies: code stays as small as ode's, and compiles and runs faster than one unrolled graph.
        x, u, h = ca.MX.sym("x", ode.sparsity_in(0)), ca.MX.sym("u", ode.sparsity_in(1)), ca.MX.sym("h")
        slopes: list[ca.MX] = []
        for row in self.a:
            slopes.append(ode(_advance(x, h, row, slopes), u))
        return ca.Function("step", [x, u, h], [_advance(x, h, self.b, slopes)], ["x", "u", "h"], ["x_next"])


def _advance(x: ca.MX, h: ca.MX, weights: tuple[float, ...], slopes: list[ca.MX]) -> ca.MX:
    """x + h Σ weight · slope, with slopes of equal weight added first: each product is a pass over the state."""
    for weight in dict.fromkeys(weights):
        if weight:
            total = sum(slope for slope, own in zip(slopes, weights, strict=True) if own == weight)
            x = x + (weight * h) * total
    return x


@dataclass(frozen=True)
class RungeKutta4:
    """The classical explicit Runge-Kutta method: order 4, four evaluations a step, stable for step · ω_max < 2.83."""

    tableau: ClassVar[Tableau] = Tableau(a=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), b=(1 / 6, 1 / 3, 1 / 3, 1 / 6))
    order: ClassVar[int] = 4

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of x' = ode(x, u) with u held: Function "step" (x, u, h) -> x_next. TypeError, ValueError: not such an ode."""
        check_ode(ode)
        return self.tableau.step(ode)

    def amplification(self, z: Complex) -> Complex:
        """R(z) = 1 + z + z²/2 + z³/6 + z⁴/24."""
        return np.asarray(np.polynomial.polynomial.polyval(z, self.tableau.stability_polynomial()), dtype=complex)

    @property
    def imaginary_limit(self) -> float:
        """Largest stable step · ω of an undamped vibration at ω rad/s: 2√2."""
        return float(stability_limit(self, np.array([1j]))[0])

    @property
    def real_limit(self) -> float:
        """Largest stable step · rate of an overdamped motion: 2.785."""
        return float(stability_limit(self, np.array([-1.0 + 0j]))[0])


def check_ode(ode: ca.Function) -> None:
    """TypeError or ValueError unless `ode` is a CasADi Function (x, u) -> xdot with columns x and xdot of one length."""
    instance("ode", ode, ca.Function, "a casadi.Function (x, u) -> xdot")
    if ode.n_in() != 2 or ode.n_out() != 1 or ode.size_out(0) != ode.size_in(0) or ode.size2_in(0) != 1:
        raise ValueError(f"ode is {ode}: give a casadi.Function (x, u) -> xdot with columns x and xdot of the same length")


def check_scheme(scheme: Scheme) -> None:
    """TypeError unless `scheme` is a scheme (and not, for instance, the class without parentheses)."""
    if isinstance(scheme, type) or not isinstance(scheme, Scheme):
        raise TypeError(f"scheme is {scheme!r}: give an integration scheme, such as RungeKutta4()")


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
