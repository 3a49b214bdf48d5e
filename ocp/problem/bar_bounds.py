"""Limits of what bars carry along a plan, as values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds import PathBound, PathConstraint, limits_of, without_inf
from ocp.problem.instant import symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, nonnegative, number_or_vector, per_item, positive_number


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
                array = number_or_vector(f"BarForceLimits.{name}", without_inf(value))
                nonnegative(f"BarForceLimits.{name}", array, "bar")

    def check(self, structure: Structure) -> None:
        """Raise where there are no bars or the limits have the wrong number."""
        _check_bars("BarForceLimits", structure)
        self._most(structure)

    def _most(self, structure: Structure) -> tuple[Array, Array]:
        """The most compression and tension (β,), N."""
        count = len(structure.bars)
        compression = limits_of("BarForceLimits.compression", self.compression, count, np.inf)
        return compression, limits_of("BarForceLimits.tension", self.tension, count, np.inf)

    def constraint(self, model: Model) -> PathConstraint:
        """Return the force in each bar, positive in compression."""
        now, (compression, tension) = symbolic(model), self._most(model.scene.structure)
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


def _check_bars(name: str, structure: Structure) -> None:
    if not len(structure.bars):
        raise ValueError(f"{name} limits bars, and the structure has none: leave it out")
