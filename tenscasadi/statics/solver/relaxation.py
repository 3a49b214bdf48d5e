"""Dynamic relaxation with kinetic damping.

A simulation restarts at rest at each maximum of its kinetic energy [1]_.

References
----------
.. [1] M. R. Barnes, Form finding and analysis of tension structures by dynamic relaxation,
   International Journal of Space Structures 14 (1999), 89-104.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stability import contact_step, stable_step
from tenscasadi.scene.binding import fix
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.engine.request import FINISHED, MEASURED
from tenscasadi.simulation.engine.roll import Request, Runs, roll
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.inputs.run_inputs import read_inputs
from tenscasadi.simulation.verdict.starts import constraint_violation
from tenscasadi.simulation.verdict.thresholds import THRESHOLDS
from tenscasadi.statics.solver.trust_region import SEARCH_COST
from tenscasadi.util.validate import MAX_ITERATIONS, ROUNDING, Array

_ROWS = 200  # steps of a round, among which the maximum is sought
_LONGEST = 1e-2  # s, longest step of a structure without stiff members


def relax(scene: Scene, nodes: Array, control: Array, parameters: Array, time: float) -> Array:
    """Relax a scene to rest under constant loads.

    These are the loads of one instant.

    Parameters
    ----------
    scene : Scene
        The scene.
    nodes : ndarray, shape (n, 3)
        Start, with supports in place [m].
    control, parameters : ndarray, shape (nu,), (np,)
        Constant control and parameters.
    time : float
        Time of the loads [s].

    Returns
    -------
    ndarray, shape (n, 3)
        Nodes near an equilibrium; the last nodes if the motion does not come to rest.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = Model(freeze_loads(scene, nodes, parameters, time))
        state = model.state(nodes)
        limits = (stable_step(model, state, control, safety=0.5), 0.5 * contact_step(model))
    if constraint_violation(model, state) > THRESHOLDS["start"].failed:
        return nodes
    step = min(_LONGEST, *(limit for limit in limits if limit > 0.0))
    duration, highest, taken = _ROWS * step, 0.0, 0.0
    for _ in range(MAX_ITERATIONS):
        taken += duration / step
        if taken * nodes.size > SEARCH_COST:
            break
        run = _move(model, state, control, duration, step)
        kinetic = run.measured[0, :, MEASURED.index("kinetic")]
        if run.rolled.status[0] != FINISHED or not np.isfinite(kinetic).all():
            break
        peak = int(np.argmax(kinetic))
        highest = max(highest, float(kinetic[peak]))
        state = model.state(model.nodes(run.saved[0, peak]))
        if kinetic[peak] <= ROUNDING * highest:
            break
        inside = 0 < peak < len(kinetic) - 1
        reached = run.times(run.saved_steps(0))[peak]
        duration = max(_ROWS * step, 2.0 * reached) if inside else 2.0 * duration
    return np.asarray(model.nodes(state))


def _move(model: Model, state: Array, control: Array, duration: float, step: float) -> Runs:
    """Simulate for a duration [s], and save up to about 1000 states.

    It begins at a state (nx,), with a constant control (nu,) and time steps of `step` [s].
    """
    scheme = RungeKutta4()
    inputs = read_inputs(model, duration, step, scheme, state, control, None, many=False)
    every = max(1, -(-inputs.grid.steps // 1000))
    return roll(Request(inputs, scheme, None, every, Account(False, False), "errors", lanes=1))


def freeze_loads(scene: Scene, nodes: Array, parameters: Array, time: float) -> Scene:
    """Replace time-varying loads and supports by constants.

    They are those of one instant.

    Parameters
    ----------
    scene : Scene
        The scene.
    nodes : ndarray, shape (n, 3)
        Nodes with supports in place [m].
    parameters : ndarray, shape (np,)
        Parameters, which become constants.
    time : float
        The instant [s].

    Returns
    -------
    Scene
        A scene without clock and parameters.
    """
    fixed: Scene = fix(scene, parameters)
    changes: dict[str, Any] = {"supports": None}
    for name in ("gravity", "pressure", "forces"):
        load = getattr(fixed, name)
        if load is not None and load.varies:
            value = ca.DM(load.at(ca.DM(time))).full().T
            value = value if name == "forces" else np.squeeze(value)
            constant = {load.quantity_name: value, "times": None, "breakpoints": ()}
            changes[name] = replace(load, **constant)
    count = len(fixed.structure.nodes)
    changes["structure"] = fixed.structure.replace(nodes=nodes[:count])
    return replace(fixed, **changes)
