"""Conversion of functions of time to samples and interpolants.

Files of results contain samples, and runs use interpolants.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.scene.interpolants import Samples
from tenscasadi.scene.over_time import read_sample
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.time_functions import CURE
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array


def sample_functions(scene: Scene, times: Array) -> tuple[Scene, tuple[str, ...]]:
    """Replace functions of time by samples at times (K,) [s].

    Formulas remain, because files can store them. Returns the scene and the names of the sampled
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


def interpolate_functions(scene: Scene, first: float, last: float) -> Scene:
    """Interpolate a scene's functions of time that CasADi cannot trace.

    Parameters
    ----------
    scene : Scene
        The scene.
    first, last : float
        Start and end of the run [s].

    Returns
    -------
    Scene
        Scene with interpolants; the given one if all functions can be traced.

    Raises
    ------
    ValueError
        If a function raises, is not deterministic, or changes too fast.
    """
    parts = {name: getattr(scene, name) for name in ("gravity", "pressure", "forces", "supports")}
    found = {name: part and part.interpolate(first, last) for name, part in parts.items()}
    changes = {name: part for name, part in found.items() if part is not parts[name]}
    return replace(scene, **changes) if changes else scene


def reject_python_functions(scene: Scene, user: str) -> None:
    """Raise ValueError if CasADi cannot trace a function of time.

    The message names the `user`, which needs expressions or machine code.
    """
    for part in scene.over_time:
        if part.is_interpolated:
            raise add_address(
                ValueError(
                    f"{user} cannot use {part.field}, which CasADi cannot trace: give "
                    f"model.interpolate_functions(first, last), or {CURE}"
                )
            )
