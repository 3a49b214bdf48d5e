"""Iterates of the condensed Newton method, and their updates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.solvers.condensed_newton.bounds import select_stiffest
from ocp.solvers.condensed_newton.condensed_program import CondensedProgram, Expansion, Residual
from ocp.solvers.condensed_newton.metric import Metric, Projector
from tenscasadi.util.validate import Array, Indices


class Iterate(NamedTuple):
    """Iterate of the condensed Newton method.

    Attributes
    ----------
    u, s, slack : ndarray
        Independent and dependent variables, and slacks (p,) of the path constraints.
    left : Residual
        Violations of the constraints.
    total, worst : float
        Sum of the absolute violations, and the largest one.
    cost : float
        Objective.
    """

    u: Array
    s: Array
    slack: Array
    left: Residual
    total: float
    worst: float
    cost: float


def evaluate(of: CondensedProgram, u: Array, s: Array, slack: Array) -> Iterate:
    """Evaluate cost and constraints at an iterate.

    `u`, `s` and `slack` are its variables, see `Iterate`. `of` is the program.
    """
    cost, goals, defects, paths = of.values(u, s)
    left = Residual(goals, defects, paths - slack)
    total = sum(float(np.abs(one).sum()) for one in left)
    worst = np.max([np.abs(one).max(initial=0.0) for one in left])  # keeps NaN
    return Iterate(u, s, slack, left, total, float(worst), cost)


def step_back(expansion: Expansion, projector: Projector, chosen: Indices, point: Iterate) -> Array:
    """Compute the smallest step that removes the violations.

    To first order, it satisfies goals, defects and the chosen path constraints. `chosen` are the
    indices of the latter, and `projector` holds the gradients of goals and chosen constraints.
    `expansion` has the derivatives, and `point` the violations. Returns a step of u.
    """
    drift = expansion.follow(None, point.left.defects)
    paths = (point.left.paths + expansion.path_change(drift, None))[chosen]
    return -projector.shortest(np.append(point.left.goals + expansion.change(drift), paths))


def move(
    of: CondensedProgram,
    expansion: Expansion,
    point: Iterate,
    step: Array,
    share: float,
    most: float,
    least: float,
) -> Iterate:
    """Apply a step of u, and the step of s that follows from it.

    Both begin at the iterate `point`. `expansion` has the derivatives that determine the step of s,
    which removes the fraction `share` of the defects. `most` and `least` shorten the step of u at
    its bounds, see `VariableBounds.cut`. Slacks change more slowly: otherwise they vanish before s
    has followed.
    """
    left, bounds, slack = point.left, of.path_bounds, point.slack
    d = of.bounds.cut(point.u, step, most, least)
    moved = expansion.follow(d, share * left.defects)
    u, s = point.u + d, point.s + moved
    if len(slack):
        true = of.values(u, s)[3]
        change = expansion.path_change(moved, d) + share * left.paths
        slack = bounds.follow(slack, change, true, min(most, 0.6), least)
    return evaluate(of, u, s, slack)


def polish(of: CondensedProgram, point: Iterate, tolerance: float) -> Iterate:
    """Find the nearest iterate that satisfies all constraints.

    The search starts at `point`. Changes are measured relative to the distances from the bounds.
    `tolerance` is the largest permitted violation, scaled. If it is not reached, the result is the
    best iterate. `of` is the program.
    """
    for _ in range(12):
        if not point.worst > tolerance:
            break
        expansion = Expansion(of, point.u, point.s)
        room, near = (
            np.clip(np.minimum(*bounds.gaps(at)), 1e-5, 0.5)
            for bounds, at in ((of.bounds, point.u), (of.path_bounds, point.slack))
        )
        # path rows far from their limits do not count
        chosen = select_stiffest(1 / near, (near < 0.02) | (point.left.paths != 0))
        selected = np.zeros((len(near), len(chosen)))
        selected[chosen, range(len(chosen))] = 1.0
        rows = np.vstack([expansion.jacobian, expansion.of_paths(selected)])
        give = np.append(np.zeros(of.goals), near[chosen] ** 2)
        metric = Metric(np.where(of.bounds.free, 1 / room, 1e300))
        projector = Projector(rows, give, metric)
        moved = _improve(of, expansion, projector, chosen, point)
        if moved is None:
            break
        before, point = point, moved
        # the same expansion while it serves
        while point.worst > tolerance and point.total < 0.1 * before.total:
            back = step_back(expansion, projector, chosen, point)
            before, point = point, move(of, expansion, point, back, 1.0, 0.999, 0.0)
        if not point.total < before.total:
            point = before
    return point


def _improve(
    of: CondensedProgram,
    expansion: Expansion,
    projector: Projector,
    chosen: Indices,
    point: Iterate,
) -> Iterate | None:
    """Try fractions of a step; return the first better iterate.

    The step is that of `step_back`, which explains the arguments. Returns None if no fraction is
    better.
    """
    whole = step_back(expansion, projector, chosen, point)
    for share in (1.0, 0.5, 0.25, 0.1):
        tried = move(of, expansion, point, share * whole, share, 0.999, 0.0)
        if tried.total < point.total or tried.worst < point.worst:
            return tried
    return None
