"""Final state that meets the goals, and its constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.linalg

from ocp.problem.rows import RELIABLE
from ocp.targets.row_reduction import Reduction
from tenscasadi.util.validate import TOLERANCE, Array, Indices

StateAt = Callable[[float], Array]  # fraction of the duration → state (nx,), or states (n, nx)


class GoalResiduals(NamedTuple):
    """Absolute residuals of the user's goals in n trajectories.

    Attributes
    ----------
    values : ndarray, shape (n, m)
        Residuals [m or m/s].
    names, units : tuple of str
        Name and unit of each row.
    """

    values: Array
    names: tuple[str, ...]
    units: tuple[str, ...]

    def select(self, unit: str) -> Array:
        """Select the residuals (n, ·) in a unit."""
        return self.values[:, [own == unit for own in self.units]]

    def distances(self, duration: float) -> Array:
        """Compute the residuals [m], with velocities times the duration."""
        return self.values * [duration if unit == "m/s" else 1.0 for unit in self.units]

    def find_worst(self, duration: float) -> tuple[str, float, str]:
        """Find the largest residual of the first trajectory.

        Returns its name, value and unit. Velocities are multiplied by the duration for the
        comparison.
        """
        k = int(np.argmax(self.distances(duration)[0]))
        return self.names[k], float(self.values[0, k]), self.units[k]


@dataclass(frozen=True, eq=False)
class Target:
    """Final state that meets the goals, and the goal constraints.

    Attributes
    ----------
    start : ndarray, shape (nx,)
        Initial state x₀ on the constraints.
    state : ndarray, shape (nx,), or None
        State nearest to the goals; None without goals.
    single : casadi.Function
        x → m residuals (goal rows), all zero if the goals are met. Their derivatives are sparse.
    weights : ndarray, shape (count, m)
        Independent combinations of these residuals, dense.
    misfit : casadi.Function
        x → residuals of the user's goals.
    names, units : tuple of str
        Names and units of the user's goals.
    reduction : Reduction
        Composition of the independent combinations.
    shape : int
        Number of distances that replace singular string lengths.
    adjusted : float
        Adjustment of goals to the bar lengths [m].
    met : bool
        Whether `state` meets the goals.
    waypoints : tuple of WaypointTarget
        Targets of waypoints.
    free_start : FreeStartRows or None
        Constraints on a free initial state, near which `start` is.
    tolerance : float
        Tolerance of the goals, relative to the structure's size.
    """

    start: Array
    state: Array | None
    single: ca.Function
    weights: Array
    misfit: ca.Function
    names: tuple[str, ...]
    units: tuple[str, ...]
    reduction: Reduction = field(default_factory=lambda: Reduction(np.zeros((0, 0))))
    shape: int = 0
    adjusted: float = 0.0
    met: bool = True
    waypoints: tuple[WaypointTarget, ...] = ()
    free_start: FreeStartRows | None = None
    tolerance: float = RELIABLE

    @property
    def count(self) -> int:
        """Number of independent goal constraints."""
        return len(self.weights)

    @property
    def instants(self) -> list[tuple[float, Target, str]]:
        """Fractions of the duration, targets and name prefixes.

        The first entry is the end of the plan, the others are the waypoints.
        """
        return [(1.0, self, ""), *((one.share, one.target, one.label) for one in self.waypoints)]

    @property
    def rows(self) -> ca.Function:
        """Function x → independent goal residuals, zero if they are met."""
        x = ca.MX.sym("x", self.single.size1_in(0))
        return ca.Function(
            "goal", [x], [ca.mtimes(ca.DM(self.weights), self.single(x))], ["x"], ["rows"]
        )

    @property
    def residual(self) -> float:
        """Permitted residual of dependent goal rows, relative to their scale."""
        return float(np.clip(0.5 * self.tolerance, TOLERANCE, 0.5 * RELIABLE))

    @property
    def dependent(self) -> Indices:
        """Indices of goal rows that the independent combinations do not determine.

        Near the target the conserved quantities satisfy them. Elsewhere they need not: a bar
        perpendicular to its direction at the target can still rotate.
        """
        basis = np.linalg.qr(self.weights.T)[0][: len(self.names)]
        # the squared sine of a row to the imposed combinations is 0 where they determine it
        return np.flatnonzero(1.0 - (basis * basis).sum(axis=1) > TOLERANCE)

    def measure(self, state_at: StateAt) -> GoalResiduals:
        """Compute the residuals of goals and waypoints of trajectories.

        `state_at` returns their states (n, nx) at a fraction of the duration. Residuals of
        waypoints are at their fractions.
        """
        values: list[Array] = []
        names: tuple[str, ...] = ()
        units: tuple[str, ...] = ()
        for share, part, label in self.instants:
            states = np.atleast_2d(state_at(share))
            found = part.misfit.map(len(states))(states.T) if part.names else np.zeros((0, 1))
            values.append(np.abs(ca.DM(found).full()).T)
            names += tuple(label + name for name in part.names)
            units += part.units
        count = max(len(one) for one in values)
        return GoalResiduals(np.hstack([one for one in values if len(one) == count]), names, units)

    def keep(self, kept: Array, reason: str) -> Target:
        """Reduce to the combinations `kept` (k, count) of the present ones.

        The number of the dropped ones is stored by reason.
        """
        return replace(
            self, weights=kept @ self.weights, reduction=self.reduction.keep(kept, reason)
        )

    def begin_at(self, start: Array) -> Target:
        """Build the target for a given initial state.

        `start` (nx,) is this state. The goals then include those of periodicity.
        """
        free = self.free_start
        if free is None:
            return self
        x = ca.MX.sym("x", len(start))
        return replace(
            self,
            start=start,
            single=ca.Function("single", [x], [ca.vertcat(self.single(x), free.repeats(start, x))]),
            weights=scipy.linalg.block_diag(self.weights, np.eye(free.repeats.size1_out(0))),
            misfit=ca.Function("misfit", [x], [ca.vertcat(self.misfit(x), free.misfit(start, x))]),
            names=self.names + free.reduction.names,
            units=self.units + free.units,
            reduction=self.reduction.join(free.reduction),
            free_start=None,
        )

    def describe(self) -> str:
        """Describe the number of goal rows in one line.

        An example is "36 → 21 rows: 6 bar, 9 momentum", with the reasons of the dropped rows.
        """
        waypoints = [one.label + one.target.describe() for one in self.waypoints]
        given = len(self.reduction.names) - self.shape
        if not given:
            return "; ".join(waypoints) or "no goals"
        left_out = [f"{count} {kind}" for kind, count in self.reduction.repeated.items()]
        left_out += [f"{self.shape} added for the shape"] if self.shape else []
        text = f"{given} → {self.count} rows" + (": " + ", ".join(left_out) if left_out else "")
        text += "" if self.met else "; no target state was found"
        text += f"; goals are met up to {self.adjusted:.1e} m" if self.adjusted else ""
        return "; ".join([text, *waypoints])


class WaypointTarget(NamedTuple):
    """State that meets the goals of a waypoint, and their constraints.

    Attributes
    ----------
    share : float
        Time of the waypoint as a fraction of the duration.
    target : Target
        The state and the constraints.
    """

    share: float
    target: Target

    @property
    def label(self) -> str:
        """Prefix of the names of the waypoint's goals."""
        return f"waypoint at {self.share:.3g} of the duration, "


@dataclass(frozen=True, eq=False)
class FreeStartRows:
    """Constraints on a free initial state x₀ and the final state x.

    Attributes
    ----------
    start : casadi.Function
        x₀ → independent residuals of bars and initial goals.
    repeats : casadi.Function
        (x₀, x) → independent residuals, zero if the final state equals the initial one.
    misfit : casadi.Function
        (x₀, x) → residual of each periodic goal.
    units : tuple of str
        Units of these residuals.
    reduction : Reduction
        Composition of `repeats`.
    """

    start: ca.Function
    repeats: ca.Function
    misfit: ca.Function
    units: tuple[str, ...]
    reduction: Reduction
