"""Diagnosis of a run, for its message: why it broke down, what in one that finished is not to be trusted, and the cure."""

from __future__ import annotations

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta
from tenscasadi.integrators.scheme import Scheme, extent
from tenscasadi.integrators.stability import fastest_rate, stable_step
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.validate import Array

_BROKEN_BARS = 0.1  # relative length error at which a run has diverged
_BEYOND = 1e12  # entries of a state above this are not physical in any unit
_DRIFTED_BARS = 0.01  # relative length error at which the message speaks of it
_LOST_ENERGY = 0.05  # share of the energy that moves at which the message speaks of it
_ROUNDING = {False: 1e-9, True: 1e-5}  # of the energies, what a run may lose by rounding, in double and in single precision
_OFF = 1e-6  # of lengths and speeds: what a start may be off its bars and joints by without a word
_WRONG_START = 0.2  # of lengths and speeds: a start that is off by more is another structure's
_EPSILON = 64 * float(np.finfo(float).eps)  # of the largest entry of a state: what rounding may change differences of entries by


def first_fault(states: Array, bar_length_error: Array) -> tuple[int, str]:
    """Count the good rows of states (T, nx) and bar_length_error (T,), and say what is wrong with the next; "" when all are good."""
    faults = {
        "the state is not finite": ~np.all(np.isfinite(states), axis=1),
        "the state is beyond any physical size": np.any(np.abs(states) > _BEYOND, axis=1),
        f"a bar is off by more than {_BROKEN_BARS:.0%} of its length": bar_length_error > _BROKEN_BARS + bar_length_error[0],
    }
    bad = np.any(list(faults.values()), axis=0)
    bad[0] = False  # the start is the caller's
    if not bad.any():
        return len(states), ""
    row = int(np.argmax(bad))
    return row, next(name for name, where in faults.items() if where[row])


def explain_divergence(model: Model, scheme: Scheme, run: Trajectory, last: int) -> str:
    """Say why a run diverged after row `last`, as far as the start and the linearised motion tell, and what to do."""
    step, name = run.step, type(scheme).__name__
    if off := off_constraints(model, run.states[0], _OFF):
        return f"the start is {off}"
    if scheme.adaptive:
        return f"the error of each step was kept, so the motion itself breaks down or was not resolved: try a smaller {name}(rtol)"
    limits = []
    for row in (0, last):  # the start first: a state that is about to break has limits of its own
        x, u = run.states[row], run.control[row]
        limits.append(stable_step(model, x, u, scheme, safety=1.0))
        if step > limits[-1]:
            return (
                f"the step {step:g} s is above the stability limit {limits[-1]:.3g} s of {name} at t = {run.time[row]:g} s "
                f"(fastest rate ω_max = {fastest_rate(model, x, u):.4g} rad/s): try step={0.9 * limits[-1]:.2g}"
            )
    limit = min(limits)
    stable = f"is below the stability limit {limit:.3g} s of the linearised motion" if np.isfinite(limit) else f"is stable, as any of {name}"
    unsolved = "" if isinstance(scheme, ExplicitRungeKutta) else ", equations of a step that have no solution"
    return (
        f"the step {step:g} s {stable}, so accuracy was lost elsewhere "
        f"(fast rotation, impact, bars drifting from their length{unsolved}): try step={step / 5:.2g} or correction=Projection()"
    )


def describe_doubts(model: Model, scheme: Scheme, run: Trajectory, compiled: Compiled) -> tuple[str, bool]:
    """Say what is not to be trusted in a run that finished, each after a semicolon, with the cure; tell whether the rest may be.

    Its start, its bars, or its energy, as when a correction hides what the step destroys.
    """
    x, u = run.states[0], run.control[0]
    if off := off_constraints(model, x, _OFF):
        return f"; the start is {off}", constraint_violation(model, x) <= _WRONG_START
    drift = float(run.bar_length_error.max())
    found = [f"bars are off by up to {drift:.2g} of their length (correction=Projection() holds them)"] if drift > _DRIFTED_BARS else []
    parts = run.energy_parts
    scale = float(parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum())
    rounding = _ROUNDING[isinstance(compiled, Single)] * float(np.abs(parts).max() + run.tension.sum(axis=1).max() * np.ptp(run.nodes))
    largest = float(np.abs(run.energy_error).max())
    if largest > max(_LOST_ENERGY * scale, rounding):  # not for NaN: not known
        found.append(f"energy is off by {largest:.2g} J where {scale:.2g} J move")
    return "".join(f"; {text}" for text in found) + (f": {_finer(model, scheme, run.step, x, u)}" if found else ""), True


def _finer(model: Model, scheme: Scheme, step: float, x: Array, u: Array) -> str:
    """Name the cure for a run that is not accurate."""
    if scheme.adaptive:
        return f"try a smaller {type(scheme).__name__}(rtol)"
    limit = stable_step(model, x, u, scheme, safety=1.0)
    return f"the step is above the stability limit, try step={0.9 * limit:.2g}" if step > limit else "try a smaller step"


def off_constraints(model: Model, state: Array, tolerance: float) -> str:
    """Say by how much a state (nx,) is off its bars and joints, and the cure; "" where `constraint_violation` is within `tolerance`."""
    violation = constraint_violation(model, state)
    if violation <= tolerance:
        return ""
    return (
        f"off the lengths of its bars or its joints, or about to leave them, relatively by {violation:.2g}: "
        "start from tenscasadi.projection(model)(state)"
    )


def constraint_violation(model: Model, state: Array) -> float:
    """Return by how much a state is off its bars and joints, beyond rounding, as a share of lengths and speeds.

    Parameters
    ----------
    model : Model
        The model whose constraints the state has to meet.
    state : ndarray, shape (nx,)
        The state.

    Returns
    -------
    float
        The largest of four shares: errors of length of the bar's length, gaps of joints of the longest bar, rates of both of the largest
        speed between the ends of a bar, which counts as the longest bar per second at least.
    """
    constraints = model.constraints(state)
    q, v, _ = model.split(state)
    lengths = model.mechanism.lengths
    size = float(lengths.max(initial=0.0)) or extent(model)
    ends = model.velocities(state)[model.structure.bars]
    speed = max(size, float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max(initial=0.0)))
    scales = (lengths, speed, size, speed)  # in the order of the constraints
    largest = [np.abs(part).max(initial=0.0) for part in (q, v)] * 2
    shares = [np.maximum(np.abs(r) - _EPSILON * x, 0.0) / scale for r, x, scale in zip(constraints, largest, scales, strict=True)]
    return float(np.concatenate(shares).max(initial=0.0))
