"""Equation of motion: forces, multipliers λ̂ and Ω, accelerations."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.constraint_forces import (
    assemble_system,
    call_weighted,
    nodal_forces,
    recover_multipliers,
)
from tenscasadi.util.casadi_tools import block_inverse, sparse
from tenscasadi.util.linear_algebra import solve_semidefinite

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism
    from tenscasadi.dynamics.state_space import StateSpace


def forward_dynamics(
    space: StateSpace, N: Any, V: Any, u: Any, time: Any, mode: Any = None
) -> tuple[Any, Any, Any]:
    """Compute accelerations N̈ and multipliers λ and Ω.

    Parameters
    ----------
    space : StateSpace
        Scene, mechanism and moved supports.
    N, V : casadi matrix, shape (3, n)
        Nodes [m] and velocities [m/s], in the columns of the mechanism.
    u : casadi column, shape (nu + np + na,)
        Control, followed by the parameters and the internal states.
    time : casadi scalar
        Time, s.
    mode : casadi row, shape (1, k), optional
        Fixed mode of strings and contacts between two events, see `build_elements`.

    Returns
    -------
    tuple of casadi matrices
        N̈ (3×n), m/s²; λ (1×β), N/m; Ω (3×c), N.

    Notes
    -----
    In small models, the expressions before and after the linear system are scalar code.
    """
    mech = space.with_masses(u)
    F, B, r, *system = call_weighted(mech, partial(_assemble, space, mode), N, V, u, time)
    solution = solve_semidefinite(*system) if system else ca.DM.zeros(0, 1)
    A, lam, Omega = call_weighted(mech, partial(_recover, space), F, B, r, solution, time)
    return A, lam, Omega


def _assemble(
    space: StateSpace, mode: Any, mech: Mechanism, N: Any, V: Any, u: Any, time: Any
) -> tuple[Any, ...]:
    """Compute forces F, bar vectors B, and the multipliers' linear system.

    N and V (3×n) are node positions and velocities, and u is the stacked input. `space` and `mode`
    are those of `forward_dynamics`, and `mech` has the masses in u. Returns F (3×n), B (3×β), and
    the residuals r (1×β) of ḃᵀḃ + bᵀb̈ = 0 without constraint forces. Matrix and right-hand side of
    the system follow if it has unknowns.
    """
    F, moved = compute_forces(space, N, V, u, time, mode, mech)  # 3×n, Eq. 67
    B, Bd = mech.bar_vectors(N), mech.bar_vectors(V)  # 3×β
    Bdd = mech.with_inverse(F, mech.C_b.T) + mech.bar_vectors(moved)  # 3×β, without bar forces
    r = ca.sum1(Bd * Bd) + ca.sum1(B * Bdd)  # 1×β: the constraint ḃᵀḃ + bᵀb̈ = 0, Eq. 28
    if not mech.system_size:
        return F, B, r
    # 3×c: the constraint N̈ P = D̈, Eq. 84
    R = mech.with_inverse(F, mech.P) - space.targets(time)[2]
    return F, B, r, *assemble_system(mech, B, r, R)  # Eq. 103


def _recover(
    space: StateSpace, mech: Mechanism, F: Any, B: Any, r: Any, solution: Any, time: Any
) -> tuple[Any, ...]:
    """Compute N̈, λ and Ω from the solution of the linear system.

    `mech`, F, B and r are those of `_assemble`, whose linear system has this `solution`. `space` is
    that of `forward_dynamics`.
    """
    lam, Omega = recover_multipliers(mech, B, r, solution)  # 1×β, Eq. 87; 3×c, Eq. 103
    return _accelerations(space, mech, F, B, lam, Omega, time), lam, Omega


def _accelerations(
    space: StateSpace, mech: Mechanism, F: Any, B: Any, lam: Any, Omega: Any, time: Any
) -> Any:
    """Compute the accelerations N̈ (3×n) from the multipliers, Eqs. 85-86.

    F (3×n) are the applied forces, B (3×β) the bar vectors, `lam` is λ (1×β) and `Omega` is Ω
    (3×c). `space` has the accelerations of moving supports.
    """
    return mech.with_inverse(F + nodal_forces(mech, B, lam, Omega)) + space.support_accelerations(
        time
    )


def compute_forces(
    space: StateSpace,
    N: Any,
    V: Any,
    u: Any,
    time: Any,
    mode: Any = None,
    mech: Mechanism | None = None,
) -> tuple[Any, Any]:
    """Compute applied forces F (3×n) [N] and support accelerations.

    F are the forces of strings and loads minus the inertia of moving supports. The support
    accelerations are 3×n [m/s²]. The accelerations without constraints are F M⁻ plus these. The
    other arguments are those of `forward_dynamics`. `mech` is the mechanism with the masses of u,
    if it is known.
    """
    moved, mech = space.support_accelerations(time), mech or space.with_masses(u, inverse=False)
    u = space.add_schedule(u, time)
    total = forces.total(space.scene, mech, N, V, u, time, mode)
    return total - ca.mtimes(moved, sparse(mech.M)), moved


def joint_forces(
    space: StateSpace, full: Mechanism, N: Any, V: Any, A: Any, lam: Any, u: Any, time: Any
) -> Any:
    """Compute joint forces Ω (3×c) [N] in reduced coordinates.

    They follow from the force balance of separate bars, Eq. 85. N, V and A (3×n) are positions,
    velocities and accelerations of the shared nodes, `lam` is λ (1×β), and u is the stacked input.
    `space` has the scene, and `full` the mechanism in full coordinates, with joints.
    """
    if not full.joints:
        return ca.DM.zeros(3, 0)
    if full.masses is not None:
        full = full.with_masses(full.masses.weigh(u[space.nu : space.nw]))
    N, V, A = (Z[:, full.physical.tolist()] for Z in (N, V, A))
    known = forces.total(space.scene, full, N, V, space.add_schedule(u, time), time)
    lacking = (
        ca.mtimes(A, sparse(full.M)) - known - nodal_forces(full, full.bar_vectors(N), lam)
    )  # Ω Pᵀ
    P = full.P  # its columns are independent, and PᵀP couples those of one node only
    return ca.mtimes(lacking, sparse(P @ block_inverse(P.T @ P, np.ones(full.joints, bool))))
