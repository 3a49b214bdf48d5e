"""Natural modes as motions, so that whatever draws a trajectory draws a mode."""

from __future__ import annotations

import numpy as np

from tenscasadi.analysis.modes import Modes
from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.record import record
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import instance, positive_number, whole_number


def mode_motion(model: Model, modes: Modes, index: int, amplitude: float | None = None, rows: int = 41) -> Trajectory:
    """One period of mode `index` about the model's initial shape, as a trajectory of `rows` rows for plots and animations.

    `amplitude`: how far the furthest node moves, m; None: a twentieth of the structure's size. Nodes move in straight lines, as modes do,
    so bar lengths are off in the second order of the amplitude, and `bar_length_error` says by how much. An unstable mode is drawn
    with the period that it would have. Raises TypeError, ValueError.
    """
    instance("model", model, Model, "a tenscasadi.Model")
    instance("modes", modes, Modes, "the result of tenscasadi.modes(model)")
    if whole_number("index", index, 0) >= len(modes.frequency):
        raise ValueError(f"index is {index}: modes are numbered from 0 to {len(modes.frequency) - 1}")
    count = whole_number("rows", rows, 3)
    shape = modes.shape[index]
    if shape.shape != model.structure.nodes.shape:
        raise ValueError(f"modes.shape has {shape.shape[0]} nodes: give the modes of this model, which has {len(model.structure.nodes)}")
    size = float(np.ptp(model.structure.nodes, axis=0).max())
    reach = size / 20 if amplitude is None else positive_number("amplitude", amplitude)
    omega = 2 * np.pi * max(abs(float(modes.frequency[index])), 1e-9)
    time = np.linspace(0.0, 2 * np.pi / omega, count)
    moved = shape * (reach / np.linalg.norm(shape, axis=1).max())
    nodes = model.structure.nodes + np.sin(omega * time)[:, None, None] * moved
    velocities = omega * np.cos(omega * time)[:, None, None] * moved
    states = np.array([model.state(*row) for row in zip(nodes, velocities, strict=True)])
    controls = np.tile(model.initial_control, (count, 1))
    message = f"mode {index}, {modes.frequency[index]:.4g} Hz"
    return record(model, time, states, controls, step=float(time[1]), message=message)
