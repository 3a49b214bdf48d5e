"""Limits of strings along a plan, as values: of force densities, tensions, rest lengths and how fast these change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds import Bound, PathBound, PathConstraint, RateBound, limits_of, without_inf
from ocp.problem.instant import symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, nonnegative, number_or_vector, per_item


@dataclass(frozen=True, eq=False)
class StringLimits(Bound):
    """A lower and an upper limit for every string: what ForceDensityLimits and the like have in common."""

    lower: ArrayLike | None = None
    upper: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise ValueError(f"{type(self).__name__}.lower and .upper are both None: give at least one")
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value is not None:
                field = f"{type(self).__name__}.{name}"
                array = number_or_vector(field, without_inf(value) if name == "upper" else value)
                nonnegative(field, array, "string")

    def check(self, structure: Structure) -> None:
        """Raise where the limits have the wrong number or cross each other."""
        lower, upper = self.limits(structure)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise ValueError(f"{type(self).__name__}: lower is {lower[i]:g} and upper is {upper[i]:g} for string {i}: give lower ≤ upper")

    def limits(self, structure: Structure) -> tuple[Array, Array]:
        """Lower and upper limits (α,); −inf and inf where there is none."""
        count, name = len(structure.strings), type(self).__name__
        return limits_of(f"{name}.lower", self.lower, count, -np.inf), limits_of(f"{name}.upper", self.upper, count, np.inf)


@dataclass(frozen=True, eq=False)
class ForceDensityLimits(StringLimits):
    """Limits of γ, N/m, one number or one per string (≥ 0: strings do not push). A problem without them keeps γ ≥ 0."""

    lower: ArrayLike | None = 0.0


@dataclass(frozen=True, eq=False)
class TensionLimits(StringLimits, PathBound):
    """Limits of the tension γ s, N, at both ends of every interval; one number or one per string (≥ 0).

    The limits of a string that is modelled in segments hold in each of them.
    """

    def constraint(self, model: Model) -> PathConstraint:
        """Return the tension of each modelled string."""
        now, parent = symbolic(model), model.structure.string_parent
        lower, upper = (limit[parent] for limit in self.limits(model.scene.structure))
        lower = np.where(lower > 0, lower, -np.inf)  # γ ≥ 0 says so already
        names = tuple(f"tension of string {k}" for k in parent)
        return PathConstraint(now.tension, lower, upper, names, "N", now.symbols, self.ends).without_open()


@dataclass(frozen=True, eq=False)
class RestLengthLimits(StringLimits, PathBound):
    """Limits of the rest length ρ = s (1 − γ/k), m, at both ends of every interval; one number or one per string (≥ 0).

    stiffness: k, N/m, one number or one per string; None: the structure's. `RestLengthLimits(0)` says that every γ can be
    reached by winding a string of that stiffness.
    """

    lower: ArrayLike | None = 0.0
    upper: ArrayLike | None = None
    stiffness: ArrayLike | None = None

    def check(self, structure: Structure) -> None:
        """Raise where limits or stiffness do not fit the strings."""
        super().check(structure)
        stiffness_of("RestLengthLimits.stiffness", self.stiffness, structure)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the rest length of each string."""
        now, structure = symbolic(model), model.scene.structure
        rest = now.rest_lengths(stiffness_of("RestLengthLimits.stiffness", self.stiffness, structure))
        lower, upper = self.limits(structure)
        names = tuple(f"rest length of string {k}" for k in range(len(lower)))
        return PathConstraint(rest, lower, upper, names, "m", now.symbols, self.ends).without_open()


@dataclass(frozen=True, eq=False)
class RestLengthRateLimits(RateBound):
    """How fast a motor winds: |ρ at the start of an interval − ρ at the start of the one before| ≤ speed · h.

    Where force densities are linear, ρ at the end of the last interval is limited, too.
    speed: m/s, one number or one per string (inf: no limit). stiffness: N/m; None: the structure's.
    """

    speed: ArrayLike
    stiffness: ArrayLike | None = None

    def __post_init__(self) -> None:
        array = number_or_vector("RestLengthRateLimits.speed", without_inf(self.speed, 1.0))
        nonnegative("RestLengthRateLimits.speed", array, "string", strict=True)

    def check(self, structure: Structure) -> None:
        """Raise where speed or stiffness do not fit the strings."""
        limits_of("RestLengthRateLimits.speed", self.speed, len(structure.strings), np.inf)
        stiffness_of("RestLengthRateLimits.stiffness", self.stiffness, structure)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the mean rate of each rest length, m/s."""
        before, after, structure = symbolic(model), symbolic(model), model.scene.structure
        interval: Any = type(before.state).sym("h")
        k = stiffness_of("RestLengthRateLimits.stiffness", self.stiffness, structure)
        rate = (after.rest_lengths(k) - before.rest_lengths(k)) / interval
        speed = limits_of("RestLengthRateLimits.speed", self.speed, len(structure.strings), np.inf)
        names = tuple(f"rest length rate of string {i}" for i in range(len(speed)))
        symbols = (before.state, before.control, after.state, after.control, interval)
        return PathConstraint(rate, -speed, speed, names, "m/s", symbols, self.ends).without_open()


def stiffness_of(field: str, given: ArrayLike | None, structure: Structure) -> Array:
    """Stiffness (α,), N/m: the given one or the structure's. Raises ValueError for a string without."""
    values = per_item(field, structure.stiffness if given is None else given, len(structure.strings))
    return nonnegative(field, values, "string", strict=True)
