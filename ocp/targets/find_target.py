"""Search for a final state that meets the goals.

The search precedes planning. The state determines the initial guess. The gradients of the goals
there determine which goal rows are independent. Goals that are proven infeasible are rejected by
name.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, pairwise
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.problem.goals.goal import Goal
from ocp.problem.problem import Problem
from ocp.problem.rows import RELIABLE, RESOLUTION, Rows, goal_rows
from ocp.problem.scaling import Scales, typical_mass
from ocp.targets.certificate import prove_infeasible, read_quadratic
from ocp.targets.distance_rows import find_distance_rows, list_neighbors, squared_distances
from ocp.targets.free_start import find_free_start
from ocp.targets.gauss_newton import NEARLY_SINGULAR, STARTS, GaussNewton
from ocp.targets.infeasible_goal import InfeasibleGoalError, TargetNotFoundWarning
from ocp.targets.invariants import invariants
from ocp.targets.rigid_fit import fit_start
from ocp.targets.row_reduction import RowFunction, reduce_rows, soft_directions
from ocp.targets.target import Target, WaypointTarget
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.names import add_names
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import TOLERANCE, Array, Indices

# relative to the structure's size: inconsistency of goals with bar lengths that rounding to four
# digits causes; if residuals are larger, the search continues for a state that meets the goals
ROUNDED = 2e-4
# to the typical mass: largest ratio in the metric, where motions of a heavier node, divided by the
# root of its mass, would fall below the rank tolerance
MASS_RATIO = 10.0
RIGID = ("bar", "joint", "clock")


def find_target(
    problem: Problem,
    scales: Scales,
    near: Callable[[float], Array] | None = None,
    tolerance: float = RELIABLE,
) -> Target:
    """Find states that meet the terminal goals and the waypoints.

    They are the nearest ones to the initial state, or to `near` at the same fraction of the
    duration. Raises `InfeasibleGoalError` for goals that are proven to be infeasible by more than
    the tolerance, which is relative to the structure's size, and warns if no state was found.
    `near` maps a fraction of the duration to a state.
    """
    tolerance = max(tolerance, ROUNDED)

    def find(share: float, goals: tuple[Goal, ...], label: str = "") -> Target:
        state = problem.initial_state if near is None else near(share)
        return _find_end(problem, goals, share, scales, state, label, tolerance)

    waypoints = [
        WaypointTarget(share, find(share, goals, f"waypoint at {share:.3g} of the duration: "))
        for share, goals in problem.waypoints
    ]
    if problem.initial_goals:
        closed = any(goal.shift == (0.0, 0.0, 0.0) for goal in problem.periodic_goals)
        find(0.0, problem.initial_goals + closed * problem.terminal_goals, "free start: ")
    end = find(1.0, problem.terminal_goals)
    return replace(
        end, waypoints=tuple(waypoints), free_start=find_free_start(problem, scales, tolerance)
    )


def _find_end(
    problem: Problem,
    goals: tuple[Goal, ...],
    share: float,
    scales: Scales,
    near: Array,
    label: str,
    tolerance: float,
) -> Target:
    """Find a state that meets the goals at one instant.

    `share` is the instant's fraction of the duration. A free initial state may be at any time of
    the plan. The search starts at the state `near`. `label` begins its error messages. `tolerance` is
    relative to the structure's size.
    """
    search = _TargetSearch(problem, goals, share or 1.0, scales, tolerance)
    if not search.goals.names:
        x = ca.SX.sym("x", problem.model.nx)
        empty = ca.Function("single", [x], [ca.SX(0, 1)])
        return Target(problem.initial_state, None, empty, np.zeros((0, 0)), empty, (), ())
    try:
        return search.run(near)
    except InfeasibleGoalError as error:
        raise InfeasibleGoalError(f"{label}{error}", error.certificate) from None


class _TargetSearch:
    """Search for a state and duration that meet all goals.

    The unknown is y = (x, duration). It also satisfies the conserved quantities (invariants). The
    duration in y is the time of the goals, the fraction `share` of the plan's duration.
    """

    def __init__(
        self,
        problem: Problem,
        goals: tuple[Goal, ...],
        share: float,
        scales: Scales,
        tolerance: float,
    ) -> None:
        model, self.problem, self.scales = problem.model, problem, scales
        self.tolerance = tolerance
        self.shortest, self.longest = share * problem.shortest, share * problem.longest
        self.typical, self.given = share * problem.typical_duration, goals
        self.x, duration = ca.SX.sym("x", model.nx), ca.SX.sym("T")
        self.y, self.scale = ca.vertcat(self.x, duration), np.append(scales.state, scales.time)
        self.goals = goal_rows(goals, model, self.x)
        self.sizes = self.goals.sizes(scales.units)
        self.invariants = self._invariants(duration, duration**2 / 2)
        every = [self.goals, *self.invariants]
        self.rows = RowFunction(self.y, [rows.scale(scales.units) for rows in every], self.scale)
        ends = np.cumsum([0, *(len(rows.units) for rows in every)]).tolist()
        self.goal, *self.kept = [self.rows.select(slice(a, b)) for a, b in pairwise(ends)]
        self.search = GaussNewton(self.scale, _metric(model), self._allowed, self._deforming)

    def _invariants(self, time: Any, half_square: Any) -> list[Rows]:
        """Build the invariants of the motion after `time`.

        They are bar lengths, joints, clock and conserved momenta. A free initial state can have any
        momentum, so that momenta are then omitted. `half_square` is time²/2.
        """
        start = self.problem.initial_state
        return [
            rows
            for rows in invariants(self.problem.model, start, self.x, time, half_square)
            if rows.kind in RIGID or not self.problem.free_start
        ]

    # --- the state ---

    def run(self, near: Array) -> Target:
        """Find the final state and its independent goal rows.

        The search starts near the given state, then at states that approximately meet the goals. It
        ends at a state that meets them up to rounding, or within the tolerance if the next start
        leads to none that is better.
        """
        best, least = np.append(near, self.typical), np.inf
        for start in self._starts(near):
            y = self._find_nearest(start)
            miss = float(np.abs(self.rows(y)[0]).max(initial=0.0))
            better = miss < (1 - RESOLUTION) * least
            if miss < least:
                best, least = y, miss
            if least <= (ROUNDED if better else self.tolerance):
                break
        if least > self.tolerance:
            self._reject(best)
        straight = self._straighten(best)
        if straight is not None:
            best = self.search.find_nearest(self.rows, len(self.goals.names), straight)
        return self.impose(best, least <= self.tolerance)

    def _starts(self, near: Array) -> Iterator[Array]:
        """Yield the starting points y of the search.

        They are the state `near`, the initial state, and states that approximately meet the goals,
        each at several durations, then random changes of `near`.
        """
        problem = self.problem
        times = [self.typical]
        if self.shortest < self.longest:
            times += np.linspace(self.shortest, self.longest, 5).tolist()
        split = problem.model.split
        given = [near] if near is problem.initial_state else [near, problem.initial_state]
        for state in chain(given, fit_start(problem.model, self.given, near)):
            for time in times:
                y = np.append(state, time)
                split(y[:-1]).clock[:] = split(problem.initial_state).clock + time
                yield y
        if len(self.goals.names) > problem.model.nq:
            return  # few states meet such goals, which is costly to find out
        drawn = np.random.default_rng(0)
        spread = 0.3  # in units of the size; sizes from 0.1 to 0.5 find the same targets
        for _ in range(STARTS):
            y = np.append(near, self.typical)
            split(y[:-1]).clock[:] = split(problem.initial_state).clock + self.typical
            places = split(y[:-1]).positions
            places += spread * self.scales.length * drawn.uniform(-1.0, 1.0, places.shape)
            yield y

    def _find_nearest(self, y: Array) -> Array:
        """Minimize the goal residuals, starting from y.

        The first pass has the constraints of bars, joints and clock only, the second one all
        invariants. Returns y at the end of the second pass.
        """
        goals = len(self.goals.names)
        rigid = sum(len(rows.units) for rows in self.invariants if rows.kind in RIGID)
        y = self.search.find_nearest(self.rows.select(slice(goals + rigid)), goals, y)
        if goals + rigid < self.rows.count:
            y = self.search.find_nearest(self.rows, goals, y)
        return y

    def _allowed(self, y: Array) -> Array:
        """Clip the duration in y to the problem's limits."""
        return np.append(y[:-1], np.clip(y[-1], self.shortest, self.longest))

    def _deforming(self, step: Array) -> Array:
        """Select the part of a change of y that deforms the structure.

        `step` (ny,) is the change, scaled. The part changes positions only, without rigid-body
        translation. With pinned nodes there is no such translation.
        """
        nq = self.problem.model.nq
        result = np.where(np.arange(len(step)) < nq, step, 0.0)
        if not self.problem.model.structure.held.any():
            result[:nq] -= np.tile(step[:nq].reshape(-1, 3).mean(axis=0), nq // 3)
        return result

    def _straighten(self, y: Array) -> Array | None:
        """Move nodes inside strings to the straight line between the ends.

        Strings that are modeled in segments have such nodes. Returns the changed y, or None if
        there are none.
        """
        model, s = self.problem.model, self.problem.model.structure
        parent = s.string_parent
        # segments are ordered from first to second node
        inner = np.flatnonzero(parent[:-1] == parent[1:])
        if not inner.size:
            return None
        nodes = model.nodes(y[:-1]).copy()
        a, b = nodes[model.scene.structure.strings].transpose(1, 0, 2)
        along = np.cumsum(s.string_fraction)
        along = along - np.concatenate([[0.0], along])[np.searchsorted(parent, parent)]
        nodes[s.strings[inner, 1]] = a[parent[inner]] + along[inner, None] * (b - a)[parent[inner]]
        x = model.state(nodes, model.velocities(y[:-1]))
        model.split(x).internal[:] = model.split(y[:-1]).internal
        model.split(x).clock[:] = model.split(y[:-1]).clock
        return np.append(x, y[-1])

    def _reject(self, y: Array) -> None:
        """Raise InfeasibleGoalError if the goals are proven infeasible.

        Otherwise warn that no state was found. `y` is the state and duration that come closest to
        the goals.
        """
        values = self.goal(y)[0]
        # the first of equal violations
        worst = int(np.argmax(np.abs(values) > (1 - 1e-6) * np.abs(values).max()))
        size = abs(values[worst]) * self.sizes[worst]
        proof = self._prove(y)
        if proof is None:
            text = (
                f"no state was found that meets the goals; at the nearest one, "
                f"{self.goals.names[worst]} is off by {size:.3g} {self.goals.units[worst]}"
            )
            text = add_names(text, self.problem.model.scene.structure)
            warnings.warn(text, TargetNotFoundWarning, stacklevel=2)
            return
        weights = proof.multipliers
        named = [name for name in self.goals.names if weights.get(name)]
        if named:
            worst = self.goals.names.index(max(named, key=lambda name: abs(weights[name])))
            size = abs(values[worst]) * self.sizes[worst]
        reasons = {name: rows.kind for rows in self.invariants for name in rows.names}
        least = TOLERANCE * max(map(abs, weights.values()), default=0.0)  # the solver's errors
        held = [name for name in reasons if abs(weights.get(name, 0.0)) > least]
        reason = "the goals contradict each other: leave one out"
        if sum(abs(weights[name]) > least for name in named) == 1:
            reason = "no state of the structure comes closer: change the goal"
        if held:
            name = max(held, key=lambda name: abs(weights[name]))
            reason = f"{name}{_CURES[reasons[name]]}"
        raise add_address(
            InfeasibleGoalError(
                f"{self.goals.names[worst]} misses its goal by {size:.3g} "
                f"{self.goals.units[worst]} at best, as {reason}",
                proof,
            )
        )

    def _prove(self, y: Array) -> Any:
        """Prove that goals and invariants contradict each other.

        `y` is the state and duration at which the search for a proof begins. Returns None if there
        is no proof. A free duration T enters by T and T²/2 as independent unknowns within their
        limits.
        """
        model, (first, last) = self.problem.model, (self.shortest, self.longest)
        free = first < last
        time: Any = ca.SX.sym("time", 2) if free else ca.DM([last, last**2 / 2])
        every = [self.goals, *self._invariants(time[0], time[1])]
        columns, scale, box = [self.x], self.scales.state, np.tile([[-np.inf], [np.inf]], model.nx)
        if free:
            columns.append(time)
            units = self.scales.time ** np.arange(1, 3)
            scale = np.append(scale, units)
            box = np.hstack([box, [[first, first**2 / 2] / units, [last, last**2 / 2] / units]])
        every = [
            replace(rows, value=rows.value if rows.quadratic is None else rows.quadratic)
            for rows in every
        ]
        if model.scene.has_clock and not free:
            clock = float(model.split(self.problem.initial_state).clock[0]) + last
            every = [
                replace(rows, value=ca.substitute(rows.value, self.x[-1], clock)) for rows in every
            ]
        names = [name for rows in every for name in rows.names]
        scaled = [rows.scale(self.scales.units) for rows in every]
        # invariants hold up to rounding; velocities count as distances in the duration
        permitted = np.full(len(names), TOLERANCE)
        permitted[: len(self.goals.names)] = self.tolerance
        fast = [unit == "m/s" for unit in self.goals.units]
        permitted[: len(fast)][fast] *= self.scales.time / self.problem.shortest
        rows = read_quadratic(RowFunction(ca.vertcat(*columns), scaled, scale), names, permitted)
        z = np.append(y[:-1], [y[-1], y[-1] ** 2 / 2] if free else []) / scale
        return prove_infeasible(rows, z, box)

    # --- the rows ---

    def impose(self, y: Array, met: bool) -> Target:
        """Select independent goal rows at y, and build the target.

        `met` tells whether y meets the goals within the tolerance. If it does, their values are
        adjusted to it; otherwise they remain as given.
        """
        values, H = self.goal(y)
        adjusted = float(np.abs(values).max(initial=0.0)) * self.scales.length if met else 0.0
        values = values if met else np.zeros_like(values)
        directions, _, _ = soft_directions(self.rows, y, NEARLY_SINGULAR)
        weights, gradient, pairs = self._find_shape_rows(y, directions)
        H = np.concatenate([H, gradient])
        groups = [
            (rows.kind, kept(y)[1]) for rows, kept in zip(self.invariants, self.kept, strict=True)
        ]
        if self.shortest == self.longest:
            H, groups = H[:, :-1], [(kind, A[:, :-1]) for kind, A in groups]
        names = (*self.goals.names, *(f"shape, combination {k}" for k in range(len(weights))))
        sizes = np.append(self.sizes, np.ones(len(weights)))
        reduction = reduce_rows(H, groups, names, sizes)
        squared = self._squared(pairs)
        at_target = ca.Function("squared", [self.x], [squared])(y[:-1])
        scaled = self.goals.scale(self.scales.units) - ca.DM(values)
        every, own = reduction.combinations, len(values)
        return Target(
            start=self.problem.initial_state,
            state=y[:-1],
            single=ca.Function("single", [self.x], [ca.vertcat(scaled, squared - at_target)]),
            weights=np.concatenate([every[:, :own], every[:, own:] @ weights], axis=1),
            misfit=ca.Function("misfit", [self.x], [self.goals.value]),
            names=self.goals.names,
            units=self.goals.units,
            reduction=reduction,
            shape=len(weights),
            adjusted=adjusted if adjusted > 1e-7 * self.scales.length else 0.0,
            met=met,
            tolerance=self.tolerance,
        )

    def _find_shape_rows(self, y: Array, directions: Array) -> tuple[Array, Array, Indices]:
        """Find distances between nodes that change along directions.

        `directions` (ny, k) are scaled changes of y. Distances do not change with rigid-body
        motions. Returns combinations (k, m) of m squared distances, their gradients (k, ny) with
        respect to y, and the pairs (m, 2) of nodes.
        """
        structure = self.problem.model.scene.structure
        count = len(structure.nodes)
        nodes = self.problem.model.nodes(y[:-1])[:count]
        placed = ca.jacobian(ca.vec(self.problem.model.nodes(self.x)[:count, :].T), self.y)
        by_y = ca.DM(ca.Function("moves", [self.y], [placed])(y)).sparse()
        moves = sp.csr_array(sp.csr_array(by_y) * (self.scale / self.scales.length))
        # clock and duration do not change distances
        directions = directions[:, np.linalg.norm(moves @ directions, axis=0) > RESOLUTION]
        if not directions.shape[1]:
            return np.zeros((0, 0)), np.zeros((0, len(y))), np.zeros((0, 2), dtype=np.intp)
        return find_distance_rows(
            nodes / self.scales.length, moves, directions, list_neighbors(structure)
        )

    def _squared(self, pairs: Indices) -> Any:
        """Build the squared distances of node pairs (m, 2).

        They are relative to the structure's size squared.
        """
        N = self.problem.model.nodes(self.x)
        return squared_distances(N, pairs) / self.scales.length**2


def _metric(model: Model) -> Array:
    """Compute the metric of state changes from the mass matrix.

    Positions and velocities have the mass relative to a typical one. The clock, the duration, and
    pinned nodes without mass have 1. Masses far from the typical one are limited.
    """
    mass = model.mechanism.free_mass.toarray()
    own = np.diag(mass)
    mass = mass / typical_mass(model)
    mass += np.diag((own == 0).astype(float))
    if np.diag(mass).max() > MASS_RATIO or np.diag(mass).min() < 1 / MASS_RATIO:
        values, vectors = np.linalg.eigh(mass)
        mass = vectors * np.clip(values, 1 / MASS_RATIO, MASS_RATIO) @ vectors.T
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
