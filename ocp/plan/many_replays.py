"""Batches of replays that measure the robustness of plans.

Replays are in open loop, or under the feedback of `track`. They apply the planned control, or rest
lengths that produce it.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ocp.plan.robustness import (
    STRINGS,
    Robustness,
    draw_starts,
    share_variance,
    vary_model,
)
from ocp.problem.control import controls_force_densities
from ocp.problem.phase import reject_phases
from ocp.problem.rows import RELIABLE
from ocp.problem.scaling import Scales
from ocp.results.acceptance import interpolate_replays, measure_errors
from ocp.results.actuation import STEPS_PER_UPDATE
from ocp.results.rest_length_schedule import compute_rest_lengths
from ocp.results.result import STEPS
from ocp.results.spreads import check_variation
from ocp.targets.find_target import find_target
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import RestLength, Tension, rest_length
from tenscasadi.simulation.inputs.controls import ControlProfile
from tenscasadi.simulation.inputs.feedback import Feedback
from tenscasadi.simulation.rollouts import rollouts
from tenscasadi.simulation.verdict.endings import INTERRUPTED
from tenscasadi.structure.class_one import distances, measure_diagonal
from tenscasadi.util.validate import MAX_ENTRIES, Array, positive_number, whole_number


def measure_robustness(
    plan: Any,
    parameters: Any,
    start: Any,
    samples: int,
    seed: int,
    tolerance: float | None,
    track: Callable[..., Any] | None,
    progress: bool = False,
) -> Robustness:
    """Replay a plan with varied parameters and initial states.

    Arguments and errors are those of `Plan.robustness`. `track` builds a `Tracker` of the plan;
    None replays it in open loop.
    """
    spreads, place = check_variation(parameters, start)
    whole_number("samples", samples, 1, MAX_ENTRIES)
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    limit = None if tolerance is None else positive_number("tolerance", tolerance)
    names = tuple(spreads)
    planned, problem = plan.require_model("robustness"), plan.problem
    reject_phases(() if problem is None else problem.phases, "robustness")
    model, feedback, step = _build_replay(plan, names, track)
    draws = rng.uniform(-1, 1, (samples, len(names)))
    factors = 1 + draws * np.array(list(spreads.values()))
    starts, changes = draw_starts(model, plan.trajectory.states[0], place, factors, rng)
    began = clock.perf_counter()
    ways = [] if problem is None else problem.waypoints
    rolled = rollouts(
        model,
        float(plan.time[-1]),
        step,
        starts,
        feedback,
        factors if names else None,
        save_every=1 if ways else None,
        progress=progress,
    )
    seconds = clock.perf_counter() - began
    ended = ~np.char.startswith(rolled.message, INTERRUPTED)
    if not ended.any():
        raise KeyboardInterrupt
    misses = _measure_misses(plan, rolled.time, rolled.states[ended])
    success = rolled.success[ended]
    if limit is None:
        limit = RELIABLE * (measure_diagonal(planned.structure.nodes) or 1.0)
    varied = {name: draws[ended][:, [k]] for k, name in enumerate(names)}
    if any(place):
        varied["start"] = changes[ended]
    return Robustness(
        names=tuple(varied),
        factors=factors[ended],
        starts=starts[ended],
        error=np.where(success, misses.position, np.inf),
        speed_error=np.where(success, misses.velocity, np.inf),
        duration=float(plan.time[-1]),
        tolerance=limit,
        importance=share_variance(varied, np.where(success[:, None], misses.rows, np.nan)),
        tracked=track is not None,
        seconds=seconds,
        interrupted=rolled.interrupted,
    )


def _build_replay(
    plan: Any, names: tuple[str, ...], track: Callable[..., Any] | None
) -> tuple[Model, Feedback | ControlProfile, float]:
    """Build model, control and longest time step [s] of replays.

    The model has the varied quantities `names` as parameters. `track` builds a `Tracker` of the
    plan; None replays it in open loop.
    """
    planned = plan.require_model("robustness")
    elastic = _needs_rest_lengths(planned, names)
    model = vary_model(planned, names, RestLength() if elastic else planned.scene.control)
    decisions = STEPS * (len(plan.time) - 1) if elastic else None
    tracker = None if track is None else track(plan, decisions=decisions)
    convert = _convert_to_rest_lengths if elastic else _control_as_planned
    control, step = convert(plan, tracker)
    return model, control, step


def _measure_misses(plan: Any, time: Array, states: Array) -> Any:
    """Compute the goal residuals of n replays.

    Their states (n, T, nx) are given at times (T,) [s].
    """
    target = None
    if plan.problem is not None:
        found = find_target(plan.problem, Scales.of(plan.problem), tolerance=np.inf)
        target = found.begin_at(plan.trajectory.states[0])
    return measure_errors(plan, target, interpolate_replays(time, states))


def _needs_rest_lengths(planned: Model, names: Sequence[str]) -> bool:
    """Return whether replays need rest lengths as control.

    This is so if string parameters are among the varied `names`, as prescribed force densities do
    not depend on them. `planned` is the model of the plan.
    """
    if not any(name in STRINGS for name in names):
        return False
    control = planned.scene.control
    if isinstance(control, Tension):
        raise ValueError(
            f"parameters is {', '.join(names)}: under {control} tensions do not depend on stiffness or damping, vary others or plan with RestLength()"
        )
    return controls_force_densities(planned)


def _control_as_planned(plan: Any, tracker: Any) -> tuple[Feedback | ControlProfile, float]:
    """Build a replay's control and its longest time step [s].

    The control is the planned control over time, or the feedback of `track`. `tracker` is None in
    open loop.
    """
    longest = float(np.diff(plan.time).min()) / STEPS
    if tracker is not None:
        return Feedback(
            tracker.time,
            tracker.inputs,
            tracker.states,
            tracker.gains,
            tracker.lower,
            tracker.upper,
        ), longest
    return ControlProfile(plan.time, plan.control, STEPS), float(plan.time[-1])


def _convert_to_rest_lengths(plan: Any, tracker: Any) -> tuple[Feedback, float]:
    """Build a replay's rest-length control and longest time step.

    `tracker` is None in open loop. The control realizes the force densities of the plan, or of its
    tracking feedback, at the planned string lengths s. The step is in seconds.

    With ρ = s (1 − γ/k) (Eq. 99), the feedback law γ_k − G (x − x_k) becomes ρ_k + (s/k) G (x −
    x_k).
    """
    plan.rest_lengths()  # raises an error that names a string of too low stiffness
    k, size = plan.structure.stiffness, plan.trajectory.states.shape[1]
    time, rest = compute_rest_lengths(plan, k, STEPS)
    if tracker is None:
        return _open_loop(time, rest, size), float(np.diff(time).min()) / STEPS_PER_UPDATE
    model = plan.require_model("robustness")
    s = distances(model.nodes(tracker.states), plan.structure.strings)[:-1]
    lower, upper = (
        rest_length(np.minimum(tracker.upper, k), s, k).min(axis=0),
        rest_length(tracker.lower, s, k).max(axis=0),
    )
    control, gains = rest_length(tracker.inputs, s, k), -(s / k)[:, :, None] * tracker.gains
    return Feedback(
        tracker.time, control, tracker.states, gains, np.maximum(lower, 1e-6 * s.min()), upper
    ), float(np.diff(time).min()) / STEPS_PER_UPDATE


def _open_loop(time: Array, controls: Array, size: int) -> Feedback:
    """Convert piecewise-constant controls to a feedback with zero gains.

    Controls (K, α) apply between successive times (K + 1,). `size` is the number of states.
    """
    count, strings = controls.shape
    return Feedback(time, controls, np.zeros((count + 1, size)), np.zeros((count, strings, size)))
