"""Strings that break in a run, found in its states."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscasadi.scene.strength import list_strengths
from tenscasadi.structure.cables import name_inputs
from tenscasadi.structure.names import label

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
        Its strength [N], the least one in a cable.
    """

    member: str
    strings: tuple[int, ...]
    time: float
    force: float

    def __str__(self) -> str:
        return f"{self.member} breaks at t = {self.time:.4g} s ({self.force:.4g} N)"


def name_breakable(scene: Scene) -> list[str]:
    """Name the strings and cables that can break."""
    s, names = scene.structure, name_inputs(scene.structure)
    for k, (input_, count) in enumerate(
        zip(*np.unique(s.cable_of, return_counts=True), strict=True)
    ):
        string = int(np.flatnonzero(s.cable_of == input_)[0])
        if count == 1 and s.string_names and s.string_names[string]:
            names[k] = f"string {label(s.string_names, string)!r}"
    return [names[k] for k in scene.breakable_inputs]


def find_breaks(scene: Scene, states: Array) -> tuple[StringBreak, ...]:
    """Find the strings that break in a run.

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
                name_breakable(scene)[k],
                tuple(own.tolist()),
                float(time[-1, k] - time[0, k]),
                float(strength[own].min()),
            )
        )
    return tuple(sorted(found, key=lambda one: one.time))


def hide_broken(scene: Scene | None, states: Array, values: Array) -> Array:
    """Replace values (T, α) of broken strings by NaN, at states (T, nx)."""
    if scene is None or not len(scene.breakable_inputs):
        return values
    inputs = int(scene.structure.cable_of.max()) + 1
    broken = np.zeros((len(states), inputs), dtype=bool)
    broken[:, scene.breakable_inputs] = _select_states(scene, states)[0] < 0.5
    return np.where(broken[:, scene.input_of], np.nan, values)


def _select_states(scene: Scene, states: Array) -> tuple[Array, Array]:
    """Select the internal states (T, m) of the strength: 1 if intact, and times [s]."""
    count, end = len(scene.breakable_inputs), states.shape[1] - int(scene.has_clock)
    return states[:, end - 2 * count : end - count], states[:, end - count : end]


def describe_breaks(breaks: tuple[StringBreak, ...]) -> str:
    """Describe the first break in a message, and count the others; "" if there are none."""
    if not breaks:
        return ""
    more = len(breaks) - 1
    others = f", and {more} more break{'s' if more == 1 else ''} later" if more else ""
    return f"; {breaks[0]}{others}"
