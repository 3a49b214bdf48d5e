"""Open-loop replay of plans."""

from __future__ import annotations

import numpy as np

from ocp.problem.control import has_elastic_strings
from ocp.results.result import STEPS, PlanResult, Replayed
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stability import contact_step, find_limit
from tenscasadi.simulation.inputs.controls import ControlProfile
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array, positive_number

STIFF_STEPS = 2  # integration steps of an implicit scheme


def replay_in_doubt(plan: PlanResult, model: Model) -> Replayed:
    """Replay a plan in open loop, and check its steps.

    The acceptance test of `simulate` compares the positions of all nodes with those of longer
    steps. If the replay fails it, two replays follow, in steps of its mean step size and of half of
    it. Both have to meet the goals.
    """
    first = replay_open(plan, model, None, None)
    if first.success:
        return Replayed((first,))
    motions = tuple(
        replay_open(plan, model, None, step, verify=False) for step in (first.step, first.step / 2)
    )
    failures = [f"its replay {motion.message}" for motion in motions if not motion.success]
    return Replayed(motions, failures[0] if failures else "")


def replay_open(
    plan: PlanResult,
    model: Model,
    scheme: Scheme | None,
    step: float | None,
    verify: bool = True,
) -> Trajectory:
    """Simulate a model under the controls of a plan.

    The controls are force densities or rest lengths, applied in open loop from the initial state of
    the plan. `step` is the longest integration step [s]. By default it is a tenth of an interval,
    or less if contact with a ground requires it, of `RungeKutta4`. If elastic strings make such
    steps unstable, it is half an interval of `Collocation`. Under rest-length control with the
    default scheme, the acceptance test of the run ignores the energy error: the steps need not
    resolve vibrations of the strings, which do not affect the goals. Its error estimate is that of
    positions, unless `verify` is False. Raises TypeError or ValueError for an invalid scheme or step.
    """
    size = None if step is None else positive_number("step", step)
    start, intervals, end = plan.trajectory.states[0], np.diff(plan.time), float(plan.time[-1])
    each, judged = STEPS, True
    if scheme is None:
        scheme, judged = RungeKutta4(), not has_elastic_strings(model)
        largest = float(intervals.max()) / STEPS if size is None else size
        if not judged and find_limit(model, scheme) < largest:
            scheme, each = Collocation(2, "radau"), STIFF_STEPS
    check_scheme(scheme)
    if size is None and model.scene.grounds:
        size = min(intervals.max() / each, contact_step(model))
    control: ControlProfile | Array = plan.control
    if plan.linear or np.ptp(intervals) > 1e-9 * end:
        control = ControlProfile(plan.time, plan.control, each if size is None else 1)
        size = end if size is None else size
    step = intervals[0] / each if size is None else size
    return simulate(
        model,
        end,
        step,
        scheme,
        start,
        control,
        compiled=False,
        energy_balance=judged,
        verify=verify,
    )
