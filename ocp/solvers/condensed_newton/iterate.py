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


class Linearization(NamedTuple):
    """Linearized constraints, from which steps toward them follow.

    Attributes
    ----------
    expansion : Expansion
        Derivatives at an iterate.
    projector : Projector
        Gradients of goals and chosen path constraints.
    chosen : ndarray of int
        Indices of these path constraints.
    """

    expansion: Expansion
    projector: Projector
    chosen: Indices

    def step_back(self, point: Iterate) -> Array:
        """Compute the smallest step of u that removes the violations of an iterate.

        To first order, it satisfies goals, defects and the chosen path constraints.
        """
        expansion, left = self.expansion, point.left
        drift = expansion.follow(None, left.defects)
        paths = (left.paths + expansion.path_change(drift))[self.chosen]
        return -self.projector.shortest(np.append(left.goals + expansion.change(drift), paths))


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
    u, s = point.u + d, point.s + moved[: len(point.s)]
    if len(slack):
        true = of.values(u, s)[3]
        change = expansion.path_change(moved) + share * left.paths
        slack = bounds.follow(slack, change, true, min(most, 0.6), least)
    return evaluate(of, u, s, slack)


def polish(
    of: CondensedProgram, point: Iterate, tolerance: float, known: Linearization | None = None
) -> tuple[Iterate, Linearization | None]:
    """Find the nearest iterate that satisfies all constraints.

    The search starts at `point`. Changes are measured relative to the distances from the bounds.
    `tolerance` is the largest permitted violation, scaled. If it is not reached, the result is the
    best iterate. `of` is the program. Also returns the last linearization. That of an iterate
    nearby, `known`, saves the first one.
    """
    if known is not None:
        point = _repeat(of, known, point, tolerance)
    for _ in range(12):
        if not point.worst > tolerance:
            break
        known = _linearize(of, point)
        moved = _improve(of, known, point)
        if moved is None:
            break
        point = _repeat(of, known, moved, tolerance, moved.total / point.total)
    return point, known


def _linearize(of: CondensedProgram, point: Iterate) -> Linearization:
    """Linearize the constraints for steps that keep off the bounds."""
    expansion = Expansion(of, point.u, point.s)
    room, near = (
        np.clip(np.minimum(*bounds.gaps(at)), 1e-5, 0.5)
        for bounds, at in ((of.bounds, point.u), (of.path_bounds, point.slack))
    )
    # path rows far from their limits do not count
    chosen = select_stiffest(1 / near, (near < 0.02) | (point.left.paths != 0))
    selected = np.zeros((len(near), len(chosen)))
    selected[chosen, range(len(chosen))] = 1.0
    rows = expansion.stack(expansion.of_paths(selected))
    give = np.append(np.zeros(of.goals), near[chosen] ** 2)
    metric = Metric(np.where(of.bounds.free, 1 / room, 1e300))
    return Linearization(expansion, Projector(rows, give, metric), chosen)


def _repeat(
    of: CondensedProgram,
    known: Linearization,
    point: Iterate,
    tolerance: float,
    share: float = 0.0,
) -> Iterate:
    """Take steps with the same linearization while each removes most violations.

    The last step has left the fraction `share` of the violations.
    """
    while point.worst > tolerance and share < 0.1:
        tried = move(of, known.expansion, point, known.step_back(point), 1.0, 0.999, 0.0)
        share = tried.total / point.total
        if not share < 1:
            break
        point = tried
    return point


def _improve(of: CondensedProgram, known: Linearization, point: Iterate) -> Iterate | None:
    """Try fractions of a step; return the first better iterate.

    The step is that of the linearization `known`. Returns None if no fraction is better.
    """
    whole = known.step_back(point)
    for share in (1.0, 0.5, 0.25, 0.1):
        tried = move(of, known.expansion, point, share * whole, share, 0.999, 0.0)
        if tried.total < point.total or tried.worst < point.worst:
            return tried
    return None
