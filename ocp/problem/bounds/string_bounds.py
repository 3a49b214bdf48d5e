"""Bounds on force densities, tensions and rest lengths of strings.

Rates of force densities and of rest lengths can be limited, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import (
    Bound,
    Limit,
    PathBound,
    RateBound,
    broadcast_limits,
    drop_infinite,
)
from tenscasadi.schema.field_types import LIMITS, PER_ITEM
from tenscasadi.structure.cables import name_inputs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import Array, nonnegative, per_item, positive_each

if TYPE_CHECKING:
    from ocp.problem.instant import Instant

_Lower = Annotated[ArrayLike, LIMITS, positive_each("string", zero=True)]
_Upper = Annotated[ArrayLike, LIMITS, positive_each("string", zero=True, infinite=True)]
_Rate = Annotated[ArrayLike, LIMITS, positive_each("string", infinite=True)]


@dataclass(frozen=True, eq=False)
class StringLimits(Bound):
    """Base class of lower and upper limits of each string.

    Attributes
    ----------
    per_cable : bool
        Whether a cable has one limit, instead of one for each of its strings.
    """

    per_cable: ClassVar[bool] = False
    lower: _Lower | None = None
    upper: _Upper | None = None

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise ValueError(
                f"{type(self).__name__}.lower and .upper are both None: give at least one"
            )
        super().__post_init__()

    def check(self, structure: Structure) -> None:
        """Check that the limits can apply to a structure.

        Raises TypeError or ValueError if the number of limits differs from that of strings, or if a
        lower limit is above the upper one.
        """
        lower, upper = self.limits(structure)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise ValueError(
                f"{type(self).__name__}: lower is {lower[i]:g} and upper is {upper[i]:g} for {self.names_of(structure)[i]}: give lower ≤ upper"
            )

    @classmethod
    def names_of(cls, structure: Structure) -> list[str]:
        """Name the strings or cables that have a limit each.

        With `per_cable`, they are the cables and the strings that belong to no cable.
        """
        if cls.per_cable:
            return name_inputs(structure)
        return [f"string {string}" for string in range(len(structure.strings))]

    def limits(self, structure: Structure) -> tuple[Array, Array]:
        """Return the lower and upper limits of each string (α,).

        With `per_cable`, they have an entry per control input (nu,): for each cable and for each
        string in no cable. They are −inf and inf where there are none.
        """
        count, name = len(self.names_of(structure)), type(self).__name__
        return broadcast_limits(f"{name}.lower", self.lower, count, -np.inf), broadcast_limits(
            f"{name}.upper", self.upper, count, np.inf
        )


@dataclass(frozen=True, eq=False)
class ForceDensityLimits(StringLimits, kind="ForceDensityLimits"):
    """Limits of the force density γ of each string.

    Where force densities are the control, these are bounds on decision variables, and hold exactly
    at all times. Under rest-length control, they are path constraints at both ends of every
    interval. Strings carry no compression: γ ≥ 0 holds without these limits, too.

    Parameters
    ----------
    lower : float or array_like, shape (α,), optional
        Smallest force density [N/m], ≥ 0: one number, or one for each string. None for 0.
    upper : float or array_like, shape (α,), optional
        Largest force density [N/m]: one number, or one for each string. None or inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If a limit is negative or not a number. In a `Problem`: if the number of limits differs from
        that of strings, or if ``lower`` is above ``upper``.

    See Also
    --------
    TensionLimits : Limits of the tension of each string.

    Examples
    --------
    >>> import ocp
    >>> ocp.ForceDensityLimits(5.0, 100.0).upper
    100.0
    """

    lower: _Lower | None = 0.0


@dataclass(frozen=True, eq=False)
class ForceDensityRateLimits(RateBound, kind="ForceDensityRateLimits"):
    """Limits of the rate of each force density.

    From the start of an interval of duration h [s] to the start of the next one, the force density
    changes by at most ``rate`` · h. For piecewise-linear controls (`PiecewiseLinear`), the limits
    also hold from the start to the end of the last interval.

    Parameters
    ----------
    rate : float or array_like, shape (α,)
        Largest mean rate [N/(m s)], > 0: one number, or one for each string. inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If a rate is not a positive number. In a `Problem`: if the number of rates differs from that
        of strings.

    See Also
    --------
    PiecewiseConstant : Limits the number of control changes (``max_changes``).
    RestLengthRateLimits : Limits of the rate of each rest length.

    Examples
    --------
    >>> import ocp
    >>> ocp.ForceDensityRateLimits(50.0).rate
    50.0
    """

    rate: _Rate

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the number of rates differs from that of strings.
        """
        broadcast_limits("ForceDensityRateLimits.rate", self.rate, len(structure.strings), np.inf)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the force-density rates between two instants, and their limits.

        Parameters
        ----------
        before, after : Instant
            Symbolic instants at the starts of two intervals.
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
class TensionBound(StringLimits, PathBound):
    """Base class of limits on string tensions at mesh points.

    A cable has one limit (``per_cable``).
    """

    per_cable: ClassVar[bool] = True

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Tension of each string or segment of the model [N].
        """
        scene = now.model.scene
        # without friction, the strings of a cable have equal tensions
        equal = not scene.structure.cable_friction.any()
        strings = scene.first_strings if equal else np.arange(len(scene.modelled.strings))
        of = scene.input_of[strings]
        lower, upper = (limit[of] for limit in self.limits(scene.structure))
        lower = np.where(lower > 0, lower, -np.inf)  # γ ≥ 0 implies it already
        every = self.names_of(scene.structure)
        names = tuple(f"tension of {every[k]}" for k in of)
        if not equal:
            parent = scene.modelled.string_parent
            names = tuple(f"tension of string {k}" for k in parent)
        own = now.tension if len(strings) == now.tension.shape[0] else now.tension[strings.tolist()]
        return drop_infinite(Limit(own, lower, upper, names, "N"))


@dataclass(frozen=True, eq=False)
class TensionLimits(TensionBound, kind="TensionLimits"):
    """Limits of the tension of each string.

    The limits hold at both ends of every interval. If a string is modeled in segments, they hold in
    each segment. A cable has one limit, see `tenscasadi.Structure.cable_of`. Under tension control
    (``control=Tension()``), they are bounds on decision variables.

    Parameters
    ----------
    lower : float or array_like, shape (nu,), optional
        Smallest tension [N], ≥ 0: one number, or one for each cable and each string in no cable.
        None for 0, as strings carry no compression.
    upper : float or array_like, shape (nu,), optional
        Largest tension [N]: one number, or one for each cable and each string in no cable. None or
        inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If both are None, or if a limit is negative or not a number. In a `Problem`: if the number
        of limits differs from nu, or if ``lower`` is above ``upper``.

    Examples
    --------
    >>> import ocp
    >>> ocp.TensionLimits(upper=12.0).lower is None
    True
    """


@dataclass(frozen=True, eq=False)
class StrengthLimits(TensionLimits):
    """Tension limits that `Problem` derives from the strength of strings.

    They are not stored among the user's bounds: a copied problem derives them again.
    """


@dataclass(frozen=True, eq=False)
class RestLengthLimits(StringLimits, PathBound, kind="RestLengthLimits"):
    """Limits of the rest length of each string.

    A string of length s, force density γ and stiffness k has the rest length ρ = s (1 − γ/k). The
    limits hold at both ends of every interval. With ``RestLengthLimits(0)``, an actuator can realize
    all force densities by changing the rest length. Under rest-length control
    (``control=RestLength()``), the limits are bounds on decision variables, which are positive
    without these limits, too. A cable has one limit, see `tenscasadi.Structure.cable_of`.

    Parameters
    ----------
    lower : float or array_like, shape (nu,), optional
        Smallest rest length [m], ≥ 0: one number, or one for each cable and each string in no cable.
        None for no limit.
    upper : float or array_like, shape (nu,), optional
        Largest rest length [m]: one number, or one for each cable and each string in no cable. None
        or inf for no limit.
    stiffness : float or array_like, shape (α,), optional
        Stiffness k [N/m]: one number, or one for each string. None for that of the structure.

    Raises
    ------
    TypeError, ValueError
        If both limits are None, or if one is negative or not a number. In a `Problem`: if the
        number of limits differs from nu, if ``lower`` is above ``upper``, or if a string has no
        stiffness.

    Examples
    --------
    >>> import ocp
    >>> bound = ocp.RestLengthLimits(0.2, stiffness=1000.0)
    >>> bound.lower, bound.upper
    (0.2, None)
    """

    per_cable: ClassVar[bool] = True
    lower: _Lower | None = 0.0
    upper: _Upper | None = None
    stiffness: Annotated[ArrayLike | None, PER_ITEM] = None

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the limits or the stiffness do not fit the strings.
        """
        super().check(structure)
        read_stiffness("RestLengthLimits.stiffness", self.stiffness, structure)

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Rest length of each cable and each string in no cable [m].
        """
        structure = now.model.scene.structure
        stiffness = read_stiffness("RestLengthLimits.stiffness", self.stiffness, structure)
        lower, upper = self.limits(structure)
        names = tuple(f"rest length of {name}" for name in self.names_of(structure))
        return drop_infinite(Limit(now.rest_lengths(stiffness), lower, upper, names, "m"))


@rename_fields(speed="rate")
@dataclass(frozen=True, eq=False)
class RestLengthRateLimits(RateBound, kind="RestLengthRateLimits"):
    """Limits of the rate of each rest length.

    They are the speed limits of winches. From the start of an interval of duration h [s] to the
    start of the next one, the rest length changes by at most ``rate`` · h. For piecewise-linear
    controls (`PiecewiseLinear`), the limits also hold from the start to the end of the last
    interval. Under ``control=RestLengthRate()``, they are bounds on decision variables.

    Parameters
    ----------
    rate : float or array_like, shape (nu,)
        Largest mean rate [m/s], > 0: one number, or one for each cable and each string in no cable.
        inf for no limit.
    stiffness : float or array_like, shape (α,), optional
        Stiffness k [N/m]: one number, or one for each string. None for that of the structure. A
        string of length s and force density γ has the rest length ρ = s (1 − γ/k).

    Raises
    ------
    TypeError, ValueError
        If a rate is not a positive number. In a `Problem`: if the number of rates differs from nu,
        or if a string has no stiffness.

    Examples
    --------
    >>> import ocp
    >>> ocp.RestLengthRateLimits(0.4, stiffness=1000.0).rate
    0.4
    """

    rate: _Rate
    stiffness: Annotated[ArrayLike | None, PER_ITEM] = None

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the rates or the stiffness do not fit the strings.
        """
        count = len(name_inputs(structure))
        broadcast_limits("RestLengthRateLimits.rate", self.rate, count, np.inf)
        read_stiffness("RestLengthRateLimits.stiffness", self.stiffness, structure)

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the rest-length rates between two instants, and their limits.

        Parameters
        ----------
        before, after : Instant
            Symbolic instants at the starts of two intervals.
        interval : casadi.SX or casadi.MX
            Time between them [s].

        Returns
        -------
        Limit
            Mean rate of the rest length of each cable and each string in no cable [m/s].
        """
        structure = before.model.scene.structure
        k = read_stiffness("RestLengthRateLimits.stiffness", self.stiffness, structure)
        value = (after.rest_lengths(k) - before.rest_lengths(k)) / interval
        inputs = name_inputs(structure)
        rate = broadcast_limits("RestLengthRateLimits.rate", self.rate, len(inputs), np.inf)
        names = tuple(f"rest length rate of {name}" for name in inputs)
        return drop_infinite(Limit(value, -rate, rate, names, "m/s"))


def combine_rates(structure: Structure, bounds: Iterable[Bound]) -> Array:
    """Compute the tightest limit (nu,) of rest-length rates [m/s].

    It has one entry for each cable and for each string that belongs to no cable, inf without a
    limit. ``bounds`` are all bounds of a problem.
    """
    count = len(name_inputs(structure))
    largest = np.full(count, np.inf)
    for bound in bounds:
        if isinstance(bound, RestLengthRateLimits):
            own = broadcast_limits("RestLengthRateLimits.rate", bound.rate, count, np.inf)
            largest = np.minimum(largest, own)
    return largest


def read_stiffness(field: str, given: ArrayLike | None, structure: Structure) -> Array:
    """Read the stiffness (α,) [N/m] of strings.

    ``given`` is the argument of the user; None for the stiffness of the structure. ``field`` names
    it in messages. Raises ValueError for strings without stiffness.
    """
    values = per_item(
        field, structure.stiffness if given is None else given, len(structure.strings)
    )
    return nonnegative(field, values, "string", strict=True)
