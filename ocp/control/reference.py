"""What a predictive controller follows: a plan over time, or the state of the goals."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.find_target import find_target
from ocp.plan.plan import Plan
from ocp.problem.goals import Periodic
from ocp.problem.problem import FreeStart, Problem
from ocp.problem.scaling import Scales
from ocp.problem.waypoints import Waypoint
from ocp.transcription.initial_guess import settled
from ocp.transcription.mesh import at
from tenscasadi.util.validate import Array


class Reference:
    """What outputs of the state, `output` (x → value, derivative), and force densities should be over `count` intervals of `period` s.

    plan: followed over time, and held at its end; None: the state of the goals is held. strength: a typical γ, N/m.
    Raises ValueError for goals that ask for a motion without a plan, UnreachableGoal.
    """

    def __init__(self, problem: Problem, scales: Scales, plan: Plan | None, output: ca.Function, count: int, period: float) -> None:
        state, gamma = _goal(problem, scales) if plan is None else (plan.trajectory.states[-1], plan.force_density[-1])
        self._plan, self._one, self._outputs, self._count, self._period = plan, output, output.map(count), count, period
        self._end = np.asarray(self._outputs(np.repeat(state[:, None], count, axis=1))[0].full()), np.repeat(gamma[None], count, axis=0)
        self.strength = float((gamma if plan is None else plan.force_density).mean()) or 1.0

    def __call__(self, time: float) -> tuple[Array, Array]:
        """Outputs (·, count) at the ends of the next intervals, and γ (count, α) in them."""
        plan = self._plan
        if plan is None or time >= plan.time[-1] - 1e-9:
            return self._end
        ends = np.minimum(time + self._period * np.arange(self._count + 1), plan.time[-1])
        states = np.array([np.interp(ends[1:], plan.time, column) for column in plan.trajectory.states.T])
        return np.asarray(self._outputs(states)[0].full()), at(plan.force_density, plan.time, (ends[:-1] + ends[1:]) / 2)

    def symbolic(self, time: Any) -> tuple[Any, Any]:
        """Outputs (·, count) and γ (α, count) from a symbolic time on."""
        plan = self._plan
        if plan is None:
            return ca.DM(self._end[0]), ca.DM(self._end[1].T)
        ends = [ca.fmin(time + self._period * k, float(plan.time[-1])) for k in range(self._count + 1)]
        outputs = [self._one(_along(plan.trajectory.states, plan.time, end))[0] for end in ends[1:]]
        return ca.horzcat(*outputs), ca.horzcat(*(_along(plan.force_density, plan.time, (a + b) / 2) for a, b in pairwise(ends)))


def _goal(problem: Problem, scales: Scales) -> tuple[Array, Array]:
    """The state of the goals, and γ that hold it as nearly as they can."""
    asked = [type(part).__name__ for part in (problem.start, *problem.goals) if isinstance(part, (FreeStart, Waypoint, Periodic))]
    if asked:
        raise ValueError(f"problem has {asked[0]}, which asks for a motion, not for one state to be held: plan first, then Mpc(problem, plan=plan)")
    target = find_target(problem, scales)
    state = target.start if target.state is None else target.state
    return state, np.asarray(settled(problem, np.array([state, state]))[0])


def _along(values: Array, nodes: Array, time: Any) -> Any:
    """As `ocp.grid.at`, of a symbolic time; rows of states are linear in time as rows of a linear profile are."""
    k = ca.low(ca.DM(nodes), time)
    left = ca.MX(ca.DM(values.T))[:, k]
    if len(values) < len(nodes):
        return left
    start = ca.MX(ca.DM(nodes))
    return left + (time - start[k]) / (start[k + 1] - start[k]) * (ca.MX(ca.DM(values.T))[:, k + 1] - left)
