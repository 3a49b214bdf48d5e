"""Model predictive control."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.control.formulation import Formulation
from ocp.control.holding import find_rest, force_limits
from ocp.control.mpc_constraints import Horizon, HorizonLimits
from ocp.control.scaled_output import build_scaled_output
from ocp.control.variational_equation import build_slopes, linearize_step, propagate
from ocp.guess.inverse_dynamics import inverse_dynamics
from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.control import build_smooth_model, check_control, controls_force_densities
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.path_constraints import scaled_rows
from ocp.problem.phase import reject_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, scale_deviations
from ocp.problem.start import FreeStart
from ocp.results.result import PlanResult
from ocp.sampling.horizon_costs import OVERSTEP
from ocp.solvers.dual_active_set import HorizonProgram, is_finite, name_inputs
from ocp.targets.find_target import find_target
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.util.casadi_tools import ArrayFunction, symbol_kind
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import (
    MAX_REPETITIONS,
    Array,
    finite_array,
    instance,
    positive_number,
    whole_number,
)


class Mpc:
    """Model predictive control that tracks a plan or holds goals.

    It is a controller for `run`. At each decision, it predicts the motion from the measured state
    under the previous controls, shifted by a period. A quadratic program improves the controls, and
    those of the first period are applied.

    Parameters
    ----------
    problem : Problem
        Optimal control problem. Limits of the control are kept exactly. Other limits are
        linearized at the ends of the periods, and violated only if they are infeasible. Costs are
        not used.
    period : float
        Sampling period [s].
    intervals : int
        Prediction horizon in periods.
    plan : Plan, optional
        Plan to track, and to hold at its end. Default: the target state of the goals, with the
        control that balances it best. Problems with `Waypoint`, `Periodic` or `FreeStart` need a
        plan.
    iterations : int
        Quadratic programs for each decision. 1 is the real-time iteration [1]_.
    substeps : int
        Number of steps of `RungeKutta4` in each period.
    position_scale : float, optional
        Deviation of a coordinate [m] that costs as much as a control deviation of `control_scale`.
        The scale of velocities is 10 · position_scale/duration. For free structures, deviations are
        those of distances between nodes. Default: 1 % of the structure's size.
    control_scale : float, optional
        Control deviation, of force densities [N/m] or of another control in its unit. Default: the
        mean force density of the plan or of the goals, or the change of tensions, rest lengths or
        torques that causes it. For rest-length rates, it is the scale of velocities.

    Raises
    ------
    InfeasibleGoalError
        If the goals are infeasible.
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Notes
    -----
    The quadratic program is condensed. Its unknowns are the changes of the control, and the states
    follow by the exact derivatives of the steps, so bars, joints and momenta need no constraints.
    A dual active-set method in C solves it [2]_, or CasADi's DAQP without a C compiler. Rate limits,
    such as `RestLengthRateLimits`, also hold from the last decision to the new one.

    References
    ----------
    .. [1] M. Diehl, H. G. Bock, J. P. Schlöder, A real-time iteration scheme for nonlinear
       optimization in optimal feedback control, SIAM J. Control Optim. 2005, 43, 1714.
    .. [2] D. Goldfarb, A. Idnani, A numerically stable dual method for solving strictly convex
       quadratic programs, Math. Program. 1983, 27, 1.

    Examples
    --------
    A planar cross moves to another shape:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> problem = ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()], bounds=[ocp.ForceDensityLimits(0.0, 20.0)])
    >>> controller = ocp.Mpc(problem, period=0.1, intervals=5)
    >>> controller.control(0.0, cross.initial_state).shape
    (2,)
    """

    @rename_keywords(place="position_scale", effort="control_scale")
    def __init__(
        self,
        problem: Problem,
        period: float = 0.05,
        intervals: int = 10,
        *,
        plan: PlanResult | None = None,
        iterations: int = 1,
        substeps: int = 1,
        position_scale: float | None = None,
        control_scale: float | None = None,
    ) -> None:
        instance("problem", problem, Problem, "an ocp.Problem")
        reject_phases(problem.phases, "Mpc")
        check_control(problem.model)
        _check_plan(plan, problem.model)
        self.problem, self.model = problem, problem.model
        # slack strings would not respond to changes of their rest lengths
        problem = replace(problem, model=build_smooth_model(problem.model))
        self._predicted = problem.model
        self.period = positive_number("period", period)
        self.intervals = whole_number("intervals", intervals, 1, MAX_REPETITIONS)
        self._iterations = whole_number("iterations", iterations, 1, MAX_REPETITIONS)
        self._substeps = whole_number("substeps", substeps, 1, MAX_REPETITIONS)
        scales = Scales.of(problem)
        size = scales.read_position(position_scale)
        self._scaled_output = build_scaled_output(self.model, size, 10 * size / scales.time)
        self._reference, strength = _build_reference(
            problem, scales, plan, self._scaled_output, self.intervals, self.period, size
        )
        if control_scale is not None:
            own = np.full(self.model.nu, positive_number("control_scale", control_scale))
        else:
            own = scale_deviations(self.model, strength, 10 * size / scales.time)
        self._control_scale = own
        self._weights = np.tile(self._control_scale**-2, self.intervals)
        self._lower, self._upper = (
            np.tile(limit, self.intervals) for limit in problem.control_limits
        )
        self._limits = HorizonLimits(problem, scales, strength, self.period)
        self._scales, self._strength = scales, strength
        self._shift, self._program = self._build_shift(), self._build_program()
        self._decide = ArrayFunction(self.function(self.quadratic_program.compiled()))
        self._last: _MpcDecision
        self.reset()

    def __repr__(self) -> str:
        return (
            f"Mpc({self.model.nu} strings, every {self.period:g} s over {self.intervals} intervals)"
        )

    def control(self, time: float, state: Array) -> Array:
        """Compute the control for the next sampling period.

        A time before that of the previous call begins a new run.

        Parameters
        ----------
        time : float
            Time since the beginning [s].
        state : array_like, shape (nx,)
            Measured state.

        Returns
        -------
        ndarray, shape (nu,)
            Control.
        """
        time, state = (
            positive_number("time", time, zero=True),
            finite_array("state", state, (self.model.nx,)),
        )
        if time < self._last.time:
            self.reset()
        inputs = [np.array([time]), state, *self._last[1:3]]
        gamma, status = self._decide(*inputs if self._limits.from_last_decision else inputs[:3])
        self._last = _MpcDecision(time, gamma, state, bool(status))
        return np.array(gamma[0])

    @property
    def failed(self) -> bool:
        """Whether a quadratic program of the last decision was not solved.

        Its controls are then those of the previous decision, shifted by a period.
        """
        return self._last.failed

    @property
    def formulation(self) -> Formulation:
        """Optimal control problem on the prediction horizon, as data."""
        x = symbol_kind(self._scaled_output).sym("x", self.model.nx)
        smooth = replace(self.problem, model=self._predicted)
        limits = scaled_rows(smooth, PathBound, self._scales, self._strength)
        rates = scaled_rows(smooth, RateBound, self._scales, self._strength)
        return Formulation(
            self._predicted.ode,
            ca.Function("output", [x], [self._scaled_output(x)[0]]),
            self._reference,
            self._control_scale,
            self._substeps,
            limits,
            [name for rows in rates for name in rows.names],
        )

    @property
    def quadratic_program(self) -> HorizonProgram:
        """Sizes of the quadratic programs, and solvers for them."""
        outputs, rows = self._scaled_output.size1_out(0), self._program.size1_out("b")
        return HorizonProgram(self.intervals, self.model.nu, outputs, rows, OVERSTEP)

    def reset(self) -> None:
        """Discard the warm start before another run."""
        self._last = _MpcDecision(
            0.0, np.full((self.intervals, self.model.nu), np.nan), np.full(self.model.nx, np.nan)
        )

    def function(self, solver: ca.Function | None = None) -> ca.Function:
        """Build the controller as one CasADi Function.

        Use `export_mpc` for C code.

        Parameters
        ----------
        solver : casadi.Function, optional
            Solver of `quadratic_program`. Default: CasADi's DAQP.

        Returns
        -------
        casadi.Function
            Function (time, state (nx), before (nu, intervals)) → after (nu, intervals), status. The
            columns of ``after`` are the controls in the periods of the horizon; apply the first
            one. ``before`` is ``after`` of the previous call, or `first` in the first call. With
            rate limits, there is a fourth input ``earlier`` (nx): the state in the previous call,
            or NaN in the first call. ``status`` is 0, or 1 if a quadratic program was not solved,
            as for a state that is NaN; ``after`` then has its controls without improvement.
        """
        if solver is None:
            solver = self.quadratic_program.interpreted()
        instance("solver", solver, ca.Function, "a casadi.Function or None")
        time, state, before = (
            ca.MX.sym("time"),
            ca.MX.sym("state", self.model.nx),
            ca.MX.sym("before", self.model.nu, self.intervals),
        )
        inputs = {"time": time, "state": state, "before": before}
        if self._limits.from_last_decision:
            inputs["earlier"] = ca.MX.sym("earlier", self.model.nx)
        after, failures = self._shift(time, before), ca.MX(0)
        for _ in range(self._iterations):
            after, *terms = self._program(time, state, after, before, inputs.get("earlier", state))
            change, status = solver(*terms)[:2]
            change = ca.if_else(status, ca.DM.zeros(change.shape), change)
            after = self._clip(after + ca.reshape(change, *after.shape))
            failures += status
        outputs = [after, failures > 0]
        return ca.Function(
            "decide", list(inputs.values()), outputs, list(inputs), ["after", "status"]
        )

    @property
    def first(self) -> Array:
        """Reference control, the input ``before`` of the first call of `function`."""
        held = self._reference(0.0)[1].full()
        return np.column_stack([held[:, :1], held[:, :-1]])

    def _build_shift(self) -> ca.Function:
        """Build the Function (time, before) → controls γ shifted by a period.

        In the first call, γ is the reference.
        """
        time, before = ca.MX.sym("time"), ca.MX.sym("before", self.model.nu, self.intervals)
        held = self._reference(time)[1]
        gamma = ca.if_else(is_finite(before), ca.horzcat(before[:, 1:], held[:, -1]), held)
        return ca.Function("shift", [time, before], [self._clip(gamma)])

    def _clip(self, gamma: Any) -> Any:
        return ca.fmin(
            ca.fmax(gamma, ca.reshape(self._lower, *gamma.shape)),
            ca.reshape(self._upper, *gamma.shape),
        )

    def _build_program(self) -> ca.Function:
        """Build the quadratic program about a predicted trajectory.

        The Function (time, state, γ, before, earlier) → γ, G, g, a, b gives the program: minimize ½
        ‖G ΔU‖² + ½ ‖ΔU/control_scale‖² + gᵀ ΔU subject to a ΔU ≤ b, over changes ΔU (nu ·
        intervals) of the controls γ. `before` and `earlier` are the controls and the state of the
        previous call. If the trajectory under γ diverges, γ is replaced by the reference.
        """
        model, count = self.model, self.intervals
        time, state, earlier = (
            ca.MX.sym(name, size)
            for name, size in (("time", 1), ("state", model.nx), ("earlier", model.nx))
        )
        given, before = (ca.MX.sym(name, model.nu, count) for name in ("given", "before"))
        wanted, held = self._reference(time)
        roll = RungeKutta4().step(self._predicted.ode).mapaccum(count * self._substeps)
        ends = roll(
            state, ca.kron(given, ca.DM.ones(1, self._substeps)), self.period / self._substeps
        )
        gamma = ca.if_else(is_finite(ends), given, held)
        begun = is_finite(earlier)
        last = [
            ca.if_else(begun, *pair) for pair in ((earlier, state), (before[:, 0], gamma[:, 0]))
        ]
        horizon = self._horizon(state, gamma, *last)
        reached, slopes = zip(*(self._scaled_output(x) for x in horizon.states[2:]), strict=True)
        blocks = [effect @ C.T for C, effect in zip(slopes, horizon.state_effects[2:], strict=True)]
        a, b = self._limits.rows(horizon, time, begun)
        now = ca.vec(gamma)
        inputs = [
            *blocks,
            ca.vec(ca.horzcat(*reached) - wanted),
            self._weights,
            now - ca.vec(held),
            a,
            b,
            self._lower - now,
            self._upper - now,
        ]
        return ca.Function(
            "program",
            [time, state, given, before, earlier],
            [gamma, *(ca.densify(ca.MX(value)) for value in inputs)],
            ["t", "x", "given", "before", "earlier"],
            ["u", *name_inputs(count)],
        )

    def _horizon(self, state: Any, gamma: Any, earlier: Any, last: Any) -> Horizon:
        """Predict states and sensitivities under the controls γ.

        `gamma` is (nu, intervals), `state` the current state (nx,). `earlier` and `last` are state
        and control of the previous sampling period.
        """
        nu, slopes = self.model.nu, build_slopes(self._predicted)
        none = ca.DM(0, self.model.nx)
        x, states, effects = state, [earlier, state], [none, none]
        for k in range(self.intervals):
            old, new = effects[-1], ca.DM(nu, self.model.nx)
            for _ in range(self._substeps):
                x, stages = linearize_step(slopes, x, gamma[:, k], self.period / self._substeps)
                old, new = propagate(old, stages, False), propagate(new, stages, True)
            states.append(x)
            effects.append(ca.vertcat(old, new))
        own = [ca.vertcat(ca.DM(k * nu, nu), ca.DM.eye(nu)) for k in range(self.intervals)]
        return Horizon(states, effects, [last, *ca.horzsplit(gamma)], [ca.DM(0, nu), *own])


class _MpcDecision(NamedTuple):
    """Decision of the previous call; its arrays are NaN before the first call.

    Attributes
    ----------
    time : float
        Its time [s].
    force_density : ndarray, shape (intervals, nu)
        Controls on the prediction horizon.
    state : ndarray, shape (nx,)
        State at this time.
    failed : bool
        Whether a quadratic program was not solved.
    """

    time: float
    force_density: Array
    state: Array
    failed: bool = False


def _check_plan(plan: PlanResult | None, model: Model) -> None:
    if plan is None:
        return
    instance("plan", plan, PlanResult, "an ocp.Plan or None")
    if (plan.trajectory.states.shape[1], plan.control.shape[1]) != (model.nx, model.nu):
        raise ValueError(
            "plan is of another structure than the problem: give one whose model has the same nodes and strings"
        )


def _build_reference(
    problem: Problem,
    scales: Scales,
    plan: PlanResult | None,
    output: ca.Function,
    count: int,
    period: float,
    place: float,
) -> tuple[ca.Function, float]:
    """Build the reference to track, and a typical force density [N/m].

    The Function of the time returns the scaled output (·, count) at the ends of the next intervals,
    and the control (nu, count) in them. With a plan, it is the plan, then its final equilibrium if
    it ends at rest. Without a plan, it is an equilibrium that meets the goals. Raises ValueError,
    InfeasibleGoalError. `output` is the scaled output and `count` the number of intervals of length
    `period` [s]. `place` is the scale of positions [m].
    """
    time = ca.MX.sym("time")
    if plan is None:
        state, control, forces = _find_goal(problem, scales)
        wanted, held = (ca.repmat(ca.DM(value), 1, count) for value in (output(state)[0], control))
    else:
        forces, end = plan.force_density, float(plan.time[-1])
        final = plan.trajectory.states[-1]
        limits = force_limits(problem.model, problem, final)
        rest = find_rest(problem.model, final, *limits, place / scales.time)
        times = [time + period * k for k in range(count + 1)]
        wanted = ca.horzcat(
            *(
                output(_interpolate(plan.trajectory.states, plan.time, ca.fmin(now, end)))[0]
                for now in times[1:]
            )
        )
        columns = [
            _interpolate(plan.control, plan.time, (ca.fmin(a, end) + ca.fmin(b, end)) / 2)
            for a, b in pairwise(times)
        ]
        if rest.state is not None:
            columns = [
                ca.if_else((a + b) / 2 < end, own, ca.DM(rest.control))
                for own, (a, b) in zip(columns, pairwise(times), strict=True)
            ]
        held = ca.horzcat(*columns)
    # moves the mass by the structure's size within the duration; much smaller means are rounding
    moving = scales.mass / scales.time**2
    strength = float(forces.mean())
    reference = ca.Function("reference", [time], [ca.densify(wanted), ca.densify(held)])
    return reference, strength if strength > 1e-6 * moving else moving


def _find_goal(problem: Problem, scales: Scales) -> tuple[Array, Array, Array]:
    """Find an equilibrium at the goals.

    Returns its state (nx,), control (nu,) and force densities [N/m]. Raises ValueError for goals at
    other instants than the end.
    """
    asked = [
        type(part).__name__
        for part in (problem.start, *problem.goals)
        if isinstance(part, (FreeStart, Waypoint, Periodic))
    ]
    if asked:
        raise ValueError(
            f"problem has {asked[0]}, which needs a plan: find one, then give Mpc(problem, plan=plan)"
        )
    target = find_target(problem, scales)
    state = target.start if target.state is None else target.state
    model = problem.model
    slow = 1e-3 * scales.length / scales.time
    rest = find_rest(model, state, *force_limits(model, problem, state), slow)
    held, control = rest.state, rest.control
    if held is None:
        states, inputs, _ = inverse_dynamics(problem, np.array([state, state]), 1.0)
        held, control = states[-1], inputs[0]
    if controls_force_densities(model):
        return held, control, control
    return held, control, np.asarray(model.force_density(held, control))


def _interpolate(values: Array, nodes: Array, time: Any) -> Any:
    """Interpolate controls or states of a plan at a symbolic time.

    `nodes` (K + 1,) are the mesh times [s]. With K `values`, they are constant in the intervals.
    """
    k = ca.low(ca.DM(nodes), time)
    left = ca.MX(ca.DM(values.T))[:, k]
    if len(values) < len(nodes):
        return left
    start = ca.MX(ca.DM(nodes))
    return left + (time - start[k]) / (start[k + 1] - start[k]) * (
        ca.MX(ca.DM(values.T))[:, k + 1] - left
    )
