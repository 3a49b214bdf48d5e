"""Sliders that control strings, separately or in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.drawing.view_content import list_names
from tenscasadi.scene.strings import RestLength
from tenscasadi.schema.reading import Names
from tenscasadi.structure.cables import name_inputs, select_first
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import Array, as_tuple, format_value, text
from tenscasadi.viewer.live_mode.simulation import LiveSimulation

constants = lazy_module("scipy.constants")

# Ranges relative to initial rest lengths, to the largest initial force density, and to nominal
# values: twice the stiffness and half the mass halve the stable step; the step is at most half of it.
_RANGES = {"rest length": (0.5, 1.5), "force density": (0.0, 3.0), "parameter": (0.5, 2.0)}

Groups = Mapping[str, Sequence[int]] | None


@dataclass(frozen=True)
class Slider:
    """Slider that sets the control of some strings.

    It sets the rest length [m] or force density [N/m] of each of the `strings` between `low` and
    `high`. With `factor` it multiplies their initial values. `name` is its label.
    """

    name: str
    strings: tuple[int, ...]
    low: float
    high: float
    factor: bool = False

    def apply(self, simulation: LiveSimulation, value: float) -> None:
        """Set the control of a simulation to the slider's value.

        The value is limited to the slider's range.
        """
        if not np.isfinite(value):
            return
        value = float(np.clip(value, self.low, self.high))
        for string in self.strings if self.factor else ():
            simulation.set_control([string], value * simulation.start_control[string])
        if not self.factor:
            simulation.set_control(self.strings, value)

    def read(self, simulation: LiveSimulation) -> float:
        """Compute the slider's position in a simulation, a mean over its strings."""
        now, start = (
            control[list(self.strings)]
            for control in (simulation.control, simulation.start_control)
        )
        if self.factor:
            now = now[start != 0] / start[start != 0] if np.any(start) else np.ones(1)
        return float(np.clip(now.mean(), self.low, self.high))


@dataclass(frozen=True)
class ParameterSlider:
    """Slider that sets a parameter of the model.

    `quantity` is the name of the parameter, and `name` the slider's label. It multiplies the values
    of all items by a number from `low` to `high`. `unit_values` are those at 1.
    """

    name: str
    quantity: str
    unit_values: tuple[float, ...]
    low: float
    high: float

    def apply(self, simulation: LiveSimulation, value: float) -> None:
        """Set the parameter of a simulation to the slider's value.

        The value is limited to the slider's range.
        """
        if np.isfinite(value):
            number = float(np.clip(value, self.low, self.high))
            simulation.set_parameters(self.quantity, number * np.array(self.unit_values))

    def read(self, simulation: LiveSimulation) -> float:
        """Compute the position of the slider from the simulation's parameters.

        It is a factor of `unit_values`.
        """
        now = simulation.parameters[simulation.model.parameters.places[self.quantity]]
        unit = np.array(self.unit_values)
        return float(np.clip(now @ unit / (unit @ unit), self.low, self.high))


def choose_parameter_sliders(simulation: LiveSimulation) -> list[ParameterSlider]:
    """Choose a simulation's sliders for constant gravity and each parameter."""
    layout, found = simulation.model.parameters, []
    for quantity, place in layout.places.items():
        nominal = layout.nominal[place]
        size = float(np.linalg.norm(nominal))
        if quantity == "gravity":
            direction = nominal / size if size else np.array([0.0, 0.0, -1.0])
            most = _round(2 * (size or constants.g), np.ceil)
            unit = tuple(direction.tolist())
            found.append(ParameterSlider("gravity (m/s²)", quantity, unit, 0.0, most))
        elif quantity != "forces" and size:
            name = f"{quantity.replace('_', ' ')} (factor)"
            unit = tuple(nominal.tolist())
            found.append(ParameterSlider(name, quantity, unit, *_RANGES["parameter"]))
    return found


def build_slider(simulation: LiveSimulation, string: int) -> Slider:
    """Build the slider of one string, given by its index."""
    low, high = _choose_range(simulation, simulation.start_control[[string]])
    return Slider(_list_names(simulation)[string], (string,), low, high)


def choose_sliders(simulation: LiveSimulation, groups: Groups = None) -> list[Slider]:
    """Choose the sliders of a simulation.

    Parameters
    ----------
    simulation : LiveSimulation
        Simulation.
    groups : mapping of str to sequence of int or str, optional
        Strings that share a slider, by its name. Default: each of at most 12 strings has its own.
        Otherwise strings of equal length and control share one, if there are at most 12 kinds.

    Returns
    -------
    list of Slider
        The sliders. If there are several, the first one controls all strings.

    Raises
    ------
    TypeError, ValueError
        A group is wrong; the message names it.
    """
    start = simulation.start_control
    count = len(start)
    if not count:
        return []
    named = (
        _group_equal(simulation)
        if groups is None
        else _read_groups(groups, simulation.model.scene.structure.names)
    )
    factors = _RANGES["rest length" if _by_length(simulation) else "force density"]
    found = []
    for name, strings in named.items():
        own = start[list(strings)]
        equal = bool(np.ptp(own) <= 1e-9 * abs(own).max())
        low, high = _choose_range(simulation, own) if equal else factors
        label = name if equal else f"{name} (factor)"
        found.append(Slider(label, strings, low, high, factor=not equal))
    if count > 1 and np.any(start > 0) and not (len(found) == 1 and len(found[0].strings) == count):
        found.insert(0, Slider("all (factor)", tuple(range(count)), *factors, factor=True))
    return found


def _list_names(simulation: LiveSimulation) -> tuple[str, ...]:
    """List the names of a simulation's cables and of strings in no cable."""
    structure = simulation.model.scene.structure
    strings = list_names(structure, "string", len(structure.strings))
    inputs = zip(name_inputs(structure), select_first(structure.cable_of), strict=True)
    return tuple(name if name.startswith("cable") else strings[k] for name, k in inputs)


def _by_length(simulation: LiveSimulation) -> bool:
    return isinstance(simulation.model.scene.control, RestLength)


def _choose_range(simulation: LiveSimulation, own: Array) -> tuple[float, float]:
    """Choose the range of a slider for strings with initial values `own`.

    The values are rest lengths [m] or force densities [N/m] (k,).
    """
    largest = float(own.max())
    if _by_length(simulation):
        low, high = _RANGES["rest length"]
        return _round(low * largest, np.floor), _round(high * largest, np.ceil)
    largest = largest or float(simulation.start_control.max())
    return 0.0, _round(_RANGES["force density"][1] * largest, np.ceil) if largest else 100.0


def _round(value: float, way: Any) -> float:
    """Round a positive number to two significant digits.

    A slider displays its limits so. `way` is NumPy's floor or ceil, the direction of rounding.
    """
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{way(round(value / digit, 6)) * digit:.3g}")


def _group_equal(simulation: LiveSimulation) -> dict[str, tuple[int, ...]]:
    """Group strings of equal length and equal control.

    The keys are the names of the groups, and the values the indices of strings.
    """
    start, structure = simulation.start_control, simulation.model.scene.structure
    count = len(start)
    if count <= MOST_LISTED:
        return {name: (k,) for k, name in enumerate(_list_names(simulation))}
    lengths = np.bincount(structure.cable_of, weights=structure.string_lengths)
    rows = np.column_stack([values / (np.abs(values).max() or 1.0) for values in (start, lengths)])
    _, kinds = np.unique(np.round(rows, 9), axis=0, return_inverse=True)
    if kinds.max() >= MOST_LISTED:
        return {"all": tuple(range(count))}
    groups = [np.flatnonzero(kinds.ravel() == k) for k in dict.fromkeys(kinds.ravel().tolist())]
    return {_name_group(strings): tuple(strings.tolist()) for strings in groups}


def _name_group(strings: Any) -> str:
    first = ", ".join(map(str, strings[:3]))
    if len(strings) == 1:
        return f"string {first}"
    return f"{len(strings)} strings: {first}{' …' if len(strings) > 3 else ''}"


def _read_groups(groups: Any, names: Names) -> dict[str, tuple[int, ...]]:
    if not isinstance(groups, Mapping) or not groups:
        raise TypeError(
            f"groups is {format_value(groups)}: give a mapping of names to strings, such as {{'top': [0, 1, 2]}}"
        )
    read = {}
    for name, strings in groups.items():
        text("groups", name)
        field = f"groups[{format_value(name)}]"
        own = names.resolve_all(field, "input", strings)
        given = as_tuple(field, own, "[0, 1, 2] of indices of strings")
        if not given:
            raise ValueError(f"{field} is empty: give at least one string")
        indices = [names.index(field, "input", string) for string in given]
        read[name] = tuple(dict.fromkeys(indices))
    return read
