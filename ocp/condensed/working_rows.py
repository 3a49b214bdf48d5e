"""Which of the limits along the way are near enough to count among the rows of a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ocp.condensed.path_rows import PathRows
from tenscasadi.util.validate import Array, Indices

MOST = 400  # rows
FELT = 1e-2  # of the metric: what a row adds to it at least
UNMET = 1e-9  # in order-one rows
SAMPLE = 30  # rows, from which is learnt what they add


class WorkingRows:
    """Rows that are met, as their limits are equal, and those whose barriers bend the costs most.

    All others act through products with the second derivatives alone.
    """

    def __init__(self, paths: PathRows) -> None:
        self.free, self.met = paths.limits.free, np.flatnonzero(~paths.limits.free)
        self.size = 0.0  # of B D⁻¹ Bᵀ, typical

    def learn(self, sizes: Array) -> None:
        """Remember how far the metric lets rows give way."""
        if len(sizes):
            self.size = float(np.median(sizes))

    def choose(self, stiffness: Array, left: Array) -> Indices:
        """Return rows (p',), those that are met first, given how stiff their barriers are, and what they leave unmet."""
        felt = stiffness * self.size > FELT if self.size else stiffness >= np.sort(stiffness)[-SAMPLE:].min(initial=np.inf)
        return np.append(self.met, self.stiffest(stiffness, felt | (np.abs(left) > UNMET)))

    def stiffest(self, stiffness: Array, among: NDArray[np.bool_]) -> Indices:
        """Return those rows that are stiffest, in their order, among some that are not met."""
        rows = np.flatnonzero(among & self.free)
        return np.sort(rows[np.argsort(stiffness[rows], kind="stable")[::-1][:MOST]])
