"""Colours of strings by tension or force density, and of motions beside each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tenscasadi.util.validate import Array

Bytes = NDArray[np.uint8]
Rgb = tuple[int, int, int]

BAR: Rgb = (57, 66, 78)
JOINT: Rgb = (196, 145, 48)  # where bars meet
NODE: Rgb = (90, 98, 110)
PIN: Rgb = (192, 57, 43)
SLACK: Rgb = (185, 190, 197)
PUSHING: Rgb = (27, 158, 119)
GROUND: Rgb = (219, 212, 194)
OBSTACLE: Rgb = (214, 96, 77)
TARGET: Rgb = (46, 125, 50)

# matplotlib's "plasma" up to 0.86, as `tenscasadi.plots` uses it: brighter is hard to see on white
RAMP = np.array(
    [
        (13, 8, 135),
        (70, 3, 159),
        (114, 1, 168),
        (156, 23, 158),
        (189, 55, 134),
        (216, 87, 107),
        (237, 121, 83),
        (251, 159, 58),
        (253, 190, 43),
    ],
    dtype=float,
)

# of the motions that lie over the first one
GHOSTS: tuple[Rgb, ...] = (
    (31, 119, 180),
    (255, 127, 14),
    (44, 160, 44),
    (148, 103, 189),
    (140, 86, 75),
    (227, 119, 194),
)


@dataclass(frozen=True)
class Scale:
    """Colours from 0 to `largest`; slack strings are grey, those that push green.

    label, unit: of what the colours tell. slack, pushing: whether any string is so at any time;
    least: how hard they push, at most.
    """

    label: str
    unit: str
    largest: float
    slack: bool = False
    pushing: bool = False
    least: float = 0.0

    @staticmethod
    def of(label: str, unit: str, values: list[Array]) -> Scale:
        """Return the scale of all values that are finite."""
        known = (
            np.concatenate([value[np.isfinite(value)] for value in values])
            if values
            else np.zeros(0)
        )
        largest, least = float(known.max(initial=0.0)), float(known.min(initial=0.0))
        return Scale(label, unit, largest, bool(np.any(known == 0)), least < 0, least)

    def colours(self, values: Array) -> Bytes:
        """Return the colours (m, 3) of values (m,)."""
        share = np.clip(np.nan_to_num(values) / (self.largest or 1.0), 0.0, 1.0) * (len(RAMP) - 1)
        low = np.minimum(share.astype(int), len(RAMP) - 2)
        found = RAMP[low] + (share - low)[:, None] * (RAMP[low + 1] - RAMP[low])
        found[~(values > 0)] = SLACK
        found[values < 0] = PUSHING
        return np.asarray(np.round(found), dtype=np.uint8)


def linear(colours: Bytes | Rgb) -> Bytes:
    """Return colours of copies of a mesh as viser wants them: linear in light, while pages and pictures write them as sRGB."""
    share = np.asarray(colours, dtype=float) / 255
    found = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255 * found), dtype=np.uint8)


def css(colour: Rgb | Array) -> str:
    """Return a colour as pages write it."""
    return "#" + "".join(f"{round(float(part)):02x}" for part in colour)
