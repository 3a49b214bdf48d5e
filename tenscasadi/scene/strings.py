"""The law of a string: stretch and its rate → force density γ and elastic energy, and back from γ to the rest length (Appendix A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array, positive_number


@dataclass(frozen=True)
class ForceDensity:
    """The control is γ of every parent string, N/m, taken as it is commanded: no stiffness, damping or slack is built."""


@dataclass(frozen=True)
class RestLength:
    """The control is the rest length ρ of every parent string, m (> 0); the string law turns it into γ."""


Control = ForceDensity | RestLength


@dataclass(frozen=True)
class Clip:
    """Slack as it is: γ is exactly 0 unless the string is longer than its rest length and its tension positive (Eq. 99)."""

    def force_density(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None) -> Any:
        """γ of strings from s² (`squared`), ρ, k and c sᵀṡ (`rate`, None when undamped); any matching shape (Eq. 99).

        `taut` 1 or 0: strings held to pull, or not to, whatever their length: those too short push; None: as they are.

        `unit` is a typical length, constant: s² is raised by (1e-9 unit)², below rounding for any taut string, so that a string of
        no length has finite derivatives.
        """
        safe = squared + (1e-9 * unit) ** 2
        length = ca.sqrt(safe)
        strain = (length - rest) / length
        gamma = stiffness * strain if rate is None else stiffness * strain + rate / safe
        if taut is None:
            taut = strain > 0 if rate is None else (strain > 0) * (gamma > 0)
        return gamma * taut  # a product: the shortest code, and finite in all derivatives

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Elastic energy ½ k (s − ρ)² of taut strings, J."""
        stretch = ca.sqrt(ca.fmax(squared, rest * rest)) - rest
        return stiffness * stretch * stretch / 2


@dataclass(frozen=True)
class Smooth:
    """Slack as a smooth maximum, for optimisers: tension t = (t′ + √(t′² + (k w)²))/2, with t′ the unclipped tension.

    `width` w, m: tension is wrong by at most k w/2, at the rest length, and by k w²/(4 |s − ρ|) far from it.
    Damping fades over the same width.
    """

    width: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", positive_number("Smooth.width", self.width))

    def force_density(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None) -> Any:
        """γ of strings; arguments as for `Clip.force_density`, but for `taut`: here strings are both."""
        length = self._length(squared, unit)
        stretch = length - rest
        tension = stiffness * stretch
        if rate is not None:
            fade = (1 + stretch / ca.sqrt(stretch * stretch + self.width**2)) / 2
            tension = tension + fade * rate / length
        return (tension + ca.sqrt(tension * tension + (stiffness * self.width) ** 2)) / (2 * length)

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Elastic energy, J: the integral of the undamped tension over the stretch, 0 at the rest length as w → 0."""
        e = self._length(squared, unit) - rest
        w = self.width
        return stiffness * (e * e + e * ca.sqrt(e * e + w * w) + w * w * ca.asinh(e / w)) / 4

    def _length(self, squared: Any, unit: Any) -> Any:
        return ca.sqrt(squared + (1e-9 * unit) ** 2)  # finite derivatives at no length


Slack = Clip | Smooth


def rest_length(force_density: Array, length: Array, stiffness: Array) -> Array:
    """ρ = s (1 − γ/k), m: the rest lengths at which strings of these lengths (m) and stiffness (N/m) carry γ (N/m) (Eq. 99).

    Not positive where γ ≥ k: no rest length reaches that force density. Where k = 0: NaN, unless γ = 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(force_density == 0, length, length * (1 - force_density / stiffness))
