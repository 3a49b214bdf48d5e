"""Gauss-Newton search for the nearest state that meets goals.

A quadratic equation replaces the linear one if gradients vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp

from ocp.problem.rows import RESOLUTION
from ocp.targets.row_reduction import RowFunction, soft_directions
from tenscasadi.util.linear_algebra import find_blocks
from tenscasadi.util.validate import MAX_ITERATIONS, ROUNDING, Array

STRIDE = 0.1  # relative to the structure's size: largest relative displacement of nodes in a step
NEARLY_SINGULAR = 3e-2  # rank tolerance below which a quadratic equation replaces Newton's step
# a step that leaves less than this fraction of the residual is accepted without alternatives
QUICK = 0.9
CRAWL, PATIENCE = (
    0.99,
    5,
)  # the search stops after 5 steps that each leave more than 99 % of the residual
# iterations on the quadratic; where it has no root, up to 600 took two thirds of the time of plans
# of thrown structures
MAX_TRIALS = 20
STARTS = 8  # starting points of a local search


class GaussNewton:
    """Gauss-Newton method with minimum-norm steps in a metric.

    It reduces residuals r(y) with the Jacobian J, both scaled. Steps are in scaled unknowns, which
    are y divided by `scale` (ny,). The `metric` (ny, ny) applies to them. With the mass matrix,
    steps neither rotate nor translate an unsupported structure.

    `allowed` projects y onto the admissible values. `deforming` selects the part of a scaled step
    that moves nodes relative to each other; steps along the rest may be long, as residuals are
    nearly linear in it.
    """

    def __init__(
        self,
        scale: Array,
        metric: Array,
        allowed: Callable[[Array], Array],
        deforming: Callable[[Array], Array],
    ) -> None:
        self._scale, self._allowed, self._deforming = scale, allowed, deforming
        self._basis = np.linalg.inv(
            np.linalg.cholesky(metric)
        ).T  # columns of unit length in the metric

    def find_nearest(self, rows: RowFunction, goals: int, y: Array) -> Array:
        """Minimize the goal residuals subject to the other residuals.

        The search starts at y. The first `goals` residuals are minimized; the others are zero at
        the result, up to rounding.
        """
        crawling, size = 0, rows.size(y)
        for _ in range(MAX_ITERATIONS):
            best, least = None, size
            if size < ROUNDING or crawling == PATIENCE:
                break
            for trial, left in self._trials(rows, y, size):
                if left < least:
                    best, least = trial, left
                if least < QUICK * size:
                    break
            if best is None:
                break
            crawling = crawling + 1 if least > CRAWL * size else 0
            y, size = best, least
        kept, before = rows.select(slice(goals, rows.count)), np.inf
        for _ in range(
            MAX_ITERATIONS
        ):  # rigid rows come last, so that the goal's residual shows the violation
            size = kept.size(y)
            if size < ROUNDING or size > CRAWL * before:
                break
            y, before = self._moved(y, self._step(kept, y, RESOLUTION)), size
        return y

    def _trials(self, rows: RowFunction, y: Array, size: float) -> Iterator[tuple[Array, float]]:
        """Yield values of y, one step from the given y, with smaller residuals.

        Steps are along regular directions, along all directions, and along those constrained only
        to second order. `rows` are the residuals, whose norm at the given y is `size`. Each y comes
        with its norm.
        """
        for step in self._steps(rows, y, NEARLY_SINGULAR, RESOLUTION):
            yield from self._shortened(rows, y, size, step, follow=False)
        soft = self._soft_step(rows, y)
        if soft is not None:
            yield from self._shortened(rows, y, size, soft, follow=True)

    def _shortened(
        self, rows: RowFunction, y: Array, size: float, step: Array, follow: bool
    ) -> Iterator[tuple[Array, float]]:
        """Yield y after the first of step, step/2, … that reduces the residuals.

        `step` is in scaled unknowns, and `size` the norm of the residuals before it. With `follow`,
        a Gauss-Newton step along regular directions corrects each trial first. The norm after the
        step comes with y.
        """
        for halvings in range(8):
            trial = self._moved(y, step * 0.5**halvings)
            if follow:
                trial = self._moved(trial, self._step(rows, trial, NEARLY_SINGULAR))
            if (left := rows.size(trial)) < size:
                yield trial, left
                return

    def _step(self, rows: RowFunction, y: Array, rank_tolerance: float) -> Array:
        return next(self._steps(rows, y, rank_tolerance))

    def _steps(self, rows: RowFunction, y: Array, *rank_tolerances: float) -> Iterator[Array]:
        """Yield the Gauss-Newton step −J⁺ r for each rank tolerance.

        r and J are the residuals `rows` and their Jacobian at y. Singular values of J below the
        tolerance, relative to the largest, are omitted.
        """
        r, J = rows(y)
        inverse = self._pseudoinverse(J)
        for tolerance in rank_tolerances:
            step = -inverse(r, tolerance)
            wanted = y + step * self._scale
            allowed = self._allowed(wanted)
            held = allowed != wanted
            if held.any():  # unknowns at their limits are fixed for the others
                fixed = np.where(held, (allowed - y) / self._scale, 0.0)
                step = fixed - self._pseudoinverse(np.where(held, 0.0, J))(r + J @ fixed, tolerance)
            yield self._strided(step)

    def _pseudoinverse(self, J: Array) -> Callable[[Array, float], Array]:
        """Build the pseudoinverse of J in the metric.

        It is (r, tolerance) → J⁺ r, with minimum norm. Singular values below the tolerance times
        the largest are dropped. The smaller of A Aᵀ and Aᵀ A is decomposed, because tolerances are
        far above the square root of rounding.
        """
        A = np.asarray(sp.csr_array(J) @ self._basis)
        parts = []
        for rows, columns in find_blocks(A):
            own = A[np.ix_(rows, columns)]
            wide = len(rows) <= len(columns)
            values, vectors = np.linalg.eigh(own @ own.T if wide else own.T @ own)
            parts.append(
                (
                    rows,
                    columns,
                    values,
                    *((vectors, own.T @ vectors) if wide else (own @ vectors, vectors)),
                )
            )
        largest = max((float(values[-1]) for _, _, values, _, _ in parts), default=0.0)

        def solve(r: Array, tolerance: float) -> Array:
            x = np.zeros(A.shape[1])
            for rows, columns, values, left, right in parts:
                used = values > tolerance**2 * largest
                x[columns] = right[:, used] @ ((left[:, used].T @ r[rows]) / values[used])
            return np.asarray(self._basis @ x)

        return solve

    def _soft_step(self, rows: RowFunction, y: Array) -> Array | None:
        """Compute a step d from second derivatives of the residuals at y.

        It solves c + b d + ½ dᵀ K d = 0 for the combinations of residuals with (nearly) zero
        gradient. c, b and K are their values and first and second derivatives. Returns None if
        there are no such combinations.
        """
        directions, W, K = soft_directions(rows, y, NEARLY_SINGULAR)
        if not directions.shape[1]:
            return None
        r, J = rows(y)
        c, b = W.T @ r, W.T @ J @ directions
        reach = np.sqrt(2 * np.abs(c).max() / max(np.abs(K).max(), 1e-12))
        axes = np.eye(directions.shape[1])[-STARTS // 2 :]  # of largest curvature
        starts = reach * np.repeat(axes, 2, axis=0)
        starts[1::2] *= -1.0
        costs, found = solve_quadratics(c, b, K, starts)
        best = min(
            zip(costs, found, strict=True),
            key=lambda pair: (round(float(pair[0]), 15), float(np.linalg.norm(pair[1]))),
        )
        return self._strided(directions @ best[1])

    def _strided(self, step: Array) -> Array:
        deforming = self._deforming(step)
        largest = np.abs(deforming).max(initial=0.0)
        return step - (1 - STRIDE / largest) * deforming if largest > STRIDE else step

    def _moved(self, y: Array, step: Array) -> Array:
        return self._allowed(y + step * self._scale)


def solve_quadratics(c: Array, b: Array, K: Array, starts: Array) -> tuple[Array, Array]:
    """Reduce the residuals c + b d + ½ dᵀ K d from several starts at once.

    It is the Levenberg-Marquardt method with the damping of Nielsen (Report IMM-REP-1999-05); all
    starts share its iterations. `c` (j,), `b` (j, k) and the symmetric `K` (j, k, k) are the value
    and the derivatives; `starts` are (n, k). Returns the costs (n,), half the sums of squares, and
    the values of d (n, k).
    """

    def evaluate(d: Array) -> tuple[Array, Array]:
        bent = (d @ K.reshape(-1, d.shape[1]).T).reshape(len(d), *b.shape)
        r = c + d @ b.T + (bent @ d[:, :, None])[:, :, 0] / 2
        return r, b + bent

    d, grown = starts, np.full(len(starts), 2.0)
    r, J = evaluate(d)
    eye = np.eye(d.shape[1])
    damping = 1e-3 * np.maximum((J**2).sum(axis=1).max(axis=1), 1e-300)
    for _ in range(MAX_TRIALS):
        # less than the rounding of JᵀJ would leave H singular
        damping = np.maximum(damping, ROUNDING * (J**2).sum(axis=1).max(axis=1))
        slope = (r[:, None] @ J)[:, 0]
        H = J.transpose(0, 2, 1) @ J + damping[:, None, None] * eye
        step = -np.linalg.solve(H, slope[:, :, None])[:, :, 0]
        tried, bent = evaluate(d + step)
        gain = (r**2).sum(axis=1) - (tried**2).sum(axis=1)
        expected = (step * (damping[:, None] * step - slope)).sum(axis=1)
        ratio = np.divide(gain, expected, out=np.zeros_like(gain), where=expected > 0)
        better = gain > 0
        d, r = (np.where(better[:, None], new, old) for new, old in ((d + step, d), (tried, r)))
        J = np.where(better[:, None, None], bent, J)
        shrunk = np.maximum(1 / 3, 1 - (2 * np.minimum(ratio, 1.0) - 1) ** 3)
        damping = damping * np.where(better, shrunk, grown)
        grown = np.where(better, 2.0, 2 * grown)
    return (r**2).sum(axis=1) / 2, d
