"""Smallest eigenvalues of large sparse constrained problems.

The problem is K v = λ M v with J v = 0. The method is shift-invert Lanczos, and the inertia counts
the eigenvalues below the shift.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

from tenscasadi.statics.solver.sparse_pattern import join_blocks
from tenscasadi.util.validate import Array


class SaddlePoint:
    """Factorization of the symmetric saddle-point matrix [[A, Jᵀ], [J, 0]].

    It solves A v + Jᵀ μ = f, J v = g, also with redundant rows of J. Raises LinAlgError if the
    factors are too inaccurate for iterative refinement.
    """

    def __init__(self, A: Any, J: Any) -> None:
        self.size, self.rows = int(A.shape[0]), int(J.shape[0])
        block = float(np.abs(A.data).max(initial=0.0)) or 1.0
        norm = np.sqrt(J.multiply(J).sum(axis=1))
        norm = np.where(norm > 0.0, norm, 1.0)
        self.scale = np.concatenate([np.full(self.size, block**-0.5), block**0.5 / norm])
        unit = sp.csr_array(J.multiply(1.0 / norm[:, None]))
        saddle = [(0, 0, A * (1.0 / block)), (self.size, 0, unit), (0, self.size, unit.T)]
        self.exact = join_blocks(saddle, len(self.scale))
        # A + ρ JᵀJ is equivalent for J v = 0, and has larger pivots because it is closer to definite
        self.added = sp.csc_array(10.0 * unit.T)
        # a compliance of constraints allows redundant rows, and the refinement removes it
        slack = sp.diags_array(np.full(self.rows, -1e-8))
        added = [(0, 0, self.added @ unit), (self.size, self.size, slack)]
        # diagonal pivots keep the symmetry, so that they have the signs of the eigenvalues
        options = {"SymmetricMode": True}
        try:
            self.factors = splu(
                join_blocks([*saddle, *added], len(self.scale)),
                "MMD_AT_PLUS_A",
                0.0,
                options=options,
            )
        except RuntimeError as error:  # a pivot is zero
            raise np.linalg.LinAlgError(str(error)) from None

    def solve(self, f: Array, g: Array | None = None) -> tuple[Array, Array]:
        """Solve A v + Jᵀ μ = f, J v = g for v and μ.

        Without g the lengths are fixed, J v = 0.
        """
        target = np.concatenate([f, np.zeros((self.rows, *f.shape[1:])) if g is None else g])
        scale = self.scale.reshape(-1, *[1] * (f.ndim - 1))
        target = target * scale
        x, left = np.zeros_like(target), target
        for _ in range(10):
            upper, lower = left[: self.size], left[self.size :]
            x = x + self.factors.solve(np.concatenate([upper + self.added @ lower, lower]))
            left = target - self.exact @ x
            error, size = np.abs(left).max(initial=0.0), np.abs(x).max(initial=0.0)
            if error <= 1e-15 * size:
                break
        if not error <= 1e-10 * max(size, np.abs(target).max(initial=0.0)):
            raise np.linalg.LinAlgError("the refinement of a sparse solution does not converge")
        x = x * scale
        return x[: self.size], x[self.size :]

    def count_negative(self) -> int:
        """Count the negative eigenvalues of A on the null space of J.

        By Sylvester's law of inertia they have the signs of the pivots.
        """
        if not np.array_equal(self.factors.perm_r, self.factors.perm_c):
            raise np.linalg.LinAlgError("a pivot left the diagonal")
        return int((self.factors.U.diagonal() < 0.0).sum()) - self.rows


def lowest_eigenpairs(K: Any, M: Any, J: Any, left_out: Array, count: int) -> tuple[Array, Array]:
    """Compute the smallest constrained eigenvalues and their vectors.

    They solve K v = λ M v with J v = 0 and v orthogonal to `left_out`.

    Parameters
    ----------
    K, M : sparse array (n, n)
        Symmetric matrices. M is positive definite for J v = 0.
    J : sparse array (m, n)
        Constraints.
    left_out : ndarray (n, r)
        M-orthonormal eigenvectors of eigenvalue zero, which are excluded.
    count : int
        Number of eigenvalues, well below n − m.

    Returns
    -------
    tuple of ndarray
        Eigenvalues (count,) in increasing order, and M-orthonormal eigenvectors (n, count).

    Raises
    ------
    LinAlgError
        If the matrices are too ill-conditioned.
    """
    # relative to the largest |λ|; a smaller shift would vanish in rounding beside the compliance
    shift = -1e-6 * fastest_rate(K, M)
    system = SaddlePoint(K - shift * M, J)
    below = system.count_negative()
    while below > count:  # very unstable: move the shift towards the lowest
        shift *= 4.0
        system = SaddlePoint(K - shift * M, J)
        below = system.count_negative()
    mass = M @ left_out

    def solve(f: Array) -> Array:
        # without this projection the shift would amplify the excluded vectors
        v, _ = system.solve(f - mass @ (left_out.T @ f))
        return np.asarray(v - left_out @ (mass.T @ v))

    inverse = LinearOperator(K.shape, matvec=lambda f: solve(f.ravel()), dtype=float)
    start = inverse @ np.random.default_rng(0).normal(size=K.shape[0])  # reproducible

    def nearest(number: int, side: str) -> Array:
        if not number:
            return np.zeros((K.shape[0], 0))
        return np.asarray(
            eigsh(
                K,
                number,
                M,
                shift,
                side,
                start,
                OPinv=inverse,
                ncv=min(K.shape[0], max(2 * number + 1, 40)),
            )[1]
        )

    try:
        basis: Array = np.hstack([nearest(below, "SA"), nearest(count - below, "LA")])
    except ArpackError as error:
        raise np.linalg.LinAlgError(str(error)) from None
    # the Rayleigh-Ritz method keeps the accuracy of eigenvalues next to the shift
    L = np.linalg.cholesky(basis.T @ (M @ basis))
    basis = np.asarray(np.linalg.solve(L, basis.T).T)
    values, vectors = np.linalg.eigh(basis.T @ (K @ basis))
    return values, np.asarray(basis @ vectors)


def fastest_rate(K: Any, M: Any) -> float:
    """Estimate the largest |λ| of K v = λ M v.

    Constraints are ignored, and M is replaced by its diagonal. The result is 1 if K is zero.
    """
    weight = (
        M.diagonal() ** -0.5
        if np.all(M.diagonal() > 0.0)
        else np.full(M.shape[0], float(M.diagonal().max()) ** -0.5)
    )
    return float(abs(sp.diags_array(weight) @ K @ sp.diags_array(weight)).sum(axis=1).max()) or 1.0
