"""Limits of internal states, and of the motors of winches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscasadi.scene.failed_strings import name_limited
from tenscasadi.scene.strength import STATES
from tenscasadi.scene.winches import Winch
from tenscasadi.simulation.verdict.thresholds import Doubts
from tenscasadi.structure.cables import name_inputs
from tenscasadi.util.validate import TOLERANCE

if TYPE_CHECKING:
    from tenscasadi.simulation.engine.roll import Runs


def check_internal_states(runs: Runs) -> Doubts:
    """Find runs with internal states below their lower limits.

    An example is a rest length that becomes negative.
    """
    model, n = runs.request.inputs.model, len(runs.rolled.status)
    text, failed = [""] * n, np.zeros(n, dtype=bool)
    if not model.na:
        return Doubts(text, failed)
    states = model.split(runs.saved[:, :, : model.nx]).internal
    parts = model.scene.internal_states
    inputs = name_inputs(model.scene.structure)
    limited = name_limited(model.scene)
    names = [
        f"{part.quantity} of {name}"
        for part in parts
        for name in (limited if part.quantity in STATES else inputs)
    ]
    least = np.concatenate([np.full(len(part.initial), part.least) for part in parts])
    for k in range(n):
        steps = runs.saved_steps(k)
        low = states[k, : len(steps)] <= least
        if not low.any():
            continue
        row = int(low.any(axis=1).argmax())
        entry = int(low[row].argmax())
        failed[k] = True
        text[k] = (
            f"; the {names[entry]} reaches {least[entry]:g} at {float(runs.times(steps[row])):.3g} s: "
            "give inputs that wind up less, or a smaller t_end"
        )
    return Doubts(text, failed)


def describe_motor_overload(runs: Runs, k: int) -> str:
    """Describe the motor of run k that exceeds a limit of its `Winch` most.

    Returns "" if none does. The torques of a run with feedback are not examined: they are limited.
    """
    inputs = runs.request.inputs
    model, steps = inputs.model, runs.saved_steps(k)
    control, count = model.scene.control, model.nu
    if not isinstance(control, Winch):
        return ""
    states = runs.saved[k, : len(steps), : model.nx]
    reached = {
        "speed": (model.split(states).internal[:, count : 2 * count], "winding speed", "rad/s")
    }
    if inputs.feedback is None:
        given = inputs.add_schedule(inputs.stack(k, steps), runs.times(steps))[:, :count]
        reached["torque"] = given, control.name, control.unit
    found = []
    for field, (values, quantity, unit) in reached.items():
        largest, limit = np.abs(values).max(axis=0), control.limits(field, count)
        entry = int(np.argmax(largest / limit))
        if largest[entry] > (1 + TOLERANCE) * limit[entry]:
            name, most = name_inputs(model.scene.structure)[entry], f"{limit[entry]:g} {unit}"
            found.append(
                f"; the {quantity} of {name} is up to {largest[entry]:.3g} {unit}, "
                f"beyond the {most} of Winch.{field}"
            )
    return "".join(found)
