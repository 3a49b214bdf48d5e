"""Where the goals of a problem lead, and the rows that impose them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.linalg

from ocp.targets.free_start import FreeStartRows
from ocp.targets.row_reduction import Reduction
from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Target:
    """Where the goals lead, and the rows that impose them.

    start: x₀ (nx,) on the constraints. state: the nearest state (nx,) that meets the goals, or None
    without goals. weights (count, m): independent combinations of the m rows of single, a Function
    x → rows, all zero at the goal; they are dense, and apart from the rows, whose derivatives are
    sparse. misfit: Function x → (metres, metres per second), the distance from the goals in each of
    `names` (first those in metres). reduction: what `rows` consist of; its last `shape` rows are
    added because string lengths are singular at the target. adjusted: by how much goals are moved
    to fit the bars, m. waypoints: what is to be met on the way. free_start: rows of a free start,
    near which `start` is.
    """

    start: Array
    state: Array | None
    single: ca.Function
    weights: Array
    misfit: ca.Function
    names: tuple[str, ...]
    reduction: Reduction
    shape: int = 0
    adjusted: float = 0.0
    waypoints: tuple[WaypointTarget, ...] = ()
    free_start: FreeStartRows | None = None

    @property
    def count(self) -> int:
        """Rows that are imposed."""
        return len(self.weights)

    @property
    def instants(self) -> list[tuple[float, Target, str]]:
        """When something is to be met, as a share of the duration; what; and what names of its goals begin with: first the end."""
        return [(1.0, self, ""), *((one.share, one.target, one.label) for one in self.waypoints)]

    @property
    def rows(self) -> ca.Function:
        """Function x → the rows that are imposed, zero at the goal."""
        x = ca.MX.sym("x", self.single.size1_in(0))
        return ca.Function(
            "goal", [x], [ca.mtimes(ca.DM(self.weights), self.single(x))], ["x"], ["rows"]
        )

    def keep(self, kept: Array, reason: str) -> Target:
        """Return the target with the combinations `kept` (k, count) of its rows; the others are left out for a reason."""
        return replace(
            self, weights=kept @ self.weights, reduction=self.reduction.keep(kept, reason)
        )

    def begin_at(self, start: Array) -> Target:
        """Return the target of a motion from a free start that has been found, whose rows and misfit include those of repeating it."""
        free = self.free_start
        if free is None:
            return self
        x = ca.MX.sym("x", len(start))
        (metres, speeds), (more_metres, more_speeds) = self.misfit(x), free.misfit(start, x)
        count, more = metres.shape[0], more_metres.shape[0]
        return replace(
            self,
            start=start,
            single=ca.Function("single", [x], [ca.vertcat(self.single(x), free.repeats(start, x))]),
            weights=scipy.linalg.block_diag(self.weights, np.eye(free.repeats.size1_out(0))),
            misfit=ca.Function(
                "misfit",
                [x],
                [ca.vertcat(metres, more_metres), ca.vertcat(speeds, more_speeds)],
                ["x"],
                ["metres", "speeds"],
            ),
            names=(
                *self.names[:count],
                *free.reduction.names[:more],
                *self.names[count:],
                *free.reduction.names[more:],
            ),
            reduction=self.reduction.join(free.reduction),
            free_start=None,
        )

    def describe(self) -> str:
        """Return the count of rows, such as "36 → 21 rows: 6 bar, 9 momentum"."""
        given = len(self.reduction.names) - self.shape
        if not given:
            return (
                "; ".join(one.label + one.target.describe() for one in self.waypoints) or "no goals"
            )
        text = f"{given} → {self.count} rows"
        left_out = [f"{count} {kind}" for kind, count in self.reduction.repeated.items()]
        left_out += [f"{self.shape} added for the shape"] if self.shape else []
        text += ": " + ", ".join(left_out) if left_out else ""
        text += (
            f"; goals adjusted by {self.adjusted:.1e} m to fit the bars" if self.adjusted else ""
        )
        return "; ".join([text, *(one.label + one.target.describe() for one in self.waypoints)])


class WaypointTarget(NamedTuple):
    """The target of a waypoint, at a share of the duration."""

    share: float
    target: Target

    @property
    def label(self) -> str:
        """The words that names of its goals begin with."""
        return f"waypoint at {self.share:.3g} of the duration, "
