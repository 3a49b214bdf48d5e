"""Limits along a plan, as values. Each refers to strings as the structure numbers them; None is no limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ocp.checks import dimensions
from tenscasadi.structure import Structure
from tenscasadi.validate import Array, at_least, finite_array, per_item


class Bound(Protocol):
    """A lower and an upper limit for every string."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the limits do not fit the structure."""

    def limits(self, structure: Structure) -> tuple[Array, Array]:
        """Lower and upper limits (α,); −inf and inf where there is none."""


@dataclass(frozen=True, eq=False)
class _Limits:
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise ValueError(f"{type(self).__name__}.lower and .upper are both None: give at least one")
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value is not None:
                field = f"{type(self).__name__}.{name}"
                array = finite_array(field, _finite(value) if name == "upper" else value, (None,) if dimensions(value) else ())
                at_least(field, np.atleast_1d(array), 0.0, "string")

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
class ForceDensityLimits(_Limits):
    """Limits of γ, N/m, one number or one per string (≥ 0: strings do not push). A problem without them keeps γ ≥ 0."""

    lower: ArrayLike | None = 0.0


@dataclass(frozen=True, eq=False)
class TensionLimits(_Limits):
    """Limits of the tension γ s, N, at both ends of every interval; one number or one per string (≥ 0).

    The limits of a string that is modelled in segments hold in each of them.
    """


def _finite(value: Any) -> Any:
    """`value` with inf, which says that there is no limit, replaced by a number that passes the checks."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return value  # refused next, by name
    return np.where(np.isposinf(array), 0.0, array)


def _broadcast(field: str, value: ArrayLike | None, count: int, missing: float) -> Array:
    if value is None:
        return np.full(count, missing)
    per_item(field, _finite(value), count, "string")
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()
