"""Whether a plan is a success: its replay against the goals, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ocp.results.error_growth import UNSTABLE
from ocp.results.explanation import long_steps, measure_misses
from ocp.results.report import report_of
from ocp.results.result import PlanResult
from ocp.results.terminal_limits import broken_at_end
from ocp.solvers.base import Outcome
from ocp.targets.target import Target
from ocp.transcription.mesh import held_values
from tenscasadi.simulation.trajectory import Trajectory

Replay = Callable[[PlanResult], Trajectory]

_KEEP = "keep to it by ocp.track(plan) or ocp.Mpc(problem, plan=plan)"


def assess_plan(
    plan: PlanResult,
    target: Target,
    found: Outcome,
    tolerance: float,
    replay: Replay,
    automatic: bool = False,
) -> PlanResult:
    """Judge a plan by its replay.

    automatic: whether the package chose how near the motion has to be to fine steps, and not the
    user: then the replay alone counts. Returns the plan with its errors, success and message.
    """
    error, speed_error, why, replayed = _replay_errors(
        plan, target.begin_at(found.states[0]), replay
    )
    plan = replace(plan, replay_error=error, replay_speed_error=speed_error)
    how = "its replay under ocp.track" if plan.tracked else "its replay"
    found = found._replace(
        success=found.success or (automatic and found.coarse and plan.worst_error <= tolerance)
    )
    success, verdict = _verdict(
        plan, found, tolerance, f"at the end of {how} {why}" if why and np.isfinite(error) else ""
    )
    ends = (
        f"{how} ends {error:.2g} m and {speed_error:.2g} m/s from the goal"
        if np.isfinite(error)
        else why or f"{how} diverges"
    )
    parts = verdict, found.imposed, ends, _overstepped(plan, replayed) if success else ""
    return replace(plan, success=success, message="; ".join(part for part in parts if part))


def _overstepped(plan: PlanResult, replayed: Trajectory | None) -> str:
    """Tell which limit is broken most where nodes bounce on a ground between the nodes of the mesh, at which alone limits hold."""
    problem = plan.problem
    if problem is None or replayed is None or not problem.model.scene.grounds:
        return ""
    broken = report_of(
        problem, plan.time, plan.trajectory.states, plan.control, replayed, None
    ).violated
    if not broken:
        return ""
    worst = max(broken, key=lambda one: abs(one.worst - one.limit) / (abs(one.limit) or 1.0))
    unit = worst.unit and f" {worst.unit}"
    return (
        f"{worst.name} is {worst.worst:.3g}{unit} at {worst.time:.3g} s, "
        f"beyond its limit of {worst.limit:g}: see report()"
    )


def _verdict(plan: PlanResult, found: Outcome, tolerance: float, broken: str) -> tuple[bool, str]:
    """Tell whether the plan is a success, and what is to be said of it. broken: the limit of the end that its replay misses more than goals."""
    growth = "" if np.isnan(found.states).any() else _told_growth(plan)
    if not found.success:
        return False, f"{found.why}; {growth}" if growth and plan.duals is not None else found.why
    if plan.worst_error <= tolerance:
        return True, f"found after {found.iterations} iterations" + (
            f"; {growth}: {_KEEP}" if growth else ""
        )
    within = f"more than {tolerance:.2g} m (or {tolerance:.2g} m per duration)"
    beyond = f"{broken}: {within}" if broken else f"its replay misses the goal by {within}"
    told = f"a plan was found after {found.iterations} iterations, but {beyond}"
    if growth and not plan.tracked:
        return (
            False,
            f"{growth}: {told}: {_KEEP}, and judge it so by solve(..., tracked=True), or give plan.refine({tolerance:.2g})",
        )
    return False, f"too coarse: {told}: {_finer(plan, found)}, or plan.refine({tolerance:.2g})"


def _told_growth(plan: PlanResult) -> str:
    if plan.known_model("solve").scene.grounds:
        return ""  # contact begins and ends a little sooner or later: no derivative tells
    growth = plan.error_growth
    return f"open-loop unstable: errors grow {growth:.2g}-fold" if growth > UNSTABLE else ""


def _finer(plan: PlanResult, found: Outcome) -> str:
    """Tell what makes a replay miss less."""
    if plan.problem is not None and plan.problem.phases:
        return "give a harder ground, more damping of it, or longer phases"
    too_long = ""
    if found.time is None and plan.transcription is not None:
        held, step = (
            held_values(found.force_density, plan.transcription.count),
            plan.transcription.longest_step(found.duration),
        )
        too_long = long_steps(plan.known_model("solve"), found.states, held, step, found.duration)
    return too_long or "give more intervals, or substeps"


def _replay_errors(
    plan: PlanResult, target: Target, replay: Replay
) -> tuple[float, float, str, Trajectory | None]:
    """Measure how far the replay ends from the goals, and from limits of the end; without goals for the place (or speed) from the plan.

    NaN where it does not get there; and why, where that is known, or which limit of the end is
    missed most. And the replay.
    """
    if not np.all(np.isfinite(plan.force_density)) or not plan.time[-1] > 0:
        return np.nan, np.nan, "", None
    try:
        replayed = replay(plan)
    except ValueError as error:
        if not plan.tracked:
            raise
        return np.nan, np.nan, f"ocp.track does not keep to it: {error}", None
    if not replayed.success:
        return np.nan, np.nan, "", None
    times = replayed.time / replayed.time[-1]
    missed = measure_misses(
        target,
        lambda share: np.array([np.interp(share, times, column) for column in replayed.states.T]),
    )
    metres, speeds = ([amount for amount, _ in rows] for rows in missed)
    if not metres:
        metres = np.linalg.norm(replayed.nodes[-1] - plan.trajectory.nodes[-1], axis=1).tolist()
    if (
        not speeds
        and plan.problem is not None
        and plan.problem.model.scene.grounds
        and any(part.names for _, part, _ in target.instants)
    ):
        speeds = [0.0]  # on a ground that gives way nodes vibrate: what has no goal is not measured
    if not speeds:
        speeds = np.linalg.norm(
            replayed.velocities[-1] - plan.trajectory.velocities[-1], axis=1
        ).tolist()
    if plan.problem is None:
        return float(max(metres)), float(max(speeds)), "", replayed
    ends = np.array([plan.trajectory.states[-1], replayed.states[-1]])
    broken = broken_at_end(
        plan.problem, ends, np.array([plan.control[-1], replayed.control[-1]]), float(plan.time[-1])
    )
    told = broken.told if broken.distance > max(*metres, float(plan.time[-1]) * max(speeds)) else ""
    return float(max(*metres, broken.distance)), float(max(speeds)), told, replayed
