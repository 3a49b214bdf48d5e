"""Proofs that goals are infeasible, by Lagrangian relaxation.

The proofs show that constraints which are quadratic in the state have no common solution. Let μ be
the residuals at a local minimum of their sum of squares. The function μᵀ residuals is stationary
there and has the value |μ|² > 0. If it is convex, this is its minimum, so that no state satisfies
all constraints. Affine constraints are satisfied exactly: convexity is needed on their solutions
only.

A state that meets all goals within their tolerances τ has μᵀ residuals ≤ |μ|ᵀ τ. The minimum must
exceed this sum, so that goals are infeasible by more than the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.sparse as sp

from ocp.problem.rows import RESOLUTION
from ocp.problem.scaling import UNBOUNDED
from ocp.targets.infeasible_goal import Certificate
from ocp.targets.row_reduction import RowFunction
from tenscasadi.util.linear_algebra import null_space
from tenscasadi.util.validate import Array, Indices


class QuadraticRows(NamedTuple):
    """Residuals that are quadratic in scaled variables z.

    They are c + A z + ½ zᵀ Q z, with a symmetric matrix Q for each residual.

    Attributes
    ----------
    names : list of str
        Names of the m residuals.
    c, A : ndarray, shape (m,) and (m, n)
        Constant and linear parts.
    row, one, other : ndarray of int
        Residual, row and column of each nonzero of the matrices Q.
    value : ndarray
        Values of these nonzeros.
    permitted : ndarray, shape (m,)
        Sizes of the residuals that count as zero.
    """

    names: list[str]
    c: Array
    A: Array
    row: Indices
    one: Indices
    other: Indices
    value: Array
    permitted: Array

    def select(self, kept: Indices) -> QuadraticRows:
        """Select some of the residuals.

        `kept` are their indices.
        """
        place = np.full(len(self.c), -1)
        place[kept] = np.arange(len(kept))
        own = place[self.row] >= 0
        names = [self.names[k] for k in kept]
        entries = place[self.row[own]], self.one[own], self.other[own], self.value[own]
        return QuadraticRows(names, self.c[kept], self.A[kept], *entries, self.permitted[kept])

    @property
    def affine(self) -> Any:
        """Whether each residual (m,) is affine."""
        return ~np.isin(np.arange(len(self.c)), self.row[self.value != 0])

    def hessian(self, multipliers: Array) -> sp.csr_array:
        """Compute the Hessian (n, n) of a weighted sum of residuals.

        The Hessian is that with respect to z.

        There is one multiplier for each of the m residuals.
        """
        entries = multipliers[self.row] * self.value, (self.one, self.other)
        return sp.csr_array(sp.coo_array(entries, shape=(self.A.shape[1],) * 2))

    def at(self, z: Array) -> tuple[Array, Array]:
        """Compute the residuals (m,) and their Jacobian (m, n).

        z (n,) is the scaled state.
        """
        entries = self.value * z[self.other], (self.row, self.one)
        J = self.A + sp.coo_array(entries, shape=self.A.shape).toarray()
        return self.c + (self.A + J) @ z / 2, J


def read_quadratic(rows: RowFunction, names: Sequence[str], permitted: Array) -> QuadraticRows:
    """Select the residuals that are quadratic.

    The others are dropped. A proof with fewer constraints is still valid. `names` are those of all
    residuals `rows`, and `permitted` the sizes that count as zero.
    """
    zero = np.zeros(len(rows.scale))
    c, A = rows(zero)
    row, one, other, value = rows.second_derivatives(zero)
    probe = np.random.default_rng(0).uniform(-1.0, 1.0, len(zero)) * rows.scale
    varying = np.abs(rows.second_derivatives(probe)[3] - value) > 1e-9
    every = QuadraticRows(list(names), c, A, row, one, other, value, permitted)
    return every.select(np.setdiff1d(np.arange(len(c)), row[varying]))


def prove_infeasible(rows: QuadraticRows, z: Array, box: Array) -> Certificate | None:
    """Prove that no state satisfies all constraints within their tolerances.

    Returns None if the proof fails. The search for multipliers starts at the scaled state z (n,),
    whose entries are within a box (2, n). `rows` are the residuals of these constraints.
    """
    linear = rows.select(np.flatnonzero(rows.affine))
    known = solve_affine(linear, box)
    rest = linear.at(known)[0]
    slope = linear.A.T @ rest
    least = np.minimum(*(slope * np.clip(side, -UNBOUNDED, UNBOUNDED) for side in box)).sum()
    proof = _certificate(linear, rest, float(rest @ linear.c + least), "linear")
    timed = np.isfinite(box).all(axis=0)
    bent = np.flatnonzero(~rows.affine & ~rows.A[:, timed].any(axis=1))
    if proof is not None or not len(bent):
        return proof
    untimed = ~linear.A[:, timed].any(axis=1)
    A, slack = linear.A[untimed], (linear.permitted + np.abs(rest))[untimed]
    curved = rows.select(bent)
    Z = null_space(np.vstack([A, np.eye(len(z))[timed]]), RESOLUTION)

    def residual(s: Array) -> tuple[Array, Array]:
        value, J = curved.at(known + Z @ s)
        return value, J @ Z

    s = Z.T @ (z - known)
    if len(s):
        exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        s = scipy.optimize.least_squares(
            lambda s: residual(s)[0], s, lambda s: residual(s)[1], **exact
        ).x
    weights, J = curved.at(known + Z @ s)
    off = np.linalg.pinv(A, rcond=RESOLUTION) * slack
    falls = _measure_falls(curved.hessian(weights), J.T @ weights, Z, off)
    return _certificate(curved, weights, float(weights @ weights) - falls, "convex")


def _measure_falls(H: Any, slope: Array, Z: Array, off: Array) -> float:
    """Bound the decrease of a quadratic function from a point.

    `H` (n, n) and `slope` (n,) are its Hessian and gradient there. Changes of the point are those
    along the columns of `Z` (n, k), and columns of `off` (n, m) times factors from −1 to 1. For
    products of both, the changes along flat columns have a norm of at most 1: velocities within a
    tolerance have any angular momentum if their arms are long enough.
    """
    values, vectors = np.linalg.eigh(Z.T @ (H @ Z))
    steep = values > 1e-6 * max(float(abs(H).max()), 1e-300)
    along = Z @ vectors
    own, both = np.abs(along.T @ slope), np.abs(along.T @ (H @ off)).sum(axis=1)
    falls = ((own + both)[steep] ** 2 / values[steep]).sum() / 2 + np.linalg.norm(both[~steep])
    falls += (UNBOUNDED * own[~steep] - UNBOUNDED**2 * np.minimum(values[~steep], 0.0)).sum()
    return float(falls + np.abs(slope @ off).sum() + np.abs(off.T @ (H @ off)).sum() / 2)


def solve_affine(rows: QuadraticRows, box: Array) -> Array:
    """Minimize affine residuals by least squares within a box.

    Returns the scaled state z (n,); `box` (2, n) are its lower and upper limits.
    """
    if np.isfinite(box).any() and len(rows.c):
        return np.asarray(scipy.optimize.lsq_linear(rows.A, -rows.c, box, tol=1e-14).x)
    return np.asarray(np.linalg.lstsq(rows.A, -rows.c, rcond=RESOLUTION)[0])


def _certificate(
    rows: QuadraticRows, weights: Array, bound: float, relaxation: str
) -> Certificate | None:
    # a distance within its tolerance exceeds it by up to 10 % as a residual quadratic in the state
    if not bound > 1.1 * np.abs(weights) @ rows.permitted:
        return None
    multipliers = dict.fromkeys(rows.names, 0.0)
    for name, weight in zip(rows.names, weights.tolist(), strict=True):
        multipliers[name] = max(multipliers[name], weight, key=abs)
    return Certificate(multipliers, float(bound), relaxation)
