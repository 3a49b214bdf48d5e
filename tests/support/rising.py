"""A free prism that rises within limits, and limits that are broken without a bound and met with it."""

from __future__ import annotations

import casadi as ca
import numpy as np
from planning import driven, prism

import ocp
from ocp.problem.instant import symbolic

PRESTRESS = ocp.ForceDensityLimits(1.0, 100.0)
MODEL = driven(prism(1.0, bar_radius=0.01, stiffness=1000.0))
GOALS = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())


def raised(*bounds, costs=(ocp.Effort(),), duration=1.0, intervals=10, model=MODEL):
    return ocp.solve(
        ocp.Problem(model, duration, goals=GOALS, bounds=[PRESTRESS, *bounds], costs=costs),
        ocp.MultipleShooting(intervals),
    )


def along(plan, read, model=MODEL):
    """Evaluate a function of an instant at the start of every interval (K, entries)."""
    now = symbolic(model)
    function = ca.Function("read", [now.state, now.control, now.time], [read(now)])
    states = plan.trajectory.states[:-1]
    return np.array(
        [
            function(x, u, t).full().ravel()
            for x, u, t in zip(states, plan.force_density, plan.time[:-1], strict=True)
        ]
    )


def binds(plan, free, read, limit, upper=True):
    """Check that a limit is violated without its bound and satisfied with it."""
    sign = 1.0 if upper else -1.0
    before, after = ((sign * along(one, read)).max() for one in (free, plan))
    assert plan.success, plan.message
    assert before > sign * limit
    assert after <= sign * limit + 1e-6 * abs(limit)
    assert plan.objective > free.objective
