"""The part of the second derivatives that is inverted: costs, barriers and what is added to them, tridiagonal over time for each group."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from tenscasadi.util.validate import Array


class Metric:
    """A positive definite matrix D (n×n): a diagonal (n,), and what couples the same group in neighbouring intervals (Kc − 1, m)."""

    def __init__(self, diagonal: Array, coupling: Array | None) -> None:
        self.diagonal, self.coupling = diagonal, coupling
        if coupling is not None:
            self._factor(coupling)

    def _factor(self, coupling: Array) -> None:
        """D = L P Lᵀ with unit L, of all groups at once."""
        count, m = coupling.shape[0] + 1, coupling.shape[1]
        pivots = self.diagonal[: count * m].reshape(count, m).copy()
        factors = np.empty_like(coupling)
        for k in range(1, count):
            factors[k - 1] = coupling[k - 1] / pivots[k - 1]
            pivots[k] -= factors[k - 1] * coupling[k - 1]
        self._pivots, self._factors = pivots, factors

    def times(self, x: Array) -> Array:
        """Return D x of x (n,)."""
        result = self.diagonal * x
        if self.coupling is not None:
            m = self.coupling.shape[1]
            size = self.coupling.size
            flat = self.coupling.ravel()
            result[m : m + size] += flat * x[:size]
            result[:size] += flat * x[m : m + size]
        return result

    def solve(self, x: Array) -> Array:
        """Return D⁻¹ x of x (n,) or (n, r)."""
        if self.coupling is None:
            return np.asarray((x.T / self.diagonal).T)
        count, m = self._pivots.shape
        result = np.array(x, dtype=float)
        y = result[: count * m].reshape(count, m, -1)
        for k in range(1, count):
            y[k] -= self._factors[k - 1][:, None] * y[k - 1]
        y /= self._pivots[:, :, None]
        for k in range(count - 2, -1, -1):
            y[k] -= self._factors[k][:, None] * y[k + 1]
        result[count * m :] = (result[count * m :].T / self.diagonal[count * m :]).T
        return result


class Projector:
    """Steps that J does not see, and the shortest that it does, in the sense of a metric to which some rows add what they resist.

    jacobian (m + p, n): of rows that are met, J, then of p that give way, B. give (m + p,): by how
    much, 0 of those that are met. The metric is D + Bᵀ give⁻¹ B.
    """

    def __init__(self, jacobian: Array, give: Array, diagonal: Metric, damping: float) -> None:
        self.jacobian, self.diagonal = jacobian, diagonal
        self.count = int(np.count_nonzero(give == 0))
        self.soft, self.resisting = jacobian[self.count :], 1 / give[self.count :]
        if diagonal.coupling is None and len(jacobian):
            half = jacobian / np.sqrt(diagonal.diagonal)
            matrix = scipy.linalg.blas.dsyrk(1.0, half.T, trans=1, lower=1)  # the lower half
            self.spread = half / np.sqrt(diagonal.diagonal)  # J D⁻¹
        else:
            self.spread = np.ascontiguousarray(diagonal.solve(jacobian.T).T)
            matrix = self.spread @ jacobian.T
        count = len(matrix)
        self.sizes = matrix.diagonal().copy()
        matrix[range(count), range(count)] += (
            damping * max(np.trace(matrix) / max(count, 1), 1e-300) + give
        )
        self._factor = (
            scipy.linalg.cho_factor(matrix, lower=True, check_finite=False) if count else None
        )

    def times(self, x: Array) -> Array:
        """Return the metric times x (n,)."""
        own = self.diagonal.times(x)
        return own + self.soft.T @ (self.resisting * (self.soft @ x)) if len(self.soft) else own

    def norm(self, x: Array) -> float:
        """Return the square root of xᵀ times(x)."""
        return float(np.sqrt(np.maximum(x @ self.times(x), 0.0)))

    def inner(self, x: Array) -> Array:
        """Return (J D⁻¹ Jᵀ + give)⁻¹ x of all rows."""
        return (
            x
            if self._factor is None
            else np.asarray(scipy.linalg.cho_solve(self._factor, x, check_finite=False))
        )

    def shortest(self, rows: Array) -> Array:
        """Return the least step d, in the metric, with J d = rows; those that give way resist what is left of theirs."""
        return np.asarray(self.spread.T @ self.inner(rows))

    def multipliers(self, force: Array) -> Array:
        """Return y (m,) that makes force + Jᵀy least, in the inverse metric."""
        return -self.inner(self.spread @ force)[: self.count]

    def project(self, force: Array) -> Array:
        """Return the inverse metric times a force, less what J sees."""
        w = self.diagonal.solve(force)
        return w - self.spread.T @ self.inner(self.jacobian @ w)
