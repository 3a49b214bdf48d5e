"""Metric of the condensed Newton method, and its projections.

The metric is a positive definite approximation of the Hessian.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg

from tenscasadi.util.validate import Array


class Metric:
    """Positive definite matrix D, a diagonal plus a sparse rest."""

    def __init__(self, diagonal: Array, rest: sp.csr_array | None = None) -> None:
        self.diagonal, self.rest = diagonal, rest
        if rest is not None:
            self._factor = scipy.sparse.linalg.splu(sp.csc_array(rest + sp.diags_array(diagonal)))

    def times(self, x: Array) -> Array:
        """Compute D x for x (n,)."""
        own = self.diagonal * x
        return own if self.rest is None else own + self.rest @ x

    def solve(self, x: Array) -> Array:
        """Compute D⁻¹ x for x (n,) or (n, r)."""
        if self.rest is None:
            return np.asarray((x.T / self.diagonal).T)
        return np.asarray(self._factor.solve(np.ascontiguousarray(x)))


class Projector:
    """Projections onto linear constraints J d = r in a metric.

    Hard constraints hold exactly. Soft constraints have the Jacobian B and are penalized. The
    metric is D + Bᵀ give⁻¹ B.

    Parameters
    ----------
    jacobian : ndarray, shape (m + p, n)
        J, with m hard constraints, then the p soft constraints B.
    give : ndarray, shape (m + p,)
        Compliance (inverse penalty) of each constraint; 0 for hard ones.
    metric : Metric
        D.
    """

    def __init__(self, jacobian: Array, give: Array, metric: Metric) -> None:
        self.jacobian, self.give, self.metric = jacobian, give, metric
        self.count = int(np.count_nonzero(give == 0))
        self.soft, self.resisting = jacobian[self.count :], 1 / give[self.count :]
        if metric.rest is None and len(jacobian):
            matrix, most = np.zeros((len(jacobian),) * 2, order="F"), 1024  # more leave the cache
            root = np.sqrt(metric.diagonal)
            for first in range(0, len(root), most):
                own = slice(first, first + most)
                half = np.asfortranarray(jacobian[:, own] / root[own])
                # the lower half
                matrix = scipy.linalg.blas.dsyrk(
                    1.0, half, beta=1.0, c=matrix, lower=1, overwrite_c=1
                )
        else:
            matrix = jacobian @ metric.solve(jacobian.T)
        count = len(matrix)
        self.sizes = matrix.diagonal().copy()
        # a little more than rounding: rows that nothing moves stay harmless
        damping = 1e-12 * max(np.trace(matrix) / max(count, 1), 1e-300)
        matrix[range(count), range(count)] += damping + give
        self._factor = (
            scipy.linalg.cho_factor(matrix, lower=True, check_finite=False) if count else None
        )

    def times(self, x: Array) -> Array:
        """Compute the product of the metric and x (n,)."""
        own = self.metric.times(x)
        return own + self.soft.T @ (self.resisting * (self.soft @ x)) if len(self.soft) else own

    def norm(self, x: Array) -> float:
        """Compute the norm of x (n,) in the metric."""
        return float(np.sqrt(np.maximum(x @ self.times(x), 0.0)))

    def inner(self, x: Array) -> Array:
        """Compute (J D⁻¹ Jᵀ + give)⁻¹ x for x (m + p,).

        `give` is the diagonal matrix of the compliances.
        """
        if self._factor is None:
            return x
        y = scipy.linalg.cho_solve(self._factor, x, check_finite=False)
        # one refinement: barriers make the matrix ill-conditioned
        left = x - self.jacobian @ self.metric.solve(self.jacobian.T @ y) - self.give * y
        return np.asarray(y + scipy.linalg.cho_solve(self._factor, left, check_finite=False))

    def shortest(self, rows: Array) -> Array:
        """Compute the smallest step d with J d ≈ rows.

        `rows` (m + p,) are the required changes of the constraints. The norm of d (n,) is that in
        D.
        """
        return self.metric.solve(self.jacobian.T @ self.inner(rows))

    def duals(self, force: Array) -> Array:
        """Compute duals y (m,) that minimize the norm of force + Jᵀy.

        `force` (n,) is the gradient of a function.
        """
        return -self.inner(self.jacobian @ self.metric.solve(force))[: self.count]

    def project(self, force: Array) -> Array:
        """Project a gradient onto the null space of J.

        The gradient is `force` (n,). The result is the step d (n,) with J d ≈ 0 that is nearest to
        D⁻¹ force.
        """
        w = self.metric.solve(force)
        return w - self.shortest(self.jacobian @ w)
