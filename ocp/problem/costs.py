"""Costs of a plan, whose weighted sum is minimized."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import casadi as ca
from numpy.typing import ArrayLike

from tenscasadi.schema.field_types import PER_ITEM
from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    format_value,
    instance,
    nonnegative,
    number_or_vector,
    per_item,
    positive_number,
)

if TYPE_CHECKING:
    from ocp.problem.instant import Instant

ControlTerm = Callable[[Any, Any], Any]  # (force densities α×intervals, interval)
InstantTerm = Callable[["Instant"], Any]


class CostTerms(NamedTuple):
    """Expressions of costs by the part of a plan that they are taken of.

    Attributes
    ----------
    control : of the force densities of each interval.
    changes : of the force densities of neighboring intervals.
    running : of each instant, integrated over time.
    instants : of an instant, with its fraction of the duration, 1 at the end.
    """

    control: tuple[ControlTerm, ...] = ()
    changes: tuple[ControlTerm, ...] = ()
    running: tuple[InstantTerm, ...] = ()
    instants: tuple[tuple[float, InstantTerm], ...] = ()


def cost_terms(costs: Iterable[Cost]) -> CostTerms:
    """Collect the terms of several costs."""
    each = [cost.terms() for cost in costs]
    return CostTerms(*(sum(parts, ()) for parts in zip(*each, strict=True)))


class Cost(Value):
    """Number that is added to those of the other costs and minimized.

    additive: whether the cost of a plan is the sum of those of its phases.
    """

    additive: ClassVar[bool] = True

    def terms(self) -> CostTerms:
        """Return the terms of the cost."""
        raise TypeError(
            f"Problem.costs has {format_value(self)}: give a ControlCost, RunningCost or TerminalCost"
        )

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError where the cost does not fit the structure."""


class ControlCost(Cost):
    """Cost of the force densities.

    Under rest-length control it is integrated as a `RunningCost` of those that follow.
    """

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of force densities (α×intervals) [N/m], each for an interval [s]."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost of each interval."""
        return CostTerms(control=(self.expression,))


class RunningCost(Cost):
    """Cost that is integrated over time.

    Simpson's rule is used on each interval, with the middle on the cubic between its ends.
    """

    def rate(self, now: Instant) -> Any:
        """Build the cost per second, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the integrand."""
        return CostTerms(running=(self.rate,))


class TerminalCost(Cost):
    """Cost of the end of a plan."""

    additive: ClassVar[bool] = False

    def terminal(self, end: Instant) -> Any:
        """Build the cost, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost of the end."""
        return CostTerms(instants=((1.0, self.terminal),))


@dataclass(frozen=True, eq=False)
class CostAt(Cost):
    """Terminal cost at a fraction of the duration, between 0 and 1."""

    additive: ClassVar[bool] = False
    cost: TerminalCost
    share: float

    def __post_init__(self) -> None:
        instance("CostAt.cost", self.cost, TerminalCost, "a cost of the end")
        if not positive_number("CostAt.share", self.share) < 1:
            raise ValueError(
                f"CostAt.share is {self.share:g}: give a fraction of the duration between 0 and 1"
            )

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError where the cost does not fit the structure."""
        self.cost.check(structure)

    def terms(self) -> CostTerms:
        """Return the cost of the instant."""
        return CostTerms(instants=((self.share, self.cost.terminal),))


@dataclass(frozen=True)
class Effort(ControlCost, kind="Effort"):
    """Cost weight · ∫ Σ γ² dt over all strings.

    Parameters
    ----------
    weight : float, optional
        Factor of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is no number, zero or negative.

    Notes
    -----
    The integral is exact for the profile of the force densities; its unit is N²·s/m².

    Examples
    --------
    >>> import ocp
    >>> ocp.Effort(2.0)
    Effort(weight=2.0)
    """

    weight: float = 1.0

    def __post_init__(self) -> None:
        check_weight(self)

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of some intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals, N/m.
        interval : casadi.SX, casadi.MX or float
            Length of each interval, s.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · h Σ γ², a scalar, N²·s/m² for weight 1.
        """
        return self.weight * interval * ca.sumsqr(force_density)


@dataclass(frozen=True)
class Smoothness(ControlCost, kind="Smoothness"):
    """Cost weight · Σ (γ⁺ − γ)²/h over neighboring intervals.

    It approximates ∫ Σ γ̇² dt, or that of rest lengths under rest-length control. h is the time
    from the middle of one interval to that of the next; for controls that are linear in each
    interval, its length.

    Parameters
    ----------
    weight : float, optional
        Factor of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is no number, zero or negative.

    Notes
    -----
    Its unit is N²/(m²·s); of rest lengths m²/s.

    Examples
    --------
    >>> import ocp
    >>> ocp.Smoothness()
    Smoothness(weight=1.0)
    """

    weight: float = 1.0

    def __post_init__(self) -> None:
        check_weight(self)

    def terms(self) -> CostTerms:
        """Return the cost of neighboring intervals.

        Returns
        -------
        CostTerms
            Of changes alone.
        """
        return CostTerms(changes=(self.expression,))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of some intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals, N/m.
        interval : casadi.SX, casadi.MX or float
            Length of each interval, s.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ (γ⁺ − γ)²/h of neighboring columns, a scalar, N²/(m²·s) for weight 1.
        """
        return self.weight * ca.sumsqr(force_density[:, 1:] - force_density[:, :-1]) / interval


@dataclass(frozen=True, eq=False)
class Prestress(ControlCost, kind="Prestress"):
    """Cost weight · ∫ Σ (γ − level)² dt.

    Parameters
    ----------
    level : float or array_like, shape (α,)
        Wanted force density, N/m, ≥ 0; one number, or one for each string.
    weight : float, optional
        Factor of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If weight or level is no number, or negative; with a problem, if there is not one level for
        each string.

    Examples
    --------
    >>> import ocp
    >>> ocp.Prestress(20.0, weight=0.1).level
    20.0
    """

    level: Annotated[ArrayLike, PER_ITEM]
    weight: float = 1.0

    def __post_init__(self) -> None:
        check_weight(self)
        array = number_or_vector("Prestress.level", self.level)
        nonnegative("Prestress.level", array, "string")

    def check(self, structure: Structure) -> None:
        """Reject a structure that the cost does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        ValueError
            If there is not one level for each string.
        """
        per_item("Prestress.level", self.level, len(structure.strings))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of some intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals, N/m.
        interval : casadi.SX, casadi.MX or float
            Length of each interval, s.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · h Σ (γ − level)², a scalar, N²·s/m² for weight 1.
        """
        level = ca.DM(per_item("Prestress.level", self.level, force_density.shape[0]))
        return (
            self.weight
            * interval
            * ca.sumsqr(force_density - ca.repmat(level, 1, force_density.shape[1]))
        )


@dataclass(frozen=True)
class Duration(TerminalCost, kind="Duration"):
    """Cost weight · T of the duration T [s].

    It needs ``Problem(duration=(shortest, longest))``, and for other costs or limits of force to
    weigh against.

    Parameters
    ----------
    weight : float, optional
        Factor of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is no number, zero or negative.

    Examples
    --------
    >>> import ocp
    >>> ocp.Duration(10.0)
    Duration(weight=10.0)
    """

    additive: ClassVar[bool] = True
    weight: float = 1.0

    def __post_init__(self) -> None:
        check_weight(self)

    def terminal(self, end: Instant) -> Any:
        """Build the cost of the end.

        Parameters
        ----------
        end : Instant
            The end of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · T, a scalar.
        """
        return self.weight * end.time


@dataclass(frozen=True)
class Work(RunningCost, kind="Work"):
    """Cost weight · ∫ Σ max(0, −γ s ṡ) dt, the work of shortening strings [J].

    Lengthening strings return no work.

    Parameters
    ----------
    weight : float, optional
        Factor of the cost, > 0.
    smoothing : float, optional
        Power, W, > 0, over which the maximum is rounded off.

    Raises
    ------
    TypeError, ValueError
        If weight or smoothing is no number, zero or negative.

    Notes
    -----
    With P = −γ s ṡ and w the smoothing, max(0, P) is taken as (P + √(P² + w²) − w)/2. Integrated by
    Simpson's rule on each interval, its middle on the cubic between its ends.

    Examples
    --------
    >>> import ocp
    >>> ocp.Work()
    Work(weight=1.0, smoothing=0.1)
    """

    weight: float = 1.0
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        check_weight(self)
        object.__setattr__(self, "smoothing", positive_number("Work.smoothing", self.smoothing))

    def rate(self, now: Instant) -> Any:
        """Build the cost per second.

        Parameters
        ----------
        now : Instant
            An instant of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ max(0, −γ s ṡ), rounded off, a scalar.
        """
        power = -now.force_density * now.lengths * now.rates
        return (
            self.weight
            * ca.sum1(power + ca.sqrt(power**2 + self.smoothing**2) - self.smoothing)
            / 2
        )


def check_weight(cost: Any) -> None:
    """Raise TypeError or ValueError for a weight that is not positive."""
    object.__setattr__(
        cost, "weight", positive_number(f"{type(cost).__name__}.weight", cost.weight)
    )
