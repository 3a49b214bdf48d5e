"""A natural mode as a trajectory, for plots and animations."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.analysis.modes import Modes
from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import instance, positive_number, whole_number


def mode_motion(
    model: Model,
    modes: Modes,
    index: int,
    amplitude: float | None = None,
    rows: int = 41,
    parameters: Any = None,
) -> Trajectory:
    """Compute one period of vibration in a natural mode.

    The trajectory, about the model's initial nodes, is for plots and animations.

    Nodes move in straight lines, so bar lengths have errors of second order in the amplitude, see
    `bar_length_error`. For an unstable mode with the growth rate σ, the period is 2π/σ.

    Parameters
    ----------
    model : Model
        The model that the modes belong to.
    modes : Modes
        Result of `modes(model)`.
    index : int
        Number of the mode, from 0.
    amplitude : float, optional
        Largest displacement of a node [m]; None: a twentieth of the structure's size.
    rows : int
        Number of times in the trajectory.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, as those of the modes.

    Returns
    -------
    Trajectory
        The motion over one period.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, there is no such mode, or the modes are those of another
        structure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(prestress=30.0)))
    >>> motion = tc.mode_motion(model, tc.modes(model), index=0, amplitude=0.02)
    >>> motion.nodes.shape
    (41, 6, 3)
    """
    check_model(model)
    instance("modes", modes, Modes, "the result of tenscasadi.modes(model)")
    if whole_number("index", index, 0) >= len(modes.frequency):
        raise ValueError(
            f"index is {index}: modes are numbered from 0 to {len(modes.frequency) - 1}"
        )
    count = whole_number("rows", rows, 3, 100_000)
    shape = modes.shape[index]
    if shape.shape != model.structure.nodes.shape:
        raise ValueError(
            f"modes.shape has {shape.shape[0]} nodes: give the modes of this model, which has {len(model.structure.nodes)}"
        )
    reach = extent(model) / 20 if amplitude is None else positive_number("amplitude", amplitude)
    omega = 2 * np.pi * max(abs(float(modes.frequency[index])), 1e-9)
    time = np.linspace(0.0, 2 * np.pi / omega, count)
    moved = shape * (reach / np.linalg.norm(shape, axis=1).max())
    nodes = model.structure.nodes + np.sin(omega * time)[:, None, None] * moved
    velocities = omega * np.cos(omega * time)[:, None, None] * moved
    states = np.array([model.state(*row) for row in zip(nodes, velocities, strict=True)])
    controls = np.tile(model.stack_inputs(None, parameters), (count, 1))
    message = f"mode {index}, {modes.frequency[index]:.4g} Hz"
    return record_trajectory(model, time, states, controls, step=float(time[1]), message=message)
