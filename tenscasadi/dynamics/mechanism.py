"""Rigid bars and joints: the multipliers λ̂ and Ω, and what they do to accelerations, positions and velocities.

One formula serves every class and both coordinates. With M⁻ the inverse mass matrix on the coordinates that can move,
B = N C_bᵀ and X any 3×n matrix of accelerations (or displacements) before the constraints act, the constrained one is

    X + (B λ̂ C_b + Ω Pᵀ) M⁻,                                                    Eqs. 85-87 in the current bᵀb instead of l²

with λ̂ and Ω such that bᵢᵀ of its bar i is −rᵢ and its joints (times P) are −R. In "reduced" coordinates joints hold by
construction, P has no columns and λ solves ((BᵀB) ∘ G) λ = −r with G = C_b M⁻ C_bᵀ (Eqs. 94-95); in "full" coordinates every
bar has its own nodes, G is diagonal, λ̂ is eliminated bar by bar and Ω solves Eq. 103 (corrected, and symmetric).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.structure.structure import Structure, connectivity
from tenscasadi.util.casadi_tools import (
    block_inverse,
    call_as_sx,
    constant_row,
    drop_rounding,
    is_diagonal,
    matrix_with_pattern,
    solve_semidefinite,
    sparse,
    weighted_product,
)
from tenscasadi.util.validate import Array, Indices

UNROLL_MEMBERS = 300  # above, expressions stay vector operations (MX loops): generated C does not grow with the structure
UNROLL_UNKNOWNS = 60  # the same for the unknowns of the multipliers' system
UNROLL_SOLVE = 6  # above, linear systems are solved by a routine instead of unrolled scalar code: shorter derivatives

Coordinates = Literal["reduced", "full"]
BarLength = Literal["current", "constant"]


class Multipliers(NamedTuple):
    """λ (β,), N/m: force densities of bars, positive in compression (Eq. 87); Ω (3, c), N: joint and pin forces (Eq. 85)."""

    bar_force_density: Any
    joint_force: Any


@dataclass(frozen=True, eq=False)
class Mechanism:
    """The constant matrices of a structure in one of the two coordinates. Columns: physical nodes (reduced) or class-one nodes (full)."""

    N: Array  # 3×n initial nodes
    free: Any  # (n, 3) bool: coordinates that are part of the state
    physical: Indices  # (n,) physical node of each column
    first: Indices  # one column for each physical node
    C_b: sp.csr_array  # β×n
    C_s: sp.csr_array  # α×n
    M: sp.csr_array  # n×n
    inverse: tuple[sp.csr_array, ...]  # M⁻ (n×n) for each axis, or once for all three
    P: sp.csr_array  # n×c, no columns in reduced coordinates
    D: Array  # 3×c
    active: Any  # 3×c bool: axes that a column of P constrains (all, but for per-axis supports)
    lengths: Array  # (β,)
    constant_length: bool  # λ̂ divides by l² as Eqs. 46-87 print it, instead of by the current bᵀb

    @property
    def bars(self) -> int:
        """How many bars there are."""
        return len(self.lengths)

    @property
    def joints(self) -> int:
        """How many columns P has."""
        return int(self.P.shape[1])

    @property
    def constrained(self) -> bool:
        """Whether there is anything to keep."""
        return self.bars > 0 or self.joints > 0

    @property
    def large(self) -> bool:
        """Whether expressions are kept as vector operations instead of unrolled scalars."""
        return bool(self.bars + self.C_s.shape[0] > UNROLL_MEMBERS or self.system_size > UNROLL_UNKNOWNS)

    def with_inverse(self, X: Any, then: Any = None) -> Any:
        """X M⁻ (3×n), or X M⁻ `then` (a constant matrix of n rows)."""
        factors = [sparse(inverse if then is None else drop_rounding(inverse @ then)) for inverse in self.inverse]
        if len(factors) == 1:
            return ca.mtimes(X, factors[0])
        return ca.vertcat(*(ca.mtimes(X[axis, :], factors[axis]) for axis in range(3)))

    @cached_property
    def G(self) -> tuple[sp.csr_array, ...]:
        """C_b M⁻ C_bᵀ (β×β) for each axis, or once."""
        return tuple(drop_rounding(self.C_b @ inverse @ self.C_b.T) for inverse in self.inverse)

    @cached_property
    def system_size(self) -> int:
        """Unknowns of the linear system that has to be solved: 0 where every bar stands alone."""
        if self.joints:
            return 3 * self.joints
        G = self.G
        alone = len(G) == 1 and is_diagonal(G[0]) and bool(np.all(G[0].diagonal() > 0))
        return 0 if alone else self.bars


def mechanism(structure: Structure, coordinates: Coordinates, bar_length: BarLength = "current") -> Mechanism:
    """The matrices of a structure in "reduced" or "full" coordinates; `bar_length`: what λ̂ divides by."""
    constant = bar_length == "constant"
    if coordinates == "reduced":
        n = len(structure.nodes)
        C_b, C_s, M = connectivity(structure.bars, n), connectivity(structure.strings, n), structure.mass_matrix()
        free = ~structure.fixed
        axes = [free[:, 0]] if (free == free[:, :1]).all() else [free[:, axis] for axis in range(3)]
        every = np.arange(n)
        inverse = tuple(block_inverse(M, axis) for axis in axes)
        none = sp.csr_array((n, 0)), np.zeros((3, 0)), np.ones((3, 0), bool)
        return Mechanism(structure.nodes.T, free, every, every, C_b, C_s, M, inverse, *none, structure.bar_lengths, constant)
    split = structure.class_one(sparse=True)
    n = split.N.shape[1]
    first = np.unique(split.physical, return_index=True)[1]
    free = np.ones((n, 3), dtype=bool)
    fixed = structure.fixed
    rollers = np.flatnonzero(fixed.any(axis=1) & ~fixed.all(axis=1))  # supports that NP = D cannot say: a column each, for some axes
    columns = sp.csr_array((np.ones(len(rollers)), (first[rollers], np.arange(len(rollers)))), shape=(n, len(rollers)))
    P = sp.csr_array(sp.hstack([split.P, columns]))
    D = np.hstack([split.D, structure.nodes[rollers].T])
    active = np.hstack([np.ones(split.D.shape, bool), fixed[rollers].T])
    C_b = sp.csr_array(split.C_b @ split.C_nb)
    # A pinned string node may have no mass; it never moves, so any mass gives the same motion.
    diagonal = split.M_s.diagonal()
    inverse = (block_inverse(split.M_s + sp.diags_array(np.where(diagonal == 0, diagonal.max(initial=0.0) or 1.0, 0.0)), free[:, 0]),)
    C_s = sp.csr_array(split.C_s)
    return Mechanism(split.N, free, split.physical, first, C_b, C_s, split.M_s, inverse, P, D, active, structure.bar_lengths, constant)


# --- the three steps: assemble the linear system, solve it, apply the multipliers ---


def system(mech: Mechanism, B: Any, r: Any, R: Any) -> tuple[Any, Any]:
    """The symmetric system of the multipliers that are not eliminated and its right-hand side (Eq. 103, or (BᵀB)∘G)."""
    if not mech.joints:
        return _reduced_matrix(mech, B), -r.T
    h = _bar_scale(mech, B)
    K = drop_rounding(mech.P.T @ mech.inverse[0] @ mech.C_b.T)  # c×β
    rhs = (ca.mtimes(B * ca.repmat(r / h, 3, 1), sparse(K.T)) - R) * ca.DM(mech.active.astype(float))  # 3×c
    return _joint_matrix(mech, B / ca.repmat(ca.sqrt(h), 3, 1), K), ca.vec(rhs)


def multipliers(mech: Mechanism, B: Any, r: Any, solution: Any) -> tuple[Any, Any]:
    """λ (1×β) and Ω (3×c) from the solution of `system`, or bar by bar where nothing had to be solved."""
    if mech.joints:
        Omega = ca.reshape(solution, 3, mech.joints)
        K = drop_rounding(mech.P.T @ mech.inverse[0] @ mech.C_b.T)
        return -(r + ca.sum1(B * ca.mtimes(Omega, sparse(K)))) / _bar_scale(mech, B), Omega
    Omega = ca.DM.zeros(3, 0)
    if mech.system_size:
        return solution.T, Omega
    return -r / _bar_scale(mech, B), Omega


def push(mech: Mechanism, B: Any, lam: Any, Omega: Any) -> Any:
    """B λ̂ C_b + Ω Pᵀ (3×n): what bars and joints do to the nodes."""
    force = weighted_product(B, lam, mech.C_b)
    return force + ca.mtimes(Omega, sparse(mech.P.T)) if mech.joints else force


def without_residual(mech: Mechanism, Z: Any, B: Any, r: Any, R: Any) -> Any:
    """Z + (B λ̂ C_b + Ω Pᵀ) M⁻ with the multipliers that take away the residuals r (bars, 1×β) and R (joints, 3×c)."""

    def linear(B: Any, r: Any, R: Any) -> tuple[Any, ...]:
        return system(mech, B, r, R)

    def moved(Z: Any, B: Any, r: Any, solution: Any) -> tuple[Any, ...]:
        return (Z + mech.with_inverse(push(mech, B, *multipliers(mech, B, r, solution))),)

    solution: Any = ca.DM.zeros(0, 1)
    if mech.system_size:
        solution = solve_semidefinite(*call_as_sx(mech.large, linear, B, r, R))
    return call_as_sx(mech.large, moved, Z, B, r, solution)[0]


def without_stretching(mech: Mechanism, N: Any, V: Any, Dd: Any) -> Any:
    """The velocities closest to V (3×n), mass-weighted, with bᵀḃ = 0 and V P = Ḋ."""
    B, Bd = (ca.mtimes(Z, sparse(mech.C_b.T)) for Z in (N, V))
    return without_residual(mech, V, B, ca.sum1(B * Bd), ca.mtimes(V, sparse(mech.P)) - Dd)


def _bar_scale(mech: Mechanism, B: Any) -> Any:
    """h = bᵀb G_ii (1×β) of bars that stand alone; l² G_ii with the paper's constant length."""
    squared = ca.DM(mech.lengths**2).T if mech.constant_length else ca.sum1(B * B)
    return squared * constant_row(mech.G[0].diagonal())


def _reduced_matrix(mech: Mechanism, B: Any) -> Any:
    """Σ over axes of (b bᵀ) ∘ G (β×β), on the pattern of G only."""
    G = mech.G
    pattern = sp.coo_array(sum(abs(g) for g in G) + sp.eye_array(mech.bars))
    order = np.lexsort((pattern.row, pattern.col))
    rows, columns = pattern.row[order].tolist(), pattern.col[order].tolist()
    weights = [ca.DM(np.asarray(sp.csr_array(g)[rows, columns]).ravel()) for g in G]
    products = B[:, rows] * B[:, columns]  # 3×nnz
    if len(G) == 1:
        values = ca.sum1(products).T * weights[0]
    else:
        values = sum(products[axis, :].T * weights[axis] for axis in range(3))
    return matrix_with_pattern(ca.Sparsity.triplet(mech.bars, mech.bars, rows, columns), values)


def _joint_matrix(mech: Mechanism, unit: Any, K: sp.csr_array) -> Any:
    """(Pᵀ M⁻ P) ⊗ I − Σᵢ (kᵢ kᵢᵀ) ⊗ (uᵢ uᵢᵀ) (3c×3c), with kᵢ = Pᵀ M⁻ C_bᵢᵀ and uᵢ = bᵢ/√hᵢ: Eq. 103 with Eᵀ, columns combined to be symmetric."""
    c = mech.joints
    E = drop_rounding(mech.P.T @ mech.inverse[0] @ mech.P)
    pattern = sp.coo_array(abs(E) + abs(K) @ abs(K.T) + sp.eye_array(c))
    n, j = pattern.row, pattern.col
    direct = np.asarray(E[n, j]).ravel()
    pairs = sp.csr_array(K[n, :].multiply(K[j, :]))  # nnz×β: k_ni k_ji
    rows: list[Any] = []
    columns: list[Any] = []
    values = []
    for a in range(3):
        for b in range(3):
            kept = np.flatnonzero(mech.active[a, n] & mech.active[b, j])
            block = -ca.mtimes(sparse(pairs[kept]), (unit[a, :] * unit[b, :]).T)
            values.append(ca.densify(block + ca.DM(direct[kept]) if a == b else block))
            rows.append(3 * n[kept] + a)
            columns.append(3 * j[kept] + b)
    idle = np.flatnonzero(~mech.active.T.ravel())  # a multiplier that constrains nothing is zero
    rows.append(idle)
    columns.append(idle)
    values.append(ca.DM.ones(len(idle)))
    row, column = np.concatenate(rows), np.concatenate(columns)
    order = np.lexsort((row, column))
    sparsity = ca.Sparsity.triplet(3 * c, 3 * c, row[order].tolist(), column[order].tolist())
    return matrix_with_pattern(sparsity, ca.vertcat(*values)[order.tolist()])
