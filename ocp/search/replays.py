"""Replays of plans, in open loop or under feedback."""

from __future__ import annotations

from ocp.control.lqr import replay_tracked
from ocp.results.replay import replay_in_doubt
from ocp.results.result import PlanResult, Replayed


def replay_plan(plan: PlanResult, tracked: bool) -> Replayed:
    """Replay a plan, under `track` if `tracked` is True.

    If no feedback gains are found, the result has no replay, and `failure` gives the reason.
    """
    if not tracked:
        return replay_in_doubt(plan, plan.require_model("replay"))
    try:
        motion = replay_tracked(plan)
    except ValueError as error:
        return Replayed((), f"ocp.track does not keep to it: {error}")
    return Replayed((motion,), "" if motion.success else f"its tracked replay {motion.message}")
