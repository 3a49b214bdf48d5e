"""Costs of a plan, as values: each a weighted number, summed with those of the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import casadi as ca
from numpy.typing import ArrayLike

from ocp.problem.instant import Instant
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

ControlTerm = Callable[[Any, Any], Any]  # (force densities α×intervals, interval)
InstantTerm = Callable[[Instant], Any]


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
    """A number that is summed with those of the other costs and minimized.

    additive: whether the cost of a plan is the sum of those of its phases.
    """

    additive: ClassVar[bool] = True

    def terms(self) -> CostTerms:
        """Return the terms of the cost."""
        raise TypeError(
            f"Problem.costs has {format_value(self)}: give a ControlCost, RunningCost or FinalCost"
        )

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the cost does not fit the structure."""


class ControlCost(Cost):
    """A cost of the force densities alone; where rest lengths are decided, it is integrated as a `RunningCost` of those that follow."""

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Return the cost of force densities (α×intervals, N/m) held for `interval` (s) each, as a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost of each interval."""
        return CostTerms(control=(self.expression,))


class RunningCost(Cost):
    """A cost that is integrated over time, by Simpson's rule on each interval, its middle on the cubic between its ends."""

    def rate(self, now: Instant) -> Any:
        """Return the cost per second, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the integrand."""
        return CostTerms(running=(self.rate,))


class FinalCost(Cost):
    """A cost of the end."""

    additive: ClassVar[bool] = False

    def final(self, end: Instant) -> Any:
        """Return the cost, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost of the end."""
        return CostTerms(instants=((1.0, self.final),))


@dataclass(frozen=True, eq=False)
class CostAt(Cost):
    """A cost of the end that is taken at a share of the duration, between 0 and 1."""

    additive: ClassVar[bool] = False
    cost: FinalCost
    share: float

    def __post_init__(self) -> None:
        instance("CostAt.cost", self.cost, FinalCost, "a cost of the end")
        if not positive_number("CostAt.share", self.share) < 1:
            raise ValueError(
                f"CostAt.share is {self.share:g}: give a share of the duration between 0 and 1"
            )

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the cost does not fit the structure."""
        self.cost.check(structure)

    def terms(self) -> CostTerms:
        """Return the cost of the instant."""
        return CostTerms(instants=((self.share, self.cost.final),))


@dataclass(frozen=True)
class Effort(ControlCost, kind="Effort"):
    """The cost weight · ∫ Σ γ² dt over all strings.

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
        """Return the cost of some intervals.

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
    """The cost weight · Σ (γ⁺ − γ)²/h over neighbouring intervals, which stands for ∫ Σ γ̇² dt; of rest lengths where these are decided.

    h is the time from the middle of one interval to that of the next; where force densities are
    linear in each interval, its length.

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
        """Return the cost of some intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals, N/m.
        interval : casadi.SX, casadi.MX or float
            Length of each interval, s.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ (γ⁺ − γ)²/h of neighbouring columns, a scalar, N²/(m²·s) for weight 1.
        """
        return self.weight * ca.sumsqr(force_density[:, 1:] - force_density[:, :-1]) / interval


@dataclass(frozen=True, eq=False)
class Prestress(ControlCost, kind="Prestress"):
    """The cost weight · ∫ Σ (γ − level)² dt, which keeps force densities near a level.

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
        """Refuse a structure that this does not fit.

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
        """Return the cost of some intervals.

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
class Duration(FinalCost, kind="Duration"):
    """The cost weight · T of the duration T, s.

    It asks for ``Problem(duration=(shortest, longest))``, and for other costs or limits of force to
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

    def final(self, end: Instant) -> Any:
        """Return the cost of the end.

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
    """The cost weight · ∫ Σ max(0, −γ s ṡ) dt: the work, J, that strings do as they shorten.

    Nothing is won back where strings are drawn out.

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
        """Return the cost per second.

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
    """Refuse a weight that is no positive number."""
    object.__setattr__(
        cost, "weight", positive_number(f"{type(cost).__name__}.weight", cost.weight)
    )
