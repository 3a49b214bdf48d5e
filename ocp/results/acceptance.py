"""Acceptance test of plans.

The replay is compared with the user's goals, waypoints and limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.diagnosis import explain_undefined, find_long_steps, interpolate_plan
from ocp.results.error_growth import UNSTABLE
from ocp.results.report import Finding, report_of, violated_limits
from ocp.results.result import PlanResult, Replayed
from ocp.results.terminal_limits import measure_terminal_limits
from ocp.solvers.base import Outcome
from ocp.targets.target import StateAt, Target
from ocp.transcription.mesh import held_values
from tenscasadi.scene.failed_strings import describe_overload
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array

# of a plan, in open loop or under `track`; None if the search stopped before
Replay = Callable[[PlanResult, bool], Replayed | None]

UNFINISHED = "its replay was not finished in time"
NO_PLAN = "no plan: "  # start of the message of a search without a result


class ReplayMeasures(NamedTuple):
    """Goal residuals of several replays.

    Attributes
    ----------
    position, velocity : ndarray, shape (n,)
        Largest residuals [m and m/s].
    rows : ndarray, shape (n, m)
        All residuals; velocities as the distance over the duration [m].
    worst : str
        Name of the goal row with the largest residual of the first replay.
    """

    position: Array
    velocity: Array
    rows: Array
    worst: str = ""


def measure_errors(plan: PlanResult, target: Target | None, state_at: StateAt) -> ReplayMeasures:
    """Compute the goal residuals of several trajectories.

    `state_at` returns their states (n, nx) at a fraction of the duration. Residuals refer to the
    user's goals and waypoints. Without goals they refer to the final state of the plan. `target`
    has the goals.
    """
    duration, worst = float(plan.time[-1]), ""
    if target is not None and any(part.names for _, part, _ in target.instants):
        found = target.measure(state_at)
        position, velocity = found.select("m"), found.select("m/s")
        worst = found.find_worst(duration)[0]
    else:
        model, end = plan.require_model("replay"), plan.trajectory.states[-1]
        position, velocity = (
            np.linalg.norm(values(np.atleast_2d(state_at(1.0))) - values(end), axis=2)
            for values in (model.nodes, model.velocities)
        )
    rows = np.hstack([position, velocity * duration])
    largest, fastest = (part.max(axis=1, initial=0.0) for part in (position, velocity))
    return ReplayMeasures(largest, fastest, rows, worst)


def interpolate_replays(times: Array, states: Array) -> StateAt:
    """Interpolate the states of n replays linearly between time steps.

    The states (n, T, nx) are given at times (T,) [s].
    """

    def state_at(share: float) -> Array:
        k = min(int(np.searchsorted(times, share * times[-1], side="right")), len(times) - 1)
        part = (share * times[-1] - times[k - 1]) / (times[k] - times[k - 1])
        return np.asarray((1 - part) * states[:, k - 1] + part * states[:, k])

    return state_at


class _Verified(NamedTuple):
    """Replay of a plan and its errors.

    Attributes
    ----------
    motion : Trajectory or None
        The replay; None if it failed.
    position, velocity : float
        Largest residuals of the goals [m and m/s], over all replays; NaN if the replay failed.
    note : str
        Cause of a failure, or the violated terminal limit; "" without either.
    goal : str
        Name of the goal row with the largest error.
    """

    motion: Trajectory | None
    position: float
    velocity: float
    note: str = ""
    goal: str = ""

    def worst(self, duration: float) -> float:
        """Compute the larger of position and velocity error [m].

        The velocity error counts as velocity × duration. A failed replay has infinite error.
        """
        return float(np.nan_to_num(max(self.position, self.velocity * duration), nan=np.inf))

    def describe(self, name: str, success: bool) -> str:
        """Describe the final errors of the replay for a message.

        `name` is the kind of replay, such as "replay". Without `success`, the text adds the goal
        with the largest residual.
        """
        if np.isnan(self.position):
            return self.note
        text = f"its {name} ends {self.position:.2g} m and {self.velocity:.2g} m/s from the goals"
        if self.note:
            return f"{text}, and there {self.note}"
        return f"{text}, farthest in {self.goal}" if self.goal and not success else text


def assess_plan(
    plan: PlanResult,
    target: Target,
    found: Outcome,
    tolerance: float,
    replay: Replay,
    tracked: bool,
    scene: Scene,
) -> PlanResult:
    """Accept or reject a plan by its replay.

    `found` is the result of the attempt, `target` has its goal rows. The replay must meet goals,
    waypoints and terminal limits within the tolerance, and the plan all limits at mesh points,
    which plans with slack strings can violate although the solver converged. Its convergence is not
    required. By default the open-loop replay counts. The replay under the feedback of `track`
    counts instead if `tracked` is True, or if errors grow so fast that no open-loop simulation
    follows the plan, see `describe_growth`. The objective has to be finite, unlike that of a guess,
    with which an early stop ends. `scene` is that of the user's problem, whose strings can break or
    yield. Returns the plan with its errors, success and message.
    """
    target = target.begin_at(found.states[0])
    duration = float(plan.time[-1])
    whole = np.all(np.isfinite(plan.force_density)) and duration > 0
    open_loop = counts = (
        _verify(plan, target, replay, False)
        if whole
        else _Verified(None, np.nan, np.nan, "its force densities or its duration are not finite")
    )
    missed = find_missed_goal(plan, target, tolerance) if whole else ""
    growth = ""
    if whole and open_loop.worst(duration) > tolerance and open_loop.note != UNFINISHED:
        growth = describe_growth(plan, tolerance)
    if tracked or growth:
        counts = _verify(plan, target, replay, True)
    plan = replace(
        plan,
        tracked=counts is not open_loop,
        replay_error=counts.position,
        replay_speed_error=counts.velocity,
        open_loop_error=open_loop.worst(duration),
    )
    broken = _find_violated(plan)
    good = counts.worst(duration) <= tolerance and not broken and bool(np.isfinite(found.objective))
    overload = _describe_overload(scene, counts.motion)
    success = good and not overload
    name = "tracked replay" if plan.tracked else "replay"
    if good and overload:
        verdict, overload = f"{NO_PLAN}{overload}", ""
    elif good:
        verdict = _accepted(found)
    elif counts.note == UNFINISHED and (found.success or found.coarse):
        verdict = f"the plan after {found.iterations} iterations is unchecked: increase time_limit"
    elif broken and (found.success or found.coarse) and counts.worst(duration) <= tolerance:
        verdict = f"{NO_PLAN}after {found.iterations} iterations, the motion violates {broken[0]}"
    else:
        verdict = _rejected(plan, found, tolerance, name, missed)
    ends = counts.describe(name, success)
    if plan.tracked:
        reason = growth or "tracked=True"
        ends += f"; it counts, as {reason}; {open_loop.describe('open-loop replay', True)}"
        ends += ": track the plan by ocp.track(plan) or ocp.Mpc(problem, plan=plan)" * success
    beyond = _describe_violation(plan, counts.motion) if success else ""
    parts = verdict, found.imposed, ends, overload, beyond
    planned = replace(plan.trajectory, success=plan.trajectory.success or success)
    message = "; ".join(part for part in parts if part)
    return replace(plan, success=success, message=message, trajectory=planned)


def _verify(plan: PlanResult, target: Target, replay: Replay, tracked: bool) -> _Verified:
    """Replay a plan and compute its terminal errors.

    Errors are the distances from the goals, and from states within the terminal limits. `target`
    has the goals. With `tracked`, the replay is that under the feedback of `track`.
    """
    found = replay(plan, tracked)
    failure = UNFINISHED if found is None else found.failure
    if found is None or failure:
        return _Verified(None, np.nan, np.nan, failure)
    measured = [_measure(plan, target, motion) for motion in found.motions]
    worst = max(measured, key=lambda one: one.worst(float(plan.time[-1])))
    return worst._replace(motion=found.motions[0])


def _measure(plan: PlanResult, target: Target, motion: Trajectory) -> _Verified:
    """Compute the terminal errors of one replay.

    `motion` is the replay, `target` has the goals.
    """
    errors = measure_errors(plan, target, interpolate_replays(motion.time, motion.states[None]))
    position, velocity = float(errors.position[0]), float(errors.velocity[0])
    if plan.problem is None:
        return _Verified(motion, position, velocity, "", errors.worst)
    limit = measure_terminal_limits(plan.problem, plan, motion)
    worst = max(position, float(plan.time[-1]) * velocity)
    note = limit.message if limit.distance > worst else ""
    return _Verified(motion, max(position, limit.distance), velocity, note, errors.worst)


def find_missed_goal(plan: PlanResult, target: Target, tolerance: float) -> str:
    """Find the goal row that the plan itself violates most.

    Waypoints are evaluated by the interpolant of their constraints, see `build_interpolant`.
    `target` has the goals. Returns "" if the planned states meet all goals within the tolerance
    [m].
    """
    errors = measure_errors(plan, target, interpolate_plan(plan))
    return "" if errors.rows.max(initial=0.0) <= tolerance else errors.worst


def _find_violated(plan: PlanResult) -> tuple[Finding, ...]:
    """Find the limits that the planned trajectory violates at mesh points."""
    if plan.problem is None:
        return ()
    return violated_limits(plan.problem, plan.time, plan.trajectory.states, plan.control)


def describe_growth(plan: PlanResult, tolerance: float) -> str:
    """Describe the growth of errors in open loop.

    `tolerance` is that of the goals [m]. Returns "" if the growth is small or unknown. In phases,
    the contact nodes of the plan do not sink into the ground. The depth to which they sink at rest
    is an error that no finer mesh reduces. If it grows beyond the tolerance, the growth is not
    small.
    """
    # A small error shifts the times of contact, which the state transition does not describe. In
    # phases they are given.
    model, problem = plan.require_model("solve"), plan.problem
    phased = problem is not None and bool(problem.phases)
    if (model.scene.grounds and not phased) or np.isnan(plan.trajectory.states).any():
        return ""
    growth = plan.error_growth
    text = f"errors grow {growth:.2g}-fold in open loop"
    if growth > UNSTABLE:
        return text
    depth = _measure_depth(problem) if problem is not None and phased else 0.0
    if growth * depth > tolerance:
        return f"{text} and contact nodes sink {depth:.2g} m into the ground"
    return ""


def _measure_depth(problem: Problem) -> float:
    """Compute the penetration depth of contact nodes at rest [m]."""
    scene = problem.model.scene
    counts = [len(phase.contact_nodes) for phase in problem.phases if phase.contact_nodes]
    if not counts or scene.gravity is None:
        return 0.0
    weight = Scales.of(problem).mass * float(np.linalg.norm(scene.gravity.acceleration))
    return weight / (scene.grounds[0].stiffness * min(counts))


def _accepted(found: Outcome) -> str:
    text = f"found after {found.iterations} iterations"
    if found.success or found.coarse:
        return text
    return f"{text}; the cost is not settled: {found.why.split('; ')[0]}"


def _rejected(plan: PlanResult, found: Outcome, tolerance: float, name: str, missed: str) -> str:
    if not (found.success or found.coarse):
        return f"{NO_PLAN}{found.why}"
    if not np.isfinite(found.objective):
        return f"{NO_PLAN}{explain_undefined('the sum of Problem.costs')}"
    text = f"a plan was found after {found.iterations} iterations, but its {name} misses by"
    text = f"{text} more than {tolerance:.2g} m (or {tolerance:.2g} m per duration)"
    if found.coarse:
        text = f"{text}; {found.why}"
    if missed and not found.coarse:
        return (
            f"{text}; so does the planned motion itself, farthest in {missed}: give another guess"
        )
    return f"{text}: {_advise(plan, found)}, or plan.refine({tolerance:.2g})"


def _advise(plan: PlanResult, found: Outcome) -> str:
    """Advise how to reduce the error of the replay.

    `found` is the result of the attempt.
    """
    if plan.problem is not None and plan.problem.phases:
        return "give a harder ground, more damping of it, or longer phases"
    too_long = ""
    if found.time is None and plan.transcription is not None:
        held = held_values(found.force_density, plan.transcription.count)
        step = plan.transcription.longest_step(found.duration)
        model = plan.require_model("solve")
        too_long = find_long_steps(model, found.states, held, step, found.duration)
    return too_long or "give more intervals, or substeps"


def _describe_overload(scene: Scene, motion: Trajectory | None) -> str:
    """Describe a string that breaks or yields in a replay.

    This happens between mesh points. Returns "" if there is none. `motion` is the replay, or None
    without a valid one.
    """
    if motion is None:
        return ""
    found = describe_overload(scene, motion.tension.max(axis=0, initial=0.0))
    kind = type(scene.strength).__name__
    return found and f"{found} between mesh points: give more intervals, or a larger {kind}.margin"


def _describe_violation(plan: PlanResult, motion: Trajectory | None) -> str:
    """Describe the largest limit violation of a replay with contact.

    The limits hold at mesh points, so that the violation is between them. Returns "" if there is
    none, and for scenes without ground. `motion` is the replay, or None without a valid one.
    """
    problem: Problem | None = plan.problem
    if problem is None or motion is None or not problem.model.scene.grounds:
        return ""
    states, control = plan.trajectory.states, plan.control
    broken = report_of(problem, plan.time, states, control, motion, None).violated
    if not broken:
        return ""
    worst = max(broken, key=lambda one: abs(one.worst - one.limit) / (abs(one.limit) or 1.0))
    unit = worst.unit and f" {worst.unit}"
    return (
        f"{worst.name} is {worst.worst:.3g}{unit} at {worst.time:.3g} s, "
        f"beyond its limit of {worst.limit:g}: see report()"
    )
