"""Acceptance test of runs.

It finds how a run ended and whether it is trustworthy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_switching
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.simulation.diagnosis import (
    DRIFTED_BARS,
    LOST_ENERGY,
    LOST_TRUST,
    OFF,
    WRONG_START,
    constraint_violation,
    describe_doubts,
    describe_drift,
    describe_energy_error,
    describe_violation,
    explain_divergence,
)
from tenscasadi.simulation.engine.engine import FAULTS, Request, Run
from tenscasadi.simulation.engine.request import KINETIC, STOPPED, SUPPLIED, WORST, Rolled
from tenscasadi.simulation.engine.step_error import estimate_error
from tenscasadi.simulation.time_grid import describe_unseen
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array

_MOST = 50  # tested runs above the stability limit, or with lost energy
_LIMIT = "stability limit"


def conclude(
    model: Model, request: Request, run: Run, recorded: Trajectory, verify: bool
) -> Trajectory:
    """Complete the trajectory of a run with its verdict.

    The model of the request may be driven by a control function. With `verify`, a repetition of
    the run estimates the step-size error.
    """
    scheme = request.scheme
    if run.status in FAULTS and not run.failure:
        return replace(
            recorded, success=False, message=_explain_loss(model, request, run, recorded)
        )
    if run.status:
        last = recorded.time[-1]
        message = (
            f"stopped after t = {last:g} s: {run.failure}"
            if run.failure
            else f"interrupted from the keyboard, the last state kept is at t = {last:g} s"
        )
        return replace(recorded, success=False, message=message + run.note)
    doubts, trusted = describe_doubts(model, scheme, recorded, request.compiled)
    driven, error = request.model, np.nan
    first = float(request.start[-1]) if driven.has_clock else 0.0
    unseen = describe_unseen(driven.over_time, request.inputs, first, run.step, scheme.order)
    message = f"finished {run.text}{doubts}{unseen}"
    # A scheme with error control may have resolved it with its own steps.
    success = trusted and (scheme.adaptive or not unseen)
    if verify and success:
        found = estimate_error(request, run, recorded.nodes)
        error = found.error
        if found.reported and "try" not in message:
            message += _describe_error(model, scheme, recorded, error)
    return replace(
        recorded, success=success, message=message + run.note, error_estimate=float(error)
    )


def _explain_loss(model: Model, request: Request, run: Run, recorded: Trajectory) -> str:
    fault, last = FAULTS[run.status], len(recorded.time) - 1
    why = explain_divergence(model, request.scheme, recorded, last)
    return (
        f"diverged between t = {recorded.time[-1]:g} and {run.found:g} s: {fault}; {why}{run.note}"
    )


def _describe_error(model: Model, scheme: Scheme, run: Trajectory, error: float) -> str:
    """Describe the step-size error, its cause and the cure."""
    off = f"put it off by some {error:.1g} m"
    if scheme.adaptive:
        return f"; its tolerance {off}: try {type(scheme).__name__}(rtol={getattr(scheme, 'rtol', 0.0) / 100:.1g})"
    finer = run.step / 4  # errors at events are about proportional to the step
    if not _meets_events(model, run):
        return f"; its steps, too long for the fastest that moves, {off}: try step={finer:.2g}"
    events = "strings that go slack or taut"
    events += " and contacts" if model.scene.grounds else ""
    return (
        f"; {events} within its steps {off}: "
        f"try DormandPrince853(rtol=1e-6), which ends its steps there, or step={finer:.2g}"
    )


def _meets_events(model: Model, run: Trajectory) -> bool:
    """Return whether the set of taut strings or contacts changes.

    Only saved rows are compared.
    """
    modes: Any = run.tension[:, model.scene.switching_strings] != 0
    gaps = build_switching(model) if model.scene.grounds else None
    if gaps is not None:
        held = np.hstack([run.control, np.tile(run.parameters, (len(run.time), 1))])
        modes = gaps.map(len(held))(run.states.T, ca.DM(held.T)).full().T > 0
    return bool((modes[1:] != modes[:-1]).any())


# --- many motions ---


class Runs(NamedTuple):
    """Input and result of a batch of runs.

    The shapes are (n or 1, nx) for starts, (n or 1, K, nu) for controls and (n or 1, np) for
    parameters. `step` is the mean length of the steps [s]. `time` (T,) belongs to saved rows;
    `times` gives the time of a step. `rows` gives the controls (T, nu) of run k at the saved
    times.
    """

    model: Model
    scheme: Scheme
    starts: Array
    controls: Array
    parameters: Array
    steps: int
    step: float
    time: Array
    times: Callable[[int], float]
    rows: Callable[[int], Array]
    result: Rolled
    unseen: str = ""  # functions of time that the steps do not resolve


def judge(run: Runs) -> tuple[NDArray[np.bool_], NDArray[np.str_]]:
    """Find whether each run is trustworthy, and its message."""
    result, n = run.result, len(run.result.status)
    success = result.status == 0
    told = np.array([_describe_finish(run)] * n, dtype=object)
    for k in np.flatnonzero(~success).tolist():
        told[k] = _describe_end(run, k)
    violation = _violations(run, np.flatnonzero(success))
    for k in np.flatnonzero(violation > OFF).tolist():
        told[k] += f"; the start is {describe_violation(violation[k])}"
    success &= violation <= WRONG_START
    extremes: Any = result.worst  # rollouts always measure it
    worst = dict(zip(WORST, extremes.T, strict=True))
    for k in np.flatnonzero(success & (worst["bar_length_error"] > DRIFTED_BARS)).tolist():
        told[k] += f"; {describe_drift(worst['bar_length_error'][k])}"
    moved = (
        worst["kinetic"]
        + worst["elastic_high"]
        - worst["elastic_low"]
        + worst["gravity_high"]
        - worst["gravity_low"]
    )
    size = (
        worst["kinetic"]
        + abs(worst["elastic_high"])
        + abs(worst["gravity_low"])
        + abs(worst["gravity_high"])
    )
    off = np.where(
        worst["energy_error"] > 1e-9 * size,
        worst["energy_error"] / np.maximum(moved, 1e-300),
        0.0,
    )
    for k in np.flatnonzero(success & (off > LOST_ENERGY)).tolist():
        told[k] += (
            f"; {describe_energy_error(worst['energy_error'][k], moved[k])}: try a smaller step"
        )
    _look_closer(run, off, success, told)
    if run.unseen and not run.scheme.adaptive:
        success[:] = False
    return success, np.array(told.tolist(), dtype=np.str_).reshape(n)


def _describe_finish(run: Runs) -> str:
    return f"finished {run.steps} steps of {run.step:g} s{run.unseen}"


def _describe_end(run: Runs, k: int) -> str:
    status, good, fault = (
        int(values[k]) for values in (run.result.status, run.result.good, run.result.fault)
    )
    if status == STOPPED:
        return f"interrupted from the keyboard after t = {run.times(fault):g} s"
    if fault == 0:
        return f"the start is not one: {FAULTS[status]}"
    return (
        f"diverged between t = {run.times(good):g} and {run.times(fault):g} s: {FAULTS[status]}; "
        f"try a step below tenscasadi.stable_step(model, x, u, scheme), such as step={run.step / 5:.2g}, or correction=Projection()"
    )


def _violations(run: Runs, motions: NDArray[np.intp]) -> Array:
    """Compute the constraint violation of each start.

    See `constraint_violation`. Starts that are clearly consistent have 0.
    """
    found = np.zeros(len(run.result.status))
    if not len(motions):
        return found
    if len(run.starts) == 1:
        found[motions] = constraint_violation(run.model, run.starts[0])
        return found
    for k in motions[_may_be_off(run.model, run.starts[motions])].tolist():
        found[k] = constraint_violation(run.model, run.starts[k])
    return found


def _may_be_off(model: Model, starts: Array) -> NDArray[np.bool_]:
    """Find the starts that may violate bars or joints.

    This quick test leaves few starts for `constraint_violation`.
    """
    lengths = model.mechanism.lengths
    if not model.mechanism.constrained:
        return np.zeros(len(starts), dtype=bool)
    small = OFF * float(lengths.min(initial=np.inf if len(lengths) else 1.0))
    if not model.mechanism.joints:
        ends, moving = (
            part[:, model.structure.bars[model.mechanism.rigid]]
            for part in (model.nodes(starts), model.velocities(starts))
        )
        bars, rates = ends[:, :, 1] - ends[:, :, 0], moving[:, :, 1] - moving[:, :, 0]
        off = np.abs(np.einsum("nbx,nbx->nb", bars, bars) / lengths - lengths) + np.abs(
            np.einsum("nbx,nbx->nb", bars, rates) / lengths
        )
    else:
        x = ca.MX.sym("x", model.nx)
        off = abs(
            ca.Function("rows", [x], [ca.vertcat(*model.constraints(x))])
            .map(len(starts))(starts.T)
            .full()
            .T
        )
    return np.asarray(off.max(axis=1, initial=0.0) > small)


def _look_closer(run: Runs, share: Array, success: NDArray[np.bool_], told: NDArray[Any]) -> None:
    """Apply the tests of `simulate` to selected runs.

    They are those most likely to be wrong, and all if a step is above the stability limit. `share`
    (n,) is the energy error relative to the energy that moves.
    """
    left = np.flatnonzero(success)
    if not len(left) or not run.model.nx:
        return
    order = left[
        np.argsort(-np.nan_to_num(share[left]), kind="stable")
    ].tolist()  # the most likely to be wrong first
    # The first, the last, the two largest energy errors, and the extremes of up to 8 parameters or
    # controls; of more, of their sum.
    chosen = {int(left[0]), int(left[-1]), *order[:2]}
    for values in (run.parameters, run.controls[:, 0]):
        if len(values) > 1 and values.shape[1]:
            columns = (
                values[left] if values.shape[1] <= 8 else values[left].sum(axis=1, keepdims=True)
            )
            chosen |= {
                int(left[pick(column)]) for column in columns.T for pick in (np.argmin, np.argmax)
            }
    lost = [k for k in order if share[k] > LOST_TRUST]
    chosen |= set(lost[:_MOST])
    for k in sorted(chosen):
        _ask(run, k, success, told)
    success[lost[_MOST:]] &= bool(success[lost[:_MOST]].all())  # as trustworthy as the tested ones
    above = [k for k in sorted(chosen) if _LIMIT in told[k]]
    if not above:
        return
    others = [k for k in order if k not in chosen]
    for k in others[:_MOST]:
        _ask(run, k, success, told)
    trusted = bool(success[[*chosen, *others[:_MOST]]].all())
    for k in others[_MOST:]:  # as trustworthy as the tested ones
        success[k] &= trusted
        told[k] += (
            f"; not looked at, as others took steps above the {_LIMIT}, see motion {above[0]}"
        )


def _ask(run: Runs, k: int, success: NDArray[np.bool_], told: NDArray[Any]) -> None:
    """Apply the tests of `simulate` to run k."""
    saved, measured = run.result.saved, run.result.measured
    if saved is None or measured is None:
        return
    inputs = np.hstack(
        [
            run.rows(k),
            np.broadcast_to(
                run.parameters[k if len(run.parameters) > 1 else 0],
                (len(run.time), run.parameters.shape[1]),
            ),
        ]
    )
    recorded = record_trajectory(run.model, run.time, saved[k], inputs, step=run.step, message="")
    energy = measured[k, :, KINETIC:SUPPLIED].sum(
        axis=1
    )  # under the control before a row, since that of the row may be the next one
    recorded = replace(recorded, energy_error=energy - energy[0] - measured[k, :, SUPPLIED])
    doubts, success[k] = describe_doubts(run.model, run.scheme, recorded, None)
    if doubts:
        told[k] = _describe_finish(run) + doubts
