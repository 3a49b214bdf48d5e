"""Which sliders drive the strings: one for each where they are few, one for those that are alike where they are many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.scene.strings import RestLength
from tenscasadi.util.validate import Array, listed, node_index, shown, text
from tenscasadi.viewer.live_mode.simulation import LiveSimulation

MOST = 12  # sliders
_LENGTHS = 0.5, 1.5  # of the rest length at the start
_FORCES = 3.0  # times the largest force density at the start
_USUAL = 100.0  # N/m, where all are 0 at the start
_ALIKE = 9  # digits

Groups = Mapping[str, Sequence[int]] | None


@dataclass(frozen=True)
class Slider:
    """A slider for some strings, from `low` to `high`.

    It gives each the same rest length, m, or force density, N/m; with `factor` it multiplies what
    each has at the start.
    """

    name: str
    strings: tuple[int, ...]
    low: float
    high: float
    factor: bool = False

    def apply(self, simulation: LiveSimulation, value: float) -> None:
        """Drive the strings of a simulation; values beyond the slider count as its ends, what is no number does nothing."""
        if not np.isfinite(value):
            return
        value = float(np.clip(value, self.low, self.high))
        for string in self.strings if self.factor else ():
            simulation.set_control([string], value * simulation.start_control[string])
        if not self.factor:
            simulation.set_control(self.strings, value)

    def read(self, simulation: LiveSimulation) -> float:
        """Return where the slider stands for the control of a simulation: the mean over its strings."""
        now, start = (
            control[list(self.strings)]
            for control in (simulation.control, simulation.start_control)
        )
        if self.factor:
            now = now[start != 0] / start[start != 0] if np.any(start) else np.ones(1)
        return float(np.clip(now.mean(), self.low, self.high))


def single(simulation: LiveSimulation, string: int) -> Slider:
    """Return the slider of one string."""
    low, high = _limits(simulation, simulation.start_control[[string]])
    return Slider(f"string {string}", (string,), low, high)


def sliders_of(simulation: LiveSimulation, groups: Groups = None) -> list[Slider]:
    """Choose the sliders of a simulation.

    Parameters
    ----------
    simulation : LiveSimulation
        What is driven.
    groups : mapping of str to sequence of int, optional
        Strings that share a slider, by its name. Default: each has its own where they are at most
        12; else strings of one length and control share one, if these are at most 12.

    Returns
    -------
    list of Slider
        The sliders; one for all strings is the first where there are several.

    Raises
    ------
    TypeError, ValueError
        A group is wrong; the message names it.
    """
    start = simulation.start_control
    count = len(start)
    if not count:
        return []
    named = _alike(simulation) if groups is None else _read(groups, count)
    found = []
    for name, strings in named.items():
        own = start[list(strings)]
        equal = bool(np.ptp(own) <= 1e-9 * abs(own).max())
        low, high = (
            _limits(simulation, own)
            if equal
            else (_LENGTHS if _by_length(simulation) else (0.0, _FORCES))
        )
        found.append(
            Slider(name if equal else f"{name} (factor)", strings, low, high, factor=not equal)
        )
    if count > 1 and np.any(start > 0) and not (len(found) == 1 and len(found[0].strings) == count):
        low, high = _LENGTHS if _by_length(simulation) else (0.0, _FORCES)
        found.insert(0, Slider("all (factor)", tuple(range(count)), low, high, factor=True))
    return found


def _by_length(simulation: LiveSimulation) -> bool:
    return isinstance(simulation.model.scene.control, RestLength)


def _limits(simulation: LiveSimulation, own: Array) -> tuple[float, float]:
    largest = float(own.max())
    if _by_length(simulation):
        return _rounded(_LENGTHS[0] * largest, np.floor), _rounded(_LENGTHS[1] * largest, np.ceil)
    everywhere = float(simulation.start_control.max())
    return 0.0, _rounded(_FORCES * (largest or everywhere or _USUAL / _FORCES), np.ceil)


def _rounded(value: float, way: Any) -> float:
    """Round to two digits: these stand below the slider."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{way(round(value / digit, 6)) * digit:.3g}")


def _alike(simulation: LiveSimulation) -> dict[str, tuple[int, ...]]:
    start, structure = simulation.start_control, simulation.model.scene.structure
    count = len(start)
    if count <= MOST:
        return {f"string {k}": (k,) for k in range(count)}
    scales = [np.abs(values).max() or 1.0 for values in (start, structure.string_lengths)]
    rows = np.round(
        np.column_stack([start / scales[0], structure.string_lengths / scales[1]]), _ALIKE
    )
    _, kind = np.unique(rows, axis=0, return_inverse=True)
    order = list(dict.fromkeys(kind.ravel().tolist()))
    if len(order) > MOST:
        return {"all": tuple(range(count))}
    return {
        _described(np.flatnonzero(kind.ravel() == one)): tuple(
            np.flatnonzero(kind.ravel() == one).tolist()
        )
        for one in order
    }


def _described(strings: Any) -> str:
    first = ", ".join(map(str, strings[:3]))
    return (
        f"{len(strings)} strings: {first}{' …' if len(strings) > 3 else ''}"
        if len(strings) > 1
        else f"string {first}"
    )


def _read(groups: Any, count: int) -> dict[str, tuple[int, ...]]:
    if not isinstance(groups, Mapping) or not groups:
        raise TypeError(
            f"groups is {shown(groups)}: give a mapping of names to strings, such as {{'top': [0, 1, 2]}}"
        )
    read = {}
    for name, strings in groups.items():
        text("groups", name)
        given = listed(f"groups[{shown(name)}]", strings, "[0, 1, 2] of indices of strings")
        if not given:
            raise ValueError(f"groups[{shown(name)}] is empty: give at least one string")
        read[name] = tuple(
            dict.fromkeys(
                node_index(f"groups[{shown(name)}]", string, count, "string") for string in given
            )
        )
    return read
