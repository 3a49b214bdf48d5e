"""Starts, parameters, controls and steps of rollouts.

An array with one row is shared by all runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.control_input import ControlProfile, SampledControl, sample_control
from tenscasadi.simulation.engine.request import Intervals, count_runs, gather_steps
from tenscasadi.simulation.feedback import Feedback
from tenscasadi.simulation.time_grid import lay_grid
from tenscasadi.util.validate import (
    SMALLEST,
    Array,
    finite_array,
    format_value,
    nesting,
    positive_number,
    real_array,
)

_MOST_DECISIONS = 1e7  # feedback updates: bounds the memory


class ControlSchedule(NamedTuple):
    """Controls of rollouts.

    `controls` (n or 1, K, nu) are constant on K equal parts of the run. A `feedback` replaces
    them; they are then a placeholder (1, 1, nu).
    """

    controls: Array
    feedback: Feedback | None


def read_starts(model: Model, states: Any, p: Array) -> Array:
    """Check the initial states (n or 1, nx).

    A state that is not finite makes only its own run fail. Raises TypeError, ValueError.
    """
    wanted = f"states of shape (n, {model.nx}) or ({model.nx},)"
    given = (
        _stack_rows([model.start_at(row) for row in p], model.nx)
        if states is None
        else real_array("states", states, wanted)
    )
    if given.ndim not in (1, 2) or given.shape[-1] != model.nx:
        raise ValueError(f"states has shape {given.shape}: give {wanted}")
    starts = np.atleast_2d(given)
    clocks = model.split(starts)[2]
    if clocks.size and len(np.unique(clocks[np.isfinite(clocks)])) > 1:
        raise ValueError(
            f"states[:, {model.nx - 1}] are clocks from {np.nanmin(clocks):g} to {np.nanmax(clocks):g} s: start all motions at one time"
        )
    return starts


def read_parameters(model: Model, given: Any) -> Array:
    """Check the parameters (n or 1, np).

    Raises TypeError, ValueError.
    """
    layout = model.parameters
    if isinstance(given, Mapping):
        tables = {name: value for name, value in given.items() if nesting(value) >= 2}
        shared = layout.values(
            {name: value for name, value in given.items() if name not in tables}
            | dict.fromkeys(tables.keys() - layout.places, 0)
        )
        checked = {}
        for name, value in tables.items():
            place = layout.places[name]
            shape = (None, place.stop - place.start)
            checked[name] = finite_array(f"parameters[{format_value(name)}]", value, shape)
        counts = {f"parameters[{name!r}]": len(value) for name, value in checked.items()}
        rows = np.tile(shared, (count_runs(**counts), 1))
        for name, value in checked.items():
            rows[:, layout.places[name]] = value
    elif nesting(given) < 2:
        return layout.values(given)[None]
    else:
        rows = finite_array("parameters", given, (None, len(layout)))
    layout.check(rows)
    return rows


def _stack_rows(rows: list[Array], size: int) -> Array:
    """Stack rows; one row if all are the same object."""
    kept = rows[:1] if all(row is rows[0] for row in rows) else rows
    return np.array(kept).reshape(len(kept), size)


def read_controls(model: Model, controls: Any, p: Array) -> ControlSchedule:
    """Check the controls.

    Raises TypeError, ValueError.
    """
    nu = model.nu
    if isinstance(controls, Feedback):
        given, known = controls.controls.shape[1], controls.states.shape[1]
        clock = known - 2 * model.nq  # not fed back
        if given != nu or clock not in (0, 1):
            raise ValueError(
                f"controls is a Feedback of {given} controls and {known} states: the model has {nu} and {model.nx}"
            )
        if isinstance(model.scene.control, RestLength):
            _check_rest_lengths(controls)
        return ControlSchedule(np.zeros((1, 1, nu)), controls)
    if controls is None:
        return ControlSchedule(_initial(model, p)[:, None], None)
    depth = nesting(controls)
    shapes: dict[int, tuple[int | None, ...]] = {1: (nu,), 2: (None, nu)}
    table = finite_array("controls", controls, shapes.get(depth, (None, None, nu)))
    table = table[None, None] if depth == 1 else table[:, None] if depth == 2 else table
    if table.shape[1] == 0:
        raise ValueError(f"controls has shape {table.shape}: give at least one interval")
    bad = np.argwhere(table < SMALLEST)
    if isinstance(model.scene.control, RestLength) and len(bad):
        place = tuple(int(i) for i in bad[0])
        raise ValueError(
            f"controls{list(place)} is {table[place]:g}: rest lengths (RestLength) must be greater than 0"
        )
    return ControlSchedule(table, None)


def _check_rest_lengths(feedback: Feedback) -> None:
    """Raise ValueError unless feedback keeps rest lengths positive."""
    least = np.where(np.any(feedback.gains, axis=(0, 2)), -np.inf, feedback.controls.min(axis=0))
    bad = np.flatnonzero(
        (np.maximum(least, feedback.lower) < SMALLEST) | (feedback.upper < SMALLEST)
    )
    if bad.size:
        k = bad[0]
        told = f"controls is a Feedback whose limits of string {k} are {feedback.lower[k]:g} and {feedback.upper[k]:g}"
        raise ValueError(
            f"{told}: rest lengths (RestLength) must be greater than 0, give Feedback(lower=...) above it"
        )


def _initial(model: Model, p: Array) -> Array:
    """Compute the model's initial controls (n or 1, nu)."""
    controls = np.array([model.control_at(row) for row in p]).reshape(len(p), model.nu)
    return controls[:1] if len(controls) and not np.ptp(controls, axis=0).any() else controls


def first_time(model: Model, starts: Array) -> float:
    """Return the initial time of the clock [s].

    It is 0 without a clock.
    """
    times = model.split(starts)[2]
    return float(times[np.isfinite(times)][0]) if np.any(np.isfinite(times)) else 0.0


def lay_steps(
    model: Model, starts: Array, t_end: float, step: float, plan: ControlSchedule
) -> SampledControl:
    """Choose the steps of rollouts.

    The sampled "control" of a step is the number of its control interval.
    """

    def sample(end: float, steps: int) -> SampledControl:
        if plan.feedback is None:
            return sample_control(
                np.arange(plan.controls.shape[1], dtype=float)[:, None], np.zeros(1), end, steps
            )
        nodes = plan.feedback.time
        period = nodes[-1] - nodes[-2]
        if end > _MOST_DECISIONS * period:
            raise ValueError(
                f"t_end is {end:g}: that takes more than {_MOST_DECISIONS:g} decisions of {period:g} s, give a smaller one"
            )
        later = nodes[-1] + period * np.arange(1, max(0, np.ceil((end - nodes[-1]) / period)) + 1)
        nodes = np.append(nodes, later)
        nodes = np.append(nodes[nodes < end - 1e-9 * period], end)
        return sample_control(
            ControlProfile(nodes, np.arange(len(nodes) - 1, dtype=float)[:, None]),
            np.zeros(1),
            end,
            steps,
        )

    return lay_grid(
        model,
        first_time(model, starts),
        positive_number("t_end", t_end),
        positive_number("step", step),
        sample,
    )


def gather_intervals(
    model: Model, inputs: SampledControl, plan: ControlSchedule
) -> tuple[Intervals, dict[str, Any] | None]:
    """Merge equal steps into intervals and prepare the feedback arrays."""
    if inputs.ends is None:
        count = plan.controls.shape[1]  # equal intervals
        row, steps = np.arange(count), np.full(count, inputs.steps // count)
        length = np.full(count, inputs.step)
    else:
        piece = gather_steps(inputs.window(0, inputs.steps), inputs.lengths(0, inputs.steps))
        own, steps, length = piece.intervals
        row = piece.inputs[0, own, 0].astype(np.int64)
    if plan.feedback is None:
        return Intervals(row, steps, length), None
    plan_size, referred = len(plan.feedback.controls), 2 * model.nq
    last = [plan_size - 1]  # after the plan, the last gain holds its last state
    feedback = {
        "decides": np.concatenate([[1], np.diff(row) != 0]).astype(np.int64),
        "decision": np.minimum(row, plan_size).astype(np.int64),
        "given": np.ascontiguousarray(
            np.concatenate([plan.feedback.controls, plan.feedback.controls[last]])
        ),
        "reference": np.ascontiguousarray(plan.feedback.states[:, :referred]),
        "gains": np.ascontiguousarray(
            np.concatenate([plan.feedback.gains, plan.feedback.gains[last]])[:, :, :referred]
        ),
        "lower": plan.feedback.lower,
        "upper": plan.feedback.upper,
        "referred": referred,
    }
    return Intervals(np.zeros_like(row), steps, length), feedback


def controls_at(plan: ControlSchedule, model: Model, time: Array, saved: Any, k: int) -> Array:
    """Compute the controls of run k at saved times.

    The controls are (T, nu), the times in s. Feedback is evaluated at the saved states, as if it
    were updated there.
    """
    if plan.feedback is None:
        table = plan.controls[k if len(plan.controls) > 1 else 0]
        return np.asarray(
            table[np.minimum((time / time[-1] * len(table) + 1e-9).astype(int), len(table) - 1)]
        )
    f, known = plan.feedback, 2 * model.nq
    row = np.searchsorted(f.time, time + 1e-9, side="right") - 1
    gain = np.minimum(row, len(f.controls) - 1)
    away = saved[k][:, :known] - f.states[row, :known]
    change = np.einsum("tux,tx->tu", f.gains[gain][:, :, :known], away)
    return np.asarray(np.clip(f.controls[gain] - change, f.lower, f.upper))
