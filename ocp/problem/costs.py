"""What a plan should keep small, as values: each a weighted number, summed with those of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from ocp.problem.instant import Instant
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import call_user_function, coordinates, node_index, nonnegative, number, number_or_vector, per_item, positive_number

Place = tuple[float | None, float | None, float | None]

UNTRACKED = "an axis that does not matter"


class Cost:
    """A number that is summed with those of the other costs and minimised."""

    def check(self, structure: Structure) -> None:
        """Raise TypeError or ValueError, naming the field, where the cost does not fit the structure."""


class ControlCost(Cost):
    """A cost of the force densities alone."""

    def expression(self, force_density: Any, interval: Any) -> Any:
        """The cost of force densities (α×intervals, N/m) held for `interval` (s) each, as a CasADi scalar."""
        raise NotImplementedError


class RunningCost(Cost):
    """A cost that is integrated over time, by Simpson's rule on each interval, its middle on the cubic between its ends."""

    def rate(self, now: Instant) -> Any:
        """The cost per second, a CasADi scalar."""
        raise NotImplementedError


class FinalCost(Cost):
    """A cost of the end."""

    def final(self, end: Instant) -> Any:
        """The cost, a CasADi scalar."""
        raise NotImplementedError


@dataclass(frozen=True)
class Effort(ControlCost):
    """weight · ∫ Σ γ² dt over all strings, N²·s/m² for weight 1."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        _weighted(self)

    def expression(self, force_density: Any, interval: Any) -> Any:
        """weight · h Σ γ²."""
        return self.weight * interval * ca.sumsqr(force_density)


@dataclass(frozen=True)
class Smoothness(ControlCost):
    """weight · Σ (γ⁺ − γ)²/h over neighbouring intervals of length h, N²/(m²·s): ∫ Σ γ̇² dt of the plan's corners."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        _weighted(self)

    def expression(self, force_density: Any, interval: Any) -> Any:
        """weight · Σ (γ⁺ − γ)²/h."""
        return self.weight * ca.sumsqr(force_density[:, 1:] - force_density[:, :-1]) / interval


@dataclass(frozen=True, eq=False)
class Prestress(ControlCost):
    """weight · ∫ Σ (γ − level)² dt, N²·s/m² for weight 1: keeps force densities near a level, N/m, one number or one per string."""

    level: ArrayLike
    weight: float = 1.0

    def __post_init__(self) -> None:
        _weighted(self)
        array = number_or_vector("Prestress.level", self.level)
        nonnegative("Prestress.level", array, "string")

    def check(self, structure: Structure) -> None:
        """Raise where there is not one level for each string."""
        per_item("Prestress.level", self.level, len(structure.strings))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """weight · h Σ (γ − level)²."""
        level = ca.DM(per_item("Prestress.level", self.level, force_density.shape[0]))
        return self.weight * interval * ca.sumsqr(force_density - ca.repmat(level, 1, force_density.shape[1]))


@dataclass(frozen=True, eq=False)
class Tracking(RunningCost):
    """weight · ∫ Σ ‖node − place‖² dt, m²·s: keeps nodes near places that may move.

    positions: {node: (x, y, z)}, m, None for an axis that does not matter, or {node: function of the time, a CasADi symbol, to three such entries}.
    """

    positions: Mapping[int, Place | Callable[[Any], Any]]
    weight: float = 1.0

    def __post_init__(self) -> None:
        _weighted(self)
        if not isinstance(self.positions, Mapping) or not self.positions:
            raise ValueError(f"Tracking.positions is {self.positions!r}: give {{node: (x, y, z)}}")
        places = {
            node: place if callable(place) else coordinates(f"Tracking.positions[{node}]", place, UNTRACKED, some=True)
            for node, place in self.positions.items()
        }
        object.__setattr__(self, "positions", places)

    def check(self, structure: Structure) -> None:
        """Raise where a node does not exist."""
        for node in self.positions:
            node_index("Tracking.positions: node", node, len(structure.nodes))

    def rate(self, now: Instant) -> Any:
        """weight · Σ ‖node − place‖²."""
        total: Any = 0
        for node, place in self.positions.items():
            entries = _moving(f"Tracking.positions[{node}](time)", place, now.time) if callable(place) else place
            total = total + sum((now.nodes[axis, node] - entry) ** 2 for axis, entry in enumerate(entries) if entry is not None)
        return self.weight * total


@dataclass(frozen=True)
class Duration(FinalCost):
    """weight · the duration, s: with Problem(duration=(shortest, longest)), and other costs or limits of force to weigh against."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        _weighted(self)

    def final(self, end: Instant) -> Any:
        """weight · T."""
        return self.weight * end.time


@dataclass(frozen=True)
class Work(RunningCost):
    """weight · ∫ Σ max(0, −γ s ṡ) dt, J: the work that strings do as they shorten; nothing is won back where they are drawn out.

    smoothing: W, the width over which the maximum is rounded off.
    """

    weight: float = 1.0
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        _weighted(self)
        object.__setattr__(self, "smoothing", positive_number("Work.smoothing", self.smoothing))

    def rate(self, now: Instant) -> Any:
        """weight · Σ of the strings' positive power."""
        power = -now.control * now.lengths * now.rates
        return self.weight * ca.sum1(power + ca.sqrt(power**2 + self.smoothing**2) - self.smoothing) / 2


def _weighted(cost: Any) -> None:
    object.__setattr__(cost, "weight", positive_number(f"{type(cost).__name__}.weight", cost.weight))


def _moving(field: str, place: Callable[[Any], Any], time: Any) -> tuple[Any, ...]:
    """The coordinates of a place at a symbolic time: expressions of it, numbers, or None."""

    def read(field: str, entry: Any) -> Any:
        if not isinstance(entry, (ca.SX, ca.MX)):
            return number(field, entry)
        if not isinstance(entry, type(time)) or not entry.is_scalar():
            raise TypeError(f"{field} has the entry {entry}: give a scalar expression of the time alone")
        return entry

    found = call_user_function(field, place, time, "give (x, y, z) of the time, s, a CasADi symbol")
    return coordinates(field, ca.vertsplit(ca.vec(found)) if isinstance(found, (ca.SX, ca.MX)) else found, UNTRACKED, some=True, read=read)
