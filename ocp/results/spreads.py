"""Checks of the parameter and state variations of robustness studies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tenscasadi.util.validate import finite_array, format_value, nesting, positive_number, text


def check_variation(parameters: Any, start: Any) -> tuple[dict[str, float], tuple[float, float]]:
    """Check the spreads of parameters and of the initial state.

    A spread is the half-width of a uniform distribution. `start` is that of positions [m], or a
    pair with that of velocities [m/s]. Returns those of the parameters by name, and those of
    positions [m] and velocities [m/s]. Raises TypeError or ValueError, also if nothing varies.
    """
    spreads, place = check_spreads(parameters), check_start(start)
    if not spreads and not any(place):
        raise ValueError(
            "parameters is empty and start is 0: give something that varies, such as {'bar_mass': 0.05}"
        )
    return spreads, place


def check_spreads(parameters: Any) -> dict[str, float]:
    """Check relative parameter spreads by name.

    Each must be at least 0 and less than 1. Raises TypeError or ValueError.
    """
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise TypeError(
            f"parameters is {format_value(parameters)}: give spreads by name, such as {{'bar_mass': 0.05}}"
        )
    for name in parameters:
        text("parameters: a name", name)
    spreads = {
        name: positive_number(f"parameters[{format_value(name)}]", value, zero=True)
        for name, value in parameters.items()
    }
    for name, value in spreads.items():
        if name == "rest_length":
            raise ValueError(
                "parameters has 'rest_length', which a plan commands: vary 'stiffness' instead"
            )
        if value >= 1:
            raise ValueError(
                f"parameters[{name!r}] is {value:g}: give a spread relative to its value, less than 1"
            )
    return spreads


def check_start(start: Any) -> tuple[float, float]:
    """Check the spreads of initial positions and velocities.

    `start` is a number [m], with zero spread of velocities, or both spreads [m, m/s]. Returns both.
    Raises TypeError or ValueError.
    """
    if nesting(start) == 0:
        return positive_number("start", start, zero=True), 0.0
    pair = finite_array("start", start, (2,))
    return positive_number("start[0]", pair[0], zero=True), positive_number(
        "start[1]", pair[1], zero=True
    )
