"""Simulation of a model to a trajectory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.operating_point import split_point
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction, check_correction
from tenscasadi.simulation.control_input import ControlInput, ControlProfile
from tenscasadi.simulation.engine.engine import Request, roll
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.time_grid import lay_run
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.simulation.verdict import conclude
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.validate import (
    finite_array,
    instance,
    positive_number,
    whole_number,
)


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
    verify: bool = True,
) -> Trajectory:
    """Simulate the motion of a model from time 0 on.

    Parameters
    ----------
    model : Model
        The model to simulate.
    t_end : float
        End of the run [s].
    step : float, optional
        Largest step [s]. The run takes the fewest equal steps that end exactly at `t_end`. They are
        cut at the times of tables, at the `breakpoints` of functions of time, and where conditions
        in these switch. Schemes with error control subdivide each step as needed. Default: 1 ms, or
        a hundredth of `t_end` for schemes with error control.
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
    seconds : float, optional
        Wall time after which the run stops [s], without compilation. As after Ctrl-C, `success` is
        False and the rows so far are returned. Default: no limit.
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
        Motion at the saved times with its errors. A run ends early if it diverges, its scheme
        fails or Ctrl-C stops it. It diverges if the state is not finite or a bar is off by 10 % of
        its length. `success` is then False and `message` gives the reason. The same holds for
        finished runs that are not trustworthy, for one of three reasons. The start violates bars
        and joints by more than a fifth of lengths and speeds. Unstable steps make a vibration grow
        tenfold. The stages do not resolve a function of time.

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
    with error control.

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
    _check_options(model, scheme, correction, compiled, **flags)
    state, control, parameters = split_point(model, state, control, parameters)
    p = model.parameters.values(parameters)
    start = np.array(
        model.start_at(p) if state is None else finite_array("state", state, (model.nx,))
    )
    laid = lay_run(model, start, t_end, step, scheme, control, p)
    inputs = laid.inputs
    every = (
        max(1, -(-inputs.steps // 1000))
        if save_every is None
        else whole_number("save_every", save_every, 1)
    )
    limit = np.inf if seconds is None else positive_number("seconds", seconds)
    driven = laid.model
    account = Account(energy_balance and driven.power is not None, energy_balance and inputs.varies)
    request = Request(driven, scheme, correction, laid.start, inputs, every, account, compiled)
    run = roll(request, limit, progress)
    supplied: Any = run.supplied if any(account) else 0.0
    if not any(account) and (inputs.varies or driven.power is not None):
        supplied = np.nan
    recorded = record_trajectory(
        model,
        run.time,
        run.states[:, : model.nx],
        laid.controls(run.time, run.controls),
        step=run.step,
        message="",
        supplied=supplied,
        seconds=run.seconds,
        observed=run.observed,
    )
    energy = run.energy
    if driven.schedule is not None:  # the schedule also supplies energy of strings
        energy = recorded.energy_parts[:, 0]
    recorded = replace(
        recorded,
        energy_error=energy - energy[0] - supplied,
        correction_shift=run.corrected[:, 0],
        correction_energy=run.corrected[:, 1],
        compiled=run.compiled,
        attempts=run.attempts,
        interrupted=run.interrupted,
    )
    return conclude(model, request, run, recorded, verify)


def _check_options(model: Any, scheme: Any, correction: Any, compiled: Any, **flags: Any) -> None:
    instance("model", model, Model, "a tenscasadi.Model")
    check_scheme(scheme)
    check_correction(correction)
    if compiled is not None:
        instance("compiled", compiled, (bool, Single), "True or False, None or Single()")
    for name, flag in flags.items():
        instance(name, flag, bool, "True or False")
