"""Constraints on a free initial state and on periodicity.

The dynamics preserve bar lengths, so they are imposed at the start only. If both ends satisfy them,
and the invariants agree, some of the constraints "end = start" are redundant. With Z a basis of the
directions that bars and momenta leave free, only Zᵀ (x − x₀) = 0 is imposed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem
from ocp.problem.rows import Rows, goal_rows
from ocp.problem.scaling import Scales
from ocp.targets.infeasible_goal import Certificate, InfeasibleGoalError
from ocp.targets.invariants import invariants
from ocp.targets.row_reduction import Reduction, RowFunction, reduce_rows
from ocp.targets.target import FreeStartRows
from tenscasadi.util.validate import Array


def find_free_start(problem: Problem, scales: Scales, tolerance: float) -> FreeStartRows | None:
    """Build the constraints on a free initial state.

    Returns None if the initial state is fixed. Raises `InfeasibleGoalError` if the plan cannot be
    periodic, as in free fall. `tolerance` is that of the goals, relative to the structure's size.
    """
    if not problem.free_start:
        return None
    model, near, structure = problem.model, problem.initial_state, problem.model.scene.structure
    first, last = ca.SX.sym("x0", model.nx), ca.SX.sym("x", model.nx)
    kept = {rows.kind: rows for rows in invariants(model, near, first, ca.SX(problem.shortest))}
    met = goal_rows(problem.initial_goals, model, first)
    before = tuple(
        moving(first)[: len(structure.nodes), :] for moving in (model.nodes, model.velocities)
    )
    periodic = [replace(goal, start=before) for goal in problem.periodic_goals]
    repeats = goal_rows(periodic, model, last)
    at_near = replace(repeats, value=ca.substitute(repeats.value, first, ca.DM(near)))
    known: list[tuple[str, Array]] = []
    imposed = []
    if "bar" in kept:
        known.append(("bar", _gradient(kept["bar"], first, near, scales)))
        imposed.append(_combined(reduce_rows(known[0][1], []), kept["bar"], scales))
    if met.names:
        imposed.append(
            _combined(reduce_rows(_gradient(met, first, near, scales), known), met, scales)
        )
    if "momentum" in kept and problem.periodic_goals:
        momentum = kept["momentum"].select(
            "m/s", "m²/s"
        )  # the path of the center of mass follows from its initial velocity
        most = tolerance * scales.time / problem.shortest
        _check_momentum(momentum, first, near, scales, most)
        known.append(("momentum", _gradient(momentum, first, near, scales)))
    reduction = reduce_rows(
        _gradient(at_near, last, near, scales), known, repeats.names, repeats.sizes(scales.units)
    )
    return FreeStartRows(
        ca.Function("start", [first], [ca.densify(ca.vertcat(ca.SX(0, 1), *imposed))]),
        ca.Function("repeats", [first, last], [ca.densify(_combined(reduction, repeats, scales))]),
        ca.Function("misfit", [first, last], [repeats.value]),
        repeats.units,
        reduction,
    )


def _gradient(rows: Rows, x: Any, at: Array, scales: Scales) -> Array:
    return RowFunction(x, [rows.scale(scales.units)], scales.state)(at)[1]


def _combined(reduction: Reduction, rows: Rows, scales: Scales) -> Any:
    return ca.mtimes(ca.DM(reduction.combinations), rows.scale(scales.units))


def _check_momentum(momentum: Rows, x: Any, near: Array, scales: Scales, most: float) -> None:
    """Reject periodic plans whose momentum must change.

    Strings cannot prevent such changes, such as those by gravity. `momentum` is the change of the
    momentum in one period, a function of the state `x`. It is evaluated at the state `near`. Scaled
    changes up to `most` are permitted.
    """
    scaled = ca.Function("change", [x], [momentum.scale(scales.units)])
    change = np.abs(scaled(near).full().ravel())
    if change.max(initial=0.0) > most:
        k = int(np.argmax(change))
        name = momentum.names[k]
        raise InfeasibleGoalError(
            f"Periodic cannot be met, as {name} whatever the strings do: give a scene with a ground, or pin a node",
            Certificate({name: 1.0}, float(change[k]), "linear"),
        )
