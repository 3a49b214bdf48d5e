"""Multipliers of rigid bars and joints, and their effects.

One formula applies to every class and to both coordinate sets. M⁻ is the inverse mass matrix on the
free coordinates, and B = N C_bᵀ. Let X be a 3×n matrix of accelerations or displacements without
constraints. The constrained one is

    X + (B λ̂ C_b + Ω Pᵀ) M⁻                         (Eqs. 85-87 with the current bᵀb instead of l²)

with λ̂ and Ω such that bᵢᵀ of its bar i is −rᵢ and its joints (times P) are −R. In reduced
coordinates joints are satisfied by construction and P has no columns. λ solves ((BᵀB) ∘ G) λ = −r
with G = C_b M⁻ C_bᵀ (Eqs. 94-95). In full coordinates every bar has its own nodes and G is
diagonal. λ̂ is eliminated bar by bar, and Ω solves Eq. 103 (corrected, and symmetric).

In the functions, `mech` has the constant matrices of the structure. N and V (3×n) are node
positions and velocities, and B (3×β) are the vectors b of the β rigid bars. N P = D are c joint
constraints with prescribed positions D (3×c).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.util.casadi_tools import (
    call_as_sx,
    diagonal_row,
    entries_at,
    matrix_with_pattern,
    multiply_rows,
    number_nonzeros,
    product,
    scale_and_multiply,
    sparse,
)
from tenscasadi.util.linear_algebra import solve_semidefinite

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism


class RedundantConstraints(UserWarning):
    """Warning of redundant bar and joint constraints at the start.

    `Model` issues it. The motion is exact if the constraints remain consistent, but their
    multipliers are not unique. The message names the bars or joints.
    """


def residuals(mech: Mechanism, N: Any, B: Any, D: Any) -> tuple[Any, Any]:
    """Compute the constraint residuals of bars and joints.

    B are the bar vectors b (3×β) at nodes N (3×n), and D (3×c) the prescribed joint positions. The
    residuals are ½(bᵀb − l²) (1×β) [m²] for bar lengths l, and N P − D (3×c) [m].
    """
    return (ca.sum1(B * B) - ca.DM(mech.lengths**2).T) / 2, ca.mtimes(N, sparse(mech.P)) - D


def residual_rates(mech: Mechanism, V: Any, B: Any, Dd: Any) -> tuple[Any, Any]:
    """Compute the time derivatives of the constraint residuals.

    They are bᵀḃ (1×β) [m²/s] for bar vectors b (columns of B) and V P − Ḋ (3×c) [m/s]. V (3×n) are
    node velocities, and `Dd` is Ḋ (3×c), the prescribed velocities of joints.
    """
    return ca.sum1(B * mech.bar_vectors(V)), ca.mtimes(V, sparse(mech.P)) - Dd


# --- the three steps: assemble the linear system, solve it, apply the multipliers ---


def assemble_system(mech: Mechanism, B: Any, r: Any, R: Any) -> tuple[Any, Any]:
    """Assemble the symmetric linear system for the multipliers.

    B (3×β) are the bar vectors; r (1×β) and R (3×c) are the residuals of bars and joints. With
    joint constraints the unknowns are Ω (3c) and the matrix is that of Eq. 103. Without them the
    unknowns are λ (β) and the matrix is (BᵀB) ∘ G. Returns matrix and right-hand side.
    """
    if not mech.joints:
        return _bar_matrix(mech, B), -r.T
    h = bar_scale(mech, B)
    bars = ca.mtimes(B * ca.repmat(r / h, 3, 1), sparse(mech.K.T))
    rhs = ca.vec(mech.project_onto_constraints(bars - R))  # 3c
    matrix = _joint_matrix(mech, B / ca.repmat(ca.sqrt(h), 3, 1))
    if mech.frames is None:
        return matrix, rhs
    D, idle = mech.constrained_directions, sparse(sp.diags_array(1.0 - mech.active.T.ravel()))
    return ca.mtimes(ca.mtimes(D.T, matrix), D) + idle, ca.mtimes(D.T, rhs)


def recover_multipliers(mech: Mechanism, B: Any, r: Any, solution: Any) -> tuple[Any, Any]:
    """Compute λ (1×β) and Ω (3×c) from the linear system's solution.

    `solution` belongs to the system of `assemble_system`, with the same bar vectors B (3×β) and bar
    residuals r (1×β). Bars that are not coupled with others are solved one by one (Eq. 87).
    """
    if mech.joints:
        Omega = ca.reshape(
            solution if mech.frames is None else ca.mtimes(mech.constrained_directions, solution),
            3,
            mech.joints,
        )
        return -(r + ca.sum1(B * ca.mtimes(Omega, sparse(mech.K)))) / bar_scale(mech, B), Omega
    lam = solution.T if mech.system_size else -r / bar_scale(mech, B)
    return lam, ca.DM.zeros(3, 0)


def nodal_forces(mech: Mechanism, B: Any, lam: Any, Omega: Any = None) -> Any:
    """Compute the constraint forces B λ̂ C_b + Ω Pᵀ (3×n) on nodes.

    These are the forces of bars with vectors B (3×β) and multipliers `lam` (λ, 1×β), and those of
    joints with multipliers `Omega` (Ω, 3×c), if given.
    """
    force = scale_and_multiply(B, lam, mech.C_b)
    return force if Omega is None or not mech.joints else force + ca.mtimes(Omega, sparse(mech.P.T))


# --- projections in the sense of the mass matrix ---


def remove_residuals(mech: Mechanism, Z: Any, B: Any, r: Any, R: Any) -> Any:
    """Remove constraint residuals by a mass-weighted projection.

    Z (3×n) are node positions, velocities or accelerations with the residuals r of bars (1×β) and R
    of joints (3×c). B (3×β) are the bar vectors. The result is Z + (B λ̂ C_b + Ω Pᵀ) M⁻ (3×n).
    """
    solution: Any = ca.DM.zeros(0, 1)
    if mech.system_size:
        solution = solve_semidefinite(*call_weighted(mech, assemble_system, B, r, R))
    return call_weighted(mech, _apply_multipliers, Z, B, r, solution)[0]


def call_weighted(
    mech: Mechanism, function: Callable[..., tuple[Any, ...]], *arguments: Any
) -> tuple[Any, ...]:
    """Call function(mech, *arguments) as scalar code, see `call_as_sx`.

    Masses of `mech` are among the arguments if they are expressions.
    """
    if mech.weights is None:
        return call_as_sx(mech.large, partial(function, mech), *arguments)
    return call_as_sx(
        mech.large,
        lambda weights, *rest: function(mech.with_masses(weights), *rest),
        mech.weights,
        *arguments,
    )


def _apply_multipliers(mech: Mechanism, Z: Any, B: Any, r: Any, solution: Any) -> tuple[Any, ...]:
    multipliers = recover_multipliers(mech, B, r, solution)
    return (Z + mech.with_inverse(nodal_forces(mech, B, *multipliers)),)


def project_velocities(mech: Mechanism, N: Any, V: Any, Dd: Any) -> Any:
    """Find the closest velocities that satisfy the constraints.

    The distance to the given velocities V (3×n) is weighted by masses. The constraints at nodes N
    (3×n) are bᵀḃ = 0 for bars and V P = Ḋ for joints, where `Dd` is Ḋ (3×c).
    """
    if not mech.constrained:
        return V
    B = mech.bar_vectors(N)
    return remove_residuals(mech, V, B, *residual_rates(mech, V, B, Dd))


def stretch_bars(mech: Mechanism, N: Any, B: Any, nu: Any) -> Any:
    """Change the lengths of bars by displacements along them.

    The bars are not coupled (G is diagonal). Each bar vector b (column of B) becomes b + ν b, where
    `nu` is ν (1×β). Returns the node positions (3×n) after the change of N.
    """
    return N + mech.with_inverse(nodal_forces(mech, B, nu / diagonal_row(mech.G[0])))


def bar_scale(mech: Mechanism, B: Any) -> Any:
    """Compute the divisors h (1×β) of the multipliers λ.

    They are h = bᵀb G_ii, for bars that are not coupled. b are the columns of B (3×β), and G = C_b
    M⁻ C_bᵀ. With the paper's constant length l, h is l² G_ii.
    """
    squared = ca.DM(mech.lengths**2).T if mech.constant_length else ca.sum1(B * B)
    return squared * diagonal_row(mech.G[0])


def _bar_matrix(mech: Mechanism, B: Any) -> Any:
    """Compute the matrix (BᵀB) ∘ G (β×β) of the bar multipliers.

    B (3×β) are the bar vectors b, and G = C_b M⁻ C_bᵀ. With different masses along x, y and z, it
    is Σ over axes of (b bᵀ) ∘ G, where b is one row of B. It has the sparsity of G.
    """
    G = mech.G
    pattern = sp.coo_array(sum(abs(number_nonzeros(g)) for g in G) + sp.eye_array(mech.bars))
    order = np.lexsort((pattern.row, pattern.col))
    rows, columns = pattern.row[order].tolist(), pattern.col[order].tolist()
    weights = [entries_at(g, rows, columns) for g in G]
    products = B[:, rows] * B[:, columns]  # 3×nnz
    if len(G) == 1:
        values = ca.sum1(products).T * weights[0]
    elif len(G) == 3:
        values = sum(products[axis, :].T * weights[axis] for axis in range(3))
    else:
        values = sum(
            (B[a, rows] * B[b, columns]).T * weights[3 * a + b] for a in range(3) for b in range(3)
        )
    return matrix_with_pattern(ca.Sparsity.triplet(mech.bars, mech.bars, rows, columns), values)


def _joint_matrix(mech: Mechanism, unit: Any) -> Any:
    """Compute the symmetric matrix of Eq. 103 (3c×3c).

    It is (Pᵀ M⁻ P) ⊗ I − Σᵢ (kᵢ kᵢᵀ) ⊗ (uᵢ uᵢᵀ).

    Here kᵢ = Pᵀ M⁻ C_bᵢᵀ and uᵢ = bᵢ/√hᵢ. This is Eq. 103 with Eᵀ, made symmetric. `unit` (3×β) has
    the columns uᵢ.
    """
    c, K, active = (
        mech.joints,
        mech.K,
        mech.active if mech.frames is None else np.ones_like(mech.active),
    )
    E, links = product(mech.P.T, mech.inverse[0], mech.P), abs(number_nonzeros(K))
    pattern = sp.coo_array(abs(number_nonzeros(E)) + links @ links.T + sp.eye_array(c))
    n, j = pattern.row, pattern.col
    direct = entries_at(E, n, j)
    pairs = multiply_rows(K, n, j)  # nnz×β: k_ni k_ji
    rows: list[Any] = []
    columns: list[Any] = []
    values = []
    for a in range(3):
        for b in range(3):
            kept = np.flatnonzero(active[a, n] & active[b, j])
            block = -ca.mtimes(pairs[kept.tolist(), :], (unit[a, :] * unit[b, :]).T)
            values.append(ca.densify(block + direct[kept.tolist(), :] if a == b else block))
            rows.append(3 * n[kept] + a)
            columns.append(3 * j[kept] + b)
    idle = np.flatnonzero(~active.T.ravel())  # a multiplier without a constraint is zero
    rows.append(idle)
    columns.append(idle)
    values.append(ca.DM.ones(len(idle)))
    row, column = np.concatenate(rows), np.concatenate(columns)
    order = np.lexsort((row, column))
    sparsity = ca.Sparsity.triplet(3 * c, 3 * c, row[order].tolist(), column[order].tolist())
    return matrix_with_pattern(sparsity, ca.vertcat(*values)[order.tolist()])


# --- redundant constraints ---


def find_redundancy(mech: Mechanism) -> str | None:
    """Describe redundant constraints of the initial configuration.

    Returns None without them. The system of the multipliers is scaled to unit diagonal and limited
    to 600 unknowns.
    """
    size = mech.system_size
    if not 0 < size <= 600:  # a dense eigenvalue problem
        return None
    matrix, _ = assemble_system(
        mech,
        mech.bar_vectors(ca.DM(mech.N)),
        ca.DM.zeros(1, mech.bars),
        ca.DM.zeros(3, mech.joints),
    )
    A = matrix.full()
    diagonal = np.sqrt(np.maximum(A.diagonal(), 0))
    scale = np.divide(
        1, diagonal, out=np.zeros(size), where=diagonal > 1e-14 * diagonal.max(initial=1e-300)
    )
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    null = values < 1e-9 * values[-1]
    if not null.any():
        return None
    share = np.abs(vectors[:, null]).max(axis=1)
    involved = np.flatnonzero(share > 1e-6 * share.max())
    smallest = max(float(values[0]), np.finfo(float).eps * float(values[-1]))
    if mech.joints:
        names = (
            "joints "
            + ", ".join(str(k) for k in np.unique(involved // 3))
            + " (columns of P) and the bars between them"
        )
    else:
        count = mech.bars - len(mech.body_of_bar)
        parts = {
            "bars": mech.rigid[involved[involved < count]],
            "bodies": np.unique(mech.body_of_bar[involved[involved >= count] - count]),
        }
        names = " and ".join(
            f"{kind} " + ", ".join(map(str, which)) for kind, which in parts.items() if len(which)
        )
    return (
        f"the constraints of {names} depend on each other in the initial shape ({int(null.sum())} redundant, condition number "
        f"{float(values[-1]) / smallest:.1e}): motion is exact as long as they stay consistent, their multipliers are not unique; "
        "remove a bar or a pin to make them so"
    )
