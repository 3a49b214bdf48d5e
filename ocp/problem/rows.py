"""Named residuals of equality constraints on a state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.instant import Instant
from tenscasadi.util.validate import Array

# Relative resolution of plans. Smaller differences of lengths are rounding, which projections
# remove. Smaller contradictions are left to the solver. With singular values below it, for rows of
# norm 1, two solutions are closer than this.
RESOLUTION = 1e-3
RELIABLE = 1e-2  # × the structure's size: default tolerance of goals


@dataclass(frozen=True, eq=False)
class Rows:
    """Column of residuals with names and units.

    A constraint is satisfied where its residual is zero.

    Attributes
    ----------
    value : casadi.SX or casadi.MX, shape (m, 1)
        Residuals.
    names, units : tuple of str
        Name and unit of each row; units are "m", "m/s", "m²/s" or "s".
    kind : str
        "goal", or the invariant whose conservation fixes the rows (`ocp.targets.invariants`).
    quadratic : casadi.SX or casadi.MX, shape (m, 1), or None
        Residuals with the same zeros that are quadratic in the state; None for ``value`` itself.
    """

    value: Any
    names: tuple[str, ...]
    units: tuple[str, ...]
    kind: str = "goal"
    quadratic: Any = None

    def select(self, *units: str) -> Rows:
        """Select the rows that have one of the given units."""
        kept = [k for k, unit in enumerate(self.units) if unit in units]
        return Rows(
            self.value[kept, :],
            tuple(self.names[k] for k in kept),
            tuple(self.units[k] for k in kept),
            self.kind,
            None if self.quadratic is None else self.quadratic[kept, :],
        )

    def sizes(self, units: Mapping[str, float]) -> Array:
        """Return the scale (m,) of each row by its unit.

        ``units`` maps units such as "m/s" to scales.
        """
        return np.array([units[unit] for unit in self.units], dtype=float)

    def scale(self, units: Mapping[str, float]) -> Any:
        """Divide the residuals by the scales of their units."""
        return self.value / ca.DM(self.sizes(units))


def stack(rows: Iterable[Rows]) -> Rows:
    """Stack the residuals of several goals, positions before velocities."""
    given = list(rows)
    parts = [part.select(unit) for unit in ("m", "m/s") for part in given]
    empty = ca.SX(0, 1)
    return Rows(
        ca.vertcat(empty, *(part.value for part in parts)),
        sum((part.names for part in parts), ()),
        sum((part.units for part in parts), ()),
        quadratic=ca.vertcat(
            empty, *(part.value if part.quadratic is None else part.quadratic for part in parts)
        ),
    )


def goal_rows(goals: Iterable[Any], model: Any, x: Any) -> Rows:
    """Build the residuals of goals.

    They are expressions of the symbolic state x (nx,).
    """
    now = Instant(model, x, None, None)
    return stack(goal.residuals(now) for goal in goals)


def distance_rows(nodes: Any, pairs: Any, wanted: Array, names: tuple[str, ...]) -> Rows:
    """Build residuals of distances between pairs of nodes.

    Nodes are 3×n [m], pairs (m, 2), and the desired distances ``wanted`` (m,) [m]. ``names`` are
    those of the residuals.
    """
    vectors = nodes[:, pairs[:, 1].tolist()] - nodes[:, pairs[:, 0].tolist()]
    squared, target = ca.sum1(vectors * vectors).T, ca.DM(wanted)
    scale = 2 * np.maximum(wanted, wanted.mean() or 1.0)
    return Rows(
        ca.sqrt(squared) - target,
        names,
        ("m",) * len(names),
        quadratic=(squared - target**2) / ca.DM(scale),
    )
