"""Messages about the end of runs: steps, causes of failures, cures."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import find_limit
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.simulation.engine.kernel import BROKEN_BARS
from tenscasadi.simulation.engine.request import (
    BEYOND,
    BROKEN,
    NOT_FINITE,
    STOPPED,
    STUCK,
    TIRED,
)
from tenscasadi.simulation.engine.sundials_runs import SundialsRuns
from tenscasadi.simulation.verdict.starts import constraint_violation, describe_violation
from tenscasadi.simulation.verdict.thresholds import THRESHOLDS
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from tenscasadi.simulation.engine.roll import Runs

INTERRUPTED = "interrupted from the keyboard"
FAULTS = {
    NOT_FINITE: "the state is not finite",
    BEYOND: "the state is beyond any physical size",
    BROKEN: f"a bar is off by more than {BROKEN_BARS:.0%} of its length",
}


class StepSummary(NamedTuple):
    """Description and number of the steps of a run.

    Attributes
    ----------
    text : str
        Description of the steps.
    step : float
        Mean step [s].
    computed : int
        Number of steps, including rejected trial steps.
    """

    text: str
    step: float
    computed: int


def describe_steps(runs: Runs, k: int) -> StepSummary:
    """Describe the steps of run k."""
    request, memory, taken = runs.request, runs.rolled.memory(k), runs.last_step(k)
    grid, step = request.inputs.grid, request.inputs.grid.step
    if isinstance(runs.kernel.backend, SundialsRuns):
        events, trials = runs.kernel.backend.located
        located = f", {trials} trials to locate {events} events" if events else ""
        name = type(request.scheme).__name__
        return StepSummary(f"{taken} times {step:g} s apart, by {name}{located}", step, taken)
    if not runs.kernel.trials:
        return StepSummary(f"{taken} steps of {step:g} s", step, taken)
    covered = float(grid.times(np.array(taken))) + (step - memory.rest if memory.rest > 0 else 0.0)
    mean = covered / memory.accepted if memory.accepted else step
    text = f"{memory.accepted:.0f} steps of {mean:.3g} s in the mean, {memory.rejected:.0f} more rejected"
    text += f", {memory.located:.0f} to locate {memory.events:.0f} events" if memory.events else ""
    return StepSummary(text, mean, round(memory.accepted + memory.rejected + memory.located))


def explain_end(runs: Runs, k: int) -> str:
    """Explain why run k ended early, with a cure."""
    status, fault = (int(codes[k]) for codes in (runs.rolled.status, runs.rolled.fault))
    if status in FAULTS and fault == 0 and not runs.kernel.trials:
        return f"the start is not one: {FAULTS[status]}"
    if status in FAULTS and not (status == NOT_FINITE and runs.kernel.trials):
        times = runs.times([max(int(runs.rolled.good[k]), 0), fault])
        lost = f"diverged between t = {times[0]:g} and {times[1]:g} s: {FAULTS[status]}"
        return f"{lost}; {_explain_loss(runs, k)}"
    last = float(runs.times(runs.last_step(k)))
    if status == STOPPED and not runs.late:
        return f"{INTERRUPTED}, the last state kept is at t = {last:g} s"
    return f"stopped after t = {last:g} s: {_explain_failure(runs, k)}"


def _explain_failure(runs: Runs, k: int) -> str:
    """Explain why the scheme could not continue run k."""
    request, status = runs.request, int(runs.rolled.status[k])
    scheme, step = request.scheme, request.inputs.grid.longest
    name = type(scheme).__name__
    if status == STOPPED:
        over = f"the time limit of {request.time_limit:g} s has expired"
        return f"{over}: increase time_limit, or use a scheme and step that take less"
    if status == STUCK:
        return (
            f"{name} needs steps shorter than {1e-13 * step:.2g} s: the motion breaks down here, "
            f"or rtol={getattr(scheme, 'rtol', 0.0):g} asks for more than rounding leaves"
        )
    if status == TIRED:
        return (
            f"{runs.kernel.trials} attempts did not reach the end of a grid step of {step:g} s, "
            f"the last of {runs.rolled.memory(k).step:.2g} s: "
            f"try a larger {name}(rtol), a smaller step, an implicit scheme or a larger max_attempts"
        )
    if status == NOT_FINITE:
        return "the state is not finite, whatever the step: give a start that can move"
    if isinstance(scheme, Sundials) and isinstance(runs.kernel.backend, SundialsRuns):
        return _explain_sundials(scheme, runs.kernel.backend.failure)
    return "CasADi could not evaluate a step: try a smaller step"


def _explain_sundials(scheme: Sundials, failure: str) -> str:
    found = re.search(r'(\w+) returned "(\w+)"', failure)
    words = f"{found[1]} returned {found[2]}" if found else failure.strip().splitlines()[-1]
    # At a loose tolerance, excessive steps indicate that the motion itself broke down.
    tight = scheme.rtol <= 1e-5
    cure = (
        "a larger rtol, a smaller step or a larger max_steps" if tight else "a smaller rtol or step"
    )
    return f"{type(scheme).__name__} failed, {words}: rtol is {scheme.rtol:g}, try {cure}"


def _explain_loss(runs: Runs, k: int) -> str:
    request, status = runs.request, runs.rolled.status
    lost = np.flatnonzero((status > 0) & (status < STOPPED))
    step = request.inputs.grid.step
    if k != lost[0] and len(lost) > 20:  # linearizing costs more than a short run
        return f"try step={step / 5:.2g}, see also run {lost[0]}"
    return explain_loss(request.inputs.model, request.scheme, step, sample_run(runs, k))


class RunSamples(NamedTuple):
    """Times, states and inputs of a run at a few instants.

    The times are in seconds, the inputs are control and parameters.
    """

    times: Array
    states: Array
    inputs: Array


def sample_run(runs: Runs, k: int) -> RunSamples:
    """Select about nine saved states of run k."""
    inputs, steps = runs.request.inputs, runs.saved_steps(k)
    rows = np.unique(np.linspace(0, len(steps) - 1, 9).astype(int))
    return RunSamples(runs.times(steps[rows]), runs.saved[k, rows], inputs.stack(k, steps[rows]))


def explain_loss(model: Model, scheme: Scheme, step: float, samples: RunSamples) -> str:
    """Explain the cause of a divergence, with a cure.

    `samples` are states and inputs of the run, which had the time `step` [s]. Causes are found from
    the initial state and the linearized dynamics.
    """
    name = type(scheme).__name__
    violation = constraint_violation(model, samples.states[0])
    if violation > THRESHOLDS["start"].reported:
        return f"the start is {describe_violation(violation)}"
    if scheme.adaptive:
        return f"the error of each step was kept, so the motion itself breaks down or was not resolved: try a smaller {name}(rtol)"
    limit, when = find_stable_step(model, scheme, samples, step)
    if step > limit:
        return f"{describe_limit(scheme, step, limit, when)}: try step={0.9 * limit:.2g}"
    stable = (
        f"is below the stability limit {limit:.3g} s of the linearized motion"
        if np.isfinite(limit)
        else f"is stable, as any of {name}"
    )
    stages = ", stages that did not converge" if scheme.implicit else ""
    return (
        f"the step {step:g} s {stable}, so accuracy was lost elsewhere "
        f"(fast rotation, impact, bars drifting from their length{stages}): try step={step / 5:.2g} or correction=Projection()"
    )


def find_stable_step(
    model: Model, scheme: Scheme, samples: RunSamples, step: float = 0.0
) -> tuple[float, float]:
    """Find a scheme's smallest stability limit of the step along a run [s].

    `samples` are states and inputs of the run. Also returns the time of this limit [s]. Samples
    after the first one with a limit below `step` are not examined.
    """
    limits: list[float] = []
    for x, w in zip(samples.states, samples.inputs, strict=True):
        u, p = np.split(w, [model.nu])
        limits.append(find_limit(model, scheme, x, u, p))
        if limits[-1] < step:
            break
    least = int(np.argmin(np.nan_to_num(limits, nan=np.inf)))
    return limits[least], float(samples.times[least])


def describe_limit(scheme: Scheme, step: float, limit: float, when: float) -> str:
    """Describe a step above the stability limit.

    `limit` [s] is that of the scheme at the time `when` [s].
    """
    return (
        f"the step {step:g} s is above the stability limit {limit:.3g} s of {type(scheme).__name__} "
        f"at t = {when:g} s"
    )
