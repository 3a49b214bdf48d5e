"""Simulation of a model to a trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.operating_point import split_point
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction, check_correction
from tenscasadi.simulation.engine.roll import Request, Runs, roll
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.inputs.controls import ControlInput, ControlProfile
from tenscasadi.simulation.inputs.run_inputs import read_inputs
from tenscasadi.simulation.trajectory import (
    Trajectory,
    name_measures,
    observe_states,
    record_trajectory,
)
from tenscasadi.simulation.verdict.endings import describe_steps
from tenscasadi.simulation.verdict.judge import Verdict, judge
from tenscasadi.simulation.verdict.step_error import estimate_errors
from tenscasadi.structure.names import add_names, name_errors
from tenscasadi.util.compile import Compiled, Single, read_compiled
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import flag, positive_number, whole_number

MAX_REFINEMENT = 8  # × default steps: limits the wall time, as errors of a chaotic motion remain


@rename_keywords(seconds="time_limit")
@name_errors
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
    time_limit: float | None = None,
    parameters: Any = None,
    verify: bool = True,
) -> Trajectory:
    """Simulate the motion of a model from time 0.

    Parameters
    ----------
    model : Model
        The model to simulate.
    t_end : float
        End of the run [s].
    step : float, optional
        Largest step [s]. The run takes the fewest equal steps that end exactly at `t_end`. Steps
        also end at the times of tables, at the `breakpoints` of functions of time, and where
        conditions in these switch. Schemes with error control subdivide each step as needed.
        Default: 1 ms, or less if stability or contact requires it; a hundredth of `t_end` for
        schemes with error control. If `verify` finds an error of more than 1 % of the motion,
        default steps are refined once, up to eightfold.
    scheme : Scheme, optional
        Integration scheme, such as `RungeKutta4` (default), `Rattle`, `DormandPrince853` or
        `Cvodes`.
    state : array_like, shape (nx,), or Equilibrium, optional
        State at the start; an equilibrium also provides the default control and parameters.
        Default: `model.initial_state`.
    control : array_like or callable, optional
        Control. An array (nu,) is constant. An array (K, nu) is constant on each of K equal parts
        of [0, t_end]; steps are shortened to fit. Each stage of a step evaluates a function
        t -> (nu,) of the time since the start, see `ControlFunction`. Default:
        `model.initial_control`.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step. Schemes with error control count their
        own steps. Default: none.
    save_every : int, optional
        Number of steps between saved rows; the first and the last state are always saved. Default:
        at most about 1000 rows.
    compiled : bool or Single, optional
        True: machine code. False: CasADi's virtual machine, with the same result. `Single()`:
        machine code in single precision. Default: machine code if there is a C compiler.
    progress : bool, optional
        Whether to show a progress bar.
    energy_balance : bool, optional
        Whether to integrate the work of damping, contact and control, which takes time. Without it,
        `energy_error` is NaN where it depends on that work.
    time_limit : float, optional
        Wall time after which the run stops [s]. As after Ctrl-C, `success` is False and the rows so
        far are returned. Default: no limit.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters (`Scene.parameters`), or of some by name, see
        `ParameterLayout.values`. One compiled loop serves all values. Default: nominal.
    verify : bool, optional
        Whether to repeat a finished run with steps twice and four times as long, or a looser
        tolerance. If the motions differ too much, it is repeated with finer steps.
        `error_estimate` and `message` report the step-size error.

    Returns
    -------
    Trajectory
        Motion at the saved times with its errors. A run ends early if it diverges, its scheme fails
        or Ctrl-C stops it. It diverges if the state is not finite or the error of a bar length
        exceeds 10 %. `success` is then False and `message` gives the reason. The same holds for
        finished runs that are not trustworthy, for one of four reasons. The start violates bars and
        joints by more than a fifth of lengths and speeds. The step-size error exceeds a tenth of
        the motion. The energy error exceeds half of the exchanged energy. The stages of fixed steps
        do not resolve a function of time.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or a function of time is not finite or moves supports by a jump; the
        message names it.
    CompileError
        `compiled` is True and compilation fails.

    See Also
    --------
    tradeoff : Measure how fast and how accurate schemes and steps are.
    stable_step : Find the largest stable step.

    Notes
    -----
    The integration loop is compiled once for all models and calls the machine code of the model.
    `correction_shift` and `correction_energy` report the effect of corrections, except for schemes
    with error control. The error estimate adds 20 to 50 % to the time of a repeated call with fixed
    Runge-Kutta steps, and about 200 % with error control.

    Examples
    --------
    A pendulum is released at 45° and swings for half a second. Its energy is conserved:

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
    flags = {"progress": progress, "energy_balance": energy_balance, "verify": verify}
    compiled = check_options(model, scheme, correction, compiled, **flags)
    state, control, parameters = split_point(model, state, control, parameters)
    limit = np.inf if time_limit is None else positive_number("time_limit", time_limit)
    inputs = read_inputs(model, t_end, step, scheme, state, control, parameters, many=False)
    steps, varies = inputs.grid.steps, inputs.controls.shape[1] > 1
    request = Request(
        inputs,
        scheme,
        correction,
        max(1, -(-steps // 1000))
        if save_every is None
        else whole_number("save_every", save_every, 1),
        Account(energy_balance and inputs.model.power is not None, energy_balance and varies),
        "all",
        compiled,
        lanes=1,
        time_limit=limit,
        deadline=time.monotonic() + limit,
        compare=verify,
    )
    runs = roll(request, progress)
    verdict = judge(runs, estimate_errors(runs) if verify else None)
    if step is None and not scheme.adaptive and verdict.finer[0] > 1:
        parts = min(int(np.ceil(verdict.finer[0])), MAX_REFINEMENT)
        runs = roll(_divide_steps(request, parts), progress)
        verdict = judge(runs, estimate_errors(runs) if verify else None)
    return record_run(model, runs, verdict)


def _divide_steps(request: Request, parts: int) -> Request:
    """Divide the steps of a request into equal parts.

    The saved rows keep their times.
    """
    grid = replace(request.inputs.grid, counts=request.inputs.grid.counts * parts)
    return request._replace(inputs=request.inputs._replace(grid=grid), every=request.every * parts)


def check_options(
    model: Any, scheme: Any, correction: Any, compiled: Any, **flags: Any
) -> Compiled:
    """Check the options of runs, and return `compiled`.

    `flags` are options by name that must be True or False. Raises TypeError.
    """
    check_model(model)
    check_scheme(scheme)
    check_correction(correction)
    for name, value in flags.items():
        flag(name, value)
    return read_compiled("compiled", compiled)


def record_run(model: Model, runs: Runs, verdict: Verdict) -> Trajectory:
    """Convert a computed run to a trajectory with its acceptance test.

    `verdict` is the result of this test.
    """
    request, rolled, steps = runs.request, runs.rolled, runs.saved_steps(0)
    inputs, scheme, count = request.inputs, request.scheme, len(steps)
    given, model = model, inputs.base
    time_, states = runs.times(steps), runs.saved[0, :count, : model.nx]
    held = inputs.add_schedule(inputs.stack(0, steps), time_)
    measured = runs.measured[0, :count]
    if isinstance(request.compiled, Single):  # measures in double precision
        observed = observe_states(model, states, held)
    else:
        observed = name_measures(model, states, measured[:, :-1])
    parts = observed["energy"]
    if inputs.model.schedule is not None:  # the work includes that of strings and gravity
        parts = parts[:, :1]
    energy = parts.sum(axis=1)
    corrected = np.zeros((count, 2)) if rolled.corrected is None else rolled.corrected[0, :count]
    if request.correction is not None and scheme.adaptive:
        corrected = np.full((count, 2), np.nan)
    taken = describe_steps(runs, 0)
    single = "; in single precision" if isinstance(request.compiled, Single) else ""
    note = runs.kernel.note and f"; {runs.kernel.note}"
    return record_trajectory(
        model,
        time_,
        states,
        held,
        step=taken.step,
        message=add_names(verdict.message[0], model.structure) + (single or note),
        success=bool(verdict.success[0]),
        energy_error=energy - energy[0] - (measured[:, -1] if request.balanced else np.nan),
        seconds=runs.seconds,
        observed=observed,
        correction_shift=corrected[:, 0],
        correction_energy=corrected[:, 1],
        scene=given.scene,
        compiled=runs.kernel.lanes > 0,
        attempts=taken.computed,
        interrupted=runs.stopped and not runs.late,
        error_estimate=float(verdict.error[0]),
    )
