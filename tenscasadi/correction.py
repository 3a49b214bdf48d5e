"""Corrections of a state that has left its constraints: bars of another length, joints that gape, velocities that would do either."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from tenscasadi import dynamics
from tenscasadi.dynamics import Mechanism, sparse
from tenscasadi.model import Model
from tenscasadi.validate import whole_number


@dataclass(frozen=True)
class Projection:
    """All bars and joints at once, by the smallest movement in the sense of the mass matrix, after `every` steps.

    Newton's method in position (`iterations` steps; bars that stand alone need one, in closed form), then one linear
    solve for velocities. Unlike Appendix C it also serves closed loops of bars and string nodes (design of the joint projection:
    min tr(ΔN M ΔNᵀ)/2 subject to the linearised constraints). Linear and angular momentum are kept; energy is not exactly.
    """

    every: int = 1
    iterations: int = 3

    def __post_init__(self) -> None:
        whole_number("Projection.every", self.every, 1)
        whole_number("Projection.iterations", self.iterations, 1)

    def step(self, model: Model) -> ca.Function | None:
        """The Function (x) → x of one correction; None when the model has nothing to keep."""
        return projection(model, self.iterations) if model.mechanism.constrained else None


Correction = Projection


def projection(model: Model, iterations: int = 3) -> ca.Function:
    """(x) → x moved onto the constraints of `model`, mass-weighted; see `Projection`."""
    mech = model.mechanism
    unrolled = not mech.large and mech.system_size <= dynamics.UNROLL_SOLVE
    x: Any = (ca.SX if unrolled else ca.MX).sym("x", model.nx)
    N, V, time = model.unpack(x)
    if mech.system_size:
        for _ in range(iterations):
            N = _newton(mech, N)
    elif mech.constrained:
        N = _rescale(mech, N)
    if mech.constrained:
        V = _without_stretching(mech, N, V)
    return ca.Function("project", [x], [model.pack(N, V, time)], ["x"], ["projected"])


def _newton(mech: Mechanism, N: Any) -> Any:
    """One Newton step on ½(bᵀb − l²) = 0 and N P = D."""
    B = ca.mtimes(N, sparse(mech.C_b.T))
    excess = (ca.sum1(B * B) - ca.DM(mech.lengths**2).T) / 2
    return _moved(mech, N, B, excess, ca.mtimes(N, sparse(mech.P)) - ca.DM(mech.D))


def _rescale(mech: Mechanism, N: Any) -> Any:
    """Bars that stand alone: b (1 + μ G_ii) has its length back at once."""
    B = ca.mtimes(N, sparse(mech.C_b.T))
    stretch = ca.DM(mech.lengths).T / ca.sqrt(ca.sum1(B * B)) - 1
    return N + dynamics.reaction(mech, B, stretch / ca.DM(mech.G()[0].diagonal()).T, ca.DM.zeros(3, 0))


def _without_stretching(mech: Mechanism, N: Any, V: Any) -> Any:
    """V with bᵀḃ = 0 and V P = 0."""
    B, Bd = (ca.mtimes(Z, sparse(mech.C_b.T)) for Z in (N, V))
    return _moved(mech, V, B, ca.sum1(B * Bd), ca.mtimes(V, sparse(mech.P)))


def _moved(mech: Mechanism, Z: Any, B: Any, r: Any, R: Any) -> Any:
    """Z + (B λ̂ C_b + Ω Pᵀ) M⁻ with the multipliers that take away the residuals r (bars) and R (joints)."""

    def linear(B: Any, r: Any, R: Any) -> tuple[Any, ...]:
        return dynamics.system(mech, B, r, R)

    def moved(Z: Any, B: Any, r: Any, solution: Any) -> tuple[Any, ...]:
        return (Z + dynamics.reaction(mech, B, *dynamics.multipliers(mech, B, r, solution)),)

    solution: Any = ca.DM.zeros(0, 1)
    if mech.system_size:
        solution = dynamics.solve_semidefinite(*dynamics.staged(mech.large, linear, B, r, R))
    return dynamics.staged(mech.large, moved, Z, B, r, solution)[0]
