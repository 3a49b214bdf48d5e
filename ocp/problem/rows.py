"""Named rows that vanish, as expressions: those of goals, and those of what every motion keeps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Rows:
    """A column of CasADi expressions, each with a name and a unit: "m", "m/s", "m²/s" or "s".

    kind: what the rows are of: "goal", or what keeps them, as in `ocp.targets.invariants`.
    """

    value: Any
    names: tuple[str, ...]
    units: tuple[str, ...]
    kind: str = "goal"

    def select(self, *units: str) -> Rows:
        """Return the rows in these units."""
        kept = [k for k, unit in enumerate(self.units) if unit in units]
        return Rows(
            self.value[kept, :],
            tuple(self.names[k] for k in kept),
            tuple(self.units[k] for k in kept),
            self.kind,
        )

    def sizes(self, units: Mapping[str, float]) -> Array:
        """Return what one stands for in each row (m,), from the sizes of the units."""
        return np.array([units[unit] for unit in self.units], dtype=float)


def stack(rows: Iterable[Rows]) -> Rows:
    """Return all rows of goals as one: those of places before those of speeds."""
    given = list(rows)
    ordered = [part.select(unit) for unit in ("m", "m/s") for part in given]
    value = ca.vertcat(ca.SX(0, 1), *(part.value for part in ordered))
    return Rows(
        value, sum((part.names for part in ordered), ()), sum((part.units for part in ordered), ())
    )
