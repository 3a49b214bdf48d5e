"""Checks of plans from files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.cables import name_inputs
from tenscasadi.util.validate import LARGEST


def check_plan(given: Mapping[str, Any]) -> None:
    """Check the fields of a plan for validity and consistency.

    `given` are the fields by name. Raises ValueError, which names the first invalid field. Numbers
    that are not finite count as unknown.
    """
    trajectory, model, structure = given["trajectory"], given["model"], given["structure"]
    if model is not None and trajectory.states.shape[1] != model.nx:
        columns = trajectory.states.shape[1]
        raise ValueError(f"field 'trajectory.states' has {columns} columns, not {model.nx}")
    intervals, strings = len(trajectory.time) - 1, len(structure.strings)
    rows = intervals + (len(given["force_density"]) == intervals + 1)
    shapes = {"time": (intervals + 1,), "force_density": (rows, strings)}
    if given["inputs"] is not None:
        shapes["inputs"] = (rows, len(name_inputs(structure)))
    for name, shape in shapes.items():
        value = given[name]
        if value.shape != shape:
            raise ValueError(f"field {name!r} has shape {value.shape}, not {shape}")
        if given["success"] and not np.all(np.abs(value) <= LARGEST):
            fault = f"not finite or above {LARGEST:g}, although the plan succeeded"
            raise ValueError(f"field {name!r} is {fault}")
    _check_numbers(given, trajectory)
    if model is None:  # The scene may subdivide strings, so that counts cannot be checked.
        return
    control, other = model.scene.control, given["inputs"] is not None
    wanted = "force_density" if control is None else control.attribute
    if given["input_attribute"] != wanted or other is (wanted == "force_density"):
        raise ValueError("fields 'inputs' and 'input_attribute' do not fit the model's control")
    for name in ("bars", "strings"):
        if not np.array_equal(getattr(trajectory, name), getattr(model.structure, name)):
            raise ValueError(f"field 'trajectory.{name}' does not hold those of the model")
    count, nodes = trajectory.nodes.shape[1], len(model.structure.nodes)
    if count != nodes:
        raise ValueError(
            f"field 'trajectory.nodes' is of {count} nodes, not of the model's {nodes}"
        )


def _check_numbers(given: Mapping[str, Any], trajectory: Trajectory) -> None:
    if np.any(np.diff(given["time"]) <= 0):
        raise ValueError("field 'time' must increase")
    if not np.allclose(given["time"], trajectory.time, equal_nan=True):
        raise ValueError("field 'trajectory.time' is not the plan's 'time'")
    for name in ("iterations", "seconds", "replay_error", "replay_speed_error"):
        if given[name] < 0:
            raise ValueError(f"field {name!r} is {given[name]:g}: it must be at least 0")
    if given["success"] and not (trajectory.success and np.isfinite(given["objective"])):
        name = "objective" if trajectory.success else "trajectory.success"
        value = given.get(name, False)
        raise ValueError(f"field {name!r} is {value}, although the plan succeeded")
