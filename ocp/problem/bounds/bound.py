"""Base classes of limits that hold along a plan."""

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

    The constraints are lower ≤ value ≤ upper. The quantities are functions of the variables at one
    instant of the plan, or at two.

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
    """Path constraint lower ≤ value ≤ upper as CasADi expressions.

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
        """Function from the symbols to the constrained quantities."""
        return ca.Function("limited", self.symbols, [ca.densify(self.value)])


class Bound(Value):
    """Base class of limits along a plan."""

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Raises TypeError, ValueError.
        """


class PathBound(Bound):
    """Base class of limits on functions of one instant.

    They hold at the ``ends`` of every mesh interval, by default at its start and its end. The start
    differs from the previous end only in the control. Limits on the state alone therefore need one
    of both.
    """

    ends: ClassVar[tuple[str, ...]] = ("start", "end")

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities at an instant, and their limits.

        ``now`` is the instant, whose quantities are CasADi expressions.
        """
        raise NotImplementedError

    def imply(self, structure: Structure) -> PathBound:
        """Build a weaker bound on fewer entries of the state.

        This bound implies it. By default, it is the bound itself.
        """
        return self


class RateBound(Bound):
    """Base class of limits of mean rates over an interval.

    A mean rate is the change from the start of an interval to that of the next, divided by the time
    between. For piecewise-linear controls, the limits also hold from the start to the end of the
    last interval.
    """

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build mean rates between two instants, and their limits.

        ``interval`` is the time between the instants [s]. ``before`` and ``after`` are these
        instants.
        """
        raise NotImplementedError


def drop_infinite(limit: Limit) -> Limit:
    """Drop the quantities with neither lower nor upper limit."""
    value, lower, upper, names, unit = limit
    kept = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    chosen = tuple(names[k] for k in kept)
    return Limit(value[kept.tolist()], lower[kept], upper[kept], chosen, unit)


def broadcast_limits(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    """Broadcast a limit to an array (``count``,), one per member.

    A ``value`` None becomes ``missing``. Raises TypeError, ValueError. ``field`` names the argument
    in messages.
    """
    if value is None:
        return np.full(count, missing)
    per_item(field, replace_inf(value), count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
