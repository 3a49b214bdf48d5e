"""What a plan should keep small, as values: each a weighted expression of γ (α×intervals) and the interval's length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca

from tenscasadi.validate import positive_number


class Cost(Protocol):
    """A number that is summed with those of the other costs and minimised."""

    def expression(self, force_density: Any, interval: Any) -> Any:
        """The cost of force densities (α×intervals, N/m) held for `interval` (s) each, as a CasADi scalar."""


@dataclass(frozen=True)
class Effort:
    """weight · ∫ Σ γ² dt over all strings, N²·s/m² for weight 1."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", positive_number("Effort.weight", self.weight))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """weight · h Σ γ²."""
        return self.weight * interval * ca.sumsqr(force_density)


@dataclass(frozen=True)
class Smoothness:
    """weight · Σ (γ⁺ − γ)²/h over neighbouring intervals of length h, N²/(m²·s): ∫ Σ γ̇² dt of the plan's corners."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", positive_number("Smoothness.weight", self.weight))

    def expression(self, force_density: Any, interval: Any) -> Any:
        """weight · Σ (γ⁺ − γ)²/h."""
        return self.weight * ca.sumsqr(force_density[:, 1:] - force_density[:, :-1]) / interval
