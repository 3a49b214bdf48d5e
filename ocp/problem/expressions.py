"""Costs and constraints given by user-defined CasADi expressions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound, Limit, PathBound, PathConstraint
from ocp.problem.constraints import build_constraint
from ocp.problem.costs import Cost, RunningCost, TerminalCost
from ocp.problem.instant import Instant, symbolic
from ocp.problem.instant_formula import InstantText
from tenscasadi.schema.field_types import LIMITS, Word
from tenscasadi.util.validate import (
    TOLERANCE,
    Array,
    Booleans,
    call_user_function,
    flag,
    format_value,
    number_or_vector,
    positive_number,
)

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

Expression = Callable[[Instant], Any]

_NO_NUMBER = "is not a number at the start: keep roots, logarithms and quotients away from their limits, or start elsewhere"


@dataclass(frozen=True, eq=False)
class AtEnd(TerminalCost, kind="AtEnd"):
    """Terminal cost weight · expression(end) of a user-defined expression.

    Within a `Constraint`, it is the constrained quantity.

    Parameters
    ----------
    name : str
        Name in error messages.
    expression : callable
        Function of the `Instant` at the end, with a CasADi scalar as its value, or an
        `InstantFormula`, which files can hold.
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the name is not a string, the expression not a function, or the weight not a positive
        number. In a `Problem`: if the expression fails, or is not a scalar of the instant alone.

    Examples
    --------
    >>> import ocp
    >>> high = ocp.AtEnd("height", lambda end: -end.nodes[2, 3])
    >>> high.weight
    1.0
    """

    name: str
    expression: Annotated[Expression, InstantText()]
    weight: float = 1.0

    def __post_init__(self) -> None:
        _named(self)
        object.__setattr__(
            self, "weight", positive_number(f"AtEnd {self.name!r}: weight", self.weight)
        )

    @property
    def weighted(self) -> Expression:
        """User-defined function of an instant, multiplied by the weight."""
        return self.expression if self.weight == 1.0 else partial(_weighted, self)

    def terminal(self, end: Instant) -> Any:
        """Build the terminal cost.

        Parameters
        ----------
        end : Instant
            The end of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · expression, a scalar.
        """
        return self.weight * _scalar(self, end)


def _weighted(item: AtEnd, end: Instant) -> Any:
    return item.weight * item.expression(end)


@dataclass(frozen=True, eq=False)
class Constraint(PathBound, kind="Constraint"):
    """Limits lower ≤ expression(now) ≤ upper of a user-defined expression.

    They hold at both ends of every interval, or at the end of the plan only.

    Parameters
    ----------
    name : str or AtEnd
        Name in reports and duals, unique in a problem.
        ``Constraint(AtEnd(name, expression), lower=...)`` limits weight · expression at the end of
        the plan, like ``Constraint(name, expression, lower=..., at_end=True)``.
    expression : callable
        Function of an `Instant`, with a CasADi scalar or column as its value, or an
        `InstantFormula`, which files can hold.
    lower : float or array_like, optional
        Lower limit: one number, or one for each entry. None for no limit.
    upper : float or array_like, optional
        Upper limit: one number, or one for each entry. None for no limit.
    at_end : bool, optional
        Whether the limits are a terminal constraint instead of a path constraint.

    Raises
    ------
    TypeError, ValueError
        If the name is not a string, the expression not a function, or both limits are None. In a
        `Problem`: if the expression fails, depends on more than the instant, is not a number at the
        start, or differs from the limits in its number of entries.

    Examples
    --------
    >>> import ocp
    >>> ocp.Constraint("height", lambda now: now.nodes[2, 3], upper=1.2).ends
    ('start', 'end')
    >>> ocp.Constraint(ocp.AtEnd("height", lambda end: end.nodes[2, 3]), upper=1.2).at_end
    True
    """

    name: Annotated[str | AtEnd, Word()]
    # None if the name is an AtEnd, which has its own
    expression: Annotated[Expression | None, InstantText()] = None
    lower: Annotated[ArrayLike | None, LIMITS] = None
    upper: Annotated[ArrayLike | None, LIMITS] = None
    at_end: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.name, AtEnd):
            if self.expression is not None:
                raise TypeError(
                    f"Constraint {self.name.name!r}: expression is given beside that of AtEnd: give lower=... and upper=... by name"
                )
            self.__dict__.update(name=self.name.name, expression=self.name.weighted, at_end=True)
        _named(self)
        flag(f"Constraint {self.name!r}: at_end", self.at_end)
        if self.lower is None and self.upper is None:
            raise ValueError(
                f"Constraint {self.name!r}: lower and upper are both None: give at least one"
            )
        for field in ("lower", "upper"):
            value = getattr(self, field)
            if value is not None:
                number_or_vector(f"Constraint {self.name!r}: {field}", value)

    @property
    def ends(self) -> tuple[str, ...]:  # type: ignore[override]
        """Ends of intervals at which the limits hold."""
        return ("last",) if self.at_end else PathBound.ends

    def limit(self, now: Instant) -> Limit:
        """Build the entries of the expression with their limits.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Entries of the expression.

        Raises
        ------
        TypeError, ValueError
            If the expression fails or is not a CasADi expression, if entries and limits differ in
            number, or if a lower limit is above the upper one.
        """
        value = _column(self, now)
        count = value.shape[0]
        lower, upper = self._limit("lower", count, -np.inf), self._limit("upper", count, np.inf)
        if np.any(lower > upper):
            raise ValueError(f"Constraint {self.name!r}: lower is above upper: give lower ≤ upper")
        names = tuple(f"{self.name} [{k}]" for k in range(count))
        return Limit(value, lower, upper, (str(self.name),) if count == 1 else names, "")

    def _limit(self, field: str, count: int, missing: float) -> Array:
        value = getattr(self, field)
        if value is None:
            return np.full(count, missing)
        array = number_or_vector(f"Constraint {self.name!r}: {field}", value)
        if array.ndim and len(array) != count:
            raise ValueError(
                f"Constraint {self.name!r}: {field} has {len(array)} entries and the expression {count}: give one number or {count}"
            )
        return np.broadcast_to(array, (count,)).copy()


@dataclass(frozen=True, eq=False)
class Integral(RunningCost, kind="Integral"):
    """Cost weight · ∫ expression(now) dt of a user-defined expression.

    Parameters
    ----------
    name : str
        Name in error messages.
    expression : callable
        Function of an `Instant`, with a CasADi scalar as its value, or an `InstantFormula`, which
        files can hold.
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the name is not a string, the expression not a function, or the weight not a positive
        number. In a `Problem`: if the expression fails, is not a scalar of the instant alone, or is
        not a number at the start.

    Notes
    -----
    The integral is computed by Simpson's rule on each interval, with the midpoint of the cubic
    Hermite interpolation between its ends.

    Examples
    --------
    >>> import casadi as ca
    >>> import ocp
    >>> calm = ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities), weight=0.1)
    >>> calm.name, calm.weight
    ('speed', 0.1)
    """

    name: str
    expression: Annotated[Expression, InstantText()]
    weight: float = 1.0

    def __post_init__(self) -> None:
        _named(self)
        object.__setattr__(
            self, "weight", positive_number(f"Integral {self.name!r}: weight", self.weight)
        )

    def rate(self, now: Instant) -> Any:
        """Build the integrand of the cost.

        Parameters
        ----------
        now : Instant
            An instant of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · expression, a scalar.
        """
        return self.weight * _scalar(self, now)


def check_expressions(
    model: Model, bounds: Sequence[Bound], costs: Sequence[Cost], start: Array | None
) -> None:
    """Check bounds and costs by building their expressions once.

    Raises TypeError or ValueError if one fails, or if the initial state (nx,) violates a bound on
    the state. ``start`` is None if the initial state is free.
    """
    names = [bound.name for bound in bounds if isinstance(bound, Constraint)]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"Problem.bounds has two constraints named {name!r}: give each its own name, reports tell them by it"
            )
    for bound in bounds:
        if isinstance(bound, PathBound):
            limited = build_constraint(bound, model)
            value, steered = _first(bound, limited.symbols, limited.value, start)
            undefined = np.isnan(value) & ~steered
            if undefined.any():
                raise ValueError(
                    f"Problem.bounds: {limited.names[int(np.argmax(undefined))]} {_NO_NUMBER}"
                )
            if limited.ends == ("end",) and len(value):
                _check_within(limited, value, TOLERANCE * float(np.ptp(model.structure.nodes)))
    for cost in costs:
        now = symbolic(model)
        terms = cost.terms()
        for rate in terms.running:
            value, steered = _first(cost, now.symbols, rate(now), start)
            if np.any(~np.isfinite(value) & ~steered):
                raise ValueError(f"Problem.costs: {_label(cost)} {_NO_NUMBER}")
        for _, instant in terms.instants:
            _first(cost, now.symbols, instant(now), None)


def _first(
    item: Any, symbols: tuple[Any, ...], value: Any, start: Array | None
) -> tuple[Array, Booleans]:
    """Evaluate an expression at the initial state with zero controls.

    ``item`` is the bound or cost, ``value`` its expression in ``symbols``. Returns its entries, and
    whether each depends on the controls. Both are empty if the start is None.
    """
    column = ca.densify(ca.vec(value))
    function = ca.Function("first", symbols, [column], {"allow_free": True})
    if function.get_free():
        raise ValueError(
            f"{_label(item)} has the symbol {function.get_free()[0]!r}, which nothing gives a value: use those of the instant alone"
        )
    if start is None or column.is_empty():
        return np.zeros(0), np.zeros(0, dtype=bool)
    steered = np.array(function.jac_sparsity(0, 1).get_triplet()[0], dtype=np.intp)
    return function(start, 0, 0).full().ravel(), np.isin(np.arange(column.shape[0]), steered)


def _check_within(limited: PathConstraint, value: Array, tolerance: float) -> None:
    excess = np.maximum(limited.lower - value, value - limited.upper)
    worst = int(np.argmax(excess))
    if excess[worst] > tolerance:
        low, high = limited.lower[worst], limited.upper[worst]
        raise ValueError(
            f"Problem.start has {limited.names[worst]} at {value[worst]:g}, and Problem.bounds keep it between {low:g} and {high:g}: "
            "start within them, or widen them"
        )


def _named(item: Any) -> None:
    kind = type(item).__name__
    if not isinstance(item.name, str) or not item.name:
        raise TypeError(
            f"{kind}.name is {format_value(item.name)}: give a name, it stands in reports"
        )
    if not callable(item.expression):
        raise TypeError(
            f"{kind} {format_value(item.name)}: expression is {format_value(item.expression)}: give a function of an instant"
        )


def _label(item: Any) -> str:
    """Return the name of a bound or cost (``item``) in messages."""
    name = getattr(item, "name", None)
    return type(item).__name__ + (f" {name!r}" if name else "")


def _column(item: Any, now: Instant) -> Any:
    """Build the entries of a user-defined expression as a column.

    ``item`` is the bound or cost with the expression, which is evaluated at the instant ``now``.
    """
    nodes, strings = now.model.scene.structure.nodes, now.model.scene.structure.strings
    hint = f"an instant has nodes and velocities 3×{len(nodes)}, lengths, rates, control ({len(strings)},), tension, bar_force, state, time"
    value = call_user_function(_label(item), item.expression, now, hint)
    if not isinstance(value, (ca.SX, ca.MX)) or value.is_empty():
        raise TypeError(
            f"{_label(item)} gives {'nothing' if hasattr(value, 'is_empty') else type(value).__name__}: give a CasADi expression of the instant"
        )
    if not isinstance(value, type(now.state)):
        kinds = f"{type(value).__name__}, and the instant is {type(now.state).__name__}"
        raise TypeError(
            f"{_label(item)} gives {kinds}: give an expression of the instant alone, without symbols of your own"
        )
    return ca.vec(value)


def _scalar(item: Any, now: Instant) -> Any:
    column = _column(item, now)
    if column.shape[0] != 1:
        raise ValueError(
            f"{_label(item)} gives {column.shape[0]} entries: give a scalar, such as ca.sumsqr(...)"
        )
    return column
