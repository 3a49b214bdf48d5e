"""The motion under force densities that are linear in time, or held on a grid of unequal intervals."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array


def run_profile(model: Model, scheme: Scheme, start: Array, time: Array, values: Array, steps: int, longest: float | None) -> Trajectory:
    """From `start` under `values` (K or K + 1, nu) on the grid `time` (K + 1,).

    Each interval takes `steps` equal steps, or as many as it needs for none to be longer than `longest` s.
    Linear force densities are held at their mean over each step. success is False where the motion diverges; the trajectory ends there.
    """
    intervals = np.diff(time)
    counts = [steps if longest is None else max(1, int(np.ceil(h / longest - 1e-9))) for h in intervals]
    h = np.repeat(intervals / counts, counts)
    ends = np.concatenate([[0.0], *(time[k] + (np.arange(n) + 1) * intervals[k] / n for k, n in enumerate(counts))])
    middle = (ends[:-1] + ends[1:]) / 2
    controls = profile_at(values, time, middle)
    chain = scheme.advance(model).mapaccum(len(h))
    states = np.column_stack([start, np.asarray(chain(start, ca.DM(controls.T), h[None]).full())]).T
    good = int(np.argmin(np.append(np.isfinite(states).all(axis=1), False)))
    message = f"finished {len(h)} steps" if good == len(states) else f"diverged after t = {ends[good - 1]:g} s: the state is not finite"
    held = np.concatenate([controls, controls[-1:]])
    return record_trajectory(model, ends[:good], states[:good], held[:good], step=float(h.max()), message=message, success=good == len(states))
