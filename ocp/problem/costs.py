"""Costs of a plan, whose sum is minimized."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import casadi as ca
from numpy.typing import ArrayLike

from ocp.problem.control import controls_force_densities
from tenscasadi.schema.field_types import PER_ITEM
from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    Positive,
    format_value,
    of_type,
    per_item,
    positive_each,
)

if TYPE_CHECKING:
    from ocp.problem.instant import Instant
    from tenscasadi.dynamics.model import Model

ControlTerm = Callable[[Any, Any], Any]  # (force densities α×intervals, interval)
InstantTerm = Callable[["Instant"], Any]


class CostTerms(NamedTuple):
    """Terms of the objective, grouped by their variables.

    Attributes
    ----------
    control : tuple of callable
        Functions of the force densities of each interval.
    changes : tuple of callable
        Functions of the force densities of neighboring intervals.
    running : tuple of callable
        Functions of each instant, which are integrated over time (Lagrange terms).
    instants : tuple of (float, callable)
        Fraction of the duration (1 at the end), and function of that instant (Mayer terms).
    effort : tuple of callable
        Functions of the force densities of each interval, or of the torques of motors.
    """

    control: tuple[ControlTerm, ...] = ()
    changes: tuple[ControlTerm, ...] = ()
    running: tuple[InstantTerm, ...] = ()
    instants: tuple[tuple[float, InstantTerm], ...] = ()
    effort: tuple[ControlTerm, ...] = ()

    def express(self, model: Model) -> CostTerms:
        """Express the terms in the control variables of a model.

        If force densities are not the control, their terms become running costs.
        """
        direct = controls_force_densities(model)
        effort = direct or model.has_coupled_rates
        own = (*(self.effort if effort else ()), *(self.control if direct else ()))
        others = (*(() if effort else self.effort), *(() if direct else self.control))
        forces = tuple(partial(_evaluate_forces, one) for one in others)
        return self._replace(control=own, effort=(), running=(*forces, *self.running))


def _evaluate_forces(term: ControlTerm, now: Instant) -> Any:
    return term(now.force_density, 1.0)


def cost_terms(costs: Iterable[Cost]) -> CostTerms:
    """Collect the objective terms of several costs by group."""
    each = [cost.terms() for cost in costs]
    return CostTerms(*(sum(parts, ()) for parts in zip(*each, strict=True)))


class Cost(Value):
    """Base class of terms of the objective.

    The objective is the sum of all costs. ``additive`` says whether the cost of a plan is the sum
    of the costs of its phases.
    """

    additive: ClassVar[bool] = True

    def terms(self) -> CostTerms:
        """Return the terms of the objective."""
        raise TypeError(
            f"Problem.costs has {format_value(self)}: give a ControlCost, RunningCost or TerminalCost"
        )

    def check(self, structure: Structure) -> None:
        """Check that the cost can apply to a structure.

        Raises TypeError, ValueError.
        """


class ControlCost(Cost):
    """Base class of costs that depend on the force densities.

    If force densities are not the control, their cost is integrated as in a `RunningCost`.
    """

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of the force densities on all intervals.

        It is a CasADi scalar. Force densities are (α×intervals) [N/m]; ``interval`` has the length
        of each interval [s].
        """
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost as a function of the force densities."""
        return CostTerms(control=(self.expression,))


class RunningCost(Cost):
    """Base class of running costs (Lagrange terms).

    The integral is computed by Simpson's rule on each interval, with the midpoint of the cubic
    Hermite interpolation between its ends.
    """

    def rate(self, now: Instant) -> Any:
        """Build the integrand at the instant ``now``, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the integrand as a running cost."""
        return CostTerms(running=(self.rate,))


class TerminalCost(Cost):
    """Base class of terminal costs (Mayer terms)."""

    additive: ClassVar[bool] = False

    def terminal(self, end: Instant) -> Any:
        """Build the cost of the final instant ``end``, a CasADi scalar."""
        raise NotImplementedError

    def terms(self) -> CostTerms:
        """Return the cost as a function of the final instant."""
        return CostTerms(instants=((1.0, self.terminal),))


@dataclass(frozen=True, eq=False)
class CostAt(Cost):
    """Cost of one instant before the end of the plan.

    It evaluates the terminal cost ``cost`` at ``share``, a fraction of the duration between 0 and
    1.
    """

    additive: ClassVar[bool] = False
    cost: Annotated[TerminalCost, of_type(TerminalCost, "a cost of the end")]
    share: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.share < 1:
            raise ValueError(
                f"CostAt.share is {self.share:g}: give a fraction of the duration between 0 and 1"
            )

    def check(self, structure: Structure) -> None:
        """Check that the cost can apply to a structure.

        Raises TypeError, ValueError.
        """
        self.cost.check(structure)

    def terms(self) -> CostTerms:
        """Return the cost with its fraction of the duration."""
        return CostTerms(instants=((self.share, self.cost.terminal),))


@dataclass(frozen=True)
class Effort(ControlCost, kind="Effort"):
    """Cost weight · ∫ Σ γ² dt over all strings.

    Under control by motor torques, it is weight · ∫ Σ τ² dt over all motors.

    Parameters
    ----------
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is not a positive number.

    Notes
    -----
    The integral is exact for piecewise-constant and piecewise-linear controls. Its unit is N²·s/m²,
    or N²·m²·s for torques.

    Examples
    --------
    >>> import ocp
    >>> ocp.Effort(2.0)
    Effort(weight=2.0)
    """

    weight: Positive = 1.0

    def terms(self) -> CostTerms:
        """Return the cost as a function of the control effort.

        Returns
        -------
        CostTerms
            Terms of the effort only.
        """
        return CostTerms(effort=(self.expression,))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of the force densities on all intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals [N/m], or torques of motors, nu×intervals [N·m].
        interval : casadi.SX, casadi.MX or float
            Length of each interval [s].

        Returns
        -------
        casadi.SX or casadi.MX
            weight · h Σ γ², a scalar [N²·s/m² for weight 1].
        """
        return self.weight * interval * ca.sumsqr(force_density)


@dataclass(frozen=True)
class Smoothness(ControlCost, kind="Smoothness"):
    """Cost weight · Σ (γ⁺ − γ)²/h over neighboring intervals.

    It approximates ∫ Σ γ̇² dt. Under rest-length control, rest lengths replace γ. The time h
    separates the midpoints of neighboring intervals; for piecewise-linear controls, it is the
    length of an interval.

    Parameters
    ----------
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is not a positive number.

    Notes
    -----
    Its unit is N²/(m²·s), or m²/s for rest lengths.

    Examples
    --------
    >>> import ocp
    >>> ocp.Smoothness()
    Smoothness(weight=1.0)
    """

    weight: Positive = 1.0

    def terms(self) -> CostTerms:
        """Return the cost as a function of neighboring force densities.

        Returns
        -------
        CostTerms
            Terms of the changes only.
        """
        return CostTerms(changes=(self.expression,))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of the force densities on all intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals [N/m].
        interval : casadi.SX, casadi.MX or float
            Length of each interval [s].

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ (γ⁺ − γ)²/h of neighboring columns, a scalar [N²/(m²·s) for weight 1].
        """
        return self.weight * ca.sumsqr(force_density[:, 1:] - force_density[:, :-1]) / interval


@dataclass(frozen=True, eq=False)
class Prestress(ControlCost, kind="Prestress"):
    """Cost of the deviation of force densities from a level.

    It is weight · ∫ Σ (γ − level)² dt, with the sum over strings.

    Parameters
    ----------
    level : float or array_like, shape (α,)
        Desired force density [N/m], ≥ 0: one number, or one for each string.
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is not a positive number, or if a level is negative or not a number. In a
        `Problem`: if the number of levels differs from that of strings.

    Examples
    --------
    >>> import ocp
    >>> ocp.Prestress(20.0, weight=0.1).level
    20.0
    """

    level: Annotated[ArrayLike, PER_ITEM, positive_each("string", zero=True)]
    weight: Positive = 1.0

    def check(self, structure: Structure) -> None:
        """Check that the cost can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        ValueError
            If the number of levels differs from that of strings.
        """
        per_item("Prestress.level", self.level, len(structure.strings))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """Build the cost of the force densities on all intervals.

        Parameters
        ----------
        force_density : casadi.SX or casadi.MX
            Force densities, α×intervals [N/m].
        interval : casadi.SX, casadi.MX or float
            Length of each interval [s].

        Returns
        -------
        casadi.SX or casadi.MX
            weight · h Σ (γ − level)², a scalar [N²·s/m² for weight 1].
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

    It requires a free duration, ``Problem(duration=(shortest, longest))``. Other costs or limits of
    forces should make short durations expensive or infeasible.

    Parameters
    ----------
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is not a positive number.

    Examples
    --------
    >>> import ocp
    >>> ocp.Duration(10.0)
    Duration(weight=10.0)
    """

    additive: ClassVar[bool] = True
    weight: Positive = 1.0

    def terminal(self, end: Instant) -> Any:
        """Build the terminal cost.

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
    """Work of the actuators that shorten strings.

    The cost is weight · ∫ Σ max(0, −γ s ṡ) dt for strings of length s, with the integral in J.
    Lengthening strings return no work.

    Parameters
    ----------
    weight : float, optional
        Weight of the cost, > 0.
    smoothing : float, optional
        Power [W], > 0, over which the maximum is smoothed.

    Raises
    ------
    TypeError, ValueError
        If weight or smoothing is not a positive number.

    Notes
    -----
    With P = −γ s ṡ and the smoothing w, max(0, P) is replaced by (P + √(P² + w²) − w)/2. The
    integral is computed by Simpson's rule on each interval, with the midpoint state of the cubic
    Hermite interpolation between its ends.

    Examples
    --------
    >>> import ocp
    >>> ocp.Work()
    Work(weight=1.0, smoothing=0.1)
    """

    weight: Positive = 1.0
    smoothing: Positive = 0.1

    def rate(self, now: Instant) -> Any:
        """Build the integrand of the cost.

        Parameters
        ----------
        now : Instant
            An instant of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ max(0, −γ s ṡ), smoothed, a scalar.
        """
        power = -now.force_density * now.lengths * now.rates
        return (
            self.weight
            * ca.sum1(power + ca.sqrt(power**2 + self.smoothing**2) - self.smoothing)
            / 2
        )
