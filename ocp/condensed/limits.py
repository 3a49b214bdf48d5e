"""Limits of unknowns, and the logarithmic barriers before them."""

from __future__ import annotations

import numpy as np

from tenscasadi.util.validate import Array

NO_LIMIT = 1e300  # distance from a limit that does not exist


class Limits:
    """lower ≤ w ≤ upper (n,), where they are finite; unknowns whose limits are equal do not move."""

    def __init__(self, lower: Array, upper: Array) -> None:
        self.lower, self.upper = lower, upper
        self.free = lower < upper
        self.below, self.above = np.isfinite(lower) & self.free, np.isfinite(upper) & self.free

    def gaps(self, w: Array) -> tuple[Array, Array]:
        """Return the distances (n,) from the lower and from the upper limits."""
        return np.where(self.below, w - self.lower, NO_LIMIT), np.where(
            self.above, self.upper - w, NO_LIMIT
        )

    def barrier(self, w: Array) -> float:
        """Return −Σ log of the distances."""
        low, high = self.gaps(w)
        return -float(np.log(low[self.below]).sum() + np.log(high[self.above]).sum())

    def barrier_slope(self, w: Array) -> Array:
        """Return its gradient."""
        low, high = self.gaps(w)
        return self.above / high - self.below / low

    def inside(self, w: Array, room: float, share: float) -> Array:
        """Return w at least `room` inside, or a share of what lies between the limits where that is less."""
        width = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, np.inf)
        least = np.minimum(room, share * width)
        return np.clip(
            w,
            self.lower + np.where(self.below, least, 0.0),
            self.upper - np.where(self.above, np.minimum(least, 0.05 * width), 0.0),
        )

    def cut(self, w: Array, step: Array, most: float, room: float) -> Array:
        """Return a step from w whose entries take at most a share of the way to the limits, and half of it within `room` of these."""
        low, high = (
            np.where(gap > 2 * room, np.minimum(most * gap, gap - room), 0.5 * gap)
            for gap in self.gaps(w)
        )
        return np.clip(step, -low, high) * self.free

    def followed(self, slack: Array, step: Array, true: Array, most: float, room: float) -> Array:
        """Return slacks after a step, cut as above; but `true`, what they stand for, where that keeps as much of the distances from limits."""
        kept = [
            new >= (1 - most) * gap
            for gap, new in zip(self.gaps(slack), self.gaps(true), strict=True)
        ]
        return np.where(
            kept[0] & kept[1] & self.free, true, slack + self.cut(slack, step, most, room)
        )


class LimitDuals:
    """Multipliers (n,) of the lower and of the upper limits, about μ over the distance."""

    def __init__(self, limits: Limits, w: Array, mu: float) -> None:
        low, high = limits.gaps(w)
        self.limits = limits
        self.lower, self.upper = limits.below * mu / low, limits.above * mu / high

    @property
    def net(self) -> Array:
        """Multipliers of what is limited: positive where an upper limit holds."""
        return self.upper - self.lower

    def stiffness(self, w: Array) -> Array:
        """Return what stands for the second derivatives of the barrier (n,)."""
        low, high = self.limits.gaps(w)
        return self.lower / low + self.upper / high

    def error(self, w: Array, mu: float) -> float:
        """Return how far products with the distances are from μ."""
        low, high = self.limits.gaps(w)
        found = np.abs(
            np.append(
                (self.lower * low - mu)[self.limits.below],
                (self.upper * high - mu)[self.limits.above],
            )
        )
        return float(found.max(initial=0.0))

    def follow(
        self, before: Array, after: Array, step: Array, mu: float, most: float, spread: float
    ) -> None:
        """Take the Newton step that belongs to a step of w; stay positive, and within a factor `spread` of μ over the distance."""
        limits = self.limits
        for dual, gap, new, direction in zip(
            (self.lower, self.upper),
            limits.gaps(before),
            limits.gaps(after),
            (step, -step),
            strict=True,
        ):
            change = mu / gap - dual - dual * direction / gap
            dual[:] = np.maximum(dual + change, (1 - most) * dual)
            dual[:] = np.clip(dual, mu / (spread * new), spread * mu / new)
        self.lower *= limits.below
        self.upper *= limits.above
