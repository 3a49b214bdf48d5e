"""Simulation: a model, a scheme and a control become a trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from tenscasadi.correction import BarLengthCorrection, Correction, Projection, projection
from tenscasadi.correction_effect import correction_effect
from tenscasadi.loop import Report, StepFailure
from tenscasadi.model import Model
from tenscasadi.precision import Compiled, Single
from tenscasadi.record import observe, record
from tenscasadi.runners import Runner, Task, make_runner, own_steps
from tenscasadi.schemes import RungeKutta4, Scheme, check_scheme
from tenscasadi.signals import ControlInput, Signal, signal
from tenscasadi.stability import fastest_rate, stable_step
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array, finite_array, instance, positive_number, whole_number

_ROWS = 1000  # rows kept when save_every is None
_BROKEN_BARS = 0.1  # relative length error at which a run has diverged
_BEYOND = 1e12  # entries of a state above this are not physical in any unit
_LOST_ENERGY = 0.05  # share of the energy that moves at which the message speaks of it
_LOOK_SECONDS = 0.5  # wall time between checks of the bar lengths


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
    for schemes that control their error).
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
        step = positive_number("t_end", t_end) / 100 if own_steps(scheme) else 1e-3
    n_steps = _count(positive_number("t_end", t_end), positive_number("step", step))
    inputs = signal(control, model.initial_control, float(t_end), n_steps)
    every = max(1, -(-inputs.steps // _ROWS)) if save_every is None else whole_number("save_every", save_every, 1)

    power = energy_balance and model.power is not None
    jumps = energy_balance and inputs.varies
    built = make_runner(Task(model, scheme, correction, power, jumps), float(t_end) / inputs.steps, inputs.steps, compiled)
    run = _run(model, built.runner, inputs, np.append(start, np.zeros(int(power or jumps))), float(t_end), every, progress)

    states, controls = run.rows[:, : model.nx], run.controls
    # Rows after a fault overflow: they are cut below.
    with np.errstate(all="ignore"):
        observed = observe(model, states, controls)
        parts = observed["energy"]
        energy = parts.sum(axis=1)
        supplied = run.rows[:, model.nx] if power or jumps else np.where(model.power is None and not inputs.varies, 0.0, np.nan)
        error = energy - energy[0] - supplied
    good, fault = _first_fault(states, observed["bar_length_error"])
    if fault:
        message = f"diverged between t = {run.time[good - 1]:g} and {run.time[good]:g} s: {fault}; {_cause(model, scheme, run, good - 1)}"
    elif run.failure:
        message = f"stopped after t = {run.time[-1]:g} s: {run.failure}"
    elif run.interrupted:
        message = f"interrupted from the keyboard, the last state kept is at t = {run.time[-1]:g} s"
    else:
        message = f"finished {run.report.text}" + _energy_note(parts, error, observed["tension"], observed["nodes"])
    told: tuple[Array, Array] | None = None
    if correction is not None:
        unknown = np.full(good, np.nan)
        told = (unknown, unknown) if own_steps(scheme) else correction_effect(model, scheme, correction, states[:good], controls[:good], run.step)
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


def _run(model: Model, runner: Runner, inputs: Signal, start: Array, t_end: float, every: int, progress: bool) -> _Run:
    """Calls `runner` until the end of the run or its failure; keeps each `every`-th state and the last."""
    n, h = inputs.steps, t_end / inputs.steps
    kept = np.append(np.arange(0, n, every), n)
    z = start.copy()
    rows, controls = np.empty((len(kept), len(z))), np.empty((len(kept), model.nu))
    u = inputs.window(0, 1)
    rows[0], controls[0], count, interrupted = z, u[0], 1, False
    failure = ""
    began = looked = time.perf_counter()
    try:
        with tqdm(total=n, unit=" steps", unit_scale=True, disable=not progress) as bar:
            for first in range(0, n, runner.steps):
                if inputs.varies or first == 0:
                    u = np.concatenate([u[-1:], inputs.window(first + 1, runner.steps)])
                    runner.hold(u)
                after = runner(z)
                z = after[-1].copy()
                end = int(np.searchsorted(kept, first + runner.steps, side="right"))
                local = kept[count:end] - first
                rows[count:end], controls[count:end] = after[local - 1], u[local]
                count = end
                bar.update(min(runner.steps, n - first))
                if not np.all(np.isfinite(z)):
                    break
                if time.perf_counter() - looked > _LOOK_SECONDS:
                    looked = time.perf_counter()
                    newest = rows[[0, count - 1], : model.nx]
                    if _first_fault(newest, observe(model, newest, controls[[0, count - 1]])["bar_length_error"])[1]:
                        break
    except StepFailure as error:
        failure = str(error)
    except KeyboardInterrupt:
        interrupted = True
    report = runner.report(int(kept[count - 1]), h)
    times = kept[:count] * h
    if count == len(kept):
        times[-1] = t_end
    return _Run(times, rows[:count], controls[:count], report, time.perf_counter() - began, interrupted, failure)


def _first_fault(states: Array, bar_length_error: Array) -> tuple[int, str]:
    """How many rows are good, and what is wrong with the next; "" when all are good."""
    faults = {
        "the state is not finite": ~np.all(np.isfinite(states), axis=1),
        "the state is beyond any physical size": np.any(np.abs(states) > _BEYOND, axis=1),
        f"a bar is off by more than {_BROKEN_BARS:.0%} of its length": bar_length_error[:, 0] > _BROKEN_BARS + bar_length_error[0, 0],
    }
    bad = np.any(list(faults.values()), axis=0)
    bad[0] = False  # the start is the caller's
    if not bad.any():
        return len(states), ""
    row = int(np.argmax(bad))
    return row, next(name for name, where in faults.items() if where[row])


def _cause(model: Model, scheme: Scheme, run: _Run, last: int) -> str:
    """Why a run diverged, as far as the start and the linearised motion tell, and what to do."""
    start = run.rows[0, : model.nx]
    moved = float(np.abs(projection(model)(start).full().ravel() - start).max(initial=0.0))
    if moved > 1e-6 * np.abs(start).max(initial=0.0):
        return f"the start is off the lengths of its bars or its joints, or about to leave them, by {moved:.2g}: start from projection(model)(state)"
    if own_steps(scheme):
        return f"the error of each step was kept, so the motion itself breaks down or was not resolved: try a smaller {type(scheme).__name__}(rtol)"
    limits = []
    for row in (0, last):  # the start first: a state that is about to break has limits of its own
        x, u = run.rows[row, : model.nx], run.controls[row]
        limits.append(stable_step(model, x, u, scheme, safety=1.0))
        if run.step > limits[-1]:
            return (
                f"the step {run.step:g} s is above the stability limit {limits[-1]:.3g} s of {type(scheme).__name__} at t = {run.time[row]:g} s "
                f"(fastest rate ω_max = {fastest_rate(model, x, u):.4g} rad/s): try step={0.9 * limits[-1]:.2g}"
            )
    return (
        f"the step {run.step:g} s is below the stability limit {min(limits):.3g} s of the linearised motion, so accuracy was lost elsewhere "
        f"(fast rotation, impact, bars drifting from their length): try step={run.step / 5:.2g} or correction=Projection()"
    )


def _energy_note(parts: Array, error: Array, tension: Array, nodes: Array) -> str:
    """Says so when the energy balance shows that the motion is not to be trusted, as when a correction hides what the step destroys."""
    scale = float(parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum())
    rounding = 1e-9 * float(np.abs(parts).max() + tension.sum(axis=1).max() * np.ptp(nodes))
    largest = float(np.abs(error).max())
    if not largest > max(_LOST_ENERGY * scale, rounding):  # NaN: not known
        return ""
    return f"; energy is off by {largest:.2g} J where {scale:.2g} J move: try a smaller step"
