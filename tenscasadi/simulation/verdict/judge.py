"""Acceptance test of runs by their endings and errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_events
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.engine.request import FINISHED, WORST
from tenscasadi.simulation.engine.roll import Runs
from tenscasadi.simulation.inputs.resolution import describe_unresolved
from tenscasadi.simulation.string_breaks import describe_failures
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.simulation.verdict.endings import (
    describe_limit,
    describe_steps,
    explain_end,
    find_stable_step,
    sample_run,
)
from tenscasadi.simulation.verdict.internal_limits import (
    check_internal_states,
    describe_motor_overload,
)
from tenscasadi.simulation.verdict.starts import (
    constraint_violation,
    describe_violation,
    start_violations,
)
from tenscasadi.simulation.verdict.thresholds import EPSILON, THRESHOLDS, Doubts
from tenscasadi.structure.mass_checks import total_mass
from tenscasadi.util.compile import Single
from tenscasadi.util.validate import Array, Booleans

if TYPE_CHECKING:
    from tenscasadi.simulation.verdict.step_error import StepErrors


class Verdict(NamedTuple):
    """Result of the acceptance test of n runs.

    Attributes
    ----------
    success : ndarray of bool, shape (n,)
        Whether a run reached its end and is trustworthy.
    message : list of str
        End of each run, and reasons not to trust it.
    error : ndarray, shape (n,)
        Estimated errors of the node positions [m], NaN if unknown.
    finer : ndarray, shape (n,)
        Factors by which the steps should be refined; 1 if errors are small or unknown.
    """

    success: Booleans
    message: list[str]
    error: Array
    finer: Array


def judge(runs: Runs, found: StepErrors | None) -> Verdict:
    """Assess whether runs are trustworthy, with reasons.

    `found` are their step-size errors, if they have been estimated.
    """
    status, scheme = runs.rolled.status, runs.request.scheme
    success, finished = status == FINISHED, np.flatnonzero(status == FINISHED)
    message = [
        f"finished {describe_steps(runs, k).text}" if ended else explain_end(runs, k)
        for k, ended in enumerate(success.tolist())
    ]
    doubts = find_doubts(_measure_runs(runs))
    success &= ~doubts.failed
    for k in finished.tolist():
        message[k] += doubts.text[k]
    model = runs.request.inputs.model
    if (scene := model.scene).strength is not None:
        own = model.moving.stop + int(scene.has_clock)  # without the clock of a control function
        for k, states in enumerate(runs.saved[:, :, :own]):
            steps = runs.saved_steps(k)
            message[k] += describe_failures(scene, runs.times(steps), states[: len(steps)])
    doubts = check_internal_states(runs)
    success &= ~doubts.failed
    message = [
        text + more + describe_motor_overload(runs, k)
        for k, (text, more) in enumerate(zip(message, doubts.text, strict=True))
    ]
    error, finer = np.full(len(status), np.nan), np.ones(len(status))
    if not len(finished):  # stopped runs return at once, however many steps remain
        return Verdict(success, message, error, finer)
    if found is not None:
        error = found.error
        doubts, finer = _check_errors(runs, found)
        success &= ~doubts.failed
        message = [text + more for text, more in zip(message, doubts.text, strict=True)]
    inputs, step = runs.request.inputs, describe_steps(runs, 0).step
    unresolved = describe_unresolved(
        inputs.model.over_time, inputs.grid, inputs.first, step, scheme.order
    )
    for k in finished.tolist():
        message[k] += unresolved
    if unresolved and not scheme.adaptive:  # error control may have resolved it
        success[:] = False
    return Verdict(success, message, error, finer)


class Measures(NamedTuple):
    """Numerical errors and exchanged energies of n runs.

    Attributes
    ----------
    start, bars : ndarray, shape (n,)
        Constraint violation of the start, and largest relative error of bar lengths, see
        `THRESHOLDS`.
    energy_error, moved : ndarray, shape (n,)
        Largest energy error [J], 0 if it is a rounding error or unknown, and exchanged energy [J].
    """

    start: Array
    bars: Array
    energy_error: Array
    moved: Array


def find_doubts(measures: Measures) -> Doubts:
    """Compare the errors of runs (`measures`) with the thresholds."""
    start, bars, error, moved = measures
    work = start > THRESHOLDS["start"].reported  # by constraints that are violated
    lost = np.where(work, 0.0, error / np.maximum(moved, 1e-300))
    shares = {"start": start, "bars": bars, "energy": lost}
    text, failed = [""] * len(start), np.zeros(len(start), dtype=bool)
    for name, share in shares.items():
        failed |= share > THRESHOLDS[name].failed
        for k in np.flatnonzero(share > THRESHOLDS[name].reported).tolist():
            text[k] += f"; {_describe_doubt(name, float(share[k]), error[k], moved[k])}"
    return Doubts(text, failed)


def _describe_doubt(name: str, share: float, error: float, moved: float) -> str:
    if name == "start":
        return f"the start is {describe_violation(share)}"
    if name == "bars":
        return f"bars are off by up to {share:.2g} of their length (correction=Projection() holds them)"
    return (
        f"energy is off by {error:.2g} J where {moved:.2g} J move: try a smaller step or tolerance"
    )


def measure_trajectory(model: Model, trajectory: Trajectory) -> Measures:
    """Compute the errors of a recorded trajectory."""
    parts = trajectory.energy_parts
    moved = parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum()
    error = np.nan_to_num(np.abs(trajectory.energy_error)).max()
    known = error > _rounding_energy(model, np.abs(parts).sum(axis=1).max(), trajectory.time[-1])
    values = (
        constraint_violation(model, trajectory.states[0]),
        trajectory.bar_length_error.max(),
        error * known,
        moved,
    )
    return Measures(*(np.array([value]) for value in values))


def _measure_runs(runs: Runs) -> Measures:
    request, n, worst = runs.request, len(runs.rolled.status), runs.rolled.worst
    inputs = request.inputs
    if worst is None:
        raise RuntimeError("the kernel has measured nothing")
    largest = dict(zip(WORST, worst.T, strict=True))
    violation = start_violations(inputs.model, inputs.starts)
    ranges = [largest[f"{name}_high"] - largest[f"{name}_low"] for name in ("elastic", "gravity")]
    size = largest["kinetic"] + np.abs(runs.measured[:, :, -1]).max(axis=1, initial=0.0)
    size = size + sum(
        abs(largest[name]) for name in ("elastic_high", "gravity_low", "gravity_high")
    )
    control = inputs.model.scene.control
    if control is not None and control.commands_forces:  # strings store no energy
        u = inputs.sample_controls()
        power = 2 if control.unit == "N/m" else 1
        size = size + np.abs(u).max(axis=1).sum(axis=1) * extent(inputs.model) ** power
    single = isinstance(request.compiled, Single)
    rounding = _rounding_energy(inputs.model, size, inputs.grid.t_end, single)
    error = np.where(largest["energy_error"] > rounding, largest["energy_error"], 0.0)
    return Measures(
        np.broadcast_to(violation, n),
        largest["bar_length_error"],
        error if request.balanced else np.zeros(n),
        largest["kinetic"] + sum(ranges),
    )


def _rounding_energy(model: Model, size: Any, t_end: float, single: bool = False) -> Any:
    """Estimate the energy error due to rounding [J].

    It is a fraction of `size`, the magnitude of the energies [J], and of the kinetic energy of a
    motion that covers the extent of the structure in the duration `t_end` [s]. The fraction is
    larger in single precision.
    """
    s = model.structure
    crossing = total_mass(s) * (extent(model) / (t_end or np.inf)) ** 2
    return (1e-5 if single else 1e-9) * size + EPSILON * crossing


def _check_errors(runs: Runs, found: StepErrors) -> tuple[Doubts, Array]:
    """Compare the step-size errors `found` of runs with the thresholds.

    The text gives the cause and the cure of the largest error. Also returns the refinement factors
    (n,) of the steps that would be sufficient.
    """
    least = runs.request.rounding
    share = np.where(found.error > least, found.error / np.maximum(found.motion, 1e-300), 0.0)
    reported, failed = THRESHOLDS["position"]
    large = share > reported
    finer = np.where(large, found.refinement(0.5 * reported), 1.0)
    text = [""] * len(share)
    if large.any():
        worst = int(np.nanargmax(share))
        for k in np.flatnonzero(large).tolist():
            text[k] = "; " + _explain_error(
                runs, worst, found.error[k], found.factor[worst], finer[worst]
            )
    return Doubts(text, share > failed), finer


def _explain_error(runs: Runs, k: int, error: float, factor: float, finer: float) -> str:
    """Find the cause and the cure of a step-size error.

    The run has the index k and the position `error` [m]. The cure is a smaller step or tolerance.
    Half the step length divides the error by `factor`. Steps shorter by the factor `finer` are
    sufficient.
    """
    scheme, model = runs.request.scheme, runs.request.inputs.model
    if scheme.adaptive:
        rtol, name = getattr(scheme, "rtol", 0.0), type(scheme).__name__
        smaller = max(rtol / finer / 10, 1e-14)
        return f"the tolerance rtol={rtol:g} is too large (position error about {error:.1g} m): try {name}(rtol={smaller:.1g})"
    step = describe_steps(runs, k).step
    limit, when = find_stable_step(model, scheme, sample_run(runs, k))
    if step > limit:
        cause = describe_limit(scheme, step, limit, when)
        return f"{cause} (position error about {error:.1g} m): try step={0.9 * limit:.2g}"
    if factor > 2 or build_events(model) is None:
        return f"the step {step:g} s is too large (position error about {error:.1g} m): try step={step / finer:.2g}"
    events = "strings go slack or taut" + (
        ", or contacts change," if model.scene.contact_laws else ""
    )
    return (
        f"{events} within steps of {step:g} s (position error about {error:.1g} m): "
        f"try DormandPrince853(rtol=1e-6), which ends its steps there, or step={step / finer:.2g}"
    )
