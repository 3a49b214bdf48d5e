"""Rest-length schedule of elastic strings that realizes a plan."""

from __future__ import annotations

import numpy as np

from ocp.results.replay import replay_open
from ocp.results.result import PlanResult
from tenscasadi.scene.strings import rest_length
from tenscasadi.structure.class_one import distances
from tenscasadi.util.validate import Array


def compute_rest_lengths(plan: PlanResult, stiffness: Array, updates: int) -> tuple[Array, Array]:
    """Compute the rest-length schedule of a plan.

    The rest lengths are s (1 − γ/k) in the middle of each step of a fine replay (Eq. 99).

    Parameters
    ----------
    plan : PlanResult
        The plan.
    stiffness : ndarray, shape (α,)
        Stiffness k of the strings [N/m].
    updates : int
        Number of rest-length updates in the shortest interval.

    Returns
    -------
    time : ndarray, shape (K + 1,)
        Times of the updates, and the end [s].
    rest : ndarray, shape (K, α)
        Rest lengths, constant between these times [m].
    """
    steps = updates * round(float(plan.time[-1] / np.diff(plan.time).min()))
    model = plan.require_model("replay_rest_lengths")
    fine = replay_open(plan, model, None, float(plan.time[-1]) / steps)
    rest = rest_length(fine.control, distances(fine.nodes, plan.structure.strings), stiffness)
    return fine.time, (rest[1:] + rest[:-1])[: len(rest) - 1] / 2
