"""A plan as a problem in force densities and duration alone: what they do to costs and goals, to second order, about any motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.condensed.chain import Chain, Motion, Rows
from ocp.condensed.goal_rows import GoalRows, needed_taps
from ocp.condensed.linear_chain import Costate, LinearChain
from ocp.condensed.objective import Objective
from ocp.condensed.path_rows import Limited, PathRows, Slopes
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import group_matrix, spans
from tenscasadi.util.validate import Array


class Leftover(NamedTuple):
    """Residuals: rows of goals (m,), of the motion, and of the limits along it (p,), less their slacks."""

    goals: Array
    rows: Rows
    paths: Array


class ReducedProblem:
    """Minimise J(w) subject to goals, w = force densities (Kc, m) in units of `strength`, then the duration, if free, in units of `time`."""

    def __init__(
        self,
        problem: Problem,
        transcription: Transcription,
        target: Target,
        scales: Scales,
        strength: float,
        cost: float,
        limited: Limited | None = None,
    ) -> None:
        fractions, profile = transcription.fractions, transcription.control
        self.problem, self.length, self.cost_scale = problem, scales.length, cost
        taps = needed_taps(target, fractions)
        self.chain = Chain(
            problem.model,
            fractions,
            profile,
            target.start,
            taps if limited is None else np.union1d(taps, limited.taps),
        )
        self.goals = GoalRows(self.chain, target)
        self.objective = Objective(problem, fractions, profile)
        self.shape = self.chain.controls.shape
        self.free_duration = problem.shortest < problem.longest
        self.duration = problem.longest
        self.together = group_matrix(profile, problem.model.nu)
        self.span = np.arange(len(fractions) + 1) if profile.linear else spans(profile, fractions)
        self.begins = np.unique(self.span, return_index=True)[
            1
        ]  # where each of the force densities begins that are unknowns
        self.paths = PathRows(self.chain, limited, self.begins)
        members = [np.flatnonzero(column) for column in self.together.T]
        least, most = problem.force_density_limits
        lower, upper = (
            np.array([pick(limit[own]) for own in members])
            for pick, limit in ((np.max, least), (np.min, most))
        )
        ends = [
            (np.tile(limit, self.shape[0]), bound)
            for limit, bound in ((lower, problem.shortest), (upper, problem.longest))
        ]
        self.units = np.append(
            np.full(self.shape[0] * self.shape[1], strength), [scales.time] * self.free_duration
        )
        self.lower, self.upper = (
            np.append(limit, [bound] * self.free_duration) / self.units for limit, bound in ends
        )
        self.size = len(self.units)
        self.shift: Rows | None = (
            None  # what rows of the motion are to leave, where they are corrected
        )

    def split(self, w: Array) -> tuple[Array, float]:
        """Return force densities (Kc, m), N/m, and the duration, s."""
        own = w * self.units
        count = self.shape[0] * self.shape[1]
        return own[:count].reshape(self.shape), float(
            own[-1]
        ) if self.free_duration else self.duration

    def force_densities(self, w: Array) -> Array:
        """Return γ of all strings (K, α), of linear profiles at the nodes of the mesh (K + 1, α), N/m."""
        return np.asarray(self.split(w)[0][self.span] @ self.together.T)

    def joined(self, c: Array, duration: Array | float) -> Array:
        """Return what belongs to each unknown: (n,) or (n, r) of (Kc, m) or (Kc, m, r) and what belongs to the duration."""
        flat = c.reshape(self.shape[0] * self.shape[1], *c.shape[2:])
        if self.free_duration:
            flat = np.concatenate([flat, np.reshape(duration, (1, *flat.shape[1:]))])
        return np.asarray(flat)

    def strings(self, w: Array) -> Array:
        """Return T²σγ at the stations (K + X, α)."""
        c, T = self.split(w)
        return T**2 * self.chain.controls.at_stations(c)

    def cost(self, w: Array) -> float:
        """Return J."""
        return self.objective.value(*self.split(w)) / self.cost_scale

    def slope(self, w: Array) -> Array:
        """Return the gradient of J."""
        return np.asarray(
            self.joined(*self.objective.gradient(*self.split(w))) * self.units / self.cost_scale
        )

    def curvature_scale(self, w: Array) -> tuple[Array, Array | None]:
        """Return a positive diagonal (n,) about as large as the second derivatives of J, and what couples neighbouring intervals, if anything."""
        c, T = self.split(w)
        diagonal, coupling = self.objective.metric(T)
        by_time = 2 * abs(self.objective.parts(c)[0]) / T
        own = self.joined(diagonal, by_time) * self.units**2 / self.cost_scale
        least = 1e-3 * float(own.mean()) if own.any() else 1.0 / self.size
        scale = float(self.units[0] ** 2 / self.cost_scale)
        return np.maximum(own, least), coupling * scale if self.objective.coupled else None

    def leftover(self, w: Array, motion: Motion, slack: Array) -> Leftover:
        """Return what is not met. slack: values (p,) within the limits along the way, which these are to take."""
        c, T = self.split(w)
        return Leftover(
            self.goals.value(motion, T),
            self.rows_of(w, motion),
            self.paths.value(c, T, motion) - slack,
        )

    def rows_of(self, w: Array, motion: Motion) -> Rows:
        """Return what the rows of the motion leave, less what they are to leave."""
        rows = self.chain.rows(self.strings(w), self.split(w)[1], motion)
        return (
            rows
            if self.shift is None
            else Rows(rows.impulses - self.shift.impulses, rows.lengths - self.shift.lengths)
        )

    def size_of(self, left: Leftover) -> tuple[float, float]:
        """Return the sum and the largest of what is not met, all of order one."""
        parts = [
            left.goals,
            left.paths,
            self.chain.count / self.length * left.rows.impulses,
            left.rows.lengths / self._squared,
        ]
        return sum(float(np.abs(part).sum()) for part in parts), max(
            float(np.abs(part).max(initial=0.0)) for part in parts
        )

    @property
    def _squared(self) -> Array:
        return np.broadcast_to(
            np.maximum(self.chain.squared, 1e-300), (len(self.chain.at), self.chain.bars)
        )

    def about(self, w: Array, motion: Motion) -> Expansion:
        """Return the expansion about a point."""
        return Expansion(self, w, motion)


class Expansion:
    """Costs and goals about a point, to second order, along steps of w that the motion follows."""

    def __init__(self, reduced: ReducedProblem, w: Array, motion: Motion) -> None:
        self.of, self.motion = reduced, motion
        chain, goals = reduced.chain, reduced.goals
        self.c, self.T = reduced.split(w)
        self.unit = chain.controls.at_stations(self.c)
        self.strings = self.T**2 * self.unit
        self.linear = LinearChain(chain, self.strings, motion)
        self.loads = chain.impulses(self.T)
        self.by_duration = -self.loads[1]
        self.by_duration[0] -= (chain.mass @ chain.first_rate).ravel()
        self.lengths_by_duration = np.zeros((len(chain.at), chain.bars))
        self.carried = chain.carried(self.T)[1:] if chain.moved and reduced.free_duration else None
        if self.carried is not None:
            pushes, self.lengths_by_duration = self.linear.along(self.carried[0])
            self.by_duration += pushes
        self.moved_by_duration = chain.by_inverse(self.by_duration[:, :, None])[:, :, 0]
        self.goal_slopes = goals.jacobians(motion, self.T)
        self.jacobian = self._jacobian()
        self.entries = (
            reduced.paths.entries(self.c, self.T, motion) if reduced.paths.count else np.zeros(0)
        )
        self.path_slopes = reduced.paths.jacobian(self.entries) if reduced.paths.count else None

    def _jacobian(self) -> Array:
        """Return the derivatives (m, n) of the goals by w."""
        of = self.of
        if not of.goals.count:
            return np.zeros((0, of.size))
        slopes = of.goals.slopes(self.goal_slopes, np.eye(of.goals.count))
        return self._followed(slopes.motion, slopes.duration)

    def of_paths(self, weights: Array) -> Array:
        """Return the derivatives (r, n) by w of combinations (p, r) of the limits along the way."""
        if self.path_slopes is None or not weights.shape[1]:
            return np.zeros((weights.shape[1], self.of.size))
        slopes = self.of.paths.slopes(self.motion, self.T, self.path_slopes.T @ weights)
        return self._followed(slopes.motion, slopes.duration, slopes.controls)

    def _followed(self, motion: Motion, by_duration: Array, by_c: Array | float = 0.0) -> Array:
        """Return the derivatives (r, n) by w of functions of these slopes, whose motion follows w."""
        costate = self.linear.solve_back(motion)
        by_strings = self.linear.by_strings(costate.impulses)
        return np.ascontiguousarray(
            (self._by_w(by_strings, costate, by_duration, by_c) * self.of.units[:, None]).T
        )

    def _by_w(
        self, by_strings: Array, costate: Costate, by_duration: Array, by_c: Array | float = 0.0
    ) -> Array:
        """Return derivatives (n, r) by w from those by T²σγ (K + X, α, r), by the duration alone (r,), and by force densities alone (Kc, m, r)."""
        T = self.T
        c = T**2 * self.of.chain.controls.gathered(by_strings) + by_c
        if not self.of.free_duration:
            return self.of.joined(c, 0.0)
        whole = (
            2 / T * np.einsum("is,isa->a", self.strings, by_strings)
            + np.einsum("ij,ija->a", self.by_duration, costate.impulses)
            + by_duration
        )
        if self.carried is not None:
            whole = whole + np.einsum("ij,ija->a", self.lengths_by_duration, costate.lengths)
        return self.of.joined(c, whole)

    def split(self, step: Array) -> tuple[Array, float]:
        """Return changes of force densities (Kc, m) and of the duration."""
        c, T = self.of.split(step)
        return c, T if self.of.free_duration else 0.0

    def strings_of(self, step: Array) -> Array:
        """Return the change (K + X, α) of T²σγ."""
        c, longer = self.split(step)
        return (
            self.T**2 * self.of.chain.controls.at_stations(c) + 2 / self.T * longer * self.strings
        )

    def follow(self, step: Array | None, rows: Rows | None) -> Motion:
        """Return the step of the motion (one column) that follows a step of w and takes away its rows."""
        stations, n = len(self.of.chain.at), 3 * self.of.chain.nodes
        impulses, lengths = (
            (np.zeros((stations, n)), np.zeros((stations, self.of.chain.bars)))
            if rows is None
            else rows
        )
        longer = 0.0 if step is None else self.split(step)[1]
        if step is not None:
            impulses = (
                impulses
                + self.linear.of_strings(self.strings_of(step))
                + longer * self.moved_by_duration
            )
            lengths = lengths + longer * self.lengths_by_duration
        moved = self.linear.solve(Rows(impulses[:, :, None], lengths[:, :, None]))
        return moved if self.carried is None else moved.moved(self.carried[0], longer)

    def change(self, moved: Motion, longer: float = 0.0) -> Array:
        """Return the change (m,) of the goals."""
        return self.of.goals.along(self.goal_slopes, moved, longer)

    def path_change(self, moved: Motion, step: Array | None) -> Array:
        """Return the change (p,) of what is limited along the way, along a step of the motion and of w."""
        return (
            np.zeros(0)
            if self.path_slopes is None
            else self.path_slopes @ self._entries_along(moved, *self._alone(step))
        )

    def _alone(self, step: Array | None) -> tuple[Array, float]:
        return (np.zeros(self.of.shape), 0.0) if step is None else self.split(step)

    def _entries_along(self, moved: Motion, change: Array, longer: float) -> Array:
        return self.of.paths.change(self.motion, self.T, moved, change, longer)

    def weigh(self, multipliers: Array, of_paths: Array, stiffness: Array) -> None:
        """Set the multipliers of goals (m,) and of limits along the way (p,), under which the motion's own are found, and how stiff barriers are."""
        slopes = self.of.goals.slopes(self.goal_slopes, multipliers[:, None]).motion
        if self.path_slopes is not None:
            self.pull = self.path_slopes.T @ of_paths
            slopes = _sum(
                slopes, self.of.paths.slopes(self.motion, self.T, self.pull[:, None]).motion
            )
            self.path_curvature = self.of.paths.hessian(self.entries, of_paths)
            self.path_stiffness = stiffness
        self.costate = self.linear.solve_back(slopes)
        self.own = self.linear.by_strings(self.costate.impulses)[:, :, 0]
        self.goal_curvature = self.of.goals.hessians(self.motion, self.T, multipliers)

    def _path_curvature(self, moved: Motion, change: Array, longer: float) -> Slopes | None:
        """Return how the slopes of limits along the way, with multipliers and barriers, change along a step."""
        if self.path_slopes is None:
            return None
        paths = self.of.paths
        along = self._entries_along(moved, change, longer)
        pull = self.path_curvature @ along + self.path_slopes.T @ (
            self.path_stiffness * (self.path_slopes @ along)
        )
        more, bent = (
            paths.slopes(self.motion, self.T, pull[:, None]),
            paths.bent(self.motion, self.T, self.pull, moved, longer),
        )
        return Slopes(
            _sum(more.motion, bent.motion),
            more.controls + bent.controls,
            more.duration + bent.duration,
        )

    def curvature(self, step: Array, moved: Motion) -> Array:
        """Return the second derivatives of J + yᵀ goals + barriers along a step of w and the step of the motion with it; `weigh` sets y."""
        of, T = self.of, self.T
        change, longer = self.split(step)
        strings = self.strings_of(step)
        slopes, by_strings = self.linear.curvature(self.costate, strings, moved)
        more = of.goals.curvature(self.goal_curvature, moved, longer)
        slopes, by_duration = _sum(slopes, more.motion), more.duration
        by_controls: Array | float = 0.0
        paths = self._path_curvature(moved, change, longer)
        if paths is not None:
            slopes, by_duration, by_controls = (
                _sum(slopes, paths.motion),
                by_duration + paths.duration,
                paths.controls,
            )
        if self.carried is not None:
            by_duration = by_duration + self._carried_curvature(*self.carried, slopes, longer)
        costate = self.linear.solve_back(slopes)
        by_strings = by_strings + self.linear.by_strings(costate.impulses)[:, :, 0]
        result = self._by_w(by_strings[:, :, None], costate, by_duration, by_controls)[:, 0]
        if of.free_duration:
            controls = of.chain.controls
            again = 2 * T * longer * controls.gathered(self.own[:, :, None])[:, :, 0]
            unit = controls.at_stations(change)
            whole = ((2 * T * unit + 2 * longer * self.unit) * self.own).sum() - longer * (
                self.costate.impulses[:, :, 0] * self.loads[2]
            ).sum()
            result = result + of.joined(again, whole)
        by_c, by_T = of.objective.curvature(self.c, T, change, longer)
        return np.asarray(of.units * (result + of.joined(by_c, by_T) / of.cost_scale))

    def _carried_curvature(
        self, first: Motion, second: Motion, slopes: Motion, longer: float
    ) -> float:
        """Return how the derivative by the duration changes where it moves supports: with slopes that change there, and as they speed up."""
        pushes, lengths = self.linear.along(second)
        again = (pushes * self.costate.impulses[:, :, 0]).sum() + (
            lengths * self.costate.lengths[:, :, 0]
        ).sum()
        return float(
            (slopes.places * first.places).sum()
            + (slopes.rates * first.rates).sum()
            + longer * again
        )


def _sum(one: Motion, other: Motion) -> Motion:
    return Motion(*(a + b for a, b in zip(one, other, strict=True)))
