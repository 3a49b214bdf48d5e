"""Model predictive control: a plan over a short horizon, made anew from the measured state at each decision."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.boundary.sensitivities import Motion, departures, linearized_step
from ocp.control.mpc_constraints import horizon_rows
from ocp.control.reference import Reference
from ocp.plan.plan import Plan
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.solvers.interior_point_qp import solve_qp
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, finite_array, instance, positive_number, whole_number

OVERSTEP = 1e5  # what oversteps limits of the path costs, in scaled units, against 1 for a departure of a `place`


class Mpc:
    """A controller for `ocp.run`: follows a plan, or brings the structure to the problem's goals and keeps it there.

    Every `period` s, from the measured state: the motion over `intervals` periods under the last decision, shifted; its exact
    derivatives; a quadratic program for all force densities of the horizon, with the problem's limits of γ as they are and
    its other bounds linearised, at the ends of the periods (overstepped only where they cannot be kept; those between instants, such as
    `RestLengthRateLimits`, also from the last decision to this one, so that the first is free); `iterations` times (1: real-time iteration).
    States are eliminated, so that bars, joints and momenta need no rows. What is kept small, in place of the problem's costs: departures of
    the nodes, relative to `place`, m, and of their velocities; of free structures, departures of the distances between nodes. All
    Functions are built once.

    plan: the reference over time, and its last state after it; None: the state of the goals under the force densities that hold it best,
    which no `Waypoint`, `Periodic` or `FreeStart` has: they ask for a motion, and need a plan. effort: N/m, the departure of γ that weighs as
    much as `place`. substeps: of RK4 in each period. Raises TypeError, ValueError, UnreachableGoal.
    """

    def __init__(
        self,
        problem: Problem,
        period: float = 0.05,
        intervals: int = 10,
        *,
        plan: Plan | None = None,
        iterations: int = 1,
        substeps: int = 1,
        place: float | None = None,
        effort: float | None = None,
    ) -> None:
        instance("problem", problem, Problem, "an ocp.Problem")
        if plan is not None:
            instance("plan", plan, Plan, "an ocp.Plan or None")
            if (plan.trajectory.states.shape[1], plan.force_density.shape[1]) != (problem.model.nx, problem.model.nu):
                raise ValueError("plan is of another structure than the problem: give one whose model has the same nodes and strings")
        self.model: Model = problem.model
        self.period = positive_number("period", period)
        self.intervals = whole_number("intervals", intervals, 1)
        self._iterations = whole_number("iterations", iterations, 1)
        scales = Scales.of(problem)
        size = 0.01 * scales.length if place is None else positive_number("place", place)
        self._substeps = whole_number("substeps", substeps, 1)
        self._motion = Motion(self.model, self.intervals, self._substeps)
        self._lower, self._upper = problem.force_density_limits
        self._departures = departures(self.model, size, 10 * size / scales.time)
        self._output = self._departures.map(self.intervals)
        self._reference = Reference(problem, scales, plan, self._departures, self.intervals, self.period)
        strength = self._reference.strength
        self._effort = strength if effort is None else positive_number("effort", effort)
        self._bounds = horizon_rows(problem, scales, strength, self.intervals, self.period)
        rows = sum(bound.rows for bound in self._bounds)
        everything = np.eye(self.intervals * self.model.nu).reshape(self.intervals, self.model.nu, -1)
        self._own = np.concatenate([np.zeros_like(everything[:1]), everything])  # what all γ are to the last one and to those of each interval
        unknowns = self.intervals * self.model.nu + bool(rows)
        shapes = {"h": ca.Sparsity.dense(unknowns, unknowns), "a": ca.Sparsity.dense(rows, unknowns)}
        self._solver = ca.conic("qp", "daqp", shapes, {"error_on_fail": False})
        self._last: _Decision | None = None

    def __repr__(self) -> str:
        return f"Mpc({self.model.nu} strings, every {self.period:g} s over {self.intervals} intervals)"

    def control(self, time: float, state: Array) -> Array:
        """γ (α,), N/m, at `time` s after the beginning and a state (nx,), until the next decision. An earlier time than the last begins anew."""
        time, state = positive_number("time", time, zero=True), finite_array("state", state, (self.model.nx,))
        if self._last is not None and time < self._last.time:
            self.reset()
        wanted, held = self._reference(time)
        gamma = held if self._last is None else np.concatenate([self._last.force_density[1:], held[-1:]])
        gamma = np.clip(gamma, self._lower, self._upper)
        for _ in range(self._iterations):
            gamma = self._improved(state, gamma, wanted, held, time)
        self._last = _Decision(time, state, gamma)
        return np.array(gamma[0])

    def reset(self) -> None:
        """Forgets the last decision, for another run."""
        self._last = None

    def function(self) -> ca.Function:
        """The decision as one CasADi Function, which generates C: (time, state (nx), before (α, intervals)) → after (α, intervals).

        before: the last `after`; `first` to begin with. What is applied until the next decision is the first column of `after`. With limits
        between decisions, such as `RestLengthRateLimits`, a fourth input `earlier` (nx): the state at the last decision; NaN to begin with.
        It decides as `control` does, by an interior-point method (`ocp.interior`) in place of DAQP.
        """
        count, nu = self.intervals, self.model.nu
        time, state, before = ca.MX.sym("time"), ca.MX.sym("state", self.model.nx), ca.MX.sym("before", nu, count)
        inputs = {"time": time, "state": state, "before": before}
        if any(bound.between for bound in self._bounds):
            inputs["earlier"] = ca.MX.sym("earlier", self.model.nx)
        begun = sane(inputs.get("earlier", state))
        last = ca.if_else(begun, inputs.get("earlier", state), state), before[:, 0]
        wanted, held = self._reference.symbolic(time)
        lower, upper = (ca.repmat(ca.DM(limit), 1, count) for limit in (self._lower, self._upper))
        gamma: Any = ca.fmin(ca.fmax(ca.horzcat(before[:, 1:], held[:, -1]), lower), upper)
        advance = linearized_step(self.model, self.period, self._substeps)
        for _ in range(self._iterations):
            end = state
            for k in range(count):
                end = advance(end, gamma[:, k])[0]
            gamma = ca.if_else(sane(end), gamma, held)
            gamma = ca.fmin(ca.fmax(gamma + self._symbolic_change(advance, (last, begun), state, gamma, wanted, held, time), lower), upper)
        return ca.Function("decide", list(inputs.values()), [gamma], list(inputs), ["after"])

    @property
    def first(self) -> Array:
        """What `function` takes for the last decision, (α, intervals), when there is none yet."""
        held = self._reference(0.0)[1]
        return np.concatenate([held[:1], held[:-1]]).T

    def _symbolic_change(self, advance: ca.Function, past: Any, x: Any, gamma: Any, wanted: Any, held: Any, time: Any) -> Any:
        """What `_improved` adds to γ (α, intervals). past: state and γ of the last decision, and whether there was one."""
        count, nu = self.intervals, self.model.nu
        (last_state, last_gamma), begun = past
        points: tuple[list[Any], list[Any]] = ([last_state, x], [last_gamma, *ca.horzsplit(gamma)])
        effects: tuple[list[Any], list[Any]] = ([ca.DM(self.model.nx, count * nu)] * 2, [ca.sparsify(ca.DM(part)) for part in self._own])
        H: Any = ca.MX(ca.DM.eye(count * nu) / self._effort**2)
        g: Any = ca.vec(gamma - held) / self._effort**2
        for k in range(count):
            x, A, B = advance(x, gamma[:, k])
            points[0].append(x)
            effects[0].append(ca.mtimes(A, effects[0][-1]) + ca.mtimes(B, effects[1][k + 1]))
            reached, C = self._departures(x)
            effect = ca.mtimes(C, effects[0][-1])
            H += ca.mtimes(effect.T, effect)
            g += ca.mtimes(effect.T, reached - wanted[:, k])
        now, upper = ca.vec(gamma), np.tile(self._upper, count)
        most = np.flatnonzero(np.isfinite(upper))
        own: Any = ca.DM.eye(count * nu)
        a, b = ca.vertcat(-own, own[most.tolist(), :]), ca.vertcat(now - np.tile(self._lower, count), upper[most] - now[most.tolist()])
        if self._bounds:
            rows, room = (ca.vertcat(*part) for part in zip(*(bound.symbolic(points, effects, time, begun) for bound in self._bounds), strict=True))
            a = ca.vertcat(ca.horzcat(rows, -ca.DM.ones(rows.shape[0], 1)), ca.diagcat(a, ca.DM(-1)))
            b, H, g = ca.vertcat(room, b, 0.0), ca.diagcat(H, OVERSTEP), ca.vertcat(g, OVERSTEP)
        change = solve_qp(H, g, a, b, ca.DM.zeros(g.shape))[: count * nu]
        return ca.reshape(ca.if_else(sane(change), change, ca.DM.zeros(count * nu)), nu, count)

    def _improved(self, state: Array, gamma: Array, wanted: Array, held: Array, time: float) -> Array:
        """One quadratic program about the motion under `gamma` (intervals, α)."""
        states, stages = self._motion.states(state, gamma, self.period)
        if not np.all(np.isfinite(states)):
            states, stages = self._motion.states(state, held, self.period)
            gamma = held
        A, B = self._motion.derivatives(stages, gamma, self.period)
        count, nu, nx = self.intervals, self.model.nu, self.model.nx
        reached, C = (np.asarray(value.full()) for value in self._output(states[1:].T))
        C = C.T.reshape(count, nx, -1).transpose(0, 2, 1)
        effects = np.zeros((count + 2, nx, count * nu))  # of all γ on the states: the last, the present one, those at the intervals' ends
        for k in range(count):
            effects[k + 2] = A[k] @ effects[k + 1]
            effects[k + 2, :, k * nu : (k + 1) * nu] = B[k]
        G = (C @ effects[2:]).reshape(-1, count * nu)
        r = (reached - wanted).T.ravel()
        H = G.T @ G + np.eye(count * nu) / self._effort**2
        g = G.T @ r + ((gamma - held) / self._effort**2).ravel()
        low, high = ((limit - gamma).ravel() for limit in (np.broadcast_to(self._lower, gamma.shape), np.broadcast_to(self._upper, gamma.shape)))
        if not self._bounds:
            result = self._solver(h=H, g=g, lbx=low, ubx=high)
        else:
            last = (state, gamma[0]) if self._last is None else (self._last.state, self._last.force_density[0])
            points = np.vstack([last[0], states]), np.vstack([last[1], gamma])
            parts = [bound(points, (effects, self._own), time, self._last is not None) for bound in self._bounds]
            a, b = (np.concatenate(part) for part in zip(*parts, strict=True))
            a = np.column_stack([a, -np.ones(len(a))])
            H = np.pad(H, (0, 1))
            H[-1, -1] = OVERSTEP
            result = self._solver(h=H, g=np.append(g, OVERSTEP), a=a, lba=-np.inf, uba=b, lbx=np.append(low, 0.0), ubx=np.append(high, np.inf))
        change = np.asarray(result["x"].full()).ravel()[: count * nu]
        if not self._solver.stats()["success"] or not np.all(np.isfinite(change)):
            return gamma
        return np.asarray(np.clip(gamma + change.reshape(count, nu), self._lower, self._upper))


class _Decision(NamedTuple):
    """When, at which state (nx,), and what: γ (intervals, α)."""

    time: float
    state: Array
    force_density: Array


def sane(values: Any) -> Any:
    """1 where all values are finite, 0 else: comparisons with what is not a number are false."""
    return ca.mmin(ca.fabs(values) < 1e30)
