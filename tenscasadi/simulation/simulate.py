"""Simulation of a model to a trajectory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import BarLengthCorrection, Correction, Projection
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

_ROWS = 1000  # rows kept when save_every is None


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
        End of the run, s.
    step : float, optional
        Largest step, s. The run takes equal steps, the fewest that end exactly at `t_end`; they are
        cut at the times of tables, at the `breakpoints` of functions of time, and where conditions
        in these switch. Schemes that control their error take any number of steps of
        their own within each of these. Default: 1 ms, or a hundredth of `t_end` for schemes that
        control their error.
    scheme : Scheme, optional
        Integration scheme, such as `RungeKutta4` (default), `Rattle`, `DormandPrince853` or
        `Cvodes`.
    state : array_like, shape (nx,), optional
        State at the start. Default: `model.initial_state`.
    control : array_like or callable, optional
        Control: an array (nu,) is constant, an array (K, nu) is constant on each of K equal parts
        of [0, t_end] (steps are shortened to fit the parts). A function t -> (nu,) of the time
        since the start is evaluated by each stage of a step, as `ControlFunction` describes.
        Default: `model.initial_control`.
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
        kept. Compiling comes on top. Default: no limit.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters (`Scene.parameters`), or of some by name, see
        `ParameterLayout.values`. One compiled loop serves all values. Default: nominal.
    verify : bool, optional
        Whether to take a run that finished again, in steps twice and four times as long or at a
        looser tolerance, and where these do not follow it in finer ones: `error_estimate` and
        `message` tell how far its steps put it off.

    Returns
    -------
    Trajectory
        The motion at the kept times, with its errors. A run that diverges (the state is not finite,
        a bar is off by 10 % of its length), that its scheme gives up or that is interrupted from
        the keyboard ends early: `success` is False, and `message` says why. So it is for a run that
        reached its end but cannot be trusted: its start is off the bars and joints by more than a
        fifth of their lengths and speeds, its steps are above the stability limit for long enough
        to make a vibration grow tenfold, or a function of time changes within steps more than their
        stages see.

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
    The loop over the steps is compiled once for all models, and calls the model's own machine code.
    What a correction changes is returned as `correction_shift` and `correction_energy`, except for
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
    flags = {"progress": progress, "energy_balance": energy_balance, "verify": verify}
    _check_options(model, scheme, correction, compiled, **flags)
    p = model.parameters.values(parameters)
    start = np.array(
        model.start_at(p) if state is None else finite_array("state", state, (model.nx,))
    )
    laid = lay_run(model, start, t_end, step, scheme, control, p)
    inputs = laid.inputs
    every = (
        max(1, -(-inputs.steps // _ROWS))
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
    if driven.schedule is not None:  # what it adds to the energy of strings is supplied, too
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
    if correction is not None:
        instance(
            "correction",
            correction,
            (Projection, BarLengthCorrection),
            "Projection(every), BarLengthCorrection(weight) or None",
        )
    if compiled is not None:
        instance("compiled", compiled, (bool, Single), "True or False, None or Single()")
    for name, flag in flags.items():
        instance(name, flag, bool, "True or False")
