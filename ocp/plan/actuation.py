"""A plan carried out by motors that wind strings: rest lengths in place of force densities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ocp.plan.plan import Plan
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import RestLength, rest_length
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array, instance, nonnegative, per_item, whole_number


def reachable(plan: Plan, stiffness: ArrayLike | None = None, shortest: ArrayLike = 0.0) -> Array:
    """Which force densities (K, α) strings of `stiffness`, N/m (None: the structure's), can carry: γ < k, and rest lengths ≥ `shortest`, m."""
    instance("plan", plan, Plan, "an ocp.Plan")
    count = plan.force_density.shape[1]
    given = plan.structure.stiffness if stiffness is None else stiffness
    k = nonnegative("stiffness", per_item("stiffness", given, count), "string")
    least = nonnegative("shortest", per_item("shortest", shortest, count), "string")
    gamma = plan.force_density
    rest = rest_length(gamma, plan.lengths()[: len(gamma)], k)
    return np.asarray(((gamma < k) | (gamma == 0)) & (rest > 0) & (rest >= least))


def replay_wound(plan: Plan, stiffness: ArrayLike | None = None, damping: ArrayLike = 0.0, updates: int = 10) -> Trajectory:
    """The motion where elastic strings are wound to the rest lengths that the plan asks for, `updates` times in each interval.

    stiffness: k, N/m (None: the structure's), damping: N s/m. Unlike force densities, which pull the same wherever the nodes are, elastic strings
    push the motion back to the plan or away from it: a second answer to how far a plan can be trusted. Raises ValueError for a string whose
    γ reaches k, and for a plan without its model.
    """
    instance("plan", plan, Plan, "an ocp.Plan")
    whole_number("updates", updates, 1)
    plan.rest_lengths(stiffness)  # names the string that is too soft
    planned = plan.known_model("replay_wound")
    k = per_item("stiffness", plan.structure.stiffness if stiffness is None else stiffness, len(plan.structure.strings))
    steps = updates * round(float(plan.time[-1] / np.diff(plan.time).min()))
    fine = plan.replay(step=float(plan.time[-1]) / steps)
    ends = fine.nodes[:, plan.structure.strings]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    rest = rest_length(fine.control, lengths, k)
    elastic = replace(planned.scene, structure=plan.structure.replace(stiffness=k, damping=damping), control=RestLength())
    model = Model(elastic, planned.coordinates, "constant" if planned.mechanism.constant_length else "current")
    wound = (rest[1:] + rest[:-1])[: len(rest) - 1] / 2  # the middle of each step
    return simulate(model, float(plan.time[-1]), float(plan.time[-1]) / steps / 5, state=plan.trajectory.states[0], control=wound, compiled=False)
