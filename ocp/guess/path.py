"""Kinematic paths from the initial to the final state.

They are initial guesses. A path moves nodes along straight lines. If the structure rotates as a
whole, the lines are straight in a frame that rotates with it. If bars rotate far, each bar rotates
about its own axis, and bars that form a rigid group about a common one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy.interpolate
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from ocp.guess.inverse_dynamics import balance, inverse_dynamics
from ocp.problem.problem import Problem
from ocp.problem.rows import RESOLUTION
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, project_states
from tenscasadi.dynamics.model import Model
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.validate import Array, Indices

LARGE_TURN = 0.5  # rad; for smaller rotations, straight lines are good paths


def make_guess(problem: Problem, target: Target, intervals: int) -> Guess:
    """Build the guess along a smooth path to the final state.

    The path is that to the final state of `target`. The guess has no noise. Of several paths, it
    follows the one whose accelerations the controls reproduce best.
    """
    paths = find_paths(target, problem.model, intervals, problem.typical_duration)
    last = target.start if target.state is None else target.state
    balanced = balance(problem, target.start), balance(problem, last)
    guesses = [_follow(problem, target, path, balanced) for path in paths]
    return min(guesses, key=lambda pair: pair[1])[0]


def follow(problem: Problem, target: Target, positions: Array) -> Guess:
    """Build the guess along given coordinates.

    `positions` (K + 1, nq) are the free coordinates at equal time intervals. They are projected
    onto the constraints of bars and joints. The controls follow by inverse dynamics. `target` has
    the initial and the final state.
    """
    return _follow(problem, target, positions)[0]


def stay_at_start(problem: Problem, target: Target, intervals: int) -> Guess:
    """Build the guess that stays at the initial state.

    The initial state is that of `target`. The controls balance it as well as their limits permit.
    """
    duration = problem.typical_duration
    states = np.repeat(target.start[None], intervals + 1, axis=0)
    clock = problem.model.split(states).clock
    clock += np.linspace(0.0, duration, intervals + 1)[:, None][:, : clock.shape[1]]
    states, controls, _ = inverse_dynamics(problem, states, duration / intervals)
    return Guess(states, controls, duration)


def _follow(
    problem: Problem,
    target: Target,
    positions: Array,
    balanced: tuple[Array, Array] | None = None,
) -> tuple[Guess, float]:
    """Build the guess along a path, and its acceleration error.

    `positions` (K + 1, nq) are the free coordinates along the path. `balanced` are controls in
    equilibrium at both ends. `target` has the initial and the final state. The error is the mean
    squared error of the accelerations. It is inf if a bar turns by 90° or more within an interval;
    the guess then stays at the start.
    """
    duration = problem.typical_duration
    states = _add_velocities(problem, target, positions, duration)
    if states is None:
        return stay_at_start(problem, target, len(positions) - 1), np.inf
    interval = duration / (len(states) - 1)
    states, controls, error = inverse_dynamics(problem, states, interval, balanced)
    return Guess(states, controls, duration), error


class _Quintic(NamedTuple):
    """Quintic Hermite polynomials at given times.

    Attributes
    ----------
    change : ndarray
        Factor of the difference between both end values.
    leave : ndarray
        Factor of the derivative at the start.
    arrive : ndarray
        Factor of the derivative at the end.
    """

    change: Array
    leave: Array
    arrive: Array

    def between(self, first: Array, last: Array, leaving: Array, arriving: Array) -> Array:
        """Interpolate between two values with given derivatives at both ends.

        The values are `first` and `last`. `leaving` and `arriving` are the derivatives with respect
        to the fraction of time. Second derivatives are zero at both ends. The result has one row
        for each time.
        """
        shape = (-1, *(1 for _ in np.shape(first)))
        change, leave, arrive = (part.reshape(shape) for part in self)
        return np.asarray(first + change * (last - first) + leave * leaving + arrive * arriving)


def _quintic(intervals: int) -> _Quintic:
    s = np.linspace(0.0, 1.0, intervals + 1)
    return _Quintic(
        s**3 * (10 - 15 * s + 6 * s**2),
        s - 6 * s**3 + 8 * s**4 - 3 * s**5,
        -4 * s**3 + 7 * s**4 - 3 * s**5,
    )


def find_paths(target: Target, model: Model, intervals: int, duration: float) -> list[Array]:
    """Find paths from the initial to the final state through waypoints.

    `target` has these states, and `duration` is in seconds. A path has the free coordinates (K + 1,
    nq) at equal time intervals. There are several paths if the structure or its bars rotate far.
    """
    start, end = target.start, target.start if target.state is None else target.state
    (q0, v0, *_), (q1, v1, *_) = model.split(start), model.split(end)
    waypoints = [
        (one.share, one.target.state) for one in target.waypoints if one.target.state is not None
    ]
    if waypoints:
        places = [q0, *(model.split(state).positions for _, state in waypoints), q1]
        rates = [(1, duration * v) for v in (v0, v1)]
        spline = scipy.interpolate.CubicSpline(
            [0.0, *(share for share, _ in waypoints), 1.0], places, bc_type=tuple(rates)
        )
        return [np.asarray(spline(np.linspace(0.0, 1.0, intervals + 1)))]
    quintic = _quintic(intervals)
    turned = _turn_nodes(model, start, end, quintic, duration)
    return [
        quintic.between(q0, q1, duration * v0, duration * v1),
        *(select_coordinates(model, nodes) for nodes in turned),
    ]


def select_coordinates(model: Model, nodes: Array) -> Array:
    """Select the free coordinates from node positions.

    Nodes are (P, n, 3) [m], the coordinates (P, nq).
    """
    columns = np.array([model.columns(place).ravel() for place in nodes])
    return np.asarray(model.mechanism.local(columns)[:, model.mechanism.free_index])


def _turn_nodes(
    model: Model, start: Array, end: Array, quintic: _Quintic, duration: float
) -> Iterator[Array]:
    """Yield paths with large rotations of the structure or bars.

    They lead from the state `start` (nx,) to `end` (nx,) in `duration` s. Each path has the nodes
    (K + 1, n, 3) [m] at equal time intervals. `quintic` interpolates along the path.
    """
    (first, v0), (last, v1) = (
        (model.nodes(state), duration * model.velocities(state)) for state in (start, end)
    )
    held = model.structure.held.any()
    c0, c1, u0, u1 = (
        np.zeros(3) if held else values.mean(axis=0) for values in (first, last, v0, v1)
    )
    center, arms = quintic.between(c0, c1, u0, u1), (first - c0, last - c1)
    drifts = v0 - u0, v1 - u1
    for turn in [np.zeros(3)] if held else _list_turns(*arms, *drifts):
        frame, angle = Rotation.from_rotvec(turn), float(np.linalg.norm(turn))
        spins = [_spin(nodes, v) for nodes, v in zip(arms, drifts, strict=True)]
        shares = [float(spin @ turn) / angle**2 if angle else 0.0 for spin in spins]
        own = [
            v - np.cross(share * turn, nodes)
            for v, share, nodes in zip(drifts, shares, arms, strict=True)
        ]
        after, arriving = frame.inv().apply(arms[1]), frame.inv().apply(own[1])
        inner = quintic.between(arms[0], after, own[0], arriving)
        bars = _turn_bars(model, inner, own[0], arriving, quintic.change)
        if angle < LARGE_TURN and bars is None:
            continue
        turned = quintic.between(np.zeros(()), np.ones(()), *(np.array(share) for share in shares))
        rotations = Rotation.from_rotvec(turned[:, None] * turn)
        moved = (inner if bars is None else bars) @ rotations.as_matrix().transpose(0, 2, 1)
        yield np.asarray(moved + center[:, None])


def _list_turns(first: Array, last: Array, v0: Array, v1: Array) -> list[Array]:
    """List candidate rotation vectors from first to last nodes.

    Nodes are (n, 3) [m]. The candidates are the zero vector and up to two others. The best-fit
    rotation may have one turn less or more; the two are those nearest to the mean angular velocity.
    Without a rotation, they are whole turns about it. `v0` and `v1` (n, 3) are the velocities at
    both ends, per duration.
    """
    turn = Rotation.from_matrix(fit_rotation(first, last)).as_rotvec()
    angle, expected = np.linalg.norm(turn), (_spin(first, v0) + _spin(last, v1)) / 2
    if angle < 1e-9:
        spin = np.linalg.norm(expected)
        whole = 2 * np.pi * np.round(spin / (2 * np.pi))
        return [np.zeros(3), *([expected * (whole / spin)] if whole else [])]
    turns = [turn * (1 + 2 * np.pi * k / angle) for k in (-1, 0, 1)]
    return [np.zeros(3), *sorted(turns, key=lambda one: np.linalg.norm(one - expected))[:2]]


def _spin(arms: Array, velocities: Array) -> Array:
    """Compute the mean angular velocity of nodes.

    `arms` (n, 3) [m] point from the center of rotation to the nodes, which have the given
    velocities (n, 3). The unit of time is theirs.
    """
    inertia = (arms**2).sum() * np.eye(3) - arms.T @ arms
    return np.asarray(np.linalg.pinv(inertia) @ np.cross(arms, velocities).sum(axis=0))


def _turn_bars(
    model: Model, nodes: Array, leaving: Array, arriving: Array, change: Array
) -> Array | None:
    """Rotate each bar or rigid group of bars about an axis.

    Nodes are (P, n, 3) [m] at the times of the path. `leaving` and `arriving` are the initial and
    final velocities (n, 3), and `change` is the interpolation of rotation angles. Each bar rotates
    by the angle nearest to that of its velocities at both ends. Bars nearly keep their lengths, and
    other nodes stay near their lines. Returns None if no bar rotates far.
    """
    structure, ends = model.structure, _list_rods(model)
    b0, b1, r0, r1 = (
        values[ends[:, 1]] - values[ends[:, 0]]
        for values in (nodes[0], nodes[-1], leaving, arriving)
    )
    if not len(ends):
        return None
    l0, l1 = (np.maximum(np.linalg.norm(b, axis=1), 1e-300)[:, None] for b in (b0, b1))
    expected = (np.cross(b0, r0) / l0**2 + np.cross(b1, r1) / l1**2) / 2
    axes = np.cross(b0 / l0, b1 / l1)
    angles = np.arctan2(np.linalg.norm(axes, axis=1), (b0 * b1 / (l0 * l1)).sum(axis=1))
    # Parallel directions define no axis: take the expected one, or the normal of the structure.
    normal = np.linalg.svd(structure.nodes - structure.nodes.mean(axis=0))[2][-1]
    others = expected + 1e-3 * normal
    others -= b0 * ((others * b0).sum(axis=1)[:, None] / l0**2)
    straight = np.linalg.norm(axes, axis=1) < 1e-6
    axes[straight] = others[straight]
    axes /= np.maximum(np.linalg.norm(axes, axis=1), 1e-300)[:, None]
    rounds = np.round(((expected * axes).sum(axis=1) - angles) / (2 * np.pi))
    vectors = (angles + 2 * np.pi * rounds)[:, None] * axes
    differences = np.zeros((len(ends), nodes.shape[1]))
    differences[np.arange(len(ends)), ends[:, 0]] = -1.0
    differences[np.arange(len(ends)), ends[:, 1]] = 1.0
    _, label = connected_components(differences.T @ differences, directed=False)
    for group in (label[ends[:, 0]] == k for k in np.unique(label[ends])):
        first, last, least = b0[group], b1[group], RESOLUTION * l0.max()
        apart = first @ fit_rotation(first, last).T - last
        if np.linalg.matrix_rank(first, least) > 1 and np.abs(apart).max() < least:
            vectors[group] = _list_turns(first, last, r0[group], r1[group])[:2][-1]
    if np.linalg.norm(vectors, axis=1).max() < LARGE_TURN:
        return None
    fixed, weight = structure.fixed.all(axis=1), 1e-2
    stays = weight * np.where(fixed, 1e4, 1.0)[:, None]
    solve = np.linalg.pinv(np.vstack([differences, stays * np.eye(nodes.shape[1])]))
    turns = Rotation.from_rotvec((change[:, None, None] * vectors).reshape(-1, 3))
    turned = turns.apply(np.tile(b0, (len(change), 1))).reshape(len(change), *b0.shape)
    bars = turned * (1 + change[:, None, None] * (l1 / l0 - 1))
    return np.asarray(solve @ np.concatenate([bars, stays * nodes], axis=1))


def _list_rods(model: Model) -> Indices:
    """List the ends (m, 2) of all bars, and of the massless bars of rigid bodies."""
    structure, mechanism = model.structure, model.mechanism
    inner = mechanism.C_b[mechanism.bars - len(mechanism.body_of_bar) :]
    ends = np.sort(inner.indices.reshape(-1, 2))  # two entries in each row
    return np.vstack([structure.bars, ends[(ends < len(structure.nodes)).all(axis=1)]])


def _add_velocities(problem: Problem, target: Target, q: Array, duration: float) -> Array | None:
    """Build states that satisfy the constraints from free coordinates.

    Coordinates `q` (K + 1, nq) are at equal time intervals in `duration` s; velocities are their
    central differences. The first of the states (K + 1, nx) is the initial state of `target`, and
    the last its final state, if known. Returns None if they are not finite or if a bar turns by 90°
    or more within an interval.
    """
    model, intervals = problem.model, len(q) - 1
    start = target.start
    clock = (
        model.split(start).clock
        + np.linspace(0.0, duration, intervals + 1)[:, None][:, : int(model.has_clock)]
    )
    own = np.tile(model.split(start).internal, (intervals + 1, 1))
    resting = np.column_stack([q, np.zeros_like(q), own, clock])
    q, *_ = model.split(project_states(model, resting, 10))
    v = np.empty_like(q)
    v[0], v[-1] = (
        model.split(state).velocities
        for state in (start, start if target.state is None else target.state)
    )
    v[1:-1] = (q[2:] - q[:-2]) * (intervals / (2 * duration))
    states = project_states(model, np.column_stack([q, v, own, clock]), 10)
    states[0] = start
    if target.state is not None:
        states[-1] = target.state
    ends = model.nodes(states)[:, _list_rods(model)]
    bars = ends[:, :, 1] - ends[:, :, 0]
    turned = np.einsum("kba,kba->kb", bars[1:], bars[:-1])
    return states if np.all(np.isfinite(states)) and np.all(turned > 0) else None
