"""Condition that damped strings do not go slack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import Limit, RateBound, drop_infinite
from ocp.problem.instant import Instant
from tenscasadi.util.validate import Array

# in the names of limits that hold at single instants of converted rest lengths
AT_INSTANT = "at an instant"


@dataclass(frozen=True, eq=False)
class TautStrings(RateBound):
    """Condition that damped strings are longer than their rest lengths.

    A string with force density γ, length s and damping c has the elastic force density γ − c ṡ/s,
    which has to be at least `least` [N/m]. A shorter string is slack, and its damping exerts no
    force. The rates ṡ are means over intervals: limits at mesh points alone would permit strings
    that get longer between them. `damping` (α,) [N s/m] includes a margin, and is 0 for strings
    that cannot go slack.
    """

    damping: Array
    least: float = 0.0

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the elastic force densities at both ends of an interval, and their limits.

        `interval` is the time [s] from `before` to `after`.
        """
        damping = ca.DM(self.damping) * (after.lengths - before.lengths) / interval
        elastic = [now.force_density - damping / now.lengths for now in (before, after)]
        strings = range(len(self.damping))
        names = tuple(
            f"elastic force density of string {k}, {AT_INSTANT}" for _ in elastic for k in strings
        )
        lower = np.tile(np.where(self.damping > 0, self.least, -np.inf), 2)
        upper = np.full(len(lower), np.inf)
        return drop_infinite(Limit(ca.vertcat(*elastic), lower, upper, names, "N/m"))
