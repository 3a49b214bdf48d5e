"""Refusals before anything is solved: limits that contradict each other, and more goals than force densities."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ocp.problem.bounds.bound import PathBound, PathConstraint, RateBound
from ocp.problem.bounds.geometric_bounds import Obstacle
from ocp.problem.control import control_name, winds
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.targets.infeasible_goal import InfeasibleGoalError
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Profile, group_matrix, locate_share, spans
from tenscasadi.dynamics.linearization import tangents
from tenscasadi.util.validate import Array

Flags = NDArray[np.bool_]

# scaled: directions in which goals move less leave a choice, and entries that these move less have
# none
FIXED = 1e-6
# times a limit of a rate is out of reach on the mean: within the last interval lengths change while
# force densities are held
HASTE = 2.0
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
    limits = [
        _limits_at(one, np.asarray(problem.start))
        for one in path_constraints(problem, PathBound)
        if one.ends != ("last",)
    ]
    told = _left_nothing(problem, limits)
    if told:
        raise ValueError(
            f"Problem.bounds leave no force densities at the start: {told}: widen one, or start elsewhere"
        )


def check_end(problem: Problem, target: Target) -> None:
    """Refuse goals at which limits cannot be met: of what the goals leave no choice.

    Raises InfeasibleGoalError, naming goal and limit, where a limit excludes the goal; ValueError where
    limits leave no force densities there.
    """
    state = target.state
    bounds = [*path_constraints(problem, PathBound), *_at_ends_of_bars(problem)]
    if (
        state is None
        or problem.free_start
        or problem.repeating
        or not (bounds or path_constraints(problem, RateBound))
    ):
        return
    turned = _elsewhere(problem, state)
    fixed, shaped = _fixed_entries(problem, target, state, turned is not None)
    limits = []
    for one in bounds:
        at, needed = _limits_at(one, state), _entries_needed(one)
        alike = (
            np.zeros(len(needed), dtype=bool)
            if turned is None
            else _same(at, _limits_at(one, turned), len(needed))
        )
        settled = [
            k
            for k, entry in enumerate(at.entry)
            if (shaped if alike[entry] else fixed)[needed[entry]].all()
        ]
        at = at.taken(settled)
        for k, entry in enumerate(at.entry):
            if needed[entry].any() and not at.slopes[k].any() and at.room[k] < -CLEAR:
                value = at.limit[k] - at.size[k] * at.room[k]
                goal = _goal_of(target, needed[entry])
                kept = f"{at.name[k]} has to be {at.wanted[k]}, and is {value:.4g} where the goals are met"
                raise InfeasibleGoalError(
                    f"{goal} and {kept}: move the goal, or give another limit"
                )
        limits.append(at)
    told = _left_nothing(problem, limits)
    if told:
        raise ValueError(
            f"Problem.bounds leave no force densities where the goals are met: {told}: widen one, or move the goal"
        )
    _check_rates(problem, state, shaped)


def _at_ends_of_bars(problem: Problem) -> list[PathConstraint]:
    """Return the distances of obstacles from the ends of bars: a goal places one of them, and leaves open where the bar is."""
    structure, found = problem.model.scene.structure, []
    for bound in problem.bounds:
        if isinstance(bound, Obstacle):
            ends = np.unique(
                structure.bars if bound.bars is None else structure.bars[list(bound.bars)]
            )
            moved = ends[~structure.fixed[ends].all(axis=1)].tolist()
            found += (
                [replace(bound, bars=[], nodes=moved).constraint(problem.model)] if moved else []
            )
    return found


class _Limits(NamedTuple):
    """One-sided limits slopes · γ ≤ room of an instant (n,), each in units of its size; entry: of the bound's column; what messages say of it."""

    slopes: Array
    room: Array
    entry: list[int]
    name: list[str]
    wanted: list[str]
    limit: Array
    size: Array

    def taken(self, chosen: list[int]) -> _Limits:
        """Return some of them."""
        name, wanted = ([part[k] for k in chosen] for part in (self.name, self.wanted))
        return _Limits(
            self.slopes[chosen],
            self.room[chosen],
            [self.entry[k] for k in chosen],
            name,
            wanted,
            self.limit[chosen],
            self.size[chosen],
        )


def _limits_at(limited: PathConstraint, state: Array) -> _Limits:
    """Return what is limited at a state and linear in γ there."""
    value, control = ca.densify(limited.value), limited.symbols[1]
    linear = ~np.array(ca.which_depends(value, control, 2, True), dtype=bool)
    function = ca.Function(
        "linear", limited.symbols, [value, ca.densify(ca.jacobian(value, control))]
    )
    at_none, slope = (np.asarray(part.full()) for part in function(state, 0, 0))
    slopes, room, entries, names, wanted, limits, sizes = [], [], [], [], [], [], []
    for side, sign, limit in (("at most", 1.0, limited.upper), ("at least", -1.0, limited.lower)):
        kept = np.flatnonzero(
            linear
            & np.isfinite(limit)
            & np.isfinite(at_none[:, 0])
            & np.isfinite(slope).all(axis=1)
        )
        size = np.maximum(np.abs(limit[kept]), 1e-9)
        slopes.append(sign * slope[kept] / size[:, None])
        room.append(sign * (limit[kept] - at_none[kept, 0]) / size)
        entries += kept.tolist()
        names += [limited.names[k] for k in kept]
        wanted += [f"{side} {limit[k]:g} {limited.unit}".rstrip() for k in kept]
        limits.append(limit[kept])
        sizes.append(sign * size)
    return _Limits(
        np.concatenate(slopes),
        np.concatenate(room),
        entries,
        names,
        wanted,
        np.concatenate(limits),
        np.concatenate(sizes),
    )


def _left_nothing(problem: Problem, limits: list[_Limits]) -> str:
    """Tell which limit of an instant cannot be met with all others, and by how much; "" where force densities meet all."""
    lower, upper = problem.control_limits
    if not sum(len(one.room) for one in limits):
        return ""
    A, b = (np.concatenate([getattr(one, name) for one in limits]) for name in ("slopes", "room"))
    best = scipy.optimize.linprog(
        np.append(np.zeros(len(lower)), 1.0),
        A_ub=np.column_stack([A, -np.ones(len(b))]),
        b_ub=b,
        bounds=np.vstack([np.column_stack([lower, upper]), [0.0, np.inf]]),
    )
    if best.x is None or best.x[-1] < CLEAR:
        return ""
    excess = A @ best.x[:-1] - b
    worst = int(np.argmax(excess))
    name, wanted, limit, size = (
        [entry for one in limits for entry in getattr(one, part)][worst]
        for part in ("name", "wanted", "limit", "size")
    )
    return f"{name} has to be {wanted}, and with all others kept as well as this one it is {limit + size * excess[worst]:.4g}"


def _entries_needed(limited: PathConstraint) -> Flags:
    """Return which entries of the state each entry of what is limited depends on (n, nx)."""
    pattern = limited.function.jac_sparsity(0, 0)
    needed = np.zeros(pattern.shape, dtype=bool)
    needed[tuple(np.array(entries, dtype=np.intp) for entries in pattern.get_triplet())] = True
    return needed


def _elsewhere(problem: Problem, state: Array) -> Array | None:
    """Return the state moved and turned as a whole; None where pins or the ground see that."""
    model = problem.model
    if model.structure.held.any() or model.scene.grounds or model.scene.has_clock:
        return None
    turn = Rotation.from_rotvec([0.4, -0.7, 0.5]).as_matrix()
    return model.state(
        model.nodes(state) @ turn.T + 0.3 * Scales.of(problem).length,
        model.velocities(state) @ turn.T,
    )


def _same(at: _Limits, moved: _Limits, count: int) -> Flags:
    """Return which entries of a bound, (count,), limit the same after a motion of the whole."""
    same: Flags = np.ones(count, dtype=bool)
    if at.entry != moved.entry:
        return np.zeros(count, dtype=bool)
    differ = (np.abs(at.room - moved.room) > FIXED) | (
        np.abs(at.slopes - moved.slopes).max(axis=1, initial=0.0) > FIXED
    )
    same[[entry for entry, other in zip(at.entry, differ, strict=True) if other]] = False
    return same


def _fixed_entries(
    problem: Problem, target: Target, state: Array, free: bool
) -> tuple[Flags, Flags]:
    """Return which entries of the state (nx,) goals and bars leave no choice of, but for other branches, such as a mirrored shape.

    The second: but for motions of the structure as a whole, where it is free.
    """
    scale = Scales.of(problem).state
    basis, _ = np.linalg.qr(tangents(problem.model, state) / scale[:, None])
    x = ca.SX.sym("x", len(state))
    J = (
        np.asarray(ca.Function("goals", [x], [ca.jacobian(target.single(x), x)])(state).full())
        * scale
        @ basis
    )
    _, values, right = np.linalg.svd(J)
    open_ = basis @ right[int(np.sum(values > FIXED * values.max(initial=0.0))) :].T
    fixed: Flags = np.linalg.norm(open_, axis=1) < FIXED
    if not free:
        return fixed, fixed
    whole, _ = np.linalg.qr(_whole_motions(problem, state) / scale[:, None])
    return fixed, np.linalg.norm(open_ - whole @ (whole.T @ open_), axis=1) < FIXED


def _whole_motions(problem: Problem, state: Array) -> Array:
    """Return the changes (nx, 12) of the state by motions and speeds of the structure as a whole, where nothing holds it."""
    model = problem.model
    nodes, velocities = model.nodes(state), model.velocities(state)
    moves = [np.broadcast_to(axis, nodes.shape) for axis in np.eye(3)] + [
        np.cross(axis, nodes) for axis in np.eye(3)
    ]
    turned = [np.zeros_like(nodes)] * 3 + [np.cross(axis, velocities) for axis in np.eye(3)]
    still = np.zeros_like(nodes)
    columns = [(move, turn) for move, turn in zip(moves, turned, strict=True)] + [
        (still, move) for move in moves
    ]
    x = ca.SX.sym("x", len(state))
    J = ca.Function(
        "columns",
        [x],
        [ca.jacobian(ca.vertcat(ca.vec(model.nodes(x).T), ca.vec(model.velocities(x).T)), x)],
    )(state)
    wanted = np.column_stack(
        [np.concatenate([part.ravel() for part in column]) for column in columns]
    )
    return np.asarray(np.linalg.lstsq(np.asarray(J.full()), wanted)[0])


def _goal_of(target: Target, needed: Flags) -> str:
    """Return the name of a goal that places some of the entries of the state."""
    pattern = target.single.jac_sparsity(0, 0)
    rows, columns = (np.array(entries, dtype=np.intp) for entries in pattern.get_triplet())
    own = len(target.reduction.names) - target.shape
    placing = np.unique(rows[needed[columns] & (rows < own)])
    return target.reduction.names[int(placing[0])] if placing.size else "the goals"


def _check_rates(problem: Problem, state: Array, fixed: Flags) -> None:
    """Refuse limits of rates under which what they limit cannot change as much as it has to, from start to goal in the longest duration."""
    lower, upper = problem.control_limits
    if not np.all(np.isfinite(upper)):
        return
    for bound in path_constraints(problem, RateBound):
        pattern = bound.function.jac_sparsity(0, 2)
        needed = np.zeros(pattern.shape, dtype=bool)
        needed[tuple(np.array(entries, dtype=np.intp) for entries in pattern.get_triplet())] = True
        before, after = bound.symbols[1], bound.symbols[3]
        slopes = [ca.densify(ca.jacobian(bound.value, u)) for u in (before, after)]
        function = ca.Function("rate", bound.symbols, [ca.densify(bound.value), *slopes])
        start, nothing = np.asarray(problem.start), np.zeros(len(lower))
        rate, *by = (
            np.asarray(part.full())
            for part in function(start, nothing, state, nothing, problem.longest)
        )
        least = rate[:, 0] + sum(
            np.minimum(slope * lower, slope * upper).sum(axis=1) for slope in by
        )
        most = rate[:, 0] + sum(
            np.maximum(slope * lower, slope * upper).sum(axis=1) for slope in by
        )
        linear = ~np.array(
            ca.which_depends(bound.value, ca.vertcat(before, after), 2, True), dtype=bool
        )
        for k, name in enumerate(bound.names):
            settled = linear[k] and fixed[needed[k]].all()
            for wrong, side, limit, value in (
                (least[k] > bound.upper[k], "at most", bound.upper[k], least[k]),
                (most[k] < bound.lower[k], "at least", bound.lower[k], most[k]),
            ):
                if settled and wrong and abs(value) > HASTE * abs(limit):
                    told = f"{name} has to be {side} {limit:g} {bound.unit}, and from the start to the goals its mean is {value:.4g} {bound.unit}"
                    raise InfeasibleGoalError(
                        f"{told} at best: allow a faster rate, or a longer duration than {problem.longest:g} s"
                    )


def check_freedom(problem: Problem, target: Target, transcription: Transcription) -> None:
    """Raise ValueError where goals have more rows than there are force densities before them, which has no solution."""
    lower, upper = problem.control_limits
    free = int(np.sum(lower < upper))
    what = "rest lengths" if winds(problem.model) else "force densities"
    held = spans(transcription.control, transcription.fractions)
    each = len(held) == held[-1] + 1
    name = (
        f"{type(transcription).__name__}.intervals is {transcription.count}"
        if each
        else f"PiecewiseConstant.changes is {held[-1]}"
    )
    for share, part, label in target.instants:
        there = int(held[locate_share(transcription.fractions, share)[0]]) + 1
        if part.count > there * free:
            least = int(np.ceil(np.ceil(part.count / free) / share)) if free else 0
            cure = f"give at least {least} intervals" if each else f"allow at least {least - 1}"
            needed = cure if free else f"allow some more {what}"
            where = "each" if share == 1.0 and each else f"each of the {there} up to there"
            raise ValueError(
                f"{name}: {label}{free} {what} in {where} cannot meet {part.count} rows of goals, {needed}"
            )
