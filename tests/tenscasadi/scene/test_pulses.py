"""Pulses: steps are cut where they would not see what a function of time does, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.pulses import Resolution, find_pulses

FIXED, ADAPTIVE = Resolution(0.1, 1e-6), Resolution(0.05, 1e-9)


def edges(
    function: Callable[[Any], Any], end: float, step: float, resolution: Resolution = ADAPTIVE
) -> np.ndarray:
    """The times at which steps begin and end, cut."""
    steps = round(end / step)
    found = find_pulses(
        Gravity(lambda t: [0, 0, function(t)]), lambda rows: rows * step, steps, 1e-12, resolution
    )
    assert found.unresolved is None
    return np.union1d(found.cuts, np.arange(steps + 1) * step)


def bell(t: Any, at: float, width: float, impulse: float = 1.0) -> Any:
    return impulse / (width * np.sqrt(np.pi)) * ca.exp(-(((t - at) / width) ** 2))


@pytest.mark.parametrize("resolution", [FIXED, ADAPTIVE])
@pytest.mark.parametrize(
    ("rest", "end"),
    [
        (lambda t: 0.5, 1.0),
        (lambda t: bell(t, 0.8, 1e-5), 1.0),  # six hundred times as high
        (lambda t: bell(t, 0.8, 1e-9), 1.0),
        (lambda t: bell(t, 0.42, 1e-9), 1.0),  # in the same step
        (lambda t: 1e3 * t, 1.0),
        (lambda t: 1e3, 1.0),
        (lambda t: 9.81 + ca.sin(3 * t), 500.0),
        (lambda t: 1e4 * ca.sin(t), 50.0),
    ],
)
def test_no_pulse_is_hidden_by_what_else_a_function_does(
    rest: Callable[[Any], Any], end: float, resolution: Resolution
) -> None:
    at, width = 0.4375, 6e-3
    times = edges(lambda t: rest(t) + bell(t, at, width), end, 0.05, resolution)
    inside = (times[1:] > at - width) & (times[:-1] < at + width)
    assert np.diff(times)[inside].max() < 3 * width


@pytest.mark.parametrize(
    "function",
    [
        lambda t: 3.0 + 0 * t,
        lambda t: 2 * t - 1,
        lambda t: ca.sin(7 * t),
        lambda t: ca.exp(-t),
        lambda t: 1e6 + ca.cos(5 * t),
    ],
)
@pytest.mark.parametrize("end", [1.0, 40.0])
def test_what_steps_see_is_not_cut(function: Callable[[Any], Any], end: float) -> None:
    assert len(edges(function, end, 0.05)) == round(end / 0.05) + 1


def test_cuts_are_no_more_than_a_pulse_needs() -> None:
    """However much narrower than the step it is: those on the way to it count as its logarithm."""
    for width in (1e-3, 1e-6, 1e-9):
        assert len(
            edges(lambda t, width=width: bell(t, 0.5123, width), 1.0, 0.05)
        ) < 21 + 60 + 2 * np.log2(0.05 / width)


def test_a_thousand_pulses_are_not_too_many() -> None:
    times = edges(lambda t: ca.exp(-100 * (1 - ca.cos(20 * t))), 400.0, 0.05)
    middles = (times[1:] + times[:-1]) / 2
    assert np.diff(times)[np.cos(20 * middles) > 0.99].max() < 0.02  # s; each is 0.014 s wide
