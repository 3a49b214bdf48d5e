"""Open-loop replay of plans."""

from __future__ import annotations

import numpy as np

from ocp.results.result import PlanResult
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stability import contact_step
from tenscasadi.simulation.inputs.controls import ControlProfile
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import positive_number

STEPS = 10  # integration steps and rest-length updates in each interval of a plan


def replay_open(plan: PlanResult, model: Model, scheme: Scheme, step: float | None) -> Trajectory:
    """Simulate a model under the controls of a plan.

    The controls are force densities or rest lengths, applied in open loop from the initial state of
    the plan. `step` is the longest integration step [s]. By default it is a tenth of an interval,
    or less if contact with a ground requires it. Raises TypeError or ValueError for an invalid
    scheme or step.
    """
    check_scheme(scheme)
    size = None if step is None else positive_number("step", step)
    start, intervals, end = plan.trajectory.states[0], np.diff(plan.time), float(plan.time[-1])
    if size is None and model.scene.grounds:
        size = min(intervals.max() / STEPS, contact_step(model))
    if plan.linear or np.ptp(intervals) > 1e-9 * end:
        profile = ControlProfile(plan.time, plan.control, STEPS if size is None else 1)
        return simulate(
            model, end, end if size is None else size, scheme, start, profile, compiled=False
        )
    return simulate(
        model,
        end,
        intervals[0] / STEPS if size is None else size,
        scheme,
        start,
        plan.control,
        compiled=False,
    )
