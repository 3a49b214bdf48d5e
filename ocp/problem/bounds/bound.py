"""Base of all bounds: quantities between limits along a plan."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, per_item

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


class Limit(NamedTuple):
    """Quantities lower ≤ value ≤ upper as functions of one or two instants.

    Attributes
    ----------
    value : casadi.SX or casadi.MX, shape (m, 1)
        The quantities.
    lower, upper : ndarray, shape (m,)
        Limits; infinite if there is none.
    names : tuple of str
        Name of each quantity.
    unit : str
        "N", "N/m", "N/(m s)", "m", "m/s", or "" for own expressions.
    """

    value: Any
    lower: Array
    upper: Array
    names: tuple[str, ...]
    unit: str


@dataclass(frozen=True, eq=False)
class PathConstraint:
    """Quantities lower ≤ value ≤ upper with the symbols that they are made of.

    Attributes
    ----------
    value, lower, upper, names, unit
        As of `Limit`.
    symbols : tuple of casadi.SX or casadi.MX
        x, u, t of an instant, or x, u, x⁺, u⁺, h of two that are h apart.
    ends : tuple of str
        Ends of every interval ("start", "end") at which it holds; ("last",): at the end of the plan
        only.
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
        """Function from the symbols to the quantities."""
        return ca.Function("limited", self.symbols, [ca.densify(self.value)])


class Bound(Value):
    """Limits of quantities along a plan."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError where the bound does not fit the structure."""


class PathBound(Bound):
    """Limits of functions of one instant, at both ends of every interval.

    Functions of the state alone are limited at the `ends` only, once for each state.
    """

    ends: ClassVar[tuple[str, ...]] = ("start", "end")

    def limit(self, now: Instant) -> Limit:
        """Build the limited quantities of an instant."""
        raise NotImplementedError

    def imply(self, structure: Structure) -> PathBound:
        """Build a weaker bound that depends on fewer entries of the state."""
        return self


class RateBound(Bound):
    """Limits of mean rates, from the start of one interval to that of the next.

    Of linear profiles they hold to the end of the last interval, too.
    """

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the limited rates of two instants that are an interval [s] apart."""
        raise NotImplementedError


def drop_infinite(limit: Limit) -> Limit:
    """Drop the quantities without limits."""
    value, lower, upper, names, unit = limit
    kept = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    chosen = tuple(names[k] for k in kept)
    return Limit(value[kept.tolist()], lower[kept], upper[kept], chosen, unit)


def replace_inf(value: Any, instead: float = 0.0) -> Any:
    """Replace inf, which stands for no limit, by a number that passes the checks."""
    with suppress(Exception):  # values that are no arrays are rejected next, by name
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and not np.ma.is_masked(value):
            return np.where(np.isposinf(array), instead, array)
    return value


def broadcast_limits(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    """Broadcast a limit to `count` members; `missing` if None. Raises TypeError, ValueError."""
    if value is None:
        return np.full(count, missing)
    per_item(field, replace_inf(value), count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
