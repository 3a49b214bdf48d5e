"""Limits of strings along a plan, as values: of force densities, tensions, rest lengths and how fast these change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import (
    Bound,
    Limit,
    PathBound,
    RateBound,
    broadcast_limits,
    drop_infinite,
    replace_inf,
)
from tenscasadi.schema.field_types import LIMITS, PER_ITEM
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import Array, nonnegative, number_or_vector, per_item

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


@dataclass(frozen=True, eq=False)
class StringLimits(Bound):
    """A lower and an upper limit for every string: what ForceDensityLimits and the like have in common."""

    lower: Annotated[ArrayLike | None, LIMITS] = None
    upper: Annotated[ArrayLike | None, LIMITS] = None

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise ValueError(
                f"{type(self).__name__}.lower and .upper are both None: give at least one"
            )
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value is not None:
                field = f"{type(self).__name__}.{name}"
                array = number_or_vector(field, replace_inf(value) if name == "upper" else value)
                nonnegative(field, array, "string")

    def check(self, structure: Structure) -> None:
        """Raise where the limits have the wrong number or cross each other."""
        lower, upper = self.limits(structure)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise ValueError(
                f"{type(self).__name__}: lower is {lower[i]:g} and upper is {upper[i]:g} for string {i}: give lower ≤ upper"
            )

    def limits(self, structure: Structure) -> tuple[Array, Array]:
        """Return lower and upper limits (α,); −inf and inf where there is none."""
        count, name = len(structure.strings), type(self).__name__
        return broadcast_limits(f"{name}.lower", self.lower, count, -np.inf), broadcast_limits(
            f"{name}.upper", self.upper, count, np.inf
        )


@dataclass(frozen=True, eq=False)
class ForceDensityLimits(StringLimits, kind="ForceDensityLimits"):
    """Limits of the force density γ of each string.

    They are limits of the solver's unknowns: they hold exactly, at every time; where rest lengths
    are decided, at both ends of every interval. Strings do not push, so that γ ≥ 0 also holds for a
    problem without them.

    Parameters
    ----------
    lower : float or array_like, shape (α,), optional
        Least force density, N/m, ≥ 0; one number, or one for each string; None for 0.
    upper : float or array_like, shape (α,), optional
        Greatest force density, N/m; None or inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If a limit is no number or negative; with a problem, if there is not one for each string or
        ``lower`` is above ``upper``.

    See Also
    --------
    TensionLimits : limits of γ s.

    Examples
    --------
    >>> import ocp
    >>> ocp.ForceDensityLimits(5.0, 100.0).upper
    100.0
    """

    lower: Annotated[ArrayLike | None, LIMITS] = 0.0


@dataclass(frozen=True, eq=False)
class ForceDensityRateLimits(RateBound, kind="ForceDensityRateLimits"):
    """Limits of how fast force densities change: of the mean rate of each γ over an interval.

    From the start of each interval, of h s, to that of the next, γ changes by at most ``rate`` · h.
    Where force densities are linear in each interval (`PiecewiseLinear`), this also holds to the
    end of the last one.

    Parameters
    ----------
    rate : float or array_like, shape (α,)
        Greatest rate, N/(m s), > 0; one number, or one for each string; inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If a rate is no number, zero or negative; with a problem, if there is not one for each
        string.

    See Also
    --------
    PiecewiseConstant : limits the number of changes, by ``changes``.
    RestLengthRateLimits : how fast motors wind.

    Examples
    --------
    >>> import ocp
    >>> ocp.ForceDensityRateLimits(50.0).rate
    50.0
    """

    rate: Annotated[ArrayLike, LIMITS]

    def __post_init__(self) -> None:
        array = number_or_vector("ForceDensityRateLimits.rate", replace_inf(self.rate, 1.0))
        nonnegative("ForceDensityRateLimits.rate", array, "string", strict=True)

    def check(self, structure: Structure) -> None:
        """Refuse a structure that this does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If there is not one rate for each string.
        """
        broadcast_limits("ForceDensityRateLimits.rate", self.rate, len(structure.strings), np.inf)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the limited rates.

        Parameters
        ----------
        before, after : Instant
            Instants of symbols at the starts of two intervals.
        interval : casadi.SX or casadi.MX
            Time between them [s].

        Returns
        -------
        Limit
            Mean rate of each force density [N/(m s)].
        """
        count = len(before.model.scene.structure.strings)
        rate = broadcast_limits("ForceDensityRateLimits.rate", self.rate, count, np.inf)
        names = tuple(f"force density rate of string {i}" for i in range(count))
        value = (after.force_density - before.force_density) / interval
        return drop_infinite(Limit(value, -rate, rate, names, "N/(m s)"))


@dataclass(frozen=True, eq=False)
class TensionLimits(StringLimits, PathBound, kind="TensionLimits"):
    """Limits of the tension γ s of each string, at both ends of every interval.

    The limits of a string that is modelled in segments hold in each of them.

    Parameters
    ----------
    lower : float or array_like, shape (α,), optional
        Least tension, N, ≥ 0; one number, or one for each string; None for no limit but γ ≥ 0.
    upper : float or array_like, shape (α,), optional
        Greatest tension, N; None or inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If both are None, or a limit is no number or negative; with a problem, if there is not one
        for each string or ``lower`` is above ``upper``.

    Examples
    --------
    >>> import ocp
    >>> ocp.TensionLimits(upper=12.0).lower is None
    True
    """

    def limit(self, now: Instant) -> Limit:
        """Build the limited quantities.

        Parameters
        ----------
        now : Instant
            Instant of symbols.

        Returns
        -------
        Limit
            Tension of each modelled string [N].
        """
        parent = now.model.structure.string_parent
        lower, upper = (limit[parent] for limit in self.limits(now.model.scene.structure))
        lower = np.where(lower > 0, lower, -np.inf)  # γ ≥ 0 says so already
        names = tuple(f"tension of string {k}" for k in parent)
        return drop_infinite(Limit(now.tension, lower, upper, names, "N"))


@dataclass(frozen=True, eq=False)
class RestLengthLimits(StringLimits, PathBound, kind="RestLengthLimits"):
    """Limits of the rest length ρ = s (1 − γ/k) of each string, at both ends of every interval.

    ``RestLengthLimits(0)`` says that every force density can be reached by winding a string of that
    stiffness. Where rest lengths are decided (``control=RestLength()``), they are limits of the
    solver's unknowns, which are greater than 0 without them, too.

    Parameters
    ----------
    lower : float or array_like, shape (α,), optional
        Least rest length, m, ≥ 0; one number, or one for each string; None for no limit.
    upper : float or array_like, shape (α,), optional
        Greatest rest length, m; None or inf for no limit.
    stiffness : float or array_like, shape (α,), optional
        k, N/m, one number, or one for each string; None for that of the structure.

    Raises
    ------
    TypeError, ValueError
        If both limits are None, or one is no number or negative; with a problem, if there is not
        one for each string, ``lower`` is above ``upper``, or a string has no stiffness.

    Examples
    --------
    >>> import ocp
    >>> bound = ocp.RestLengthLimits(0.2, stiffness=1000.0)
    >>> bound.lower, bound.upper
    (0.2, None)
    """

    lower: Annotated[ArrayLike | None, LIMITS] = 0.0
    upper: Annotated[ArrayLike | None, LIMITS] = None
    stiffness: Annotated[ArrayLike | None, PER_ITEM] = None

    def check(self, structure: Structure) -> None:
        """Refuse a structure that this does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If limits or stiffness do not fit the strings.
        """
        super().check(structure)
        read_stiffness("RestLengthLimits.stiffness", self.stiffness, structure)

    def limit(self, now: Instant) -> Limit:
        """Build the limited quantities.

        Parameters
        ----------
        now : Instant
            Instant of symbols.

        Returns
        -------
        Limit
            Rest length of each string [m].
        """
        structure = now.model.scene.structure
        stiffness = read_stiffness("RestLengthLimits.stiffness", self.stiffness, structure)
        lower, upper = self.limits(structure)
        names = tuple(f"rest length of string {k}" for k in range(len(lower)))
        return drop_infinite(Limit(now.rest_lengths(stiffness), lower, upper, names, "m"))


@rename_fields(speed="rate")
@dataclass(frozen=True, eq=False)
class RestLengthRateLimits(RateBound, kind="RestLengthRateLimits"):
    """Limits of how fast motors wind: of the mean rate of each rest length over an interval.

    From the start of each interval, of h s, to that of the next, ρ changes by at most ``rate`` ·
    h. Where force densities are linear in each interval (`PiecewiseLinear`), this also holds to the
    end of the last one.

    Parameters
    ----------
    rate : float or array_like, shape (α,)
        Greatest rate, m/s, > 0; one number, or one for each string; inf for no limit.
    stiffness : float or array_like, shape (α,), optional
        k of ρ = s (1 − γ/k), N/m, one number, or one for each string; None for that of the
        structure.

    Raises
    ------
    TypeError, ValueError
        If a rate is no number, zero or negative; with a problem, if there is not one for each
        string, or a string has no stiffness.

    Examples
    --------
    >>> import ocp
    >>> ocp.RestLengthRateLimits(0.4, stiffness=1000.0).rate
    0.4
    """

    rate: Annotated[ArrayLike, LIMITS]
    stiffness: Annotated[ArrayLike | None, PER_ITEM] = None

    def __post_init__(self) -> None:
        array = number_or_vector("RestLengthRateLimits.rate", replace_inf(self.rate, 1.0))
        nonnegative("RestLengthRateLimits.rate", array, "string", strict=True)

    def check(self, structure: Structure) -> None:
        """Refuse a structure that this does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If rate or stiffness do not fit the strings.
        """
        broadcast_limits("RestLengthRateLimits.rate", self.rate, len(structure.strings), np.inf)
        read_stiffness("RestLengthRateLimits.stiffness", self.stiffness, structure)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the limited rates.

        Parameters
        ----------
        before, after : Instant
            Instants of symbols at the starts of two intervals.
        interval : casadi.SX or casadi.MX
            Time between them [s].

        Returns
        -------
        Limit
            Mean rate of each rest length [m/s].
        """
        structure = before.model.scene.structure
        k = read_stiffness("RestLengthRateLimits.stiffness", self.stiffness, structure)
        value = (after.rest_lengths(k) - before.rest_lengths(k)) / interval
        count = len(structure.strings)
        rate = broadcast_limits("RestLengthRateLimits.rate", self.rate, count, np.inf)
        names = tuple(f"rest length rate of string {i}" for i in range(count))
        return drop_infinite(Limit(value, -rate, rate, names, "m/s"))


def read_stiffness(field: str, given: ArrayLike | None, structure: Structure) -> Array:
    """Return the stiffness (α,), N/m: the given one or the structure's. Raises ValueError for a string without."""
    values = per_item(
        field, structure.stiffness if given is None else given, len(structure.strings)
    )
    return nonnegative(field, values, "string", strict=True)
