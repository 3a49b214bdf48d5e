"""Target state of the goals, and its rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.linalg

from ocp.targets.row_reduction import Reduction
from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Target:
    """Target state of the goals, and its rows.

    Attributes
    ----------
    start : ndarray, shape (nx,)
        Initial state x₀ on the constraints.
    state : ndarray, shape (nx,), or None
        Nearest state that meets the goals; None without goals.
    single : casadi.Function
        x → m rows, all zero at the goal. Their derivatives are sparse.
    weights : ndarray, shape (count, m)
        Independent combinations of these rows, dense.
    misfit : casadi.Function
        x → (distance [m], speed [m/s]) from each goal.
    names : tuple of str
        Names of the goals, those in meters first.
    reduction : Reduction
        Composition of the rows.
    shape : int
        Number of final rows that replace singular string lengths.
    adjusted : float
        Adjustment of goals to the bar lengths [m].
    waypoints : tuple of WaypointTarget
        Targets of waypoints.
    free_start : FreeStartRows or None
        Rows of a free start, near which `start` is.
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
        """Number of imposed rows."""
        return len(self.weights)

    @property
    def instants(self) -> list[tuple[float, Target, str]]:
        """Fractions of the duration, targets and name prefixes.

        The first entry is the end.
        """
        return [(1.0, self, ""), *((one.share, one.target, one.label) for one in self.waypoints)]

    @property
    def rows(self) -> ca.Function:
        """Function x → imposed rows, zero at the goal."""
        x = ca.MX.sym("x", self.single.size1_in(0))
        return ca.Function(
            "goal", [x], [ca.mtimes(ca.DM(self.weights), self.single(x))], ["x"], ["rows"]
        )

    def keep(self, kept: Array, reason: str) -> Target:
        """Keep the combinations `kept` (k, count) of rows.

        The others are counted with a reason.
        """
        return replace(
            self, weights=kept @ self.weights, reduction=self.reduction.keep(kept, reason)
        )

    def begin_at(self, start: Array) -> Target:
        """Build the target for a start that was found.

        Its rows and misfit include those of a periodic motion.
        """
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
        """Describe the rows in one line.

        An example is "36 → 21 rows: 6 bar, 9 momentum".
        """
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
    """Target of a waypoint, at a fraction of the duration."""

    share: float
    target: Target

    @property
    def label(self) -> str:
        """Prefix of the names of its goals."""
        return f"waypoint at {self.share:.3g} of the duration, "


@dataclass(frozen=True, eq=False)
class FreeStartRows:
    """Rows of a free start x₀ and end x.

    Attributes
    ----------
    start : casadi.Function
        x₀ → independent rows of bars and initial goals.
    repeats : casadi.Function
        (x₀, x) → independent rows, zero if the end repeats the start.
    misfit : casadi.Function
        (x₀, x) → (distance [m], speed [m/s]) of each goal row.
    reduction : Reduction
        Composition of `repeats`.
    """

    start: ca.Function
    repeats: ca.Function
    misfit: ca.Function
    reduction: Reduction
