"""How far a motion is from the goals, by name: at the end, and at the waypoints."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ocp.boundary.target import Target
from tenscasadi.util.validate import Array

NOTHING = 1e-6  # m: smaller distances do not count beside speeds


class Misses(NamedTuple):
    """Distances from goals, m, and differences of speed, m/s, each with the name of the goal's row."""

    places: list[tuple[float, str]]
    speeds: list[tuple[float, str]]

    def worst(self) -> str:
        """The row that is missed most, and by how much; places come first. There has to be one."""
        place, speed = (max(rows, default=(0.0, "")) for rows in (self.places, self.speeds))
        (amount, name), unit = (place, "m") if place[0] > NOTHING or not self.speeds else (speed, "m/s")
        return f"{name} misses its goal by {amount:.2g} {unit}"


def misses(target: Target, state_at: Callable[[float], Array]) -> Misses:
    """Of the motion whose state (nx,) at a share of the duration is state_at(share)."""
    found = Misses([], [])
    for share, part, label in target.instants:
        metres, speeds = (np.abs(np.asarray(value.full()).ravel()).tolist() for value in part.misfit(state_at(share)))
        names = [label + name for name in part.names]
        found.places.extend(zip(metres, names, strict=False))
        found.speeds.extend(zip(speeds, names[len(metres) :], strict=True))
    return found
