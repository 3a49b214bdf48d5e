"""Model predictive control: a plan over a short horizon, made anew from the measured state at each decision."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.control.departures import departures
from ocp.control.holding import find_rest
from ocp.control.mpc_constraints import Horizon, HorizonLimits
from ocp.problem.control import refuse_wound
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.phase import refuse_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.problem.start import FreeStart
from ocp.results.result import PlanResult
from ocp.solvers.interior_point_qp import solve_qp
from ocp.targets.find_target import find_target
from ocp.transcription.inverse_dynamics import inverse_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, finite_array, instance, positive_number, whole_number

# what oversteps limits of the path costs, in scaled units, against 1 for a departure of a `place`
OVERSTEP = 1e5
MOST = 1000  # intervals, steps of each, improvements of a decision
ROUNDED = 1e-3  # of the structure's size in the duration: slower goals are at rest
# of force densities that move the structure: fewer are rounding, as where nothing has to be held
NOTHING = 1e-6


class Mpc:
    """Model predictive control: a controller for `run` that follows a plan, or keeps a structure at the goals of a problem.

    From the measured state it predicts the motion of some periods under its last decision, shifted,
    and improves the force densities by a quadratic program; those of the first period are applied.

    Parameters
    ----------
    problem : Problem
        What is asked. Limits of force densities are kept as they are; its other bounds are
        linearised, hold at the ends of the periods, and are overstepped only where they cannot be
        kept. Costs are not used.
    period : float
        Time from one decision to the next, s.
    intervals : int
        How many periods are predicted.
    plan : Plan, optional
        What to follow, and where to stay after it. Default: the state of the problem's goals, under
        the force densities that hold it best; `Waypoint`, `Periodic` and `FreeStart` ask for a
        motion, and need a plan.
    iterations : int
        Quadratic programs for each decision; 1: real-time iteration [1]_.
    substeps : int
        Steps of `RungeKutta4` in each period.
    place : float, optional
        Departure of a coordinate, m, that counts as much as `effort`; of velocities 10 of it in the
        duration. Of free structures, departures are those of the distances between nodes. Default:
        1 % of the structure's size.
    effort : float, optional
        Departure of a force density, N/m. Default: the mean force density of the plan or the goals.

    Raises
    ------
    InfeasibleGoalError
        No strings can bring the goals about.
    TypeError, ValueError
        An argument is wrong.

    Notes
    -----
    The program is condensed: changes of the force densities are its only unknowns, and their
    effects on the states come from the exact derivatives of the steps, so that bars, joints and
    momenta need no rows. DAQP solves it. Limits between decisions, such as `RestLengthRateLimits`,
    also hold from the last decision on; the first decision is free.

    References
    ----------
    .. [1] M. Diehl, H. G. Bock, J. P. Schlöder, "A real-time iteration scheme for nonlinear
    optimization in optimal feedback control",
       SIAM J. Control Optim. 43, 1714, 2005.

    Examples
    --------
    A planar cross is brought to another shape:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> problem = ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()], bounds=[ocp.ForceDensityLimits(0.0, 20.0)])
    >>> controller = ocp.Mpc(problem, period=0.1, intervals=5)
    >>> controller.control(0.0, cross.initial_state).shape
    (2,)
    """

    def __init__(
        self,
        problem: Problem,
        period: float = 0.05,
        intervals: int = 10,
        *,
        plan: PlanResult | None = None,
        iterations: int = 1,
        substeps: int = 1,
        place: float | None = None,
        effort: float | None = None,
    ) -> None:
        instance("problem", problem, Problem, "an ocp.Problem")
        refuse_phases(problem.phases, "Mpc")
        refuse_wound(problem.model, "Mpc")
        if plan is not None:
            instance("plan", plan, PlanResult, "an ocp.Plan or None")
            if (plan.trajectory.states.shape[1], plan.force_density.shape[1]) != (
                problem.model.nx,
                problem.model.nu,
            ):
                raise ValueError(
                    "plan is of another structure than the problem: give one whose model has the same nodes and strings"
                )
        self.model: Model = problem.model
        self.period = positive_number("period", period)
        self.intervals = whole_number("intervals", intervals, 1, MOST)
        self._iterations = whole_number("iterations", iterations, 1, MOST)
        self._substeps = whole_number("substeps", substeps, 1, MOST)
        scales = Scales.of(problem)
        size = 0.01 * scales.length if place is None else positive_number("place", place)
        self._departures = departures(self.model, size, 10 * size / scales.time)
        self._reference, strength = _reference(
            problem, scales, plan, self._departures, self.intervals, self.period, size
        )
        self._effort = strength if effort is None else positive_number("effort", effort)
        self._lower, self._upper = (
            np.tile(limit, self.intervals) for limit in problem.force_density_limits
        )
        self._limits = HorizonLimits(problem, scales, strength, self.period)
        self._steps = self._shift(), self._program()
        self._array_steps = tuple(ArrayFunction(step) for step in self._steps)
        unknowns, rows = (self._steps[1].size1_out(name) for name in ("g", "b"))
        self._slack = int(rows > 0)  # one unknown, by which limits of the path are overstepped
        shapes = {
            "h": ca.Sparsity.dense(unknowns + self._slack, unknowns + self._slack),
            "a": ca.Sparsity.dense(rows, unknowns + self._slack),
        }
        self._solver = ArrayFunction(ca.conic("qp", "daqp", shapes, {"error_on_fail": False}))
        self._last: _MpcDecision
        self.reset()

    def __repr__(self) -> str:
        return (
            f"Mpc({self.model.nu} strings, every {self.period:g} s over {self.intervals} intervals)"
        )

    def control(self, time: float, state: Array) -> Array:
        """Decide the force densities until the next decision. An earlier time than that of the last decision begins a new run.

        Parameters
        ----------
        time : float
            Time since the beginning, s.
        state : array_like, shape (nx,)
            The measured state, m and m/s.

        Returns
        -------
        ndarray, shape (α,)
            Force densities, N/m.
        """
        time, state = (
            positive_number("time", time, zero=True),
            finite_array("state", state, (self.model.nx,)),
        )
        if time < self._last.time:
            self.reset()
        gamma = self._decided(
            self._array_steps, self._improved, np.array([time]), state, *self._last[1:]
        )
        self._last = _MpcDecision(time, gamma, state)
        return np.array(gamma[0])

    def reset(self) -> None:
        """Forget the last decision, for another run."""
        self._last = _MpcDecision(
            0.0, np.full((self.intervals, self.model.nu), np.nan), np.full(self.model.nx, np.nan)
        )

    def function(self) -> ca.Function:
        """Return the decision as one CasADi Function, which generates C.

        It decides as `control` does, by an interior-point method in place of DAQP.

        Returns
        -------
        casadi.Function
            Function (time, state (nx), before (α, intervals)) → after (α, intervals). `before` is
            the last `after`, and `first` to begin with; the first column of `after` is to be
            applied. With limits between decisions, such as `RestLengthRateLimits`, there is a
            fourth input `earlier` (nx): the state at the last decision, NaN to begin with.
        """
        time, state, before = (
            ca.MX.sym("time"),
            ca.MX.sym("state", self.model.nx),
            ca.MX.sym("before", self.model.nu, self.intervals),
        )
        inputs = {"time": time, "state": state, "before": before}
        if self._limits.from_last_decision:
            inputs["earlier"] = ca.MX.sym("earlier", self.model.nx)
        steps = [lambda *given, step=step: step.call(list(given)) for step in self._steps]
        after = self._decided(
            steps, self._symbolically_improved, time, state, before, inputs.get("earlier", state)
        )
        return ca.Function("decide", list(inputs.values()), [after], list(inputs), ["after"])

    @property
    def first(self) -> Array:
        """Force densities (α, intervals) that `function` takes for the last decision when there is none yet, N/m."""
        held = np.asarray(self._reference(0.0)[1].full())
        return np.column_stack([held[:, :1], held[:, :-1]])

    def _decided(
        self,
        steps: Any,
        improved: Callable[..., Any],
        time: Any,
        state: Any,
        before: Any,
        earlier: Any,
    ) -> Any:
        """Return γ of the horizon, of symbols (α, intervals) or arrays (intervals, α). before, earlier: the last decision and its state, or NaN."""
        shift, program = steps
        (gamma,) = shift(time, before)
        for _ in range(self._iterations):
            gamma = improved(*program(time, state, gamma, before, earlier))
        return gamma

    def _shift(self) -> ca.Function:
        """Return the Function (time, before) → γ (α, intervals) to begin with: the last decision, one period on; without one, the reference."""
        time, before = ca.MX.sym("time"), ca.MX.sym("before", self.model.nu, self.intervals)
        held = self._reference(time)[1]
        gamma = ca.if_else(sane(before), ca.horzcat(before[:, 1:], held[:, -1]), held)
        return ca.Function("shift", [time, before], [self._clipped(gamma)])

    def _clipped(self, gamma: Any) -> Any:
        return ca.fmin(
            ca.fmax(gamma, ca.reshape(self._lower, *gamma.shape)),
            ca.reshape(self._upper, *gamma.shape),
        )

    def _program(self) -> ca.Function:
        """Return the Function (time, state, γ, before, earlier) → γ, G, g, a and b: the quadratic program about the motion under γ.

        Least ½ ‖G ΔU‖² + ½ ‖ΔU/effort‖² + gᵀ ΔU with a ΔU ≤ b for changes ΔU (α · intervals) of γ,
        interval by interval. Where the motion under γ diverges, γ is that of the reference.
        """
        model, count = self.model, self.intervals
        time, state, earlier = (
            ca.MX.sym(name, size)
            for name, size in (("time", 1), ("state", model.nx), ("earlier", model.nx))
        )
        given, before = (ca.MX.sym(name, model.nu, count) for name in ("given", "before"))
        wanted, held = self._reference(time)
        roll = RungeKutta4().step(model.ode).mapaccum(count * self._substeps)
        ends = roll(
            state, ca.kron(given, ca.DM.ones(1, self._substeps)), self.period / self._substeps
        )
        gamma = ca.if_else(sane(ends), given, held)
        begun = sane(earlier)
        horizon = self._horizon(state, gamma, ca.if_else(begun, earlier, state), before[:, 0])
        reached, slopes = zip(*(self._departures(x) for x in horizon.states[2:]), strict=True)
        G = ca.vertcat(
            *(C @ effect for C, effect in zip(slopes, horizon.state_effects[2:], strict=True))
        )
        g = G.T @ ca.vec(ca.horzcat(*reached) - wanted) + ca.vec(gamma - held) / self._effort**2
        a, b = self._limits.rows(horizon, time, begun)
        outputs = [gamma, *(ca.densify(value) for value in (G, g, a, b))]
        return ca.Function(
            "program",
            [time, state, given, before, earlier],
            outputs,
            ["t", "x", "given", "before", "earlier"],
            ["u", "G", "g", "a", "b"],
        )

    def _horizon(self, state: Any, gamma: Any, earlier: Any, last: Any) -> Horizon:
        """Return the motion under γ (α, intervals) in steps of RK4, and its exact derivatives."""
        (nx, nu), count = (self.model.nx, self.model.nu), self.intervals
        slopes, h = _build_slopes(self.model), self.period / self._substeps
        x, effect = state, ca.DM(nx, 0)  # by the γ of intervals so far
        states, effects = [earlier, state], [ca.DM(nx, count * nu)] * 2
        for k in range(count):
            effect = ca.horzcat(effect, ca.DM(nx, nu))
            step = RungeKutta4().step(_build_variational(slopes, effect.shape[1]))
            for _ in range(self._substeps):
                z = step(ca.vertcat(x, ca.vec(effect)), gamma[:, k], h)
                x, effect = z[:nx], ca.reshape(z[nx:], *effect.shape)
            states.append(x)
            effects.append(ca.horzcat(effect, ca.DM(nx, (count - k - 1) * nu)))
        own = ca.sparsify(ca.DM.eye(count * nu))
        return Horizon(
            states,
            effects,
            [last, *ca.horzsplit(gamma)],
            [ca.DM(nu, count * nu), *ca.vertsplit(own, nu)],
        )

    def _improved(self, gamma: Array, G: Array, g: Array, a: Array, b: Array) -> Array:
        """Return γ + ΔU (intervals, α) by DAQP, or γ where that fails, from arrays (columns, rows)."""
        slack = self._slack
        H, now = G @ G.T, gamma.ravel()
        H[np.diag_indices(len(H))] += self._effort**-2
        if slack:
            H = np.pad(H, (0, 1))
            H[-1, -1] = OVERSTEP
            a = np.vstack([a, -np.ones(a.shape[1])])
        low, high = (
            np.append(self._lower - now, np.zeros(slack)),
            np.append(self._upper - now, np.full(slack, np.inf)),
        )
        change = self._solver(
            H, np.append(g, np.full(slack, OVERSTEP)), a, np.full(b.size, -np.inf), b, low, high
        )[0].ravel()[: now.size]
        if not self._solver.stats()["success"] or not np.all(np.isfinite(change)):
            return gamma
        return np.clip(now + change, self._lower, self._upper).reshape(gamma.shape)

    def _symbolically_improved(self, gamma: Any, G: Any, g: Any, a: Any, b: Any) -> Any:
        """Return the same as an expression (α, intervals), by an interior-point method."""
        size, now = g.shape[0], ca.vec(gamma)
        H, own = G.T @ G + ca.DM.eye(size) / self._effort**2, ca.DM.eye(size)
        most = np.flatnonzero(np.isfinite(self._upper)).tolist()
        A, room = (
            ca.vertcat(-own, own[most, :]),
            ca.vertcat(now - self._lower, self._upper[most] - now[most]),
        )
        if self._slack:
            A = ca.vertcat(ca.horzcat(a, -ca.DM.ones(a.shape[0], 1)), ca.diagcat(A, ca.DM(-1)))
            room, H, g = ca.vertcat(b, room, 0.0), ca.diagcat(H, OVERSTEP), ca.vertcat(g, OVERSTEP)
        change = solve_qp(H, g, A, room, ca.DM.zeros(g.shape))[:size]
        return self._clipped(
            gamma + ca.reshape(ca.if_else(sane(change), change, ca.DM.zeros(size)), *gamma.shape)
        )


class _MpcDecision(NamedTuple):
    """When, what: γ (intervals, α), and at which state (nx,); NaN where there was none."""

    time: float
    force_density: Array
    state: Array


def _build_slopes(model: Model) -> ca.Function:
    """Build the Function (x, u) → ẋ, and its derivatives by x and by u."""
    kind: Any = ca.SX if model.ode.is_a("SXFunction") else ca.MX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    rate = model.ode(x, u)
    outputs = [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)]
    return ca.Function("slopes", [x, u], outputs, {"cse": True})


def _build_variational(slopes: ca.Function, width: int) -> ca.Function:
    """Build the equation of motion of x and of its derivatives by parameters, the last of which are u."""
    nx, nu = slopes.size1_in(0), slopes.size1_in(1)
    z, u = ca.MX.sym("z", nx * (1 + width)), ca.MX.sym("u", nu)
    rate, by_state, by_control = slopes(z[:nx], u)
    turn = by_state @ ca.reshape(z[nx:], nx, width)
    turn += ca.horzcat(ca.DM(nx, width - nu), by_control)
    return ca.Function("variational", [z, u], [ca.vertcat(rate, ca.vec(turn))])


def _reference(
    problem: Problem,
    scales: Scales,
    plan: PlanResult | None,
    output: ca.Function,
    count: int,
    period: float,
    place: float,
) -> tuple[ca.Function, float]:
    """Return the Function time → departures (·, count) at the ends of the next intervals and γ (α, count) in them as they should be; a typical γ.

    plan: followed over time, and held at its end, by force densities of equilibrium where it is at
    rest; None: the state of the goals is held, likewise. Raises ValueError for goals that ask for a
    motion
    without a plan, InfeasibleGoalError.
    """
    time = ca.MX.sym("time")
    if plan is None:
        state, gamma = _goal(problem, scales)
        wanted, held = (ca.repmat(ca.DM(value), 1, count) for value in (output(state)[0], gamma))
    else:
        gamma, end = plan.force_density, float(plan.time[-1])
        rest = find_rest(
            problem.model,
            plan.trajectory.states[-1],
            *problem.force_density_limits,
            place / scales.time,
        )
        times = [time + period * k for k in range(count + 1)]
        wanted = ca.horzcat(
            *(
                output(_along(plan.trajectory.states, plan.time, ca.fmin(now, end)))[0]
                for now in times[1:]
            )
        )
        columns = [
            _along(gamma, plan.time, (ca.fmin(a, end) + ca.fmin(b, end)) / 2)
            for a, b in pairwise(times)
        ]
        if rest.state is not None:
            columns = [
                ca.if_else((a + b) / 2 < end, own, ca.DM(rest.force_density))
                for own, (a, b) in zip(columns, pairwise(times), strict=True)
            ]
        held = ca.horzcat(*columns)
    strength, moving = (
        float(gamma.mean()),
        scales.mass / scales.time**2,
    )  # moving: moves the mass by the structure's size within the duration
    return ca.Function(
        "reference", [time], [ca.densify(wanted), ca.densify(held)]
    ), strength if strength > NOTHING * moving else moving


def _goal(problem: Problem, scales: Scales) -> tuple[Array, Array]:
    """Return the state of the goals, and γ that hold it as nearly as they can."""
    asked = [
        type(part).__name__
        for part in (problem.start, *problem.goals)
        if isinstance(part, (FreeStart, Waypoint, Periodic))
    ]
    if asked:
        raise ValueError(
            f"problem has {asked[0]}, which asks for a motion, not for one state to be held: plan first, then Mpc(problem, plan=plan)"
        )
    target = find_target(problem, scales)
    state = target.start if target.state is None else target.state
    rest = find_rest(
        problem.model, state, *problem.force_density_limits, ROUNDED * scales.length / scales.time
    )
    if rest.state is not None:
        return rest.state, rest.force_density
    return state, np.asarray(inverse_dynamics(problem, np.array([state, state]), 1.0)[0])


def _along(values: Array, nodes: Array, time: Any) -> Any:
    """As `ocp.transcription.mesh.at`, of a symbolic time; rows of states are linear in time as rows of a linear profile are."""
    k = ca.low(ca.DM(nodes), time)
    left = ca.MX(ca.DM(values.T))[:, k]
    if len(values) < len(nodes):
        return left
    start = ca.MX(ca.DM(nodes))
    return left + (time - start[k]) / (start[k + 1] - start[k]) * (
        ca.MX(ca.DM(values.T))[:, k + 1] - left
    )


def sane(values: Any) -> Any:
    """1 where all values are finite, 0 else: comparisons with what is not a number are false."""
    return ca.mmin(ca.fabs(values) < 1e30)
