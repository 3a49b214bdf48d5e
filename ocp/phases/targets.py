"""Goals and final states of contact phases.

Goal rows that contact nodes satisfy anyway are omitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.problem.start import FreeStart
from ocp.targets.find_target import find_target
from ocp.targets.infeasible_goal import InfeasibleGoalError
from ocp.targets.row_reduction import reduce_rows
from ocp.targets.target import Target, WaypointTarget
from tenscasadi.util.validate import Array


def phase_problems(problem: Problem, air: Problem) -> list[Problem]:
    """Build the separate problem of each phase.

    All of them have the initial state of the plan, and the last one has also the goals of the whole
    problem. `air` is the problem without its ground and its phases.
    """
    goals = [phase.goals for phase in problem.phases]
    goals[-1] = (*goals[-1], *problem.goals)
    return [
        replace(air, duration=phase.duration, goals=own, bounds=(*problem.bounds, *phase.bounds))
        for phase, own in zip(problem.phases, goals, strict=True)
    ]


def find_targets(
    problem: Problem, parts: Sequence[Problem], scales: Scales, tolerance: float
) -> list[Target]:
    """Find a final state of each phase that meets its goals.

    The search starts at the final state of the preceding phase. Raises `InfeasibleGoalError`, which
    names the phase. `parts` are the problems of the phases, and `tolerance` is that of their goals
    [m].
    """
    own = tolerance / scales.length
    targets, near, since_start = [], problem.initial_state, set(problem.phases[0].contact_nodes)
    for k, (phase, part) in enumerate(zip(problem.phases, parts, strict=True)):
        try:
            target = find_target(replace(part, start=FreeStart(near)), scales, tolerance=own)
        except InfeasibleGoalError as error:
            raise InfeasibleGoalError(f"phase {k}: {error}", error.certificate) from None
        since_start &= set(phase.contact_nodes)
        targets.append(
            _without_standing(target, part, phase.contact_nodes, sorted(since_start), scales)
        )
        if target.state is not None:
            near = target.state.copy()
            near[part.model.nq :] = 0.0
    targets[0] = replace(targets[0], start=problem.initial_state)
    return [replace(target, free_start=None) for target in targets]


def join_targets(targets: Sequence[Target], ends: Array) -> Target:
    """Join the targets of all phases into one.

    A target is a final state with independent goal rows. Those of intermediate phases become
    waypoints at the fractions `ends` of the duration.
    """
    start = targets[0].start
    on_the_way = [
        WaypointTarget(float(end), part) for end, part in zip(ends[:-1], targets[:-1], strict=True)
    ]
    return replace(
        targets[-1],
        start=start,
        waypoints=tuple(one for one in on_the_way if one.target.names),
    )


def _without_standing(
    target: Target, part: Problem, stands: Sequence[int], since_start: Sequence[int], scales: Scales
) -> Target:
    """Remove goal rows that contact nodes and bars satisfy anyway.

    `part` is the problem of the phase, `stands` are its contact nodes, and `since_start` those in
    contact since the start. Contact nodes fix their velocities. Nodes in contact since the start of
    the plan also fix their positions; other contact nodes land at positions that the goals
    determine. The remaining rows are combinations of the target's rows.
    """
    if not target.count or not stands or target.state is None:
        return target
    model, places = part.model, part.model.entries
    x = ca.SX.sym("x", model.nx)
    kept = model.constraints(x)
    gradients = ca.Function(
        "gradients",
        [x],
        [
            ca.jacobian(value, x)
            for value in (target.single(x), ca.vertcat(kept.bars, kept.bar_rates))
        ],
    )
    goal, bars = (J.full() * scales.state for J in gradients(target.state))
    held = np.concatenate(
        [places[list(since_start)].ravel(), model.nq + places[list(stands)].ravel()]
    ).astype(np.intp)
    standing = np.eye(model.nx)[held]
    reduction = reduce_rows(target.weights @ goal, [("bar", bars), ("standing", standing)])
    return target.keep(reduction.combinations, "standing")
