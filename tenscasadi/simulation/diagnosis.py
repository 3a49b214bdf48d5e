"""Diagnosis of a run for its message.

It gives the cause of a failure, the doubts about a finished run, and the cure.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta
from tenscasadi.integrators.scheme import Scheme, extent, stability_limit
from tenscasadi.integrators.stability import (
    DENSE,
    fastest_decay,
    fastest_rate,
    log_growth,
    rate_bound,
    stable_step,
)
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.validate import Array

DRIFTED_BARS = 0.01  # relative length error that the message reports
LOST_ENERGY = 0.05  # share of the exchanged energy that the message reports
LOST_TRUST = 0.5  # share of the exchanged energy at which a run is not trustworthy
OFF = 1e-6  # relative constraint violation of a start that is not reported
WRONG_START = 0.2  # relative constraint violation of a start at which a run is not trustworthy
SPOKEN_GROWTH = float(np.log(1.5))  # spurious log growth of a mode that the message reports
LOST_GROWTH = float(np.log(10.0))  # log growth at which a run is not trustworthy
# × stable step: longer steps do not resolve damped strings that go slack
_COARSE = 0.5
# rounding error of differences of state entries, relative to the largest entry
_EPSILON = 64 * float(np.finfo(float).eps)


def explain_divergence(model: Model, scheme: Scheme, run: Trajectory, last: int) -> str:
    """Explain the divergence of a run after row `last`.

    The start and the linearized motion give the cause and the cure.
    """
    step, name = run.step, type(scheme).__name__
    if off := off_constraints(model, run.states[0], OFF):
        return f"the start is {off}"
    if scheme.adaptive:
        return f"the error of each step was kept, so the motion itself breaks down or was not resolved: try a smaller {name}(rtol)"
    limits = []
    for row in (0, last):  # the start first: a state that is about to break has limits of its own
        x, u = run.states[row], run.control[row]
        limits.append(stable_step(model, x, u, scheme, safety=1.0, parameters=run.parameters))
        if step > limits[-1]:
            return (
                f"the step {step:g} s is above the stability limit {limits[-1]:.3g} s of {name} at t = {run.time[row]:g} s "
                f"(fastest rate ω_max = {fastest_rate(model, x, u, run.parameters):.4g} rad/s): try step={0.9 * limits[-1]:.2g}"
            )
    limit = min(limits)
    stable = (
        f"is below the stability limit {limit:.3g} s of the linearised motion"
        if np.isfinite(limit)
        else f"is stable, as any of {name}"
    )
    unsolved = (
        ""
        if isinstance(scheme, ExplicitRungeKutta)
        else ", equations of a step that have no solution"
    )
    return (
        f"the step {step:g} s {stable}, so accuracy was lost elsewhere "
        f"(fast rotation, impact, bars drifting from their length{unsolved}): try step={step / 5:.2g} or correction=Projection()"
    )


def describe_doubts(
    model: Model, scheme: Scheme, run: Trajectory, compiled: Compiled
) -> tuple[str, bool]:
    """Describe the reasons not to trust a finished run.

    They concern its start, bars or energy, for instance where a correction hides errors of the
    step. Each clause follows a semicolon and names the cure. The second result is whether the run
    is trustworthy all the same.
    """
    x = run.states[0]
    if off := off_constraints(model, x, OFF):
        return f"; the start is {off}", constraint_violation(model, x) <= WRONG_START
    looks = [] if scheme.adaptive or scheme.implicit or not model.nx else _group_states(model, run)
    growth, limit, when = _find_growth(model, scheme, run, looks)
    drift = float(run.bar_length_error.max())
    found = [describe_drift(drift)] if drift > DRIFTED_BARS else []
    parts = run.energy_parts
    scale = float(parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum())
    rounding = (1e-5 if isinstance(compiled, Single) else 1e-9) * float(
        np.abs(parts).max() + run.tension.sum(axis=1).max() * np.ptp(run.nodes)
    )
    s = model.structure
    masses = (
        model.parameters.item_values(name, run.parameters, getattr(s, name))
        for name in ("bar_mass", "node_mass")
    )
    crossing = (
        float(sum(mass.sum() for mass in masses)) * (extent(model) / float(run.time[-1])) ** 2
    )  # energy of a motion across the extent of the structure
    rounding += _EPSILON * crossing
    largest = float(np.abs(run.energy_error).max())
    trusted = not largest > max(LOST_TRUST * scale, rounding)  # NaN: not known
    if largest > max(LOST_ENERGY * scale, rounding):
        found.append(describe_energy_error(largest, scale))
    if run.step > limit:
        cure = f"try step={0.9 * limit:.2g}"
        text = f"the step {run.step:g} s is above the stability limit {limit:.3g} s of {type(scheme).__name__} at t = {when:g} s: {cure}"
        told = (
            "".join(f"; {part}" for part in found)
            + f": the step is above the stability limit, {cure}"
            if found
            else f"; {text}"
        )
        # Friction is bounded. Instability of its slope at rest causes only chatter.
        rubs = any(ground.friction is not None for ground in model.scene.grounds)
        return told, rubs or (trusted and growth <= LOST_GROWTH)
    coarse = _find_coarse_damping(model, scheme, run, looks)
    return "".join(f"; {text}" for text in found) + (
        f": {_finer(model, scheme, run)}" if found else ""
    ) + coarse, trusted


def _find_coarse_damping(
    model: Model, scheme: Scheme, run: Trajectory, looks: list[_StateGroup]
) -> str:
    """Report steps too long for damped strings that go slack.

    Such steps may be stable. The text names the cure; "" if the steps are short enough.
    """
    clamped = model.scene.clamped_strings
    damped = clamped[_string_values(model, run, "damping")[clamped] > 0]
    if (
        not looks
        or not np.any(run.tension[:, damped] == 0)
        or not np.any(run.tension[:, damped] > 0)
    ):
        return ""
    stable = float(stability_limit(scheme, np.array([-1.0 + 0.0j]))[0])  # step times rate
    worst = (0.0, 0)
    for look in looks:
        for x, row, bound in zip(look.states, look.rows, look.bounds, strict=True):
            if run.step * bound > _COARSE * stable:
                worst = max(
                    worst,
                    (
                        run.step
                        / stable
                        * fastest_decay(model, x, run.control[row], run.parameters),
                        row,
                    ),
                )
    share, row = worst
    if share <= _COARSE:
        return ""
    return (
        f"; the step {run.step:g} s is {share:.0%} of what damping leaves stable at t = {run.time[row]:g} s, "
        f"too long to follow damped strings that go slack: try step={_COARSE / 2 * run.step / share:.2g}"
    )


def _find_growth(
    model: Model, scheme: Scheme, run: Trajectory, looks: list[_StateGroup]
) -> tuple[float, float, float]:
    """Find the spurious amplification of a mode.

    The result is its logarithm, the stability limit [s], and a time at which it occurs [s].
    """
    steps, ends = (
        max(1.0, float(run.time[-1]) / run.step),
        (0, len(run.time) - 1),
    )  # there, the limit is reported for any growth
    total, worst = 0.0, (0.0, run.states[0], 0)
    for states, share, rows, bounds in looks:
        least = [0.0 if row in ends else SPOKEN_GROWTH / steps for row in rows]
        logs = [
            log_growth(model, scheme, run.step, x, run.control[row], ignored, bound, run.parameters)
            for x, row, ignored, bound in zip(states, rows, least, bounds, strict=True)
        ]
        k = int(np.argmax(logs))
        total += logs[k] * max(1.0, share * steps)
        worst = max(worst, (logs[k], states[k], rows[k]), key=lambda item: item[0])
    if not worst[0]:
        return total, np.inf, 0.0
    return (
        total,
        stable_step(
            model, worst[1], run.control[worst[2]], scheme, safety=1.0, parameters=run.parameters
        ),
        float(run.time[worst[2]]),
    )


class _StateGroup(NamedTuple):
    """States of a run with the same taut strings.

    `share` is the fraction of the run that they represent. `rows` are their rows, `bounds` upper
    bounds of their rates [rad/s].
    """

    states: list[Array]
    share: float
    rows: list[int]
    bounds: list[float]


def _group_states(model: Model, run: Trajectory) -> list[_StateGroup]:
    """Choose the states at which to linearize.

    Each set of taut strings is a group, the stiffest and most damped first. The start, the end and
    the largest force density belong to the groups. Strings may be taut only within a step, so the
    states one step ahead count too.
    """
    ahead = run.states.copy()
    q, v, _ = model.split(ahead)
    q += run.step * v
    taut = np.vstack([run.tension != 0, _find_stretched(model, run, ahead)])
    taut[:, model.scene.compression_strings] = True  # they act at any length
    count, last = len(run.time), len(run.time) - 1
    _, first, kind = np.unique(
        np.packbits(taut, axis=1), axis=0, return_index=True, return_inverse=True
    )
    kind = kind.ravel()
    rates = [_string_values(model, run, name) for name in ("stiffness", "damping")]
    danger = taut[first] @ sum(part / (part.max(initial=0.0) or 1.0) for part in rates)
    chosen = set(np.argsort(-danger, kind="stable")[: 8 if model.nx <= DENSE else 1].tolist()) | {
        int(kind[0]),
        int(kind[last]),
    }
    strongest = int(run.force_density.max(axis=1, initial=0.0).argmax())
    groups = []
    for k in sorted(chosen):
        where = dict.fromkeys(
            [int(first[k]), *(row for row in (0, last, strongest) if kind[row] == k)]
        )
        own = int(np.count_nonzero(kind[:count] == k))  # 0: this set occurs only within steps
        states = [run.states[i] if i < count else ahead[i - count] for i in where]
        rows = [i % count for i in where]
        bounds = [
            rate_bound(model, x, run.control[row], run.parameters)
            for x, row in zip(states, rows, strict=True)
        ]
        groups.append(_StateGroup(states, own / count if own else 0.0, rows, bounds))
    return groups


def _find_stretched(model: Model, run: Trajectory, states: Array) -> NDArray[np.bool_]:
    """Find the strings longer than at rest (T, α).

    The states are (T, nx), the controls those of the run.
    """
    s, scene = model.structure, model.scene
    if isinstance(scene.control, ForceDensity):
        return np.asarray(run.tension != 0)
    rest = (
        run.control[:, s.string_parent] * s.string_fraction
        if isinstance(scene.control, RestLength)
        else _string_values(model, run, "rest_length")
    )
    ends = model.nodes(states)
    return np.asarray(
        np.linalg.norm(ends[:, s.strings[:, 1]] - ends[:, s.strings[:, 0]], axis=2) > rest
    )


def _string_values(model: Model, run: Trajectory, name: str) -> Array:
    """Evaluate stiffness, damping or rest length (α,).

    The modelled strings have the parameters of the run.
    """
    s = model.structure
    if not model.scene.has_parameter(name):
        return np.asarray(getattr(s, name))
    own = model.parameters.quantities[name].numbers(run.parameters)[s.string_parent]
    return own * s.string_fraction if name == "rest_length" else own / s.string_fraction


def _finer(model: Model, scheme: Scheme, run: Trajectory) -> str:
    """Name the cure for a run that is not accurate."""
    step, x, u = run.step, run.states[0], run.control[0]
    if scheme.adaptive:
        return f"try a smaller {type(scheme).__name__}(rtol)"
    limit = stable_step(model, x, u, scheme, safety=1.0, parameters=run.parameters)
    return (
        f"the step is above the stability limit, try step={0.9 * limit:.2g}"
        if step > limit
        else "try a smaller step"
    )


def off_constraints(model: Model, state: Array, tolerance: float) -> str:
    """Describe the constraint residual of a state and the cure.

    "" if `constraint_violation` of the state (nx,) is within `tolerance`.
    """
    violation = constraint_violation(model, state)
    return "" if violation <= tolerance else describe_violation(violation)


def describe_drift(error: float) -> str:
    """Describe the largest relative error of bar lengths."""
    return f"bars are off by up to {error:.2g} of their length (correction=Projection() holds them)"


def describe_energy_error(error: float, moved: float) -> str:
    """Describe an energy error beside the exchanged energy [J]."""
    return f"energy is off by {error:.2g} J where {moved:.2g} J move"


def describe_violation(violation: float) -> str:
    """Describe a relative constraint violation and the cure."""
    return (
        f"off the lengths of its bars or its joints, or about to leave them, relatively by {violation:.2g}: "
        "start from tenscasadi.projection(model)(state)"
    )


def constraint_violation(model: Model, state: Array) -> float:
    """Compute the relative constraint violation of a state.

    It is a share of lengths and speeds, beyond rounding.

    Parameters
    ----------
    model : Model
        Model with the constraints.
    state : ndarray, shape (nx,)
        The state.

    Returns
    -------
    float
        Largest of four relative errors. Length errors are relative to the bar, gaps of joints to
        the longest bar. Their rates are relative to the largest relative speed of the ends of a
        bar, at least the longest bar per second.
    """
    constraints = model.constraints(state)
    q, v, _ = model.split(state)
    lengths = model.mechanism.lengths
    size = float(lengths.max(initial=0.0)) or extent(model)
    ends = model.velocities(state)[model.structure.bars[model.mechanism.rigid]]
    speed = max(size, float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max(initial=0.0)))
    scales = (lengths, speed, size, speed)  # in the order of the constraints
    largest = [np.abs(part).max(initial=0.0) for part in (q, v)] * 2
    shares = [
        np.maximum(np.abs(r) - _EPSILON * x, 0.0) / scale
        for r, x, scale in zip(constraints, largest, scales, strict=True)
    ]
    return float(np.concatenate(shares).max(initial=0.0))
