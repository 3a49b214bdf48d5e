"""From states to a trajectory: everything that a model can tell of each of them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array


def observe(model: Model, states: Array, controls: Array) -> dict[str, Array]:
    """What `model.observe` gives, by name, each (T, size), of T states (T, nx) and controls (T, nu)."""
    rows = len(states)
    mapped = model.observe.map(rows)
    results = mapped.call([ca.DM(states.T), ca.DM(controls.T) if model.nu else ca.DM(0, rows)])
    return {name: result.full().T.copy() for name, result in zip(model.observe.name_out(), results, strict=True)}


def record(
    model: Model,
    time: Array,
    states: Array,
    controls: Array,
    *,
    step: float,
    message: str,
    success: bool = True,
    energy_error: Array | None = None,
    correction: tuple[Array, Array] | None = None,
    seconds: float = 0.0,
    compiled: bool = False,
) -> Trajectory:
    """The trajectory of states (T, nx) under controls (T, nu) at `time` (T,).

    `energy_error` (T,), None: not computed; `correction`: its shift and energy (T,) each, None: there was none. The rest as in `Trajectory`.
    """
    rows = len(time)
    observed = observe(model, states, controls)
    shift, added = (np.zeros(rows), np.zeros(rows)) if correction is None else correction
    nodes = (rows, len(model.structure.nodes), 3)
    return Trajectory(
        time=time,
        nodes=observed["nodes"].reshape(nodes),
        velocities=observed["velocities"].reshape(nodes),
        force_density=observed["force_density"],
        tension=observed["tension"],
        energy=observed["energy"].sum(axis=1),
        energy_parts=observed["energy"],
        energy_error=np.full(rows, np.nan) if energy_error is None else energy_error,
        bar_length_error=observed["bar_length_error"][:, 0],
        joint_error=observed["joint_error"][:, 0],
        correction_shift=shift,
        correction_energy=added,
        states=states.copy(),
        control=controls,
        bars=model.structure.bars,
        strings=model.structure.strings,
        pinned=np.array(sorted(model.structure.pinned), dtype=np.intp),
        success=success,
        message=message,
        step=step,
        seconds=seconds,
        compiled=compiled,
    )
