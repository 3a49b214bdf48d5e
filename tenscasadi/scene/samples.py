"""Samples of functions of time, which take their place in files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.scene.over_time import read_sample
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.time_functions import interpolate
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, finite_array


@dataclass(frozen=True, eq=False)
class Samples(Value, kind="Samples"):
    """Function of time that is known at some times.

    It is linear between them and constant before and after.

    Parameters
    ----------
    times : ndarray, shape (K,)
        Times [s].
    values : ndarray, shape (K, 3)
        Values at these times.
    """

    times: Array
    values: Array

    def __post_init__(self) -> None:
        times = finite_array("Samples.times", self.times, (None,))
        object.__setattr__(self, "times", times)
        values = finite_array("Samples.values", self.values, (len(times), 3))
        object.__setattr__(self, "values", values)

    def __call__(self, time: Any) -> Any:
        """Interpolate at a time, a number or a CasADi symbol."""
        if isinstance(time, (ca.SX, ca.MX, ca.DM)) and len(self.times) > 1:
            return interpolate(time, self.times, self.values, 3)
        number = 0.0 if isinstance(time, (ca.SX, ca.MX)) else float(time)
        return [float(np.interp(number, self.times, column)) for column in self.values.T]


def sample_functions(scene: Scene, times: Array) -> tuple[Scene, tuple[str, ...]]:
    """Replace functions of time by their samples at `times` (K,) [s].

    Formulas, which files can hold, stay. Returns the scene and the names of the sampled fields.
    Raises ValueError.
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
