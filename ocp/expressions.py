"""Own costs and constraints: any CasADi expression of an instant of the plan, with a name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.bounds import Limited, PathBound
from ocp.checks import dimensions
from ocp.costs import FinalCost, RunningCost
from ocp.instant import Instant
from tenscasadi.validate import Array, finite_array, positive_number

Expression = Callable[[Instant], Any]


@dataclass(frozen=True, eq=False)
class Constraint(PathBound):
    """lower ≤ expression(now) ≤ upper at each end of every interval, where `now` is an `ocp.Instant`: now.nodes (3×n), now.velocities, now.time …

    name: what reports call it. expression: gives a CasADi scalar or column. lower, upper: one number or one per entry, None: no limit.
    """

    name: str
    expression: Expression
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None

    def __post_init__(self) -> None:
        _named(self)
        if self.lower is None and self.upper is None:
            raise ValueError(f"Constraint {self.name!r}: lower and upper are both None: give at least one")
        for field in ("lower", "upper"):
            value = getattr(self, field)
            if value is not None:
                finite_array(f"Constraint {self.name!r}: {field}", value, (None,) if dimensions(value) else ())

    def limited(self, now: Instant) -> Limited:
        """The expression's entries. Raises ValueError where they and the limits differ in number, or limits cross."""
        value = _column(self.name, self.expression(now))
        count = value.shape[0]
        lower, upper = self._limit("lower", count, -np.inf), self._limit("upper", count, np.inf)
        if np.any(lower > upper):
            raise ValueError(f"Constraint {self.name!r}: lower is above upper: give lower ≤ upper")
        names = (self.name,) if count == 1 else tuple(f"{self.name} [{k}]" for k in range(count))
        return Limited(value, lower, upper, names, "")

    def _limit(self, field: str, count: int, missing: float) -> Array:
        value = getattr(self, field)
        if value is None:
            return np.full(count, missing)
        array = np.asarray(value, dtype=float)
        if array.ndim and len(array) != count:
            raise ValueError(f"Constraint {self.name!r}: {field} has {len(array)} entries and the expression {count}: give one number or {count}")
        return np.broadcast_to(array, (count,)).copy()


@dataclass(frozen=True, eq=False)
class Integral(RunningCost):
    """weight · ∫ expression(now) dt, of a CasADi scalar."""

    name: str
    expression: Expression
    weight: float = 1.0

    def __post_init__(self) -> None:
        _named(self)
        object.__setattr__(self, "weight", positive_number(f"Integral {self.name!r}: weight", self.weight))

    def rate(self, now: Instant) -> Any:
        """weight · expression."""
        return self.weight * _scalar(self.name, self.expression(now))


@dataclass(frozen=True, eq=False)
class AtEnd(FinalCost):
    """weight · expression(end), of a CasADi scalar."""

    name: str
    expression: Expression
    weight: float = 1.0

    def __post_init__(self) -> None:
        _named(self)
        object.__setattr__(self, "weight", positive_number(f"AtEnd {self.name!r}: weight", self.weight))

    def final(self, end: Instant) -> Any:
        """weight · expression."""
        return self.weight * _scalar(self.name, self.expression(end))


def _named(item: Any) -> None:
    kind = type(item).__name__
    if not isinstance(item.name, str) or not item.name:
        raise TypeError(f"{kind}.name is {item.name!r}: give a name, it stands in reports")
    if not callable(item.expression):
        raise TypeError(f"{kind} {item.name!r}: expression is {item.expression!r}: give a function of an instant")


def _column(name: str, value: Any) -> Any:
    if not isinstance(value, (ca.SX, ca.MX)):
        raise TypeError(f"{name!r} gives {type(value).__name__}: give a CasADi expression of the instant")
    return ca.vec(value)


def _scalar(name: str, value: Any) -> Any:
    column = _column(name, value)
    if column.shape[0] != 1:
        raise ValueError(f"{name!r} gives {column.shape[0]} entries: give a scalar, such as ca.sumsqr(...)")
    return column
