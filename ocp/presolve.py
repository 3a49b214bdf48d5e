"""Refusals before anything is solved: limits that contradict each other, and more goals than force densities."""

from __future__ import annotations

import casadi as ca
import numpy as np
import scipy.optimize

from ocp.boundary.target import Target
from ocp.problem.bounds import PathBound
from ocp.problem.control import control_name, winds
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Profile, group_matrix, locate_share, spans

CLEAR = 1e-3  # of a limit: contradictions that are smaller are left to the solver


def check_groups(problem: Problem, profile: Profile) -> None:
    """Raise ValueError, naming the strings, where the limits of a group's strings leave nothing for all of them."""
    lower, upper = problem.control_limits
    what, unit = control_name(problem.model), "m" if winds(problem.model) else "N/m"
    for together in group_matrix(profile, len(lower)).T > 0:
        strings = np.flatnonzero(together)
        low, high = strings[np.argmax(lower[strings])], strings[np.argmin(upper[strings])]
        if lower[low] > upper[high]:
            raise ValueError(
                f"{type(profile).__name__}.groups: strings {', '.join(map(str, strings))} share a {what}, and Problem.bounds keep "
                f"that of string {low} at {lower[low]:g} {unit} or more and that of string {high} at {upper[high]:g} {unit} or less: "
                "widen one, or take the group apart"
            )


def check_start(problem: Problem) -> None:
    """Raise ValueError, naming the limit that is missed most, where no force densities meet all limits that are linear in them at the start."""
    lower, upper = problem.control_limits
    slopes, room, rows = [np.zeros((0, len(lower)))], [np.zeros(0)], []
    for limited in path_constraints(problem, PathBound):
        if limited.ends == ("last",):
            continue
        value, control = ca.densify(limited.value), limited.symbols[1]
        linear = ~np.array(ca.which_depends(value, control, 2, True), dtype=bool)
        function = ca.Function("linear", limited.symbols, [value, ca.densify(ca.jacobian(value, control))])
        at_none, slope = (np.asarray(part.full()) for part in function(np.asarray(problem.start), 0, 0))
        for side, sign, limit in (("at most", 1.0, limited.upper), ("at least", -1.0, limited.lower)):
            kept = np.flatnonzero(linear & np.isfinite(limit) & np.isfinite(at_none[:, 0]) & np.isfinite(slope).all(axis=1))
            size = np.maximum(np.abs(limit[kept]), 1e-9)
            slopes.append(sign * slope[kept] / size[:, None])
            room.append(sign * (limit[kept] - at_none[kept, 0]) / size)
            rows += [(limited.names[k], f"{side} {limit[k]:g} {limited.unit}".rstrip(), limit[k], sign * size[j]) for j, k in enumerate(kept)]
    A, b = np.concatenate(slopes), np.concatenate(room)
    if not len(b):
        return
    best = scipy.optimize.linprog(
        np.append(np.zeros(len(lower)), 1.0),
        A_ub=np.column_stack([A, -np.ones(len(b))]),
        b_ub=b,
        bounds=np.vstack([np.column_stack([lower, upper]), [0.0, np.inf]]),
    )
    if best.x is None or best.x[-1] < CLEAR:
        return
    excess = A @ best.x[:-1] - b
    worst = int(np.argmax(excess))
    name, wanted, limit, size = rows[worst]
    raise ValueError(
        f"Problem.bounds leave no force densities at the start: {name} has to be {wanted}, and with all others kept as well as this one "
        f"it is {limit + size * excess[worst]:.4g}: widen one, or start elsewhere"
    )


def check_freedom(problem: Problem, target: Target, transcription: Transcription) -> None:
    """Raise ValueError where goals have more rows than there are force densities before them, which has no solution."""
    lower, upper = problem.control_limits
    free = int(np.sum(lower < upper))
    what = "rest lengths" if winds(problem.model) else "force densities"
    held = spans(transcription.control, transcription.fractions)
    each = len(held) == held[-1] + 1
    name = f"{type(transcription).__name__}.intervals is {transcription.count}" if each else f"PiecewiseConstant.changes is {held[-1]}"
    for share, part, label in target.instants:
        there = int(held[locate_share(transcription.fractions, share)[0]]) + 1
        if part.count > there * free:
            least = int(np.ceil(np.ceil(part.count / free) / share)) if free else 0
            cure = f"give at least {least} intervals" if each else f"allow at least {least - 1}"
            needed = cure if free else f"allow some more {what}"
            where = "each" if share == 1.0 and each else f"each of the {there} up to there"
            raise ValueError(f"{name}: {label}{free} {what} in {where} cannot meet {part.count} rows of goals, {needed}")
