"""Simulation: a model, a scheme and a control become a trajectory."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import (
    BarLengthCorrection,
    Correction,
    Projection,
    measure_correction,
)
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.control_input import (
    ControlInput,
    ControlProfile,
    SampledControl,
    append_constants,
    sample_control,
)
from tenscasadi.simulation.diagnosis import describe_doubts, explain_divergence, first_fault
from tenscasadi.simulation.missed_events import describe_missed_events
from tenscasadi.simulation.steppers import (
    OutOfTime,
    Report,
    StepFailure,
    Stepper,
    Task,
    make_stepper,
)
from tenscasadi.simulation.time_grid import cut_at_changes
from tenscasadi.simulation.trajectory import (
    Trajectory,
    first_rows,
    observe_states,
    record_trajectory,
)
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.interrupts import on_interrupt
from tenscasadi.util.validate import (
    Array,
    Indices,
    finite_array,
    instance,
    positive_number,
    whole_number,
)

_ROWS = 1000  # rows kept when save_every is None
_LOOK_SECONDS = 0.5  # wall time between checks of the bar lengths
_CLOCK_LOSS = 1e-6  # share of a step that rounding may take off the clock


def simulate(  # noqa: PLR0913  the options of a run
    model: Model,
    t_end: float,
    step: float | None = None,
    scheme: Scheme = RungeKutta4(),
    state: Any = None,
    control: ControlInput | ControlProfile = None,
    correction: Correction | None = None,
    save_every: int | None = None,
    compiled: Compiled = None,
    progress: bool = False,
    *,
    energy_balance: bool = True,
    seconds: float | None = None,
    parameters: Any = None,
) -> Trajectory:
    """Simulate the motion of a model from time 0 on.

    Parameters
    ----------
    model : Model
        The model to simulate.
    t_end : float
        End of the run, s.
    step : float, optional
        Largest step, s. The run takes equal steps, the fewest that end exactly at `t_end`; they are
        cut where a table over time has its times and where a function of time jumps or has a pulse
        that a step would not see. Schemes that control their error take any number of steps of
        their own within each of these. Default: 1 ms, or a hundredth of `t_end` for schemes that
        control their error.
    scheme : Scheme, optional
        Integration scheme, such as `RungeKutta4` (default), `Rattle`, `DormandPrince853` or
        `Cvodes`.
    state : array_like, shape (nx,), optional
        State at the start. Default: `model.initial_state`.
    control : array_like or callable, optional
        Control: an array (nu,) is constant, an array (K, nu) is constant on each of K equal parts
        of [0, t_end] (steps are shortened to fit the parts). A function t -> (nu,) is called with
        the time at the start of each step, and its value is held during the step. Default:
        `model.initial_control`.
    correction : Projection or BarLengthCorrection, optional
        Correction applied after every `correction.every`-th step, of the scheme's own where it
        controls its error. Default: none.
    save_every : int, optional
        Steps from one kept row to the next; the first and the last state are always kept. Default:
        what keeps about 1000 rows or fewer.
    compiled : bool or Single, optional
        True: run as machine code. False: run in CasADi's virtual machine, to the same result.
        `Single()`: run as machine code that computes in single precision. Default: as machine code
        where there is a C compiler.
    progress : bool, optional
        Whether to show a progress bar.
    energy_balance : bool, optional
        False leaves out the account of the work of damping, contact and control, which takes time;
        `energy_error` is then NaN where it needs that account.
    seconds : float, optional
        Wall time after which the run stops, s, as by Ctrl-C: `success` is False, and what it has is
        kept. It is looked at after each piece of steps that is computed at once; compiling comes on
        top. Default: no limit.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters (`Scene.parameters`), or of some by name, see
        `ParameterLayout.values`. One compiled loop serves all values. Default: nominal.

    Returns
    -------
    Trajectory
        The motion at the kept times, with its errors. A run that diverges (the state is not finite,
        a bar is off by 10 % of its length), that its scheme gives up or that is interrupted from
        the keyboard ends early: `success` is False, and `message` says why. So it is for a run that
        reached its end but cannot be trusted: its start is off the bars and joints by more than a
        fifth of their lengths and speeds, its steps are above the stability limit for long enough
        to make a vibration grow tenfold, or a function of time changes faster than 20 000 further
        steps would see.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or a function of time is not finite or moves supports by a jump; the
        message names it.
    CompileError
        Machine code was asked for and cannot be made.

    See Also
    --------
    tradeoff : Measure how fast and how accurate schemes and steps are.
    stable_step : Find the largest stable step.

    Notes
    -----
    The loop over the steps runs inside a CasADi Function, many steps a call. What a correction
    changes is measured and returned as `correction_shift` and `correction_energy`, except for
    schemes that control their error.

    Examples
    --------
    A pendulum is released at 45° and swings for half a second; its energy is kept:

    >>> import tenscasadi as tc
    >>> pendulum = tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity((0.0, 0.0, -9.81)))
    >>> run = tc.simulate(tc.Model(pendulum), t_end=0.5, step=0.005, compiled=False)
    >>> run.message
    'finished 100 steps of 0.005 s'
    >>> run.nodes.shape
    (101, 2, 3)
    >>> bool(abs(run.energy_error).max() < 1e-6)
    True
    """
    _check_options(model, scheme, correction, compiled, progress, energy_balance)
    p = model.parameters.values(parameters)
    start = np.array(
        model.start_at(p) if state is None else finite_array("state", state, (model.nx,))
    )
    inputs = lay_run(model, start, t_end, step, scheme, control, p)
    every = (
        max(1, -(-inputs.steps // _ROWS))
        if save_every is None
        else whole_number("save_every", save_every, 1)
    )
    limit = np.inf if seconds is None else positive_number("seconds", seconds)
    power, jumps = energy_balance and model.power is not None, energy_balance and inputs.varies
    built = make_stepper(Task(model, scheme, correction, power, jumps), inputs, compiled)
    run = _run(
        model,
        built.stepper,
        inputs,
        np.append(start, np.zeros(int(power or jumps))),
        every,
        progress,
        limit,
    )
    with np.errstate(all="ignore"):  # rows after a fault overflow: they are cut below
        supplied = (
            run.rows[:, model.nx]
            if power or jumps
            else np.nan
            if inputs.varies or model.power is not None
            else 0.0
        )
        recorded = record_trajectory(
            model,
            run.time,
            run.rows[:, : model.nx],
            run.controls,
            step=run.report.step,
            message="",
            supplied=supplied,
            seconds=run.seconds,
        )
    good, success, message = _judge(model, scheme, run, recorded, compiled, inputs.unseen)
    if success and "try" not in message:
        message += describe_missed_events(model, built.stepper, inputs, run.rows, recorded)
    kept = first_rows(recorded, good)
    if correction is not None:
        unknown = scheme.adaptive or inputs.ends is not None
        shift, added = (
            np.full((2, good), np.nan)
            if unknown
            else measure_correction(
                model, scheme, correction, kept.states, run.controls[:good], kept.step
            )
        )
        kept = replace(kept, correction_shift=shift, correction_energy=added)
    attempts, interrupted = run.report.attempts, run.interrupted
    return replace(
        kept,
        success=success,
        message=message + built.note,
        compiled=built.compiled,
        attempts=attempts,
        interrupted=interrupted,
    )


def _check_options(
    model: Any, scheme: Any, correction: Any, compiled: Any, progress: Any, energy_balance: Any
) -> None:
    instance("model", model, Model, "a tenscasadi.Model")
    check_scheme(scheme)
    if correction is not None:
        instance(
            "correction",
            correction,
            (Projection, BarLengthCorrection),
            "Projection(every), BarLengthCorrection(weight) or None",
        )
    if compiled is not None:
        instance("compiled", compiled, (bool, Single), "True or False, None or Single()")
    for name, flag in {"progress": progress, "energy_balance": energy_balance}.items():
        instance(name, flag, bool, "True or False")


def lay_run(
    model: Model,
    start: Array,
    t_end: float,
    step: float | None,
    scheme: Scheme,
    control: ControlInput | ControlProfile,
    p: Array,
) -> SampledControl:
    """Choose the steps of a run and sample the control at each, with the parameters p below it."""
    end = positive_number("t_end", t_end)
    if step is None:
        step = end / 100 if scheme.adaptive else 1e-3
    positive = isinstance(model.scene.control, RestLength)

    def sample(end: float, steps: int) -> SampledControl:
        inputs = sample_control(control, model.control_at(p), end, steps, positive)
        return append_constants(inputs, p) if model.np else inputs

    return lay_grid(
        model,
        float(start[-1]) if model.scene.has_clock else 0.0,
        end,
        positive_number("step", step),
        sample,
        scheme.adaptive,
    )


def lay_grid(
    model: Model,
    first: float,
    end: float,
    step: float,
    sample: Callable[[float, int], SampledControl],
    adaptive: bool = False,
) -> SampledControl:
    """Lay steps over `end` s from the time `first` on, s, with what `sample` (end, steps) says of the control, and check what depends on time.

    adaptive: see `cut_at_changes`. Raises ValueError.
    """
    n_steps = _count(end, step)
    if model.scene.has_clock:
        _check_clock(abs(first) + end, end / n_steps)
    return cut_at_changes(model.scene.over_time, sample(end, n_steps), first, adaptive)


def _judge(
    model: Model, scheme: Scheme, run: _Run, recorded: Trajectory, compiled: Compiled, unseen: str
) -> tuple[int, bool, str]:
    """Count the good rows; tell whether the run reached its end, and how it ended; unseen: see `SampledControl`."""
    time = run.time
    good, fault = first_fault(recorded.states, recorded.bar_length_error)
    if fault:
        why = explain_divergence(model, scheme, recorded, good - 1)
        return (
            good,
            False,
            f"diverged between t = {time[good - 1]:g} and {time[good]:g} s: {fault}; {why}",
        )
    if run.failure:
        return good, False, f"stopped after t = {time[-1]:g} s: {run.failure}"
    if run.interrupted:
        return (
            good,
            False,
            f"interrupted from the keyboard, the last state kept is at t = {time[-1]:g} s",
        )
    doubts, trusted = describe_doubts(model, scheme, recorded, compiled)
    return good, trusted and not unseen, f"finished {run.report.text}{unseen}{doubts}"


class _Run(NamedTuple):
    """Rows (R, nz) and controls (R, nu) at `time` (R,), as the time loop left them."""

    time: Array
    rows: Array
    controls: Array
    report: Report
    seconds: float
    interrupted: bool
    failure: str


def _count(t_end: float, step: float) -> int:
    """Count the fewest equal steps that cover t_end, each at most `step` but for rounding."""
    ratio = t_end / step
    if ratio > 1e12:
        raise ValueError(
            f"step is {step:g}: t_end = {t_end:g} would take {ratio:.1g} steps, give a larger step or a smaller t_end"
        )
    nearest = round(ratio)
    return max(1, nearest if abs(ratio - nearest) <= 1e-9 * ratio else int(np.ceil(ratio)))


def _check_clock(latest: float, step: float) -> None:
    """Each step is added to the clock: what rounding takes off it, the loads' time loses."""
    if np.spacing(latest) > _CLOCK_LOSS * step:
        raise ValueError(
            f"state: the clock runs to {latest:g} s, where steps of {step:g} s drown in rounding: start it nearer to 0"
        )


def _run(
    model: Model,
    stepper: Stepper,
    inputs: SampledControl,
    start: Array,
    every: int,
    progress: bool,
    seconds: float,
) -> _Run:
    """Call `stepper` until the end of the run, its failure or so many seconds are over; keep each `every`-th state and the last."""
    kept, rows, controls = _rows_to_keep(inputs.steps, every, len(start), model.nw)
    z, u = start, inputs.window(0, 1)
    rows[0], controls[0], count, reached = z, u[0], 1, (0, z, u[0])
    interrupted, failure = False, ""
    pressed: list[
        bool
    ] = []  # CasADi's integrators make a failure of the KeyboardInterrupt that Ctrl-C raises
    began = looked = time.perf_counter()
    stepper.deadline = began + seconds

    def press() -> None:
        pressed.append(True)
        stepper.deadline = began  # what is tried again after a failure stops, too

    try:
        with (
            on_interrupt(press, then_raise=True),
            tqdm(total=inputs.steps, unit=" steps", unit_scale=True, disable=not progress) as bar,
        ):
            for first in range(0, inputs.steps, stepper.steps):
                if inputs.varies or inputs.ends is not None or first == 0:
                    u = np.concatenate([u[-1:], inputs.window(first + 1, stepper.steps)])
                    stepper.hold(u, inputs.lengths(first, stepper.steps))
                taken = min(stepper.steps, inputs.steps - first)
                after = stepper(z, taken)
                reached = first + taken, after[taken - 1].copy(), u[taken]
                z = reached[1]
                end = int(np.searchsorted(kept, first + stepper.steps, side="right"))
                local = kept[count:end] - first
                rows[count:end], controls[count:end] = after[local - 1], u[local]
                count = end
                bar.update(taken)
                if not np.all(np.isfinite(z)):
                    if count < len(kept):  # what is not finite stays so up to the next row
                        rows[count], controls[count], count = z, u[-1], count + 1
                    break
                if time.perf_counter() > stepper.deadline and first + taken < inputs.steps:
                    raise OutOfTime
                if time.perf_counter() - looked > _LOOK_SECONDS:
                    looked = time.perf_counter()
                    newest = rows[[0, count - 1], : model.nx]
                    if first_fault(
                        newest,
                        observe_states(model, newest, controls[[0, count - 1]])["bar_length_error"][
                            :, 0
                        ],
                    )[1]:
                        break
    except OutOfTime:
        told = f"seconds = {seconds:g} of wall time are over: give more, or a scheme and step that take less"
        interrupted, failure = bool(pressed), "" if pressed else told
    except StepFailure as error:
        interrupted, failure = bool(pressed), "" if pressed else str(error)
    except KeyboardInterrupt:
        interrupted = True
    if (failure or interrupted) and kept[count - 1] < reached[0]:
        (kept[count], rows[count], controls[count]), count = reached, count + 1
    report = stepper.report(int(kept[count - 1]), inputs.step)
    return _Run(
        inputs.times(kept[:count]),
        rows[:count],
        controls[:count],
        report,
        time.perf_counter() - began,
        interrupted,
        failure,
    )


def _rows_to_keep(steps: int, every: int, nz: int, nu: int) -> tuple[Indices, Array, Array]:
    """Choose the steps after which a row is kept, and reserve memory for states and controls there."""
    try:
        kept = np.append(np.arange(0, steps, every), steps)
        return kept, np.empty((len(kept), nz)), np.empty((len(kept), nu))
    except MemoryError:
        raise ValueError(
            f"save_every is {every}: {steps / every:.2g} rows do not fit into memory, give a larger save_every or a larger step"
        ) from None
