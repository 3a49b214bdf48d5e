"""Constant matrices of a structure in reduced or full coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.dynamics.masses import UNROLL_SOLVE, Masses
from tenscasadi.util.casadi_tools import (
    is_diagonal,
    is_expression,
    matrix_with_pattern,
    number_nonzeros,
    product,
    sparse,
)
from tenscasadi.util.immutable import ReadOnlyArrays, read_only
from tenscasadi.util.validate import Array, Indices

# members and unknowns of multipliers above which expressions remain MX, to limit the generated C
UNROLL_MEMBERS = 300
UNROLL_UNKNOWNS = 60

Coordinates = Literal["reduced", "full"]
BarLength = Literal["current", "constant"]


class Multipliers(NamedTuple):
    """Multipliers of bars, joints and pins.

    Attributes
    ----------
    bar_force_density : ndarray, shape (β,)
        Force density λ̂ of each bar [N/m], positive in compression (Eq. 87).
    joint_force : ndarray, shape (3, c)
        Forces Ω in joints and pins [N] (Eq. 85).

    Examples
    --------
    A bar of 1 kg and 2 m stands on a pin, which supports its weight of 10 N:

    >>> import tenscasadi as tc
    >>> mast = tc.Structure([(0, 0, 0), (0, 0, 2)], bars=[(0, 1)], pinned=(0,))
    >>> model = tc.Model(tc.Scene(mast, gravity=tc.Gravity((0, 0, -10))))
    >>> model.multipliers(model.initial_state).joint_force[2].round(6)
    array([10.])
    """

    bar_force_density: Any
    joint_force: Any


@dataclass(frozen=True, eq=False)
class Mechanism(ReadOnlyArrays):
    """Constant matrices of a structure in one set of coordinates.

    Columns of N (3×n) are the nodes of the structure in reduced coordinates, and separate nodes of
    each bar (class one) in full coordinates. If masses are parameters, M and M⁻ have nominal
    values. `with_masses` replaces them by expressions.
    """

    N: Array  # 3×n initial nodes
    free: Any  # (n, 3) bool: coordinates that are part of the state
    physical: Indices  # (n,) physical node of each column
    first: Indices  # one column for each physical node
    C_b: sp.csr_array  # β×n, rigid bars only
    C_s: sp.csr_array  # α×n
    C_e: sp.csr_array  # elastic bars × n
    bar_ends: Indices  # columns of the ends of all bars, two each
    rigid: Indices  # (β,) rigid ones among all bars
    M: Any  # n×n
    inverse: tuple[Any, ...]  # M⁻ (n×n) for all axes, per axis, or per pair of axes with rollers
    P: sp.csr_array  # n×c, no columns in reduced coordinates
    D: Array  # 3×c
    active: Any  # 3×c bool: directions of the frame that a column of P constrains
    lengths: Array  # (β,) of rigid bars
    constant_length: bool  # λ̂ divides by l² as in Eqs. 46-87 instead of bᵀb
    frames: Any = None  # (c, 3, 3) frame of each column of P; None: x, y, z
    turn: sp.csr_array | None = None  # 3n×3n, local coordinates to those of N; None: identity
    spread: sp.csr_array | None = None  # n×n weights of independent columns on all; None: identity
    body_of_bar: Indices = field(default_factory=lambda: np.zeros(0, np.intp))  # of the last bars
    masses: Masses | None = None  # dependence of M and M⁻ on parameters; None: constant
    weights: Any = None  # CasADi column of the entries of M and M⁻, if they are expressions

    @property
    def bars(self) -> int:
        """Number of rigid bars."""
        return len(self.lengths)

    @property
    def joints(self) -> int:
        """Number of joint and pin constraints, the columns of P."""
        return int(self.P.shape[1])

    @property
    def constrained(self) -> bool:
        """Whether there are constraints."""
        return self.bars > 0 or self.joints > 0

    @property
    def large(self) -> bool:
        """Whether expressions are vector operations, not scalar code."""
        return bool(
            self.bars + self.C_e.shape[0] + self.C_s.shape[0] > UNROLL_MEMBERS
            or self.system_size > UNROLL_UNKNOWNS
        )

    @property
    def unrolled(self) -> bool:
        """Whether the multipliers are also solved in scalar code."""
        return not self.large and self.system_size <= UNROLL_SOLVE

    @cached_property
    def free_index(self) -> Indices:
        """Indices 3 · column + axis of the free coordinates.

        They refer to N, or to its `local` coordinates.
        """
        return read_only(np.flatnonzero(self.free.ravel()))  # type: ignore[no-any-return]

    @property
    def coordinate_names(self) -> list[str]:
        """Names of the free coordinates, such as "node 2 z"."""
        turned = (
            set() if self.turn is None else set(np.flatnonzero(np.diff(self.turn.indptr) > 1) // 3)
        )
        real = len(self.first) if len(self.body_of_bar) else self.N.shape[1]
        owners = [
            f"{'' if k < real else 'auxiliary '}node {n}" for k, n in enumerate(self.physical)
        ]
        return [
            f"{owners[k // 3]} {'along its roller' if k // 3 in turned else 'xyz'[k % 3]}"
            for k in self.free_index
        ]

    @property
    def bar_names(self) -> list[str]:
        """Names of the rigid bars, such as "bar 3", and of bars of bodies."""
        own = self.rigid[: self.bars - len(self.body_of_bar)]
        return [*(f"bar {k}" for k in own), *(f"body {k}" for k in self.body_of_bar)]

    @property
    def frames_of_nodes(self) -> Array:
        """Directions (n, 3, 3) of the `local` coordinates, as columns.

        Empty if these are x, y and z.
        """
        if self.turn is None:
            return np.zeros((0, 3, 3))
        columns = self.N.shape[1]
        return np.asarray(
            self.turn.toarray().reshape(columns, 3, columns, 3)[
                np.arange(columns), :, np.arange(columns), :
            ]
        )

    def local(self, vector: Any) -> Any:
        """Convert vectors from x, y, z to roller coordinates.

        These local coordinates are along and across inclined rollers. Vectors are CasADi columns
        (3n) or arrays (…, 3n).
        """
        return vector if self.turn is None else _rotate(self.turn.T, vector)

    def world(self, vector: Any) -> Any:
        """Convert vectors from roller coordinates to x, y, z.

        It is the inverse of `local`, for the same shapes.
        """
        return vector if self.turn is None else _rotate(self.turn, vector)

    @property
    def dependent(self) -> Any:
        """Flags (n,) of nodes that are affine combinations of others."""
        n = self.N.shape[1]
        return np.zeros(n, bool) if self.spread is None else self.spread.diagonal() == 0.0

    def expand(self, Z: Any) -> Any:
        """Compute dependent columns of node positions or velocities Z (3×n).

        Dependent nodes of a rigid body are affine combinations of others. Returns Z with these
        columns replaced.
        """
        return Z if self.spread is None else ca.mtimes(Z, sparse(self.spread.T))

    def gather(self, F: Any) -> Any:
        """Transfer forces F (3×n) from dependent to independent nodes.

        The result (3×n) has the same power, and zero forces on dependent nodes.
        """
        return F if self.spread is None else ca.mtimes(F, sparse(self.spread))

    def generalized_forces(self, F: Any) -> Any:
        """Convert forces F on nodes (3×n) to generalized forces (nq).

        They are forces along the free coordinates.
        """
        own = self.local(ca.vec(self.gather(F)))
        return ca.densify(
            own if len(self.free_index) == own.shape[0] else own[self.free_index.tolist()]
        )

    @cached_property
    def free_mass(self) -> Any:
        """Mass matrix (nq×nq) of the free coordinates [kg]."""
        M = self.M if self.spread is None else product(self.spread.T, self.M, self.spread)
        if not is_expression(M):
            return free_mass_matrix(M, self.turn, self.free_index)
        wide = sp.csc_array(
            sp.csr_array(sp.kron(number_nonzeros(M), sp.eye_array(3)))[self.free_index][
                :, self.free_index
            ]
        )
        wide.sort_indices()
        pattern = ca.Sparsity(
            wide.shape[0], wide.shape[1], wide.indptr.tolist(), wide.indices.tolist()
        )
        return matrix_with_pattern(pattern, M.nz[:][(wide.data - 1).astype(int).tolist()])

    @property
    def node_weight(self) -> Any:
        """Mass of each node [kg]: the row sums of M.

        It is an array (n,), or a CasADi row (1×n).
        """
        return ca.sum1(self.M) if is_expression(self.M) else self.M.sum(axis=1)

    def with_masses(self, weights: Any) -> Mechanism:
        """Replace M and M⁻ by expressions with nonzeros `weights`.

        These are the result of `masses.weigh`.
        """
        if self.masses is None:
            return self
        M, inverse = self.masses.matrices(weights)
        return replace(self, M=M, inverse=inverse, weights=weights)

    @property
    def active_mask(self) -> ca.DM:
        """Constrained axes of joints and pins (3×c), as 1 or 0."""
        return ca.DM(self.active.astype(float))

    @cached_property
    def constrained_directions(self) -> Any:
        """Block-diagonal matrix (3c×3c) of joint constraint directions."""
        return sparse(
            sp.block_diag(
                [frame * active for frame, active in zip(self.frames, self.active.T, strict=True)]
            )
        )

    def project_onto_constraints(self, vectors: Any) -> Any:
        """Project a vector for each joint (3×c) onto its constrained directions (3×c)."""
        if self.frames is None:
            return vectors * self.active_mask
        D = self.constrained_directions
        return ca.reshape(ca.mtimes(ca.mtimes(D, D.T), ca.vec(vectors)), 3, self.joints)

    def bar_vectors(self, Z: Any) -> Any:
        """Compute Z C_bᵀ (3×β): bar vectors, or their rates.

        Z (3×n) are node positions N for the vectors B, or velocities V for the rates Ḃ.
        """
        return ca.mtimes(Z, sparse(self.C_b.T))

    def with_inverse(self, X: Any, then: Any = None) -> Any:
        """Compute X M⁻ (3×n), or X M⁻ `then`.

        X (3×n) are, for instance, forces on nodes, and X M⁻ their accelerations. `then` is a
        constant matrix of n rows, such as C_bᵀ.
        """
        factors = [
            sparse(inverse if then is None else product(inverse, then)) for inverse in self.inverse
        ]
        if len(factors) == 1:
            return ca.mtimes(X, factors[0])
        if len(factors) == 3:
            return ca.vertcat(*(ca.mtimes(X[axis, :], factors[axis]) for axis in range(3)))
        return ca.vertcat(
            *(
                sum(ca.mtimes(X[other, :], factors[3 * other + axis]) for other in range(3))
                for axis in range(3)
            )
        )

    def join_bars(self, rigid: Any, elastic: Any) -> Any:
        """Join values of rigid and elastic bars in the order of all bars.

        `rigid` is 1×β, `elastic` has one column for each elastic bar, and the result one for each
        bar.
        """
        if not self.C_e.shape[0]:
            return rigid
        order = np.argsort(np.concatenate([self.rigid, self.elastic]))
        return ca.horzcat(rigid, elastic)[:, order.tolist()]

    @property
    def elastic(self) -> Indices:
        """Indices of the elastic bars."""
        return np.setdiff1d(np.arange(len(self.bar_ends)), self.rigid)

    @cached_property
    def G(self) -> tuple[Any, ...]:
        """Matrices C_b M⁻ C_bᵀ (β×β), which couple the bars' multipliers.

        There is one for each entry of `inverse`.
        """
        return tuple(product(self.C_b, inverse, self.C_b.T) for inverse in self.inverse)

    @cached_property
    def K(self) -> Any:
        """Pᵀ M⁻ C_bᵀ (c×β): joint accelerations due to bar forces.

        It is defined in full coordinates.
        """
        return product(self.P.T, self.inverse[0], self.C_b.T)

    @cached_property
    def system_size(self) -> int:
        """Number of unknowns of the multipliers' linear system.

        It is 0 if no bars are coupled.
        """
        if self.joints:
            return 3 * self.joints
        if self.masses is None:
            G = list(self.G)
        else:  # for all values of the masses
            ends, patterns = abs(self.C_b), map(ca.DM.ones, self.masses.patterns)
            G = [ends @ number_nonzeros(pattern) @ ends.T for pattern in patterns]
        alone = len(G) == 1 and is_diagonal(G[0]) and bool(np.all(G[0].diagonal() > 0))
        return 0 if alone else self.bars


def free_mass_matrix(M: Any, turn: Any, index: Indices) -> sp.csr_array:
    """Compute the mass matrix of the free local coordinates.

    They are the entries `index` of node coordinates, after the rotation `turn` (None for none). M
    (n×n) is the mass matrix of the nodes. The result is (nq, nq) for nq entries.
    """
    wide = sp.csr_array(sp.kron(M, sp.eye_array(3)))
    return sp.csr_array(wide if turn is None else turn.T @ wide @ turn)[index][:, index]


def _rotate(matrix: Any, vector: Any) -> Any:
    if isinstance(vector, np.ndarray):
        return (vector.reshape(-1, vector.shape[-1]) @ matrix.T).reshape(vector.shape)
    return ca.mtimes(sparse(matrix), vector)
