"""Simulation: a model, a scheme and a control become a trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.correction_effect import correction_effect
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import BarLengthCorrection, Correction, Projection
from tenscasadi.simulation.control_input import ControlInput, Signal, signal
from tenscasadi.simulation.diagnosis import cause, doubts, first_fault
from tenscasadi.simulation.record import observe, record
from tenscasadi.simulation.steppers import Report, StepFailure, Stepper, Task, make_stepper
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.interrupts import on_interrupt
from tenscasadi.util.validate import Array, finite_array, instance, positive_number, whole_number

_ROWS = 1000  # rows kept when save_every is None
_LOOK_SECONDS = 0.5  # wall time between checks of the bar lengths
_CLOCK_LOSS = 1e-6  # share of a step that rounding may take off the clock


def simulate(
    model: Model,
    t_end: float,
    step: float | None = None,
    scheme: Scheme = RungeKutta4(),
    state: Any = None,
    control: ControlInput = None,
    correction: Correction | None = None,
    save_every: int | None = None,
    compiled: Compiled = None,
    progress: bool = False,
    *,
    energy_balance: bool = True,
) -> Trajectory:
    """The motion of `model` from time 0 to `t_end`, s.

    step: largest step, s; the run takes equal steps, the fewest that end exactly at t_end. Schemes that control their error take any
    number of steps of their own, none of them larger, within each of these. None: 1 ms, or a hundredth of t_end for schemes that control their error.
    state: start (nx,), None: `model.initial_state`.
    control: None: `model.initial_control`; an array (nu,): constant; an array (K, nu): constant on each of K equal parts of [0, t_end]
    (steps are shortened to fit the parts); a function t -> (nu,) called with the time at the start of each step, where it is held.
    correction: `Projection(every)`, `BarLengthCorrection(weight, every)` or None; applied after every `every`-th step (each of its own
    for schemes that control their error, where its effect is not measured: `correction_shift` of the result is NaN).
    save_every: steps from one kept row to the next, None: what keeps about 1000 rows or fewer; the first and last state are always kept.
    compiled: None: as machine code if a C compiler is found, True: that or `CompileError`, False: in CasADi's virtual machine, to the same result;
    `Single()`: as machine code that computes in single precision, or `CompileError`.
    progress: shows a progress bar.
    energy_balance: False leaves out the account of the work of damping, contact and control, which takes time, where `energy_error` needs it.

    A run that diverges (state not finite, a bar off by 10 % of its length), that a scheme gives up or that is interrupted from the keyboard
    returns what it has up to there, with `success` False and the reason in `message`.
    Raises TypeError and ValueError naming the argument, CompileError.
    """
    instance("model", model, Model, "a tenscasadi.Model")
    check_scheme(scheme)
    if correction is not None:
        instance("correction", correction, (Projection, BarLengthCorrection), "Projection(every), BarLengthCorrection(weight) or None")
    for name, flag in {"compiled": compiled, "progress": progress, "energy_balance": energy_balance}.items():
        if not isinstance(flag, bool) and not (name == "compiled" and (flag is None or isinstance(flag, Single))):
            raise TypeError(f"{name} is {flag!r}: give True or False{', None or Single()' if name == 'compiled' else ''}")
    start = np.array(model.initial_state if state is None else finite_array("state", state, (model.nx,)))
    if step is None:
        step = positive_number("t_end", t_end) / 100 if scheme.adaptive else 1e-3
    n_steps = _count(positive_number("t_end", t_end), positive_number("step", step))
    if model.scene.has_clock:
        _check_clock(abs(start[-1]) + t_end, t_end / n_steps)
    inputs = signal(control, model.initial_control, float(t_end), n_steps)
    every = max(1, -(-inputs.steps // _ROWS)) if save_every is None else whole_number("save_every", save_every, 1)

    power = energy_balance and model.power is not None
    jumps = energy_balance and inputs.varies
    built = make_stepper(Task(model, scheme, correction, power, jumps), float(t_end) / inputs.steps, inputs.steps, compiled)
    run = _run(model, built.stepper, inputs, np.append(start, np.zeros(int(power or jumps))), float(t_end), every, progress)

    states, controls = run.rows[:, : model.nx], run.controls
    # Rows after a fault overflow: they are cut below.
    with np.errstate(all="ignore"):
        observed = observe(model, states, controls)
        energy = observed["energy"].sum(axis=1)
        supplied = run.rows[:, model.nx] if power or jumps else np.where(model.power is None and not inputs.varies, 0.0, np.nan)
        error = energy - energy[0] - supplied
    good, fault = first_fault(states, observed["bar_length_error"])
    if fault:
        why = cause(model, scheme, run.step, run.time[[0, good - 1]], states[[0, good - 1]], controls[[0, good - 1]])
        message = f"diverged between t = {run.time[good - 1]:g} and {run.time[good]:g} s: {fault}; {why}"
    elif run.failure:
        message = f"stopped after t = {run.time[-1]:g} s: {run.failure}"
    elif run.interrupted:
        message = f"interrupted from the keyboard, the last state kept is at t = {run.time[-1]:g} s"
    else:
        message = f"finished {run.report.text}" + doubts(model, scheme, run.step, (start, controls[0]), observed, error, compiled)
    told: tuple[Array, Array] | None = None
    if correction is not None:
        unknown = np.full(good, np.nan)
        told = (unknown, unknown) if scheme.adaptive else correction_effect(model, scheme, correction, states[:good], controls[:good], run.step)
    recorded = record(
        model,
        run.time[:good],
        states[:good],
        controls[:good],
        step=run.step,
        message=message + built.note,
        success=not (fault or run.failure or run.interrupted),
        energy_error=error[:good],
        correction=told,
        seconds=run.seconds,
        compiled=built.compiled,
    )
    return replace(recorded, attempts=run.report.attempts, interrupted=run.interrupted)


class _Run(NamedTuple):
    """What the loop left: rows (R, nz) and controls (R, nu) at `time` (R,)."""

    time: Array
    rows: Array
    controls: Array
    report: Report
    seconds: float
    interrupted: bool
    failure: str

    @property
    def step(self) -> float:
        """The length of a step, s, in the mean."""
        return self.report.step


def _count(t_end: float, step: float) -> int:
    """The fewest equal steps that cover t_end, each at most `step` but for rounding."""
    ratio = t_end / step
    if ratio > 1e12:
        raise ValueError(f"step is {step:g}: t_end = {t_end:g} would take {ratio:.1g} steps, give a larger step or a smaller t_end")
    nearest = round(ratio)
    return max(1, nearest if abs(ratio - nearest) <= 1e-9 * ratio else int(np.ceil(ratio)))


def _check_clock(latest: float, step: float) -> None:
    """Each step is added to the clock: what rounding takes off it, the loads' time loses."""
    if np.spacing(latest) > _CLOCK_LOSS * step:
        raise ValueError(f"state: the clock runs to {latest:g} s, where steps of {step:g} s drown in rounding: start it nearer to 0")


def _run(model: Model, stepper: Stepper, inputs: Signal, start: Array, t_end: float, every: int, progress: bool) -> _Run:
    """Calls `stepper` until the end of the run or its failure; keeps each `every`-th state and the last."""
    n, h = inputs.steps, t_end / inputs.steps
    z = start.copy()
    try:
        kept = np.append(np.arange(0, n, every), n)
        rows, controls = np.empty((len(kept), len(z))), np.empty((len(kept), model.nu))
    except MemoryError:
        raise ValueError(f"save_every is {every}: {n / every:.2g} rows do not fit into memory, give a larger save_every or a larger step") from None
    u = inputs.window(0, 1)
    rows[0], controls[0], count, interrupted = z, u[0], 1, False
    failure, pressed = "", []  # CasADi's integrators make a failure of the KeyboardInterrupt that Ctrl-C raises
    began = looked = time.perf_counter()
    try:
        with on_interrupt(lambda: pressed.append(True), then_raise=True), tqdm(total=n, unit=" steps", unit_scale=True, disable=not progress) as bar:
            for first in range(0, n, stepper.steps):
                if inputs.varies or first == 0:
                    u = np.concatenate([u[-1:], inputs.window(first + 1, stepper.steps)])
                    stepper.hold(u)
                after = stepper(z)
                z = after[-1].copy()
                end = int(np.searchsorted(kept, first + stepper.steps, side="right"))
                local = kept[count:end] - first
                rows[count:end], controls[count:end] = after[local - 1], u[local]
                count = end
                bar.update(min(stepper.steps, n - first))
                if not np.all(np.isfinite(z)):
                    if count < len(kept):  # what is not finite stays so up to the next row
                        rows[count], controls[count], count = z, u[-1], count + 1
                    break
                if time.perf_counter() - looked > _LOOK_SECONDS:
                    looked = time.perf_counter()
                    newest = rows[[0, count - 1], : model.nx]
                    if first_fault(newest, observe(model, newest, controls[[0, count - 1]])["bar_length_error"])[1]:
                        break
    except StepFailure as error:
        interrupted = bool(pressed)
        failure = "" if pressed else str(error)
    except KeyboardInterrupt:
        interrupted = True
    report = stepper.report(int(kept[count - 1]), h)
    times = kept[:count] * h
    if count == len(kept):
        times[-1] = t_end
    return _Run(times, rows[:count], controls[:count], report, time.perf_counter() - began, interrupted, failure)
