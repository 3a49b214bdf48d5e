"""Search for the state that meets the goals.

It precedes planning, so that infeasible goals are rejected by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.problem.control import pulled
from ocp.problem.problem import Problem
from ocp.problem.rows import stack
from ocp.problem.scaling import Scales
from ocp.targets.distance_rows import all_pairs, feel, neighbours, squared_distances
from ocp.targets.free_start import find_free_start
from ocp.targets.gauss_newton import NEARLY_SINGULAR, GaussNewton
from ocp.targets.infeasible_goal import InfeasibleGoalError
from ocp.targets.invariants import invariants
from ocp.targets.row_reduction import RANK, Reduction, RowFunction, reduce_rows, soft_directions
from ocp.targets.target import Target, WaypointTarget
from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices

# relative to the structure's size: goals of four digits may differ that much from bar lengths;
# larger violations are rejected
ROUNDED = 2e-4
RIGID = ("bar", "joint", "clock")


def find_target(
    problem: Problem, scales: Scales, near: Callable[[float], Array] | None = None
) -> Target:
    """Find the target of a problem.

    It is the state that meets the goals, nearest to the initial state or to `near` at the same
    fraction of the duration. Raises `InfeasibleGoalError`, which names the goal's row, the reason
    and the violation.
    """
    waypoints = []
    for share, part in problem.waypoints:
        try:
            met = _find_end(part, scales, near and near(share))
            _check_time(problem, met, part.longest)
        except InfeasibleGoalError as error:
            raise InfeasibleGoalError(f"waypoint at {share:.3g} of the duration: {error}") from None
        waypoints.append(WaypointTarget(share, met))
    if problem.start_goals:
        closed = any(
            goal.shift == (0.0, 0.0, 0.0) for goal in problem.repeating
        )  # the initial state is also the final one
        try:
            _find_end(
                replace(
                    problem,
                    goals=problem.start_goals + closed * problem.final_goals,
                    bounds=(),
                    costs=(),
                ),
                scales,
            )
        except InfeasibleGoalError as error:
            raise InfeasibleGoalError(f"free start: {error}") from None
    end = _find_end(problem, scales, near and near(1.0))
    _check_time(problem, end, problem.longest)
    return replace(end, waypoints=tuple(waypoints), free_start=find_free_start(problem, scales))


def _find_end(problem: Problem, scales: Scales, near: Array | None = None) -> Target:
    """Find the target at the end, without waypoints.

    The search starts at the initial state, or at a state near the target.
    """
    model, start = problem.model, problem.first_state
    finder = _Finder(problem, start, scales)
    if finder.goals.names:
        y, adjusted = finder.find_state(start if near is None else near)
        return finder.impose(y, adjusted)
    x = ca.SX.sym("x", model.nx)
    empty = ca.SX(0, 1)
    single, misfit = ca.Function("single", [x], [empty]), ca.Function("misfit", [x], [empty, empty])
    return Target(start, None, single, np.zeros((0, 0)), misfit, (), Reduction(np.zeros((0, 0))))


def _check_time(problem: Problem, target: Target, seconds: float) -> None:
    """Reject targets that the duration and force limits cannot reach.

    Only goals that are much too far away are rejected.
    """
    model, start = problem.model, problem.first_state
    _, most = problem.force_density_limits
    if (
        target.state is None
        or problem.free_start
        or model.scene.has_clock
        or not np.all(np.isfinite(most))
    ):
        return
    linear = EquationDerivatives.of(pulled(model)).at(start[None], np.zeros((1, model.nu)))
    (free,), (by_control,) = model.split(linear.rates)[1], linear.accelerations_by_control()
    fastest = np.max(np.abs(free) + np.abs(by_control) @ most)
    reach = (np.abs(model.split(start)[1]).max() + fastest * seconds) * seconds
    away = np.abs(model.split(target.state - start)[0])
    if away.max() > 100 * reach:  # accelerations may increase, but not by this factor
        way = f"{model.mechanism.coordinate_names[np.argmax(away)]} has to move by {away.max():.2g} m in {seconds:.2g} s"
        raise InfeasibleGoalError(
            f"{way}, in which force densities within their limits move it by about {reach:.2g} m: give more time"
        )


class _Finder:
    """Search for y that meets goals and invariants.

    y is (x, duration).
    """

    def __init__(self, problem: Problem, start: Array, scales: Scales) -> None:
        model, self.problem, self.start, self.scales = problem.model, problem, start, scales
        self.x, duration = ca.SX.sym("x", model.nx), ca.SX.sym("T")
        self.y = ca.vertcat(self.x, duration)
        self.scale = np.append(scales.state, scales.time)
        N, V, structure = model.nodes(self.x).T, model.velocities(self.x).T, model.scene.structure
        self.goals = stack(goal.rows(structure, N, V) for goal in problem.final_goals)
        # a free start can have any momentum
        self.invariants = [
            rows
            for rows in invariants(model, start, self.x, duration)
            if rows.kind in RIGID or not problem.free_start
        ]
        every = [self.goals, *self.invariants]
        sizes = np.concatenate([rows.sizes(scales.units) for rows in every])
        self.rows = RowFunction(self.y, [rows.value for rows in every], sizes, self.scale)
        ends = np.cumsum([0, *(len(rows.units) for rows in every)]).tolist()
        self.goal, *self.kept = [self.rows.select(slice(a, b)) for a, b in pairwise(ends)]
        self.search = GaussNewton(self.scale, _metric(model), self._allowed, self._deforming)

    # --- the state ---

    def find_state(self, near: Array) -> tuple[Array, float]:
        """Find the target y near a state.

        Also returns the adjustment of goals [m], 0 if they are met.
        """
        y = np.append(near, self.problem.typical_duration)
        rigid = [k for k, rows in enumerate(self.invariants) if rows.kind in RIGID]
        goals, miss = len(self.goals.names), 0.0
        for active in (
            [rigid]
            if len(rigid) == len(self.invariants)
            else [rigid, list(range(len(self.invariants)))]
        ):
            count = goals + sum(
                len(self.invariants[k].units) for k in active
            )  # rigid directions come first
            y = self.search.find_nearest(self.rows.select(slice(count)), goals, y)
            miss = self._miss(y)
            if miss > ROUNDED:
                self._refuse(y, active)
        straight = self._straightened(y)
        if straight is not None:
            y = self.search.find_nearest(self.rows, goals, straight)
            miss = self._miss(y)
        return y, miss * self.scales.length if miss > 1e-7 else 0.0

    def _miss(self, y: Array) -> float:
        return float(np.abs(self.goal(y)[0]).max(initial=0.0))

    def _allowed(self, y: Array) -> Array:
        """Clip the duration in y to the problem's limits."""
        return np.append(y[:-1], np.clip(y[-1], self.problem.shortest, self.problem.longest))

    def _deforming(self, step: Array) -> Array:
        """Remove the rigid translation from a change of y.

        Structures with pinned nodes have none.
        """
        nq = self.problem.model.nq
        result = np.where(np.arange(len(step)) < nq, step, 0.0)
        if not self.problem.model.structure.held.any():
            result[:nq] -= np.tile(step[:nq].reshape(-1, 3).mean(axis=0), nq // 3)
        return result

    def _straightened(self, y: Array) -> Array | None:
        """Move nodes inside strings to the line between the ends.

        Returns None if there are none.
        """
        model, s = self.problem.model, self.problem.model.structure
        parent = s.string_parent
        inner = np.flatnonzero(
            parent[:-1] == parent[1:]
        )  # segments are ordered from first to second node
        if not inner.size:
            return None
        nodes = model.nodes(y[:-1]).copy()
        a, b = nodes[model.scene.structure.strings].transpose(1, 0, 2)
        along = np.cumsum(s.string_fraction)
        along = along - np.concatenate([[0.0], along])[np.searchsorted(parent, parent)]
        nodes[s.strings[inner, 1]] = a[parent[inner]] + along[inner, None] * (b - a)[parent[inner]]
        x = model.state(nodes, model.velocities(y[:-1]))
        model.split(x)[2][:] = model.split(y[:-1])[2]
        return np.append(x, y[-1])

    def _refuse(self, y: Array, active: list[int]) -> None:
        """Reject the goal row of the largest violation.

        The message names the invariant with the largest multiplier.
        """
        r, H = self.goal(y)
        worst = int(
            np.argmax(np.abs(r) > (1 - 1e-6) * np.abs(r).max())
        )  # the first of equal violations
        size, unit = abs(r[worst]) * self.goal.row_scale[worst], self.goals.units[worst]
        reason = "the goals contradict each other: leave one out"
        rows = [
            (self.invariants[k].kind, name) for k in active for name in self.invariants[k].names
        ]
        if rows:
            A = np.concatenate([self.kept[k](y)[1] for k in active])
            norms = np.linalg.norm(A, axis=1)
            push = abs(
                np.linalg.lstsq((A / np.maximum(norms, 1e-9)[:, None]).T, H.T @ r, rcond=RANK)[0]
            )
            later = np.array([kind not in RIGID for kind, _ in rows])
            if later.any():  # the goals satisfy the bar constraints, as an earlier step has checked
                push = push * later + 1e-9 * later * np.arange(
                    len(rows)
                )  # without multipliers the last invariant is the reason: the plane
            kind, name = rows[int(np.argmax(push))]
            if push.max() > 1e-2 * np.abs(r).max() or later.any():
                reason = f"{name}{_CURES[kind]}"
        raise InfeasibleGoalError(
            f"{self.goals.names[worst]} misses its goal by {size:.3g} {unit} at best, as {reason}"
        )

    # --- the rows ---

    def impose(self, y: Array, adjusted: float) -> Target:
        """Build the target at y from independent rows."""
        values, H = self.goal(y)
        directions, _, _ = soft_directions(self.rows, y, NEARLY_SINGULAR)
        weights, gradient, near = self._shape_rows(y, directions)
        added = len(weights)
        H = np.concatenate([H, gradient])
        groups = [
            (rows.kind, kept(y)[1]) for rows, kept in zip(self.invariants, self.kept, strict=True)
        ]
        if self.problem.shortest == self.problem.longest:
            H, groups = H[:, :-1], [(kind, A[:, :-1]) for kind, A in groups]
        row_names = (*self.goals.names, *(f"shape, combination {k}" for k in range(added)))
        reduction = reduce_rows(
            H, groups, row_names, np.append(self.goal.row_scale, np.ones(added))
        )
        found = self._nodes(y)
        squared = self._squared(near) - ca.DM(
            squared_distances(found, near) / self.scales.length**2
        )
        rows = ca.vertcat(self.goals.value / ca.DM(self.goal.row_scale) - ca.DM(values), squared)
        single, every = ca.Function("single", [self.x], [rows]), reduction.combinations
        imposed = np.concatenate(
            [every[:, : len(values)], every[:, len(values) :] @ weights], axis=1
        )
        pairs = all_pairs(len(found)) if added else near
        distances = ca.sqrt(self._squared(pairs)) * self.scales.length - ca.DM(
            np.sqrt(squared_distances(found, pairs))
        )
        lengths, speeds = self.goals.select("m"), self.goals.select("m/s")
        misfit = ca.Function(
            "misfit",
            [self.x],
            [ca.vertcat(lengths.value, distances), speeds.value],
            ["x"],
            ["metres", "speeds"],
        )
        names = (
            *lengths.names,
            *(f"distance of nodes {a} and {b}" for a, b in pairs),
            *speeds.names,
        )
        return Target(
            self.start, y[:-1], single, imposed, misfit, names, reduction, added, adjusted
        )

    def _shape_rows(self, y: Array, directions: Array) -> tuple[Array, Array, Indices]:
        """Find rows that depend on directions, not rigid motions.

        Returns combinations (k, m) of m squared distances, their gradients, and the pairs (m, 2).
        """
        structure, nodes = self.problem.model.scene.structure, self._nodes(y)
        placed = ca.jacobian(ca.vec(self.problem.model.nodes(self.x)[: len(nodes), :].T), self.y)
        by_y = ca.DM(ca.Function("moves", [self.y], [placed])(y)).sparse()
        moves = sp.csr_array(sp.csr_array(by_y) * (self.scale / self.scales.length))
        # clock and duration do not change distances
        directions = directions[:, np.linalg.norm(moves @ directions, axis=0) > RANK]
        if not directions.shape[1]:
            return np.zeros((0, 0)), np.zeros((0, len(y))), np.zeros((0, 2), dtype=np.intp)
        return feel(nodes / self.scales.length, moves, directions, neighbours(structure))

    def _nodes(self, y: Array) -> Array:
        """Compute the nodes (n, 3), without those inside strings."""
        return np.asarray(
            self.problem.model.nodes(y[:-1])[: len(self.problem.model.scene.structure.nodes)]
        )

    def _squared(self, pairs: Indices) -> Any:
        """Compute the squared distances of pairs (m, 2) as rows.

        They are functions of x, relative to the structure's size.
        """
        N = self.problem.model.nodes(self.x).T
        d = N[:, pairs[:, 0].tolist()] - N[:, pairs[:, 1].tolist()]
        return ca.sum1(d * d).T / self.scales.length**2


def _metric(model: Model) -> Array:
    """Compute the mass metric on positions and velocities.

    It is relative to the mean mass, and 1 for the clock, the duration, and pinned nodes without
    mass.
    """
    mass = model.mechanism.free_mass.toarray()
    mass = mass / np.diag(mass).mean()
    mass += np.diag((np.diag(mass) == 0).astype(float))
    result = np.eye(model.nx + 1)
    result[: model.nq, : model.nq] = mass
    result[model.nq : 2 * model.nq, model.nq : 2 * model.nq] = mass
    return result


_CURES = {
    "bar": ": give goals that fit the bars",
    "joint": ": give goals that fit the joints",
    "clock": ": give goals that fit the time",
    "momentum": " whatever the strings do: move the goal there, or pin a node",
    "plane": ", where all forces act: move the goal into it, or start out of it",
}
