"""Named constraint rows of a state, as expressions that vanish where they are satisfied."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Rows:
    """Column of CasADi expressions, each with a name and a unit.

    Attributes
    ----------
    value : casadi.SX or casadi.MX, shape (m, 1)
        The expressions.
    names, units : tuple of str
        One of each for every row; units are "m", "m/s", "m²/s" or "s".
    kind : str
        "goal", or the invariant that keeps the rows (`ocp.targets.invariants`).
    quadratic : casadi.SX or casadi.MX, shape (m, 1), or None
        Rows with the same zeros that are quadratic in the state; None: `value` itself.
    """

    value: Any
    names: tuple[str, ...]
    units: tuple[str, ...]
    kind: str = "goal"
    quadratic: Any = None

    def select(self, *units: str) -> Rows:
        """Select the rows in these units."""
        kept = [k for k, unit in enumerate(self.units) if unit in units]
        return Rows(
            self.value[kept, :],
            tuple(self.names[k] for k in kept),
            tuple(self.units[k] for k in kept),
            self.kind,
            None if self.quadratic is None else self.quadratic[kept, :],
        )

    def sizes(self, units: Mapping[str, float]) -> Array:
        """Compute the scale of each row (m,) from those of the units."""
        return np.array([units[unit] for unit in self.units], dtype=float)


def stack(rows: Iterable[Rows]) -> Rows:
    """Stack the rows of goals, positions before velocities."""
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
    """Build the rows of goals as functions of the symbolic state x (nx)."""
    nodes, velocities = model.nodes(x).T, model.velocities(x).T
    return stack(goal.rows(model.scene.structure, nodes, velocities) for goal in goals)


def distance_rows(nodes: Any, pairs: Any, wanted: Array, names: tuple[str, ...]) -> Rows:
    """Build rows of distances (m,) between pairs (m, 2) of the columns of nodes 3×n."""
    vectors = nodes[:, pairs[:, 1].tolist()] - nodes[:, pairs[:, 0].tolist()]
    squared, target = ca.sum1(vectors * vectors).T, ca.DM(wanted)
    scale = 2 * np.maximum(wanted, wanted.mean() or 1.0)
    return Rows(
        ca.sqrt(squared) - target,
        names,
        ("m",) * len(names),
        quadratic=(squared - target**2) / ca.DM(scale),
    )


def column_norms(vectors: Any) -> Any:
    """Compute the lengths (m,) of the columns of a 3×m expression."""
    return ca.sqrt(ca.sum1(vectors * vectors)).T
