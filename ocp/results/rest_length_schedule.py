"""Rest lengths of elastic strings that bring a plan about."""

from __future__ import annotations

import numpy as np

from ocp.results.replay import replay_open
from ocp.results.result import PlanResult
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.scene.strings import rest_length
from tenscasadi.util.validate import Array


def wind(plan: PlanResult, stiffness: Array, updates: int) -> tuple[Array, Array]:
    """Return times (K + 1,), s, and the rest lengths (K, α), m, to which motors wind in between; `updates` of them in each interval of a plan.

    Of the middle of each step of a fine replay: s (1 − γ/k) (Eq. 99).
    """
    steps = updates * round(float(plan.time[-1] / np.diff(plan.time).min()))
    model = plan.require_model("replay_rest_lengths")
    fine = replay_open(plan, model, RungeKutta4(), float(plan.time[-1]) / steps)
    ends = fine.nodes[:, plan.structure.strings]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    rest = rest_length(fine.control, lengths, stiffness)
    return fine.time, (rest[1:] + rest[:-1])[: len(rest) - 1] / 2
