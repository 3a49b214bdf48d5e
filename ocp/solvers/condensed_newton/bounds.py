"""Variable bounds with logarithmic barriers, and the working set."""

from __future__ import annotations

import numpy as np

from tenscasadi.util.validate import LARGEST, Array, Booleans, Indices


class VariableBounds:
    """Bounds lower ≤ w ≤ upper on variables (n,).

    `below` and `above` mark finite lower and upper bounds, `free` the variables whose bounds
    differ.
    """

    def __init__(self, lower: Array, upper: Array) -> None:
        self.lower, self.upper = lower, upper
        self.free = lower < upper
        self.below, self.above = np.isfinite(lower) & self.free, np.isfinite(upper) & self.free

    def gaps(self, w: Array) -> tuple[Array, Array]:
        """Compute the distances (n,) from lower and upper bounds.

        They are w − lower and upper − w for the variables w (n,). Without a bound, the distance is
        the large number LARGEST.
        """
        low, high = np.full(len(w), LARGEST), np.full(len(w), LARGEST)
        low[self.below] = (w - self.lower)[self.below]
        high[self.above] = (self.upper - w)[self.above]
        return low, high

    def barrier(self, w: Array) -> float:
        """Compute the barrier function −Σ log(distance from bounds).

        The variables are w (n,). Infinite bounds do not count.
        """
        low, high = self.gaps(w)
        return -float(np.log(low[self.below]).sum() + np.log(high[self.above]).sum())

    def barrier_slope(self, w: Array) -> Array:
        """Compute the gradient (n,) of the barrier function at w (n,)."""
        low, high = self.gaps(w)
        return self.above / high - self.below / low

    def inside(self, w: Array, distance: float, share: float) -> Array:
        """Move w to the interior of the bounds.

        The minimum distance from a bound is `distance`, or the fraction `share` of the width if
        that is less.
        """
        width = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, np.inf)
        least = np.minimum(distance, share * width)
        return np.clip(
            w,
            self.lower + np.where(self.below, least, 0.0),
            self.upper - np.where(self.above, np.minimum(least, 0.05 * width), 0.0),
        )

    def cut(self, w: Array, step: Array, most: float, least: float) -> Array:
        """Shorten a step so that it stays within the bounds.

        Each component covers at most the fraction `most` of the distance to its bound, and keeps
        the distance `least`. Returns the shortened step from w.
        """
        low, high = (
            np.where(gap > 2 * least, np.minimum(most * gap, gap - least), 0.5 * gap)
            for gap in self.gaps(w)
        )
        return np.clip(step, -low, high) * self.free

    def follow(self, slack: Array, step: Array, true: Array, most: float, least: float) -> Array:
        """Move slacks to the constraint values `true` within the bounds.

        Those that would come too close to a bound take the shortened step instead, see `cut`.
        `most` and `least` are those of `cut`. `slack` are the slacks before, and `step` is their
        Newton step. Returns the new slacks.
        """
        kept = [
            new >= (1 - most) * gap
            for gap, new in zip(self.gaps(slack), self.gaps(true), strict=True)
        ]
        return np.where(
            kept[0] & kept[1] & self.free, true, slack + self.cut(slack, step, most, least)
        )


class BoundDuals:
    """Dual variables (n,) of lower and upper bounds.

    Their initial values are μ / distance from the bound, at the variables `w` and the barrier
    parameter μ (`mu`).
    """

    def __init__(self, bounds: VariableBounds, w: Array, mu: float) -> None:
        low, high = bounds.gaps(w)
        self.bounds = bounds
        self.lower, self.upper = bounds.below * mu / low, bounds.above * mu / high

    @property
    def net(self) -> Array:
        """Dual of the upper minus that of the lower bound, (n,)."""
        return self.upper - self.lower

    def stiffness(self, w: Array) -> Array:
        """Compute primal-dual second derivatives (n,) of the barrier.

        They are Σ dual / distance over both bounds of each variable in w (n,).
        """
        low, high = self.bounds.gaps(w)
        return self.lower / low + self.upper / high

    def error(self, w: Array, mu: float) -> float:
        """Compute the largest complementarity error at w.

        It is |dual · distance − μ| at the barrier parameter μ (`mu`).
        """
        low, high = self.bounds.gaps(w)
        below = (self.lower * low - mu)[self.bounds.below]
        above = (self.upper * high - mu)[self.bounds.above]
        return float(np.abs(np.append(below, above)).max(initial=0.0))

    def follow(self, before: Array, after: Array, step: Array, mu: float, most: float) -> None:
        """Update the duals by Newton's method for a step of the variables.

        The variables change from `before` to `after`, with the Newton step `step`. The duals
        decrease by at most the fraction `most`, and stay near μ / distance. `mu` is the barrier
        parameter μ.
        """
        spread, bounds = 100.0, self.bounds  # spread: largest factor away from μ over the distance
        ways = zip(
            (self.lower, self.upper),
            bounds.gaps(before),
            bounds.gaps(after),
            (step, -step),
            strict=True,
        )
        for dual, gap, new, direction in ways:
            change = mu / gap - dual - dual * direction / gap
            dual[:] = np.maximum(dual + change, (1 - most) * dual)
            dual[:] = np.clip(dual, mu / (spread * new), spread * mu / new)
        self.lower *= bounds.below
        self.upper *= bounds.above


class WorkingSet:
    """Path constraints that are soft constraints of a step.

    The other path constraints enter by the diagonal of the metric, and by products with the second
    derivatives.
    """

    def __init__(self) -> None:
        self.size = 0.0  # typical compliance of a row in the metric

    def learn(self, sizes: Array) -> None:
        """Store the typical compliance of the selected constraints.

        The compliances J D⁻¹ Jᵀ of constraints with gradient J in the metric D are the entries of
        `sizes`.
        """
        if len(sizes):
            self.size = float(np.median(sizes))

    def choose(self, stiffness: Array, left: Array) -> Indices:
        """Select constraints (p',) by barrier curvature and violation.

        `stiffness` are the second derivatives of their barriers, `left` their violations. Returns
        the indices of the selected constraints.
        """
        if self.size:
            felt = stiffness * self.size > 1e-2  # of the metric
        else:  # a few, from which the size is learned
            felt = stiffness >= np.sort(stiffness)[-30:].min(initial=np.inf)
        return select_stiffest(stiffness, felt | (np.abs(left) > 1e-9))


def select_stiffest(stiffness: Array, among: Booleans) -> Indices:
    """Select the 400 constraints with the largest barrier curvature.

    `stiffness` (p,) are the curvatures; `among` marks the constraints that can be selected. Returns
    their indices in ascending order.
    """
    rows = np.flatnonzero(among)
    return np.sort(rows[np.argsort(stiffness[rows], kind="stable")[::-1][:400]])
