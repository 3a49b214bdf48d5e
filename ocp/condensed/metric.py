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

    def norm(self, x: Array) -> float:
        """Return the square root of xᵀD x."""
        return float(np.sqrt(np.maximum(x @ self.times(x), 0.0)))

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
    """Steps that J does not see, and the shortest that it does, in the sense of a metric."""

    def __init__(self, jacobian: Array, metric: Metric, damping: float) -> None:
        self.jacobian, self.metric = jacobian, metric
        if metric.coupling is None and len(jacobian):
            half = jacobian / np.sqrt(metric.diagonal)
            matrix = scipy.linalg.blas.dsyrk(1.0, half.T, trans=1, lower=1)  # the lower half
            self.spread = half / np.sqrt(metric.diagonal)  # J D⁻¹
        else:
            self.spread = np.ascontiguousarray(metric.solve(jacobian.T).T)
            matrix = self.spread @ jacobian.T
        count = len(matrix)
        matrix[range(count), range(count)] += damping * max(np.trace(matrix) / max(count, 1), 1e-300)
        self._factor = scipy.linalg.cho_factor(matrix, lower=True, check_finite=False) if count else None

    def inner(self, x: Array) -> Array:
        """Return (J D⁻¹ Jᵀ)⁻¹ x."""
        return x if self._factor is None else np.asarray(scipy.linalg.cho_solve(self._factor, x, check_finite=False))

    def shortest(self, rows: Array) -> Array:
        """Return the least step d, in the metric, with J d = rows."""
        return np.asarray(self.spread.T @ self.inner(rows))

    def multipliers(self, force: Array) -> Array:
        """Return y that makes force + Jᵀy least, in the inverse metric."""
        return -self.inner(self.spread @ force)

    def project(self, force: Array) -> Array:
        """Return the D⁻¹ force, less what J sees."""
        w = self.metric.solve(force)
        return w - self.spread.T @ self.inner(self.jacobian @ w)
