"""Where the goals of a problem lead, and the rows that impose them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.linalg

from ocp.boundary.free_start import Cycle
from ocp.boundary.row_reduction import Combined
from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Target:
    """Where the goals lead, and the rows that impose them.

    start: x₀ (nx,) on the constraints. state: the nearest state (nx,) that meets the goals, or None without goals. weights (count, m): independent
    combinations of the m rows of single, a Function x → rows, all zero at the goal; they are dense, and apart from the rows, whose derivatives are
    sparse. misfit: Function x → (metres, metres per second), the distance from the goals in each of
    `names` (first those in metres). given: rows of the goals; repeated: rows left out, by what repeats them; shape: rows added
    because string lengths are singular at the target. combined: what `rows` consist of. waypoints: what is to be met on the way. cycle: rows
    of a free start, near which `start` is then.
    """

    start: Array
    state: Array | None
    single: ca.Function
    weights: Array
    misfit: ca.Function
    names: tuple[str, ...]
    given: int
    repeated: dict[str, int]
    shape: int
    adjusted: float
    combined: Combined
    waypoints: tuple[TargetOnTheWay, ...] = ()
    cycle: Cycle | None = None

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
        return ca.Function("goal", [x], [ca.mtimes(ca.DM(self.weights), self.single(x))], ["x"], ["rows"])

    def begun(self, start: Array) -> Target:
        """The target of a motion from a free start that has been found, whose rows and misfit include those of repeating it."""
        cycle = self.cycle
        if cycle is None:
            return self
        x = ca.MX.sym("x", len(start))
        (metres, speeds), (more_metres, more_speeds) = self.misfit(x), cycle.misfit(start, x)
        count, more = metres.shape[0], more_metres.shape[0]
        own, other = self.combined, cycle.combined
        combinations = scipy.linalg.block_diag(own.combinations, other.combinations)
        return replace(
            self,
            start=start,
            single=ca.Function("single", [x], [ca.vertcat(self.single(x), cycle.repeats(start, x))]),
            weights=scipy.linalg.block_diag(self.weights, np.eye(cycle.repeats.size1_out(0))),
            misfit=ca.Function("misfit", [x], [ca.vertcat(metres, more_metres), ca.vertcat(speeds, more_speeds)], ["x"], ["metres", "speeds"]),
            names=(*self.names[:count], *cycle.names[:more], *self.names[count:], *cycle.names[more:]),
            given=self.given + len(cycle.names),
            repeated={kind: self.repeated.get(kind, 0) + cycle.repeated.get(kind, 0) for kind in (*self.repeated, *cycle.repeated)},
            combined=Combined(combinations, own.names + other.names, np.append(own.sizes, other.sizes)),
            cycle=None,
        )

    def describe(self) -> str:
        """The count of rows, such as "36 → 21 rows: 6 bar, 9 momentum"."""
        if not self.given:
            return "; ".join(one.label + one.target.describe() for one in self.waypoints) or "no goals"
        text = f"{self.given} → {self.count} rows"
        parts = [f"{count} {kind}" for kind, count in self.repeated.items()] + ([f"{self.shape} added for the shape"] if self.shape else [])
        text += ": " + ", ".join(parts) if parts else ""
        text += f"; goals adjusted by {self.adjusted:.1e} m to fit the bars" if self.adjusted else ""
        return "; ".join([text, *(one.label + one.target.describe() for one in self.waypoints)])


class TargetOnTheWay(NamedTuple):
    """What the goals of a waypoint lead to, at a share of the duration."""

    share: float
    target: Target

    @property
    def label(self) -> str:
        """What the names of its goals begin with."""
        return f"waypoint at {self.share:.3g} of the duration, "
