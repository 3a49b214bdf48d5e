"""Rattle, a symplectic scheme with exact constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from tenscasadi.dynamics.constraint_forces import (
    call_weighted,
    project_velocities,
    remove_residuals,
    residuals,
    stretch_bars,
)
from tenscasadi.dynamics.equation_of_motion import compute_forces
from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Complex, NamedScheme
from tenscasadi.integrators.tableaux import CLASSICAL, MIDPOINT, SUZUKI, Tableau
from tenscasadi.scene.dissipation import has_friction, is_damped
from tenscasadi.util.validate import Array, Count, format_value

_FRACTIONS: dict[int, Array] = {2: np.ones(1), 4: SUZUKI}
_KICKS = {2: MIDPOINT, 4: CLASSICAL}


@dataclass(frozen=True)
class Rattle(NamedScheme, kind="Rattle"):
    """Symplectic, reversible scheme with exact bars and joints.

    The order is 2 or 4. A step drifts for half its length without forces, kicks the velocities by
    the forces at its middle, and drifts again. Without damping and friction, the energy error
    stays bounded by a multiple of step² (step⁴) for any duration. The scheme is stable for step ·
    ω_max < 2 (order 4: 2.72, at five times the work), with ω_max the highest angular frequency
    [rad/s]. No bar may turn by 90° in half a step.

    Parameters
    ----------
    order : int
        2, or 4 as a composition of five steps.
    iterations : int
        Newton's iterations for bars that share nodes; other bars need none.

    Raises
    ------
    TypeError, ValueError
        If `order` is neither 2 nor 4, or `iterations` no whole number of 1 or more.

    Notes
    -----
    A drift is the step of [1]_ without forces. It satisfies bars and joints to rounding, by
    impulses along the initial bars for positions and along the final bars for velocities. A
    separate bar needs the root of a quadratic and a division. Bars that share nodes need Newton's
    method with the matrix at the start of the drift. Each iteration reduces the error by about the
    angle that bars turn in half a step. Further iterations with the matrix at the end serve bars
    that align. Moving supports are at their prescribed positions after each drift.

    A kick is the flow of V' = F(N, V) M⁻ on the tangent space at the middle of the step. It is
    exact with one evaluation of the forces if no force depends on velocity [2]_. The explicit
    midpoint rule (order 4: the classical Runge-Kutta method) integrates string damping, ground
    damping and friction within the kick, with two (four) evaluations. That keeps the order but is
    not symplectic. The same rule integrates internal states, such as rest lengths, over half a step
    before and after the kick.

    References
    ----------
    .. [1] H. C. Andersen, Rattle: a "velocity" version of the Shake algorithm, Journal of
       Computational Physics 52, 1983, 24-34.
    .. [2] E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, sections VII.1, IX.3
       and IX.5.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> run = tc.simulate(model, 0.5, step=5e-3, scheme=tc.Rattle(), compiled=False)
    >>> bool(run.bar_length_error.max() < 1e-14)
    True
    """

    order: int = 2
    iterations: Count = 6
    adaptive: ClassVar[bool] = False
    implicit: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if (
            not isinstance(self.order, (int, np.integer))
            or isinstance(self.order, bool)
            or self.order not in _FRACTIONS
        ):
            raise ValueError(f"Rattle.order is {format_value(self.order)}: give 2 or 4")
        super().__post_init__()

    def step(self, ode: ca.Function) -> ca.Function:
        """Reject an ordinary differential equation.

        It does not separate bars from forces.

        Parameters
        ----------
        ode : casadi.Function
            Function (x, u) → ẋ.

        Returns
        -------
        casadi.Function
            Never.

        Raises
        ------
        TypeError
            Always: use `advance`, or another scheme.
        """
        raise TypeError(
            f"Rattle steps a tenscasadi.Model, {ode} does not separate bars from forces: use advance(model), or another scheme such as RungeKutta4()"
        )

    def _build_advance(self, model: Model, power: ca.Function | None) -> ca.Function:
        leap = _leap(model, power, _KICKS[self.order], self.iterations)
        start = z = ca.MX.sym("z", leap.size1_in(0))
        u, h = ca.MX.sym("u", model.nw), ca.MX.sym("h")
        for fraction in _FRACTIONS[self.order]:
            z = leap(z, u, fraction * h)
        return ca.Function("step", [start, u, h], [z], ["z", "u", "h"], ["z_next"])

    def amplification(self, z: Complex) -> Complex:
        """Compute the largest amplification of a vibration in one step.

        Parameters
        ----------
        z : ndarray of complex
            step · λ, of any shape.

        Returns
        -------
        ndarray of complex
            Largest |eigenvalue| of the step of q'' = −ω² q − c q', of the shape of z. The roots of
            this equation are λ and its conjugate, or 0 for a real λ.
        """
        z = np.asarray(z, dtype=complex)
        total = np.broadcast_to(np.eye(2), (*z.shape, 2, 2))
        for fraction in _FRACTIONS[self.order]:
            total = _swing(z, fraction, _KICKS[self.order]) @ total
        return np.asarray(np.abs(np.linalg.eigvals(total)).max(axis=-1), dtype=complex)


def _swing(z: Complex, fraction: float, kick: Tableau) -> Any:
    """Compute the amplification matrix of drift, kick and drift.

    It is (…, 2, 2) and acts on (q, h v). This part takes `fraction` of the step h, and z = h λ. (q,
    h v) are position and scaled velocity of a damped vibration with the eigenvalue λ. `kick` is the
    Runge-Kutta method of the velocities.
    """
    damping = fraction * np.where(z.imag == 0, -z.real, -2 * z.real)
    squared = fraction * np.where(z.imag == 0, 0.0, np.abs(z) ** 2)
    # v' = −c v − ω² q with q held: R(−c) v − ω² q (R(−c) − 1)/(−c)
    coefficients = kick.stability_polynomial()
    kept = np.polynomial.polynomial.polyval(-damping, coefficients)
    pulled = -squared * np.polynomial.polynomial.polyval(-damping, coefficients[1:])
    one, zero = np.ones_like(kept), np.zeros_like(kept)
    kicks = np.stack([np.stack([one, zero], -1), np.stack([pulled, kept], -1)], -2)
    drift = np.array([[1, fraction / 2], [0, 1]])
    return drift @ kicks @ drift


def _leap(model: Model, power: ca.Function | None, kick: Tableau, iterations: int) -> ca.Function:
    """Build drift, kick and drift as Function (z, u, h) → z_next.

    The `kick` is the Runge-Kutta method for the velocities and internal states. Constraints are
    solved by `iterations` Newton iterations. With a Function `power`, z has one more entry, its
    integral. z is the state of the model, u the control with the parameters, and h the step [s].
    """
    kind: Any = ca.SX if model.mechanism.unrolled else ca.MX
    z, u, h = kind.sym("z", model.nx + (power is not None)), kind.sym("u", model.nw), kind.sym("h")
    mech, scene = model.with_masses(u), model.scene
    N, V, time = model.unpack(z[: model.nx])
    own = model.split(z[: model.nx]).internal

    def drift(N: Any, V: Any, time: Any) -> tuple[Any, Any, Any]:
        later = time + h / 2
        free = place_nodes(N + h / 2 * V, V, later)[0]
        moved = _constrain(mech, free, N, model.targets(later)[0], iterations)
        return place_nodes(moved, V + (moved - free) / (h / 2), later)

    def place_nodes(N: Any, V: Any, time: Any) -> tuple[Any, Any, Any]:
        """Move supports to their prescribed positions at a time.

        N and V (3×n) are node positions and velocities. Returns both with those of the supports,
        and the time [s].
        """
        return model.unpack(model.pack(N, V, own, time))

    def tangent(N: Any, V: Any, time: Any) -> Any:
        return project_velocities(mech, N, V, model.targets(time)[1])

    def turn(N: Any, V: Any, own: Any, time: Any) -> Any:
        """Advance the internal states `own` (na) by half a step at fixed nodes.

        N and V (3×n) are node positions and velocities at `time`.
        """
        slopes: list[Any] = []
        for row in kick.a if model.na else ():
            stage = own + h / 2 * _sum_slopes(row, slopes) if any(row) else own
            slopes.append(model.internal_rates(model.pack(N, V, stage, time), u))
        return own + h / 2 * _sum_slopes(kick.b, slopes) if model.na else own

    def acceleration(mech: Mechanism, N: Any, V: Any, u: Any, time: Any) -> tuple[Any, ...]:
        return (mech.with_inverse(compute_forces(model, N, V, u, time, mech=mech)[0]),)

    N, V, time = drift(N, V, time)
    rough = is_damped(scene) or has_friction(scene)
    if rough or power is not None or model.na:
        V = tangent(N, V, time)
    before, own = V, turn(N, V, own, time)
    given = ca.vertcat(u, own) if model.na else u
    if rough:
        slopes: list[Any] = []
        for row in kick.a:
            stage = tangent(N, V + h * _sum_slopes(row, slopes), time) if any(row) else V
            slopes.append(call_weighted(mech, acceleration, N, stage, given, time)[0])
        V = tangent(N, V + h * _sum_slopes(kick.b, slopes), time)
    else:
        V = tangent(N, V + h * call_weighted(mech, acceleration, N, V, given, time)[0], time)
    supplied = (
        []
        if power is None
        else [z[model.nx] + h * power(model.pack(N, (before + V) / 2, own, time), u)]
    )
    own = turn(N, V, own, time)

    N, V, time = drift(N, V, time)
    end = ca.vertcat(model.pack(N, tangent(N, V, time), own, time), *supplied)
    return ca.Function("leap", [z, u, h], ca.cse([end]), ["z", "u", "h"], ["z_next"])


def _sum_slopes(weights: tuple[float, ...], slopes: list[Any]) -> Any:
    return sum(weight * slope for weight, slope in zip(weights, slopes, strict=True) if weight)


def _constrain(mech: Mechanism, free: Any, N: Any, D: Any, iterations: int) -> Any:
    """Find positions (3×n) that satisfy bar and joint constraints.

    Displacements along the bars at the earlier positions N (3×n) correct the `free` positions
    (3×n), which ignore the constraints. `mech` has the bars and joints. D (3×c) are the prescribed
    positions of joints N P = D. Coupled constraints are solved by the given number of Newton
    `iterations`.
    """
    if not mech.constrained:
        return free
    B, lengths = mech.bar_vectors(N), ca.DM(mech.lengths).T
    if mech.system_size:
        return _newton(mech, free, B, D, iterations)
    b = mech.bar_vectors(free)
    # ‖b + ν B‖² = l²: the root nearest zero
    mixed, excess = ca.sum1(b * B), ca.sum1(b * b) - lengths**2
    nu = -excess / (mixed + ca.sqrt(mixed**2 - ca.sum1(B * B) * excess))
    return stretch_bars(mech, free, B, nu)


def _newton(mech: Mechanism, free: Any, B: Any, D: Any, iterations: int) -> Any:
    """Find positions (3×n) that satisfy coupled constraints, by Newton's method.

    It starts at the `free` positions (3×n), with impulses along the bar vectors B (3×β) of `mech`.
    D (3×c) are the prescribed positions of joints N P = D. Where bars align, the impulses become
    dependent and the `iterations` would diverge. The best iterate is used; impulses along the
    current bars remove the remaining residual.
    """

    def residual(N: Any) -> tuple[Any, Any, Any]:
        excess, gap = residuals(mech, N, mech.bar_vectors(N), D)
        return (
            excess,
            gap,
            ca.norm_inf(
                ca.vertcat(
                    (excess / ca.DM(mech.lengths).T).T, ca.vec(mech.project_onto_constraints(gap))
                )
            ),
        )

    moved = free
    excess, gap, size = residual(moved)
    for _ in range(iterations):
        trial = remove_residuals(mech, moved, B, excess, gap)
        better = residual(trial)
        kept = better[2] < size
        moved, excess, gap, size = (
            ca.if_else(kept, new, old)
            for new, old in zip((trial, *better), (moved, excess, gap, size), strict=True)
        )
    for _ in range(2):
        moved = remove_residuals(mech, moved, mech.bar_vectors(moved), excess, gap)
        excess, gap, _ = residual(moved)
    return moved
