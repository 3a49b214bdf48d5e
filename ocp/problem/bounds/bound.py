"""Base classes of bounds on quantities along a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, per_item, replace_inf

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


class Limit(NamedTuple):
    """Quantities with lower and upper limits.

    The constraints are lower ≤ value ≤ upper; the quantities are functions of one or two instants.

    Attributes
    ----------
    value : casadi.SX or casadi.MX, shape (m, 1)
        The quantities.
    lower, upper : ndarray, shape (m,)
        Limits; infinite if there is none.
    names : tuple of str
        Name of each quantity.
    unit : str
        "N", "N/m", "N/(m s)", "m", "m/s", "m/s²", "kg m²/s", or "" for user-defined expressions.
    """

    value: Any
    lower: Array
    upper: Array
    names: tuple[str, ...]
    unit: str


@dataclass(frozen=True, eq=False)
class PathConstraint:
    """Constraint lower ≤ value ≤ upper in symbols.

    Attributes
    ----------
    value, lower, upper, names, unit
        As in `Limit`.
    symbols : tuple of casadi.SX or casadi.MX
        x, u, t of one instant, or x, u, x⁺, u⁺, h of two instants a time h apart.
    ends : tuple of str
        Ends of every interval ("start", "end") at which the constraint holds; ("last",) for the end
        of the plan only.
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
    """Base class of limits along a plan."""

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Raises TypeError, ValueError.
        """


class PathBound(Bound):
    """Base class of limits of functions of one instant.

    They hold at the ``ends`` of every interval, by default at both. Functions of the state alone
    need one of them only, which limits each state once.
    """

    ends: ClassVar[tuple[str, ...]] = ("start", "end")

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities of an instant."""
        raise NotImplementedError

    def imply(self, structure: Structure) -> PathBound:
        """Build an implied, weaker bound on fewer state entries.

        By default, it is the bound itself.
        """
        return self


class RateBound(Bound):
    """Base class of limits of mean rates over an interval.

    A mean rate is taken from the start of an interval to that of the next. For piecewise-linear
    controls, the limits also hold from the start to the end of the last interval.
    """

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the mean rates between two instants.

        The instants are an interval [s] apart.
        """
        raise NotImplementedError


def drop_infinite(limit: Limit) -> Limit:
    """Drop the quantities without limits."""
    value, lower, upper, names, unit = limit
    kept = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    chosen = tuple(names[k] for k in kept)
    return Limit(value[kept.tolist()], lower[kept], upper[kept], chosen, unit)


def broadcast_limits(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    """Broadcast a limit to ``count`` members.

    None becomes ``missing``. Raises TypeError, ValueError.
    """
    if value is None:
        return np.full(count, missing)
    per_item(field, replace_inf(value), count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
