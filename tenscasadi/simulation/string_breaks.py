"""Strings that break or yield during a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscasadi.scene.failed_strings import name_limited
from tenscasadi.scene.strength import list_strengths
from tenscasadi.util.validate import NEGLIGIBLE

if TYPE_CHECKING:
    from tenscasadi.scene.scene import Scene
    from tenscasadi.util.validate import Array


class StringBreak(NamedTuple):
    """String or cable that breaks in a run.

    Attributes
    ----------
    member : str
        Name of the string or cable.
    strings : tuple of int
        Its strings in `Scene.structure`.
    time : float
        Time of the break since the start of the run [s].
    force : float
        Strength of the string, or the smallest one in the cable [N].
    """

    member: str
    strings: tuple[int, ...]
    time: float
    force: float

    def __str__(self) -> str:
        return f"{self.member} breaks at t = {self.time:.4g} s ({self.force:.4g} N)"


class StringYield(NamedTuple):
    """String or cable that yields in a run.

    Attributes
    ----------
    member : str
        Name of the string or cable.
    strings : tuple of int
        Its strings in `Scene.structure`.
    time : float
        Time of the last saved row before it yields [s].
    force : float
        Force at which it yields [N]; in a cable, the smallest one of its strings.
    elongation : float
        Plastic elongation during the run [m].
    """

    member: str
    strings: tuple[int, ...]
    time: float
    force: float
    elongation: float

    def __str__(self) -> str:
        amount = f"by {self.elongation:.3g} m ({self.force:.4g} N)"
        return f"{self.member} yields after t = {self.time:.4g} s {amount}"


def find_breaks(scene: Scene, states: Array) -> tuple[StringBreak, ...]:
    """Find the strings that break, from the states of a run.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    states : ndarray, shape (T, nx)
        States of the run from its start.

    Returns
    -------
    tuple of StringBreak
        Breaks in the order of time.
    """
    inputs = scene.breakable_inputs
    if not len(inputs) or not len(states):
        return ()
    intact, time = _select_states(scene, states)
    strength, cable_of = list_strengths(scene), scene.structure.cable_of
    found = []
    for k in np.flatnonzero((intact[0] > 0.5) & (intact[-1] < 0.5)).tolist():
        own = np.flatnonzero(cable_of == inputs[k])
        found.append(
            StringBreak(
                name_limited(scene)[k],
                tuple(own.tolist()),
                float(time[-1, k] - time[0, k]),
                float(strength[own].min()),
            )
        )
    return tuple(sorted(found, key=lambda one: one.time))


def find_yields(scene: Scene, time: Array, states: Array) -> tuple[StringYield, ...]:
    """Find the strings that yield, from the states of a run.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    time, states : ndarray, shapes (T,) and (T, nx)
        Times [s] and states of the run from its start.

    Returns
    -------
    tuple of StringYield
        Strings and cables, in the order of time.
    """
    inputs = scene.limited_inputs
    if len(inputs) == len(scene.breakable_inputs) or not len(states):
        return ()
    end = states.shape[1] - int(scene.has_clock)
    growth = states[:, end - len(inputs) : end] - states[0, end - len(inputs) : end]
    strength, cable_of, found = list_strengths(scene), scene.structure.cable_of, []
    lengths = np.bincount(cable_of, weights=scene.structure.string_lengths)[inputs]
    for k in np.flatnonzero(growth[-1] > NEGLIGIBLE * lengths).tolist():  # more than rounding
        own = np.flatnonzero(cable_of == inputs[k])
        row = int(np.argmax(growth[:, k] > NEGLIGIBLE * growth[-1, k])) - 1
        member, least = name_limited(scene)[k], float(strength[own].min())
        found.append(
            StringYield(member, tuple(own.tolist()), float(time[row]), least, float(growth[-1, k]))
        )
    return tuple(sorted(found, key=lambda one: one.time))


def hide_broken(scene: Scene | None, states: Array, values: Array) -> Array:
    """Replace values (T, α) of broken strings by NaN.

    The states of the run are (T, nx).
    """
    if scene is None or not len(scene.breakable_inputs):
        return values
    inputs = int(scene.structure.cable_of.max()) + 1
    broken = np.zeros((len(states), inputs), dtype=bool)
    broken[:, scene.breakable_inputs] = _select_states(scene, states)[0] < 0.5
    return np.where(broken[:, scene.input_of], np.nan, values)


def _select_states(scene: Scene, states: Array) -> tuple[Array, Array]:
    """Select the states (T, m) that record intact strings.

    The first ones are 1 if intact, the second ones the times for which they have been intact [s].
    """
    count, end = len(scene.breakable_inputs), states.shape[1] - int(scene.has_clock)
    return states[:, end - 2 * count : end - count], states[:, end - count : end]


def describe_failures(scene: Scene, time: Array, states: Array) -> str:
    """Describe the first string that breaks or yields.

    The text also counts the others; it is "" if there are none. `time` (T,) [s] and `states` (T,
    nx) are those of a run.
    """
    found = [*find_breaks(scene, states), *find_yields(scene, time, states)]
    if not found:
        return ""
    more = len(found) - 1
    others = f", and {more} more string{'s' if more > 1 else ''}" if more else ""
    return f"; {found[0]}{others}"
