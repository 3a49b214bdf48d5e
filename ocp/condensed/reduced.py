"""A plan as a problem in force densities and duration alone: what they do to costs and goals, to second order, about any motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.boundary.target import Target
from ocp.condensed.chain import Chain, Motion, Rows
from ocp.condensed.goal_rows import GoalRows, needed_taps
from ocp.condensed.linear_chain import LinearChain
from ocp.condensed.objective import Objective
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import group_matrix, spans
from tenscasadi.util.validate import Array


class Leftover(NamedTuple):
    """Residuals: rows of goals (m,), and rows of the motion."""

    goals: Array
    rows: Rows


class ReducedProblem:
    """Minimise J(w) subject to goals, w = force densities (Kc, m) in units of `strength`, then the duration, if free, in units of `time`."""

    def __init__(self, problem: Problem, transcription: Transcription, target: Target, scales: Scales, strength: float, cost: float) -> None:
        fractions, profile = transcription.fractions, transcription.control
        self.problem, self.length, self.cost_scale = problem, scales.length, cost
        self.chain = Chain(problem.model, fractions, profile, target.start, needed_taps(target, fractions))
        self.goals = GoalRows(self.chain, target)
        self.objective = Objective(problem, fractions, profile)
        self.shape = self.chain.controls.shape
        self.free_duration = problem.shortest < problem.longest
        self.duration = problem.longest
        self.together = group_matrix(profile, problem.model.nu)
        self.span = np.arange(len(fractions) + 1) if profile.linear else spans(profile, fractions)
        self.begins = np.unique(self.span, return_index=True)[1]  # where each of the force densities begins that are unknowns
        members = [np.flatnonzero(column) for column in self.together.T]
        least, most = problem.force_density_limits
        lower, upper = (np.array([pick(limit[own]) for own in members]) for pick, limit in ((np.max, least), (np.min, most)))
        ends = [(np.tile(limit, self.shape[0]), bound) for limit, bound in ((lower, problem.shortest), (upper, problem.longest))]
        self.units = np.append(np.full(self.shape[0] * self.shape[1], strength), [scales.time] * self.free_duration)
        self.lower, self.upper = (np.append(limit, [bound] * self.free_duration) / self.units for limit, bound in ends)
        self.size = len(self.units)
        self.shift: Rows | None = None  # what rows of the motion are to leave, where they are corrected

    def split(self, w: Array) -> tuple[Array, float]:
        """Return force densities (Kc, m), N/m, and the duration, s."""
        own = w * self.units
        count = self.shape[0] * self.shape[1]
        return own[:count].reshape(self.shape), float(own[-1]) if self.free_duration else self.duration

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
        return np.asarray(self.joined(*self.objective.gradient(*self.split(w))) * self.units / self.cost_scale)

    def curvature_scale(self, w: Array) -> tuple[Array, Array | None]:
        """Return a positive diagonal (n,) about as large as the second derivatives of J, and what couples neighbouring intervals, if anything."""
        c, T = self.split(w)
        diagonal, coupling = self.objective.metric(T)
        by_time = 2 * abs(self.objective.parts(c)[0]) / T
        own = self.joined(diagonal, by_time) * self.units**2 / self.cost_scale
        least = 1e-3 * float(own.mean()) if own.any() else 1.0 / self.size
        scale = float(self.units[0] ** 2 / self.cost_scale)
        return np.maximum(own, least), coupling * scale if self.objective.coupled else None

    def leftover(self, w: Array, motion: Motion) -> Leftover:
        """Return what is not met."""
        T = self.split(w)[1]
        rows = self.chain.rows(self.strings(w), T, motion)
        if self.shift is not None:
            rows = Rows(rows.impulses - self.shift.impulses, rows.lengths - self.shift.lengths)
        return Leftover(self.goals.value(motion, T), rows)

    def size_of(self, left: Leftover) -> tuple[float, float]:
        """Return the sum and the largest of what is not met, all of order one."""
        parts = [left.goals, self.chain.count / self.length * left.rows.impulses, left.rows.lengths / self._squared]
        return sum(float(np.abs(part).sum()) for part in parts), max(float(np.abs(part).max(initial=0.0)) for part in parts)

    @property
    def _squared(self) -> Array:
        return np.broadcast_to(np.maximum(self.chain.squared, 1e-300), (len(self.chain.at), self.chain.bars))

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
        self.moved_by_duration = chain.by_inverse(self.by_duration[:, :, None])[:, :, 0]
        self.goal_slopes = goals.jacobians(motion, self.T)
        self.jacobian = self._jacobian()

    def _jacobian(self) -> Array:
        """Return the derivatives (m, n) of the goals by w."""
        of = self.of
        if not of.goals.count:
            return np.zeros((0, of.size))
        slopes = of.goals.slopes(self.goal_slopes, np.eye(of.goals.count))
        costate = self.linear.solve_back(slopes.motion)
        by_strings = self.linear.by_strings(costate.impulses)
        return np.ascontiguousarray((self._by_w(by_strings, costate.impulses, slopes.duration) * of.units[:, None]).T)

    def _by_w(self, by_strings: Array, impulses: Array, by_duration: Array) -> Array:
        """Return derivatives (n, r) by w from those by T²σγ (K + X, α, r) and by the duration alone (r,)."""
        T = self.T
        c = T**2 * self.of.chain.controls.gathered(by_strings)
        if not self.of.free_duration:
            return self.of.joined(c, 0.0)
        whole = 2 / T * np.einsum("is,isa->a", self.strings, by_strings) + np.einsum("ij,ija->a", self.by_duration, impulses) + by_duration
        return self.of.joined(c, whole)

    def split(self, step: Array) -> tuple[Array, float]:
        """Return changes of force densities (Kc, m) and of the duration."""
        c, T = self.of.split(step)
        return c, T if self.of.free_duration else 0.0

    def strings_of(self, step: Array) -> Array:
        """Return the change (K + X, α) of T²σγ."""
        c, longer = self.split(step)
        return self.T**2 * self.of.chain.controls.at_stations(c) + 2 / self.T * longer * self.strings

    def follow(self, step: Array | None, rows: Rows | None) -> Motion:
        """Return the step of the motion (one column) that follows a step of w and takes away its rows."""
        stations, n = len(self.of.chain.at), 3 * self.of.chain.nodes
        impulses, lengths = (np.zeros((stations, n)), np.zeros((stations, self.of.chain.bars))) if rows is None else rows
        if step is not None:
            impulses = impulses + self.linear.of_strings(self.strings_of(step)) + self.split(step)[1] * self.moved_by_duration
        return self.linear.solve(Rows(impulses[:, :, None], lengths[:, :, None]))

    def change(self, moved: Motion, longer: float = 0.0) -> Array:
        """Return the change (m,) of the goals."""
        return self.of.goals.along(self.goal_slopes, moved, longer)

    def weigh(self, multipliers: Array) -> None:
        """Set the multipliers (m,) of the goals, under which the motion's own are found."""
        slopes = self.of.goals.slopes(self.goal_slopes, multipliers[:, None])
        self.costate = self.linear.solve_back(slopes.motion)
        self.own = self.linear.by_strings(self.costate.impulses)[:, :, 0]
        self.goal_curvature = self.of.goals.hessians(self.motion, self.T, multipliers)

    def curvature(self, step: Array, moved: Motion) -> Array:
        """Return the second derivatives of J + yᵀ goals along a step of w and the step of the motion with it; `weigh` sets y."""
        of, T = self.of, self.T
        change, longer = self.split(step)
        strings = self.strings_of(step)
        slopes, by_strings = self.linear.curvature(self.costate, strings, moved)
        more = of.goals.curvature(self.goal_curvature, moved, longer)
        costate = self.linear.solve_back(Motion(*(one + other for one, other in zip(slopes, more.motion, strict=True))))
        by_strings = by_strings + self.linear.by_strings(costate.impulses)[:, :, 0]
        result = self._by_w(by_strings[:, :, None], costate.impulses, more.duration)[:, 0]
        if of.free_duration:
            controls = of.chain.controls
            again = 2 * T * longer * controls.gathered(self.own[:, :, None])[:, :, 0]
            unit = controls.at_stations(change)
            whole = ((2 * T * unit + 2 * longer * self.unit) * self.own).sum() - longer * (self.costate.impulses[:, :, 0] * self.loads[2]).sum()
            result = result + of.joined(again, whole)
        by_c, by_T = of.objective.curvature(self.c, T, change, longer)
        return np.asarray(of.units * (result + of.joined(by_c, by_T) / of.cost_scale))
