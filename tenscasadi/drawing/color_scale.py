"""Color scale of string forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscasadi.drawing.style import STYLE, Bytes, interpolate_colors
from tenscasadi.util.validate import Array

QUANTITIES = {"tension": "N", "force density": "N/m"}  # with their units


@dataclass(frozen=True)
class ColorScale:
    """Color scale for string forces from 0 to `largest`.

    Slack strings are gray, and strings in compression green.

    Attributes
    ----------
    quantity : str
        Colored quantity, a key of `QUANTITIES`.
    largest : float
        Value at the end of the scale: a quantile of all values, so that an impact does not wash
        out the rest.
    highest, lowest : float
        Largest and smallest of all values.
    slack : bool
        Whether any string is slack at any time.
    """

    quantity: str
    largest: float
    highest: float
    lowest: float
    slack: bool

    @staticmethod
    def of(quantity: str, values: Array) -> ColorScale:
        """Build the color scale for all finite values.

        `quantity` is "tension" or "force density".
        """
        known = values[np.isfinite(values)]
        positive = known[known > 0]
        end = np.quantile(positive, STYLE.saturation, method="higher") if len(positive) else 0.0
        return ColorScale(
            quantity,
            float(end),
            highest=float(known.max(initial=0.0)),
            lowest=float(known.min(initial=0.0)),
            slack=bool(np.any(known == 0)),
        )

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return QUANTITIES[self.quantity]

    @property
    def label(self) -> str:
        """Quantity and unit, with the meaning of gray and green."""
        parts = [f"{self.quantity} ({self.unit})"]
        if self.slack:
            parts.append("gray: slack")
        if self.lowest < 0:
            parts.append(f"green: compression, up to {-self.lowest:.3g} {self.unit}")
        return "; ".join(parts)

    def widen(self, values: Array) -> ColorScale:
        """Extend the scale to more values.

        The scale has a new end if they exceed it by 5 %.
        """
        found = ColorScale.of(self.quantity, values)
        exceeds = found.largest > 1.05 * self.largest
        return ColorScale(
            self.quantity,
            found.largest if exceeds else self.largest,
            found.largest if exceeds else self.highest,
            min(self.lowest, found.lowest),
            self.slack or found.slack,
        )

    def colors(self, values: Array) -> Bytes:
        """Compute the colors (m, 3) of values (m,)."""
        fractions = np.nan_to_num(values) / (self.largest or 1.0)
        found = interpolate_colors(STYLE.ramp, np.clip(fractions, 0.0, 1.0))
        found[~(values > 0)] = STYLE.slack
        found[values < 0] = STYLE.compression
        return found
