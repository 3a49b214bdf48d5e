"""Plans under rest-length control by way of force densities.

Both controls can produce the same trajectory. With force densities as control, elastic vibrations
of the strings do not limit the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from ocp.control.lqr import trace_motion
from ocp.guess.initial_guess import NOISE, TrajectoryGuess, add_noise
from ocp.guess.inverse_dynamics import measure_strings
from ocp.problem.bounds.bound import Limit, PathBound, RateBound, drop_infinite
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    RestLengthRateLimits,
    combine_rates,
)
from ocp.problem.bounds.taut_strings import AT_INSTANT, TautStrings
from ocp.problem.control import (
    TAUT_MARGIN,
    build_force_density_model,
    build_locked_model,
    build_smooth_model,
    controls_rest_lengths,
    slackening_damping,
)
from ocp.problem.costs import Smoothness
from ocp.problem.expressions import AtEnd, Constraint, Integral
from ocp.problem.instant import Instant, forces_of
from ocp.problem.problem import Problem
from ocp.problem.rows import RESOLUTION
from ocp.results.report import violated_limits
from ocp.results.result import STEPS, PlanResult
from ocp.solvers.base import Outcome
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.structure.class_one import distances
from tenscasadi.util.validate import Array

# Their values differ between the controls: of expressions, and of the change of the control.
_DIFFERENT = Smoothness, Constraint, Integral, AtEnd
# × RMS force density: error of the force densities between the nodes of the rest lengths, which
# falls with the square of their number
FORCE_ERROR = 0.03
MAX_PARTS = 2 * STEPS  # parts of an interval, between whose ends rest lengths are linear


def build_force_density_problem(problem: Problem) -> Problem | None:
    """Build the same problem with force densities as control.

    Returns None if the control is neither rest lengths nor their rates, if cables have one tension
    along several strings, or if limits or costs would have other values. For rates and motors, the
    initial force densities are those of the initial rest lengths. Limits of motors are omitted.
    """
    items = (*problem.bounds, *problem.costs)
    if problem.model.scene.structure.cables:
        return None
    if isinstance(problem.model.scene.control, RestLengthRate | Winch):
        locked = lock_winches(problem)
        first = None if locked is None else _initial_forces(problem)
        if locked is None or first is None:
            return None
        twin = build_force_density_problem(locked)
        return twin and replace(twin, bounds=[*twin.bounds, InitialForces(first)])
    own = all(type(item).__module__.startswith("ocp.") for item in items)
    if not controls_rest_lengths(problem.model) or not own or problem.phases:
        return None
    if any(isinstance(item, _DIFFERENT) for item in items):
        return None
    stiffness = problem.model.scene.structure.stiffness
    bounds = [
        replace(bound, stiffness=None)
        if isinstance(bound, (RestLengthLimits, RestLengthRateLimits))
        else bound
        for bound in problem.bounds
    ]
    bounds.append(ForceDensityLimits(upper=(1 - RESOLUTION) * stiffness))
    model = build_force_density_model(problem.model)
    return replace(problem, model=model, bounds=bounds)


def limit_instants(problem: Problem, twin: Problem) -> Problem | None:
    """Add limits of converted rest lengths at single instants.

    They are limits of rest-length rates at the start of intervals, where mean rates are limited,
    and the condition that damped strings are longer than their rest lengths, without which they go
    slack. Returns None if neither applies. `twin` is the problem in force densities.
    """
    scene = problem.model.scene
    rates = combine_rates(scene.structure, problem.bounds)
    bounds = list(twin.bounds)
    if np.isfinite(rates).any():
        margin = 5e-3  # by which rates typically exceed limits between mesh points: 0.1 to 0.2 %
        bounds = [bound for bound in bounds if not isinstance(bound, RestLengthRateLimits)]
        bounds.append(RestLengthSpeeds((1 - margin) * rates))
    damping = slackening_damping(problem.model)
    if damping.any():
        bounds.append(TautStrings(TAUT_MARGIN * damping))
    return None if bounds == list(twin.bounds) else replace(twin, bounds=bounds)


@dataclass(frozen=True, eq=False)
class RestLengthSpeeds(RateBound):
    """Limits of rest-length rates at the start of intervals, and of their means.

    The limits are `rate` (α,) [m/s]. Converted rest lengths ρ = s (1 − γ/k) + c ṡ/k have to satisfy
    the limits on a finer mesh. Limits of mean rates alone would permit rates that alternate within
    the intervals.
    """

    rate: Array

    def limit(self, before: Instant, after: Instant, interval: Any) -> Limit:
        """Build the rest-length rates between two instants, and their limits.

        Force densities are linear in between. `interval` is the time [s] from `before` to `after`.
        """
        structure = before.model.scene.structure
        k, c = ca.DM(structure.stiffness), ca.DM(structure.damping)
        first, last = (now.lengths * (1 - now.force_density / k) for now in (before, after))
        changes = (after.force_density - before.force_density) / interval
        damped = c / k * (after.rates - before.rates) / interval
        at_start = before.rates * (1 - before.force_density / k) - before.lengths * changes / k
        rates = ca.vertcat(at_start + damped, (last - first) / interval + damped)
        means = tuple(f"rest length rate of string {i}" for i in range(len(self.rate)))
        names = (*(f"{name}, {AT_INSTANT}" for name in means), *means)
        limits = np.tile(self.rate, 2)
        return drop_infinite(Limit(rates, -limits, limits, names, "m/s"))


@dataclass(frozen=True, eq=False)
class InitialForces(PathBound):
    """Constraint that prescribes the initial force densities.

    They are `force_density` (α,) [N/m]. Rest lengths with limited rates cannot jump at the start,
    and neither can these forces.
    """

    ends: ClassVar[tuple[str, ...]] = ("first",)
    force_density: Array

    def limit(self, now: Instant) -> Limit:
        """Build the force densities at the instant `now`, and their required values."""
        names = tuple(
            f"initial force density of string {k}" for k in range(len(self.force_density))
        )
        return Limit(now.force_density, self.force_density, self.force_density, names, "N/m")


def _initial_forces(problem: Problem) -> Array | None:
    """Compute the initial force densities (α,) [N/m].

    Returns None if they violate limits.
    """
    model = build_smooth_model(problem.model)
    first = np.asarray(model.force_density(problem.start, np.zeros(model.nu)))
    lower, upper = problem.force_density_limits
    own = len(first) == len(lower) and bool(np.all((lower <= first) & (first <= upper)))
    return first if own else None


def lock_winches(problem: Problem) -> Problem | None:
    """Build the same problem with rest lengths as control.

    They replace their rates. Returns None if the start is free.
    """
    if problem.free_start or problem.phases:
        return None
    model = problem.model
    start = drop_internal_states(model, np.asarray(problem.start))
    return replace(problem, model=build_locked_model(model), start=start)


def drop_internal_states(model: Model, states: Array) -> Array:
    """Select positions, velocities and clock from states (…, nx).

    Internal states, such as rest lengths of winches, are removed.
    """
    parts = model.split(states)
    return np.concatenate([parts.positions, parts.velocities, parts.clock], axis=-1)


class ForceGuess(NamedTuple):
    """Initial guess in force densities, with noise for saddle points.

    `known` has the trajectory.
    """

    known: TrajectoryGuess

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on a number of equal intervals."""
        return add_noise(problem, self.known.guess(problem, target, intervals), NOISE, 0)


def convert_guess(problem: Problem, guess: Guess) -> ForceGuess:
    """Convert a guess for rest lengths to force densities.

    The guess may also have rates of rest lengths as control.
    """
    middle = (guess.states[1:] + guess.states[:-1]) / 2
    forces = forces_of(build_smooth_model(problem.model), middle, guess.force_density)
    states = drop_internal_states(problem.model, guess.states)
    return ForceGuess(TrajectoryGuess(states, forces, guess.duration))


def is_converted(plan: PlanResult) -> bool:
    """Return whether a plan was converted from force densities, the unknowns of its duals."""
    if plan.duals is None or plan.control is plan.force_density:
        return False
    unknowns = plan.duals.names[-len(plan.duals.point) :]
    return any(name.startswith("force density of ") for name in unknowns)


def is_limited_at_instants(plan: PlanResult) -> bool:
    """Return whether a plan satisfies the limits of `limit_instants`."""
    return plan.duals is not None and any(AT_INSTANT in name for name in plan.duals.names)


def restore_forces(plan: PlanResult) -> PlanResult:
    """Convert a plan of rest lengths, or of their rates, back to force densities.

    Its duals are those in force densities, which `convert_outcome` keeps.
    """
    motion, model = plan.trajectory, plan.require_model("solve")
    states = drop_internal_states(model, motion.states)
    return replace(
        plan,
        trajectory=replace(motion, states=states),
        inputs=None,
        input_attribute="force_density",
    )


def tighten_limits(
    problem: Problem, twin: Problem, fractions: Array, found: Outcome
) -> Problem | None:
    """Tighten the limits of `limit_instants`.

    They hold at the mesh points, and the converted rest lengths of `found` may exceed them in
    between. Returns None if they do not, if the states between mesh points diverge, or without such
    limits. `twin` is the problem in force densities. `fractions` are the interval lengths relative
    to the duration.
    """
    if not any(isinstance(bound, RestLengthSpeeds | TautStrings) for bound in twin.bounds):
        return None
    locked = lock_winches(problem) if problem.model.na else problem
    if locked is None or not (found.success or found.coarse):
        return None
    structure, damping = problem.model.scene.structure, slackening_damping(problem.model)
    converter = _Converter(locked, fractions, found)
    nodes = converter.nodes(converter.count_parts())
    states, planned, rest = converter.evaluate(nodes)
    lengths, rates = measure_strings(converter.forces, states)
    winding = np.diff(rest, axis=0) / np.diff(found.duration * nodes)[:, None]
    fast = np.abs(winding).max(axis=0) / combine_rates(structure, problem.bounds)
    # of all strings, as those that go slack change with the limits
    shortage = float(np.max(damping * rates / lengths - planned))
    if not 0.0 < np.max([fast.max() - 1.0 - RESOLUTION, shortage]) < np.inf:
        return None
    slower = np.maximum(fast, 1.0) * (1.0 + RESOLUTION)
    bounds = [
        replace(bound, rate=bound.rate / slower)
        if isinstance(bound, RestLengthSpeeds)
        else replace(bound, least=bound.least + max(shortage, 0.0))
        if isinstance(bound, TautStrings)
        else bound
        for bound in twin.bounds
    ]
    return replace(twin, bounds=bounds)


def convert_outcome(
    problem: Problem, fractions: Array, found: Outcome, finest: bool = False
) -> Outcome:
    """Convert a result in force densities to rest-length control.

    `fractions` are the interval lengths relative to the duration, `found` is the result. With
    `finest`, intervals have the largest number of parts. Piecewise-linear force densities become
    rest lengths, their rates, or motor torques. Rates are constant where rest lengths are linear.
    They lag behind where damping would require rates beyond the limits. Torques follow from the
    inverse dynamics of the motors, whose speeds jump between the intervals: they are only a guess.
    See `_convert_rest_lengths`.
    """
    locked = lock_winches(problem) if problem.model.na else problem
    if locked is None:
        raise ValueError("the problem has no counterpart in rest lengths")
    finer = None if finest else partial(convert_outcome, problem, fractions, found, True)
    found = _convert_rest_lengths(locked, fractions, found._replace(finer=finer))
    control = problem.model.scene.control
    if not problem.model.na or found.time is None or control is None:
        return found
    rest, start = np.array(found.force_density), problem.model.split(np.asarray(problem.start))
    rest[0] = start.internal[: rest.shape[1]]
    tension = _find_tensions(locked.model, found.states, rest)
    limits, steps = problem.control_limits, np.diff(found.time)
    internal, inputs = control.follow(rest, (tension[1:] + tension[:-1]) / 2, steps, limits)
    kept = locked.model.split(found.states)
    own = np.vstack([start.internal, internal])
    states = np.hstack([kept.positions, kept.velocities, own, kept.clock])
    return found._replace(states=states, force_density=inputs)


def _find_tensions(model: Model, states: Array, rest: Array) -> Array:
    """Compute the tensions (K, α) [N] at rest lengths `rest` [m].

    States are (K, nx), rest lengths (K, α).
    """
    lengths = distances(model.nodes(states), model.structure.strings)
    return np.asarray(forces_of(build_smooth_model(model), states, rest) * lengths)


def _convert_rest_lengths(problem: Problem, fractions: Array, found: Outcome) -> Outcome:
    """Convert a result in force densities to rest lengths.

    `found` is the result. `fractions` are the lengths of the intervals relative to the duration.
    The rest lengths are linear on parts of the intervals, short enough that the force densities
    between their ends are nearly those of the plan. The result fails if they violate a limit of the
    problem. As in the nonlinear programs of elastic strings, strings do not go slack (see
    `build_smooth_model`); the description of the result names those that would, which more rest
    lengths do not prevent. Without `found.finer`, intervals have the largest number of parts.
    """
    converter = _Converter(problem, fractions, found)
    smooth = replace(problem, model=converter.model)
    solved = found.success or found.coarse
    # Limits were imposed at the ends of whole intervals, and may be exceeded between them.
    most = MAX_PARTS if found.finer is None else converter.count_parts()
    for parts in (most, 1) if solved else (1,):
        nodes = converter.nodes(parts)
        states, _, rest = converter.evaluate(nodes)
        time = found.duration * nodes
        broken = violated_limits(smooth, time, states, rest) if solved else ()
        if not broken:
            break
    slack = (rest > 0) & (forces_of(problem.model, states, rest) <= 0.0)
    slack &= forces_of(converter.model, states, rest) > 0.0
    note = ""
    if solved and slack.any():
        named = ", ".join(map(str, np.flatnonzero(slack.any(axis=0))))
        note = f"; strings {named} go slack where damping exceeds the planned tension"
    why = f"under rest-length control, the motion violates {broken[0]}" if broken else found.why
    return found._replace(
        states=states,
        force_density=rest,
        time=time,
        success=found.success and not broken,
        coarse=found.coarse and not broken,
        why=why,
        imposed=f"{found.imposed}{note}",
        finer=None if note else found.finer,
    )


class _Converter:
    """Conversion of a plan in force densities to rest lengths.

    It interpolates the states between mesh points, and evaluates force densities and rest lengths
    there.
    """

    def __init__(self, problem: Problem, fractions: Array, found: Outcome) -> None:
        self.model = build_smooth_model(problem.model)
        self.intervals, self.controls = fractions, found.force_density
        self.limits = problem.control_limits
        self.forces = build_force_density_model(problem.model)
        self.states, self.duration = found.states, found.duration

    def nodes(self, parts: int) -> Array:
        """Divide each mesh interval into equal parts.

        Returns the ends of all parts as fractions of the duration, from 0 to 1.
        """
        return np.append(0.0, np.cumsum(np.repeat(self.intervals / parts, parts)))

    def evaluate(self, shares: Array) -> tuple[Array, Array, Array]:
        """Compute states, planned force densities and rest lengths at given times.

        `shares` are the times as fractions of the duration. The rest lengths are those of elastic
        strings with the planned force densities. They depend linearly on these.
        """
        nodes = self.nodes(1)
        states = trace_motion(
            self.forces, self.duration * nodes, self.states, self.controls, self.duration * shares
        )
        planned = profile_at(self.controls, nodes, shares)
        length = np.tile(self.model.scene.structure.string_lengths, (len(shares), 1))
        zero, full = (forces_of(self.model, states, part * length) for part in (0.0, 1.0))
        rest = length * (zero - planned) / (zero - full)
        return states, planned, np.clip(rest, *self.limits)

    def count_parts(self) -> int:
        """Choose the number of parts into which intervals are divided.

        It is 1 if the states between mesh points diverge.
        """
        nodes = self.nodes(1)
        rest = self.evaluate(nodes)[2]
        states, planned, _ = self.evaluate((nodes[1:] + nodes[:-1]) / 2)
        error = np.abs(forces_of(self.model, states, (rest[1:] + rest[:-1]) / 2) - planned).max()
        typical = float(np.sqrt(np.mean(planned**2)))
        parts = np.ceil(np.sqrt(error / (FORCE_ERROR * typical)))
        return int(np.clip(parts, 1, MAX_PARTS)) if np.isfinite(parts) else 1
