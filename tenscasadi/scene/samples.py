"""Sampled functions of time, which files can store."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.scene.over_time import read_sample
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.time_functions import Samples
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.util.validate import Array


def sample_functions(scene: Scene, times: Array) -> tuple[Scene, tuple[str, ...]]:
    """Replace functions of time by samples at times (K,) [s].

    Formulas stay, because files can store them. Returns the scene and the names of the sampled
    fields. Raises ValueError.
    """
    times = np.unique([0.0, *times])
    changes: dict[str, Any] = {}
    shapes = {"gravity": (3,), "pressure": (), "forces": (len(scene.structure.nodes), 3)}
    for name, shape in shapes.items():
        load = getattr(scene, name)
        if load is None or not load.is_function or isinstance(load.quantity, TimeFormula):
            continue
        values = [read_sample(load.field, load.quantity(float(t)), shape) for t in times]
        table = {load.quantity_name: values if len(times) > 1 else values[0], "breakpoints": ()}
        changes[name] = replace(load, **table, times=times if len(times) > 1 else None)
    if scene.supports is not None:
        functions = scene.supports.positions
        positions = {
            node: function
            if isinstance(function, (TimeFormula, Samples))
            else Samples(
                times, np.array([read_sample("position", function(t), (3,)) for t in times])
            )
            for node, function in functions.items()
        }
        if any(positions[node] is not function for node, function in functions.items()):
            changes["supports"] = replace(scene.supports, positions=positions)
    return (replace(scene, **changes) if changes else scene), tuple(sorted(changes))
