"""Check that internal states stay where the equations have a meaning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscasadi.simulation.verdict.thresholds import Doubts
from tenscasadi.structure.cables import name_inputs

if TYPE_CHECKING:
    from tenscasadi.simulation.engine.roll import Runs


def check_internal_states(runs: Runs) -> Doubts:
    """Find the runs whose internal states fall below their lower limits.

    An example is a rest length that is wound up completely.
    """
    model, n = runs.request.inputs.model, len(runs.rolled.status)
    text, failed = [""] * n, np.zeros(n, dtype=bool)
    if not model.na:
        return Doubts(text, failed)
    states = model.split(runs.saved[:, :, : model.nx]).internal
    parts = model.scene.internal_states
    inputs = name_inputs(model.scene.structure)
    names = [
        f"{part.quantity} of {inputs[k] if len(part.initial) == len(inputs) else k}"
        for part in parts
        for k in range(len(part.initial))
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
