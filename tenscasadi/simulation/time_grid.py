"""Steps cut so that they see what functions of time and tables do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tenscasadi.scene.over_time import OverTime
from tenscasadi.scene.pulses import Resolution, find_jumps, find_pulses, is_finite
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.scene.time_functions import clock_error
from tenscasadi.simulation.control_input import SampledControl, cut_steps
from tenscasadi.util.validate import Array, Indices

_RESOLUTION = {
    False: Resolution(0.1, 1e-6),
    True: Resolution(0.05, 1e-9),
}  # of a step without and with control of the error
_NARROWEST = 3.0  # errors of the clock to both sides of a jump: what lies between is stepped over


_asked: ContextVar[Resolution | None] = ContextVar("resolution", default=None)


@contextmanager
def resolving(resolution: Resolution) -> Iterator[None]:
    """Let the steps of all runs within leave no more than this of a function of time unseen."""
    before = _asked.set(resolution)
    try:
        yield
    finally:
        _asked.reset(before)


def cut_at_changes(
    changing: Sequence[OverTime | SupportMotion],
    inputs: SampledControl,
    first: float,
    adaptive: bool,
) -> SampledControl:
    """Cut the steps of a run at the times of tables, at jumps, and in pulses that a step would not see.

    Parameters
    ----------
    changing : sequence of OverTime or SupportMotion
        The parts of a scene that change over time.
    inputs : SampledControl
        Steps of the run, with the control in them.
    first : float
        Time of the clock at their beginning, s.
    adaptive : bool
        Whether the scheme controls its error: its steps then leave less unseen.

    Returns
    -------
    SampledControl
        The steps, cut, and what no cuts let them see.

    Raises
    ------
    TypeError, ValueError
        Where a function of time is not finite or moves supports by a jump, by its name.
    """
    if not changing:
        return inputs
    last, resolution = first + inputs.t_end, _asked.get() or _RESOLUTION[adaptive]
    for load in changing:
        _check_functions(load, first, last)
    steps, error = inputs.steps, clock_error(first, last, inputs.steps)
    breaks = [load.find_breaks(first, last, steps) for load in changing]
    inputs = cut_steps(inputs, np.concatenate(breaks) - first)
    # A step that ends at a jump is cut just before it, too: its last stage is to see nothing of it.
    jumps = [
        times[find_jumps(load, times, 2 * error, first, last)]
        for load, times in zip(changing, breaks, strict=True)
    ]
    inputs = cut_steps(inputs, np.concatenate(jumps) - first, error / 2)
    cuts, unseen = _find_cuts(
        changing, lambda rows: first + inputs.times(rows), inputs.steps, error, resolution
    )
    inputs = replace(cut_steps(inputs, cuts - first), unseen=unseen)
    if all(is_finite(load, last + error) for load in changing):
        return inputs
    # What is finite up to the end alone is not to be asked for a time beyond it, where rounding may
    # take the clock.
    return replace(inputs, ends=inputs.times(np.arange(inputs.steps + 1)), early=error)


def unseen_changes(
    changing: Sequence[OverTime | SupportMotion],
    first: float,
    last: float,
    steps: int,
    resolution: Resolution,
) -> str:
    """Say what changes too fast for equal steps from `first` to `last`, s, and the cuts in them; "" where there is nothing."""

    def ends(rows: Indices) -> Array:
        return np.asarray(first + (last - first) / steps * rows)

    return _find_cuts(changing, ends, steps, clock_error(first, last, steps), resolution)[1]


def _find_cuts(
    changing: Sequence[OverTime | SupportMotion],
    ends: Callable[[Indices], Array],
    steps: int,
    error: float,
    resolution: Resolution,
) -> tuple[Array, str]:
    cuts, unseen = [np.empty(0)], ""
    for load in changing:
        pulses = find_pulses(load, ends, steps, _NARROWEST * error, resolution)
        cuts.append(pulses.cuts)
        if pulses.unresolved is not None:
            unseen += f"; {load.field} changes within steps at t = {pulses.unresolved:g} s, more than they see: try a smaller step"
    return np.concatenate(cuts), unseen


@lru_cache(maxsize=32)  # many runs of one scene look once
def _check_functions(load: OverTime | SupportMotion, first: float, last: float) -> None:
    load.check_run(first, last)
