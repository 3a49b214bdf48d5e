"""The base of all bounds: each becomes path constraints, expressions between limits, which hold at each end of every interval."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, per_item


@dataclass(frozen=True, eq=False)
class PathConstraint:
    """lower ≤ value ≤ upper: a column of CasADi expressions in `unit` ("N", "N/m", "N/(m s)", "m", "m/s" or ""), with a name for each entry.

    symbols: what `value` is made of, x, u, t of an instant, or x, u, x⁺, u⁺, h of two that are h
    apart. ends: at which ends ("start", "end") of every interval it holds; ("last",): at the end of
    the last one alone.
    """

    value: Any
    lower: Array
    upper: Array
    names: tuple[str, ...]
    unit: str
    symbols: tuple[Any, ...]
    ends: tuple[str, ...]

    @property
    def function(self) -> ca.Function:
        """Function from the symbols to the column that is limited."""
        return ca.Function("limited", self.symbols, [ca.densify(self.value)])

    def drop_open(self) -> PathConstraint:
        """Return the constraint without the entries that have no limit."""
        keep = np.flatnonzero(np.isfinite(self.lower) | np.isfinite(self.upper))
        if len(keep) == len(self.names):
            return self
        names = tuple(self.names[k] for k in keep)
        return replace(
            self,
            value=self.value[keep.tolist()],
            lower=self.lower[keep],
            upper=self.upper[keep],
            names=names,
        )


class Bound(Value):
    """Something that holds along a plan."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the bound does not fit the structure."""


class PathBound(Bound):
    """Holds at each end of every interval; what does not depend on force densities at the `ends` only, once for each state."""

    ends: ClassVar[tuple[str, ...]] = ("start", "end")

    def constraint(self, model: Model) -> PathConstraint:
        """Return the path constraint, of one instant of symbols."""
        raise NotImplementedError


class RateBound(Bound):
    """Holds from the start of one interval to that of the next; of linear profiles also to the end of the last."""

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the path constraint, of two instants of symbols."""
        raise NotImplementedError


def replace_inf(value: Any, instead: float = 0.0) -> Any:
    """Replace inf, which says that there is no limit, by a number that passes the checks."""
    with suppress(Exception):  # what is no array is refused next, by name
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and not np.ma.is_masked(value):
            return np.where(np.isposinf(array), instead, array)
    return value


def broadcast_limits(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    """Return one limit for each of `count` members; `missing` where there is none. Raises TypeError, ValueError."""
    if value is None:
        return np.full(count, missing)
    per_item(field, replace_inf(value), count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
