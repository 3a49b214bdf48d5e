"""Replay of force-density plans by rest-length control."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ocp.results.rest_length_schedule import compute_rest_lengths
from ocp.results.result import PlanResult
from tenscasadi.scene.strings import RestLength, rest_length
from tenscasadi.simulation.inputs.controls import ControlProfile
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import (
    MAX_REPETITIONS,
    Array,
    instance,
    nonnegative,
    per_item,
    whole_number,
)

STEPS_PER_UPDATE = 5  # integration steps between two rest-length updates


@rename_keywords(shortest="min_rest_length")
def is_realizable(
    plan: PlanResult, stiffness: ArrayLike | None = None, min_rest_length: ArrayLike = 0.0
) -> Array:
    """Return whether elastic strings can realize a plan's force densities.

    A string of stiffness k realizes a force density γ < k by the rest length ρ = s (1 − γ/k), which
    must be positive and at least `min_rest_length`.

    Parameters
    ----------
    plan : Plan
        The plan.
    stiffness : array_like, scalar or shape (α,), optional
        Stiffness k of the strings [N/m]. Default: that of the structure.
    min_rest_length : array_like, scalar or shape (α,)
        Smallest rest length [m].

    Returns
    -------
    ndarray of bool, shape (K, α) or (K + 1, α)
        Whether the strings can realize each force density of the plan.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> bool(ocp.is_realizable(plan, stiffness=1000.0).all())
    True
    """
    instance("plan", plan, PlanResult, "an ocp.Plan")
    _reject_rest_lengths(plan)
    count = plan.force_density.shape[1]
    given = plan.structure.stiffness if stiffness is None else stiffness
    k = nonnegative("stiffness", per_item("stiffness", given, count), "string")
    least = nonnegative(
        "min_rest_length", per_item("min_rest_length", min_rest_length, count), "string"
    )
    gamma = plan.force_density
    rest = rest_length(gamma, plan.lengths()[: len(gamma)], k)
    return np.asarray(((gamma < k) | (gamma == 0)) & (rest > 0) & (rest >= least))


def replay_rest_lengths(
    plan: PlanResult,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike = 0.0,
    updates: int = 10,
) -> Trajectory:
    """Simulate a plan under rest-length control.

    Actuators set the rest lengths of elastic strings so that these have the planned force
    densities. Prescribed force densities do not depend on the nodes' positions. The tensions of
    elastic strings do, which stabilizes or destabilizes the motion about the plan. This replay is
    therefore a second test of a plan's robustness.

    Parameters
    ----------
    plan : Plan
        The plan.
    stiffness : array_like, scalar or shape (α,), optional
        Stiffness k of the strings [N/m]. Default: that of the structure.
    damping : array_like, scalar or shape (α,)
        Damping of the strings [N·s/m].
    updates : int
        Number of rest-length updates in each interval.

    Returns
    -------
    Trajectory
        The simulated motion.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, the force density of a string reaches its stiffness, or the plan
        was loaded without its model.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> elastic = ocp.replay_rest_lengths(plan, stiffness=1000.0)
    >>> bool(abs(elastic.nodes[-1] - plan.trajectory.nodes[-1]).max() < 0.01)
    True
    """
    instance("plan", plan, PlanResult, "an ocp.Plan")
    _reject_rest_lengths(plan)
    whole_number("updates", updates, 1, MAX_REPETITIONS)
    plan.rest_lengths(stiffness)  # raises an error that names a string of too low stiffness
    planned = plan.require_model("replay_rest_lengths")
    k = per_item(
        "stiffness",
        plan.structure.stiffness if stiffness is None else stiffness,
        len(plan.structure.strings),
    )
    time, rest = compute_rest_lengths(plan, k, updates)
    elastic = replace(
        planned.scene,
        structure=plan.structure.replace(stiffness=k, damping=damping),
        control=RestLength(),
    )
    model = planned.with_scene(elastic)
    control = ControlProfile(time, rest, STEPS_PER_UPDATE)
    end = float(plan.time[-1])
    return simulate(
        model, end, end, state=plan.trajectory.states[0], control=control, compiled=False
    )


def _reject_rest_lengths(plan: PlanResult) -> None:
    if plan.control is not plan.force_density:
        raise ValueError(
            "plan has decided rest lengths or tensions: Plan.control returns them, and Plan.replay applies them"
        )
