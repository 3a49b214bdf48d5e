"""Limits of strings and bars along a plan, as values. Each refers to members as the structure numbers them; None is no limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.instant import symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, nonnegative, number_or_vector, per_item, positive_number


@dataclass(frozen=True, eq=False)
class PathConstraint:
    """lower ≤ value ≤ upper: a column of CasADi expressions in `unit` ("N", "N/m", "m", "m/s" or ""), with a name for each entry.

    symbols: what `value` is made of, x, u, t of an instant, or x, u, x⁺, u⁺, h of two that are h apart. ends: at which ends
    ("start", "end") of every interval it holds.
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
        """From the symbols to the column of what is limited."""
        return ca.Function("limited", self.symbols, [ca.densify(self.value)])

    def without_open(self) -> PathConstraint:
        """Return the constraint without the entries that have no limit."""
        keep = np.flatnonzero(np.isfinite(self.lower) | np.isfinite(self.upper))
        if len(keep) == len(self.names):
            return self
        names = tuple(self.names[k] for k in keep)
        return replace(self, value=self.value[keep.tolist()], lower=self.lower[keep], upper=self.upper[keep], names=names)


class Bound:
    """Something that holds along a plan."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the bound does not fit the structure."""


class PathBound(Bound):
    """Holds at each end of every interval; what does not depend on force densities at the `ends` only, once for each state."""

    ends: ClassVar[tuple[str, ...]] = ("start", "end")

    def constraint(self, model: Model) -> PathConstraint:
        """Return what is limited, at one instant of symbols."""
        raise NotImplementedError


class RateBound(Bound):
    """Holds from the start of one interval to that of the next; of linear profiles also to the end of the last."""

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def constraint(self, model: Model) -> PathConstraint:
        """Return what is limited, between two instants of symbols."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Limits(Bound):
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
                array = number_or_vector(field, _finite(value) if name == "upper" else value)
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
        return _broadcast(f"{name}.lower", self.lower, count, -np.inf), _broadcast(f"{name}.upper", self.upper, count, np.inf)


@dataclass(frozen=True, eq=False)
class ForceDensityLimits(Limits):
    """Limits of γ, N/m, one number or one per string (≥ 0: strings do not push). A problem without them keeps γ ≥ 0."""

    lower: ArrayLike | None = 0.0


@dataclass(frozen=True, eq=False)
class TensionLimits(Limits, PathBound):
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
class RestLengthLimits(Limits, PathBound):
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
        array = number_or_vector("RestLengthRateLimits.speed", _finite(self.speed, 1.0))
        nonnegative("RestLengthRateLimits.speed", array, "string", strict=True)

    def check(self, structure: Structure) -> None:
        """Raise where speed or stiffness do not fit the strings."""
        _broadcast("RestLengthRateLimits.speed", self.speed, len(structure.strings), np.inf)
        stiffness_of("RestLengthRateLimits.stiffness", self.stiffness, structure)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the mean rate of each rest length, m/s."""
        before, after, structure = symbolic(model), symbolic(model), model.scene.structure
        interval: Any = type(before.state).sym("h")
        k = stiffness_of("RestLengthRateLimits.stiffness", self.stiffness, structure)
        rate = (after.rest_lengths(k) - before.rest_lengths(k)) / interval
        speed = _broadcast("RestLengthRateLimits.speed", self.speed, len(structure.strings), np.inf)
        names = tuple(f"rest length rate of string {i}" for i in range(len(speed)))
        symbols = (before.state, before.control, after.state, after.control, interval)
        return PathConstraint(rate, -speed, speed, names, "m/s", symbols, self.ends).without_open()


@dataclass(frozen=True, eq=False)
class BarForceLimits(PathBound):
    """The most that bars carry, N: compression and tension, one number or one per bar; None or inf: no limit."""

    compression: ArrayLike | None = None
    tension: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.compression is None and self.tension is None:
            raise ValueError("BarForceLimits.compression and .tension are both None: give at least one")
        for name in ("compression", "tension"):
            value = getattr(self, name)
            if value is not None:
                array = number_or_vector(f"BarForceLimits.{name}", _finite(value))
                nonnegative(f"BarForceLimits.{name}", array, "bar")

    def check(self, structure: Structure) -> None:
        """Raise where there are no bars or the limits have the wrong number."""
        _check_bars("BarForceLimits", structure)
        self.most(structure)

    def most(self, structure: Structure) -> tuple[Array, Array]:
        """The most compression and tension (β,), N."""
        count = len(structure.bars)
        compression = _broadcast("BarForceLimits.compression", self.compression, count, np.inf)
        return compression, _broadcast("BarForceLimits.tension", self.tension, count, np.inf)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the force in each bar, positive in compression."""
        now, (compression, tension) = symbolic(model), self.most(model.scene.structure)
        names = tuple(f"compression of bar {k}" for k in range(len(tension)))
        return PathConstraint(now.bar_force, -tension, compression, names, "N", now.symbols, self.ends).without_open()


@dataclass(frozen=True, eq=False)
class Buckling(PathBound):
    """Compression of solid round bars below Euler's load π² E I / (l² safety), I = π r⁴/4, with the structure's radius and length.

    modulus: E, Pa, one number or one per bar. Raises ValueError for a bar without radius.
    """

    modulus: ArrayLike
    safety: float = 1.0

    def __post_init__(self) -> None:
        array = number_or_vector("Buckling.modulus", self.modulus)
        nonnegative("Buckling.modulus", array, "bar", strict=True)
        object.__setattr__(self, "safety", positive_number("Buckling.safety", self.safety))

    def check(self, structure: Structure) -> None:
        """Raise where there are no bars, or one has no radius."""
        _check_bars("Buckling", structure)
        bad = np.flatnonzero(structure.bar_radius == 0)
        if bad.size:
            raise ValueError(f"Buckling needs the radius of bar {bad[0]}, which is 0: give Structure(bar_radius=...) or BarForceLimits")
        self.loads(structure)

    def loads(self, structure: Structure) -> Array:
        """The allowed compression (β,), N."""
        E = per_item("Buckling.modulus", self.modulus, len(structure.bars))
        inertia = np.pi * structure.bar_radius**4 / 4
        return np.asarray(np.pi**2 * E * inertia / structure.bar_lengths**2 / self.safety)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the compression of each bar."""
        now, loads = symbolic(model), self.loads(model.scene.structure)
        names = tuple(f"buckling of bar {k}" for k in range(len(loads)))
        return PathConstraint(now.bar_force, np.full(len(loads), -np.inf), loads, names, "N", now.symbols, self.ends)


def stiffness_of(field: str, given: ArrayLike | None, structure: Structure) -> Array:
    """Stiffness (α,), N/m: the given one or the structure's. Raises ValueError for a string without."""
    values = per_item(field, structure.stiffness if given is None else given, len(structure.strings))
    return nonnegative(field, values, "string", strict=True)


def _check_bars(name: str, structure: Structure) -> None:
    if not len(structure.bars):
        raise ValueError(f"{name} limits bars, and the structure has none: leave it out")


def _finite(value: Any, instead: float = 0.0) -> Any:
    """`value` with inf, which says that there is no limit, replaced by a number that passes the checks."""
    try:
        array = np.asarray(value)
    except ValueError:
        return value  # refused next, by name
    return np.where(np.isposinf(array), instead, array) if array.dtype.kind in "iuf" else value


def _broadcast(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    if value is None:
        return np.full(count, missing)
    per_item(field, _finite(value), count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
