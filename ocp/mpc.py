"""Model predictive control: a plan over a short horizon, made anew from the measured state at each decision."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ocp.finder import find_target
from ocp.grid import at
from ocp.guess import settled
from ocp.linearized import Motion, departures, linearized_step
from ocp.path import StageRows, stage_rows
from ocp.plan import Plan
from ocp.problem import Problem
from ocp.target import Scales
from tenscasadi.model import Model
from tenscasadi.validate import Array, instance, positive_number, whole_number

OVERSTEP = 1e3  # what oversteps limits of the path costs, in scaled units, against 1 for a departure of a `place`


class Mpc:
    """A controller for `ocp.run`: follows a plan, or brings the structure to the problem's goals and keeps it there.

    Every `period` s, from the measured state: the motion over `intervals` periods under the last decision, shifted; its exact
    derivatives; a quadratic program for all force densities of the horizon, with the problem's limits of γ as they are and
    its other bounds linearised (overstepped only where they cannot be kept); `iterations` times (1: real-time iteration). States
    are eliminated, so that bars, joints and momenta need no rows. What is kept small: departures of the nodes, relative to `place`, m,
    and of their velocities; of free structures, departures of the distances between nodes. All Functions are built once.

    plan: the reference over time, None: the state of the goals under the force densities that hold it best. effort: N/m, the departure of γ
    that weighs as much as `place`. substeps: of RK4 in each period. Raises TypeError, ValueError, UnreachableGoal.
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
        self._place = 0.01 * scales.length if place is None else positive_number("place", place)
        self._substeps = whole_number("substeps", substeps, 1)
        self._motion = Motion(self.model, self.intervals, self._substeps)
        self._lower, self._upper = problem.force_density_limits
        self._departures = departures(self.model, self._place, self._place * 10 / scales.time)
        self._output = self._departures.map(self.intervals)
        self._plan = plan
        state, gamma = _goal(problem, scales) if plan is None else (plan.trajectory.states[-1], plan.force_density[-1])
        self._end = (
            np.asarray(self._output(np.repeat(state[:, None], self.intervals, axis=1))[0].full()),
            np.repeat(gamma[None], self.intervals, axis=0),
        )
        strength = float(np.abs(gamma if plan is None else plan.force_density).mean()) or 1.0
        self._effort = strength if effort is None else positive_number("effort", effort)
        self._bounds = [_Path(rows, self.model, self.intervals) for rows in stage_rows(problem, scales, strength)]
        rows = sum(bound.rows for bound in self._bounds)
        size = self.intervals * self.model.nu + bool(rows)
        shapes = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}
        self._solver = ca.conic("qp", "daqp", shapes, {"error_on_fail": False})
        self._last: Array | None = None

    def __repr__(self) -> str:
        return f"Mpc({self.model.nu} strings, every {self.period:g} s over {self.intervals} intervals)"

    def control(self, time: float, state: Array) -> Array:
        """γ (α,), N/m, at a state (nx,), until the next decision."""
        wanted, held = self._reference(time)
        gamma = held if self._last is None else np.concatenate([self._last[1:], held[-1:]])
        gamma = np.clip(gamma, self._lower, self._upper)
        for _ in range(self._iterations):
            gamma = self._improved(state, gamma, wanted, held, time)
        self._last = gamma
        return np.asarray(gamma[0])

    def reset(self) -> None:
        """Forgets the last decision, for another run."""
        self._last = None

    def function(self) -> ca.Function:
        """The decision as one CasADi Function, which generates C: (time, state (nx), before (α, intervals)) → after (α, intervals).

        before: the last `after`; `first` to begin with. What is applied until the next decision is the first column of `after`. It decides
        as `control` does, by CasADi's own solver of quadratic programs (qrqp) in place of DAQP.
        """
        count, nu = self.intervals, self.model.nu
        time, state, before = ca.MX.sym("time"), ca.MX.sym("state", self.model.nx), ca.MX.sym("before", nu, count)
        wanted, held = self._symbolic_reference(time)
        lower, upper = (ca.repmat(ca.DM(limit), 1, count) for limit in (self._lower, self._upper))
        gamma: Any = ca.fmin(ca.fmax(ca.horzcat(before[:, 1:], held[:, -1]), lower), upper)
        advance = linearized_step(self.model, self.period, self._substeps)
        rows = sum(bound.rows for bound in self._bounds)
        size = count * nu + bool(rows)
        quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
        solver = ca.conic("qp", "qrqp", {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}, quiet)
        for _ in range(self._iterations):
            end = state
            for k in range(count):
                end = advance(end, gamma[:, k])[0]
            gamma = ca.if_else(sane(end), gamma, held)
            gamma = ca.fmin(ca.fmax(gamma + self._symbolic_change(solver, advance, state, gamma, wanted, held, time), lower), upper)
        return ca.Function("decide", [time, state, before], [gamma], ["time", "state", "before"], ["after"])

    @property
    def first(self) -> Array:
        """What `function` takes for the last decision, (α, intervals), when there is none yet."""
        held = self._reference(0.0)[1]
        return np.concatenate([held[:1], held[:-1]]).T

    def _symbolic_change(self, solver: ca.Function, advance: ca.Function, x: Any, gamma: Any, wanted: Any, held: Any, time: Any) -> Any:
        """What `_improved` adds to γ (α, intervals)."""
        count, nu = self.intervals, self.model.nu
        blocks: list[Any] = []  # ∂x/∂γ of each interval before
        H: Any = ca.MX(ca.DM.eye(count * nu) / self._effort**2)
        g: Any = ca.vec(gamma - held) / self._effort**2
        slopes: list[Any] = []
        room: list[Any] = []
        for k in range(count):
            x, A, B = advance(x, gamma[:, k])
            blocks = [*(ca.mtimes(A, block) for block in blocks), B]
            S = ca.horzcat(*blocks, ca.MX(B.shape[0], nu * (count - k - 1)))
            reached, C = self._departures(x)
            effect = ca.mtimes(C, S)
            H += ca.mtimes(effect.T, effect)
            g += ca.mtimes(effect.T, reached - wanted[:, k])
            for bound in self._bounds:
                value, by_state, by_control = bound.one(x, gamma[:, k], time + (k + 1) * self.period)
                own = ca.horzcat(ca.MX(by_control.shape[0], nu * k), by_control, ca.MX(by_control.shape[0], nu * (count - k - 1)))
                slopes.append(ca.mtimes(by_state, S) + own)
                room.append(bound.limit - value)
        low, high = (ca.vec(ca.repmat(ca.DM(limit), 1, count) - gamma) for limit in (self._lower, self._upper))
        if slopes:
            A = ca.vertcat(*slopes)
            found = solver(
                h=ca.diagcat(H, OVERSTEP),
                g=ca.vertcat(g, OVERSTEP),
                a=ca.horzcat(A, -ca.DM.ones(A.shape[0], 1)),
                lba=-np.inf,
                uba=ca.vertcat(*room),
                lbx=ca.vertcat(low, 0.0),
                ubx=ca.vertcat(high, np.inf),
            )
        else:
            found = solver(h=H, g=g, lbx=low, ubx=high)
        change = found["x"][: count * nu]
        return ca.reshape(ca.if_else(sane(change), change, ca.DM.zeros(count * nu)), nu, count)

    def _symbolic_reference(self, time: Any) -> tuple[Any, Any]:
        """`_reference` of a symbolic time."""
        plan, count = self._plan, self.intervals
        if plan is None:
            return ca.DM(self._end[0]), ca.DM(self._end[1].T)
        ends = [ca.fmin(time + self.period * k, float(plan.time[-1])) for k in range(count + 1)]
        wanted = [self._departures(along(plan.trajectory.states, plan.time, end))[0] for end in ends[1:]]
        held = [along(plan.force_density, plan.time, (before + after) / 2) for before, after in pairwise(ends)]
        return ca.horzcat(*wanted), ca.horzcat(*held)

    def _improved(self, state: Array, gamma: Array, wanted: Array, held: Array, time: float) -> Array:
        """One quadratic program about the motion under `gamma` (intervals, α)."""
        states, points = self._motion.states(state, gamma, self.period)
        if not np.all(np.isfinite(states)):
            states, points = self._motion.states(state, held, self.period)
            gamma = held
        A, B = self._motion.derivatives(points, gamma, self.period)
        count, nu, nx = self.intervals, self.model.nu, self.model.nx
        reached, C = (np.asarray(value.full()) for value in self._output(states[1:].T))
        C = C.T.reshape(count, nx, -1).transpose(0, 2, 1)
        S = np.zeros((nx, count * nu))
        effects, after = [], []
        for k in range(count):
            S = A[k] @ S
            S[:, k * nu : (k + 1) * nu] = B[k]
            effects.append(C[k] @ S)
            after.append(S.copy())
        G = np.concatenate(effects)
        r = (reached - wanted).T.ravel()
        H = G.T @ G + np.eye(count * nu) / self._effort**2
        g = G.T @ r + ((gamma - held) / self._effort**2).ravel()
        low, high = ((limit - gamma).ravel() for limit in (np.broadcast_to(self._lower, gamma.shape), np.broadcast_to(self._upper, gamma.shape)))
        if not self._bounds:
            result = self._solver(h=H, g=g, lbx=low, ubx=high)
        else:
            times = np.linspace(time + self.period, time + self.period * count, count)
            parts = [bound(states, gamma, after, times) for bound in self._bounds]
            rows, most = (np.concatenate([part[i] for part in parts]) for i in range(2))
            H = np.pad(H, (0, 1))
            H[-1, -1] = OVERSTEP
            result = self._solver(h=H, g=np.append(g, OVERSTEP), a=rows, lba=-np.inf, uba=most, lbx=np.append(low, 0.0), ubx=np.append(high, np.inf))
        change = np.asarray(result["x"].full()).ravel()[: count * nu]
        if not self._solver.stats()["success"] or not np.all(np.isfinite(change)):
            return gamma
        return np.asarray(np.clip(gamma + change.reshape(count, nu), self._lower, self._upper))

    def _reference(self, time: float) -> tuple[Array, Array]:
        """What the outputs (·, intervals) should be at the ends of the next intervals, and γ (intervals, α) in them."""
        plan = self._plan
        if plan is None or time >= plan.time[-1] - 1e-9:
            return self._end
        ends = np.minimum(time + self.period * np.arange(self.intervals + 1), plan.time[-1])
        states = np.array([np.interp(ends[1:], plan.time, column) for column in plan.trajectory.states.T])
        return np.asarray(self._output(states)[0].full()), at(plan.force_density, plan.time, (ends[:-1] + ends[1:]) / 2)


class _Path:
    """Rows of a bound at the ends of the horizon's intervals, linearised: a ΔU − overstep ≤ b."""

    def __init__(self, bound: StageRows, model: Model, count: int) -> None:
        x, u, t = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("t", 1)))
        value = bound.function(x, u, t)
        sides = [(sign, k, sign * limit[k]) for sign, limit in ((1.0, bound.upper), (-1.0, bound.lower)) for k in range(len(limit))]
        kept = [side for side in sides if np.isfinite(side[2])]
        chosen = ca.vertcat(*(sign * value[k] for sign, k, _ in kept))
        self.limit, self.rows = np.array([limit for _, _, limit in kept]), len(kept) * count
        slopes = [ca.densify(ca.jacobian(chosen, z)) for z in (x, u)]
        self.one = ca.Function("rows", [x, u, t], [chosen, *slopes])
        self._function = self.one.map(count)

    def __call__(self, states: Array, gamma: Array, effects: list[Array], times: Array) -> tuple[Array, Array]:
        """a (rows, count · nu + 1) and b (rows,)."""
        count, nu = gamma.shape
        value, by_state, by_control = (np.asarray(part.full()).T for part in self._function(states[1:].T, gamma.T, times[None]))
        m = len(self.limit)
        X, U = (part.reshape(count, -1, m).transpose(0, 2, 1) for part in (by_state, by_control))
        a = np.concatenate([X[k] @ effects[k] for k in range(count)])
        for k in range(count):
            a[k * m : (k + 1) * m, k * nu : (k + 1) * nu] += U[k]
        return np.column_stack([a, -np.ones(len(a))]), (self.limit - value).ravel()


def _goal(problem: Problem, scales: Scales) -> tuple[Array, Array]:
    """The state of the goals, and γ that hold it as nearly as they can."""
    target = find_target(problem, scales)
    state = target.start if target.state is None else target.state
    return state, np.asarray(settled(problem, np.array([state, state]))[0])


def sane(values: Any) -> Any:
    """1 where all values are finite, 0 else: comparisons with what is not a number are false."""
    return ca.mmin(ca.fabs(values) < 1e30)


def along(values: Array, nodes: Array, time: Any) -> Any:
    """As `ocp.grid.at`, of a symbolic time; rows of states are linear in time as rows of a linear profile are."""
    k = ca.low(ca.DM(nodes), time)
    left = ca.MX(ca.DM(values.T))[:, k]
    if len(values) < len(nodes):
        return left
    start = ca.MX(ca.DM(nodes))
    return left + (time - start[k]) / (start[k + 1] - start[k]) * (ca.MX(ca.DM(values.T))[:, k + 1] - left)
