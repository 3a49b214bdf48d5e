"""Time-varying linear-quadratic regulator (LQR) that tracks a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ocp.control.closed_loop import run
from ocp.control.holding import Rest, compute_stationary_cost, find_rest, force_limits
from ocp.control.scaled_output import build_scaled_output
from ocp.problem.bounds.string_bounds import StringLimits
from ocp.problem.path_constraints import control_limits
from ocp.problem.scaling import scale_deviations
from ocp.results.result import STEPS, PlanResult
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.linear_steps import riccati_gains, transitions
from tenscasadi.dynamics.linearization import tangents
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stability import contact_step, fastest_rate
from tenscasadi.scene.winches import Winch
from tenscasadi.simulation.inputs.feedback import Feedback
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import rename_fields, rename_keywords
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    LARGEST,
    Array,
    finite_array,
    instance,
    per_item,
    positive_number,
    whole_number,
)

MAX_SUBSTEPS = 50  # of a decision, for its derivatives


class Hold(NamedTuple):
    """Feedback law of a `Tracker` after the end of the plan.

    The control is u = inputs − gains (x − state), within limits.

    Attributes
    ----------
    state : ndarray, shape (nx,)
        State at rest [m, m/s].
    inputs : ndarray, shape (nu,)
        Control at rest, see `Tracker`.
    gains : ndarray, shape (nu, nx)
        Feedback gains.
    """

    state: Array
    inputs: Array
    gains: Array


@rename_fields(force_density="inputs")
@dataclass(frozen=True, eq=False)
class Tracker(ReadOnlyArrays):
    """Time-varying LQR that tracks a plan, made by `track`.

    It is a controller for `run` with the law u = u_plan − G (x − x_plan), within limits. After a
    plan that ends at rest, it keeps the final state: the control is the smallest one in
    equilibrium, with the feedback of a stationary LQR. If there is no equilibrium, `message` gives
    the reason, and the last gain G remains in use about the last state.

    Attributes
    ----------
    model : Model
        The model of the plan.
    time : ndarray, shape (K + 1,)
        Times of the decisions, and the end of the plan [s].
    states : ndarray, shape (K + 1, nx)
        The plan's states at these times [m, m/s].
    inputs : ndarray, shape (K, nu)
        The plan's control: force densities [N/m], tensions [N], rest lengths [m], their rates
        [m/s], or motor torques [N m].
    gains : ndarray, shape (K, nu, nx)
        Gains G.
    lower, upper : ndarray, shape (nu,)
        Limits of the control.
    hold : Hold or None
        Law that keeps the final state of the plan: `state` (nx,), `inputs` (nu,) and `gains`
        (nu, nx); None if the plan does not end at rest.
    message : str
        Whether the final state of the plan is kept, and the reason if not.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> tracker = ocp.track(plan)
    >>> tracker.gains.shape
    (10, 2, 18)
    >>> bool(abs(tracker.control(0.0, plan.trajectory.states[0]) - plan.force_density[0]).max() < 1e-9)
    True
    """

    model: Model
    time: Array
    states: Array
    inputs: Array
    gains: Array
    lower: Array
    upper: Array
    hold: Hold | None = None
    message: str = ""

    def __repr__(self) -> str:
        return f"Tracker({len(self.gains)} decisions, {self.inputs.shape[1]} inputs, {self.time[-1]:g} s)"

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def feedback(self) -> Feedback:
        """Feedback law for `tenscasadi.rollouts`."""
        if self.hold is None:
            return Feedback(self.time, self.inputs, self.states, self.gains, self.lower, self.upper)
        time = np.append(self.time, self.time[-1] + self.period)
        controls, gains = (
            np.vstack([self.inputs, self.hold.inputs]),
            np.concatenate([self.gains, self.hold.gains[None]]),
        )
        states = np.vstack([self.states[:-1], self.hold.state, self.hold.state])
        return Feedback(time, controls, states, gains, self.lower, self.upper)

    def control(self, time: float, state: Array) -> Array:
        """Compute the control for the next sampling period.

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
        k = min(int(time / self.period + 1e-9), len(self.gains) - 1)
        after = time > self.time[-1] - 1e-9
        if after and self.hold is not None:
            wanted, planned, gain = self.hold
        else:
            wanted, planned, gain = (
                self.states[-1 if after else k],
                self.inputs[k],
                self.gains[k],
            )
        away = state - wanted
        self.model.split(away).clock[:] = 0.0
        return np.asarray(np.clip(planned - gain @ away, self.lower, self.upper))


@rename_keywords(place="position_scale", effort="control_scale")
def track(
    plan: PlanResult,
    *,
    decisions: int | None = None,
    position_scale: float | None = None,
    control_scale: float | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> Tracker:
    """Build a time-varying LQR that tracks a plan.

    Parameters
    ----------
    plan : Plan
        The plan to track.
    decisions : int, optional
        Number of decisions, at equal times. Default: one per interval of the plan, as long as the
        shortest.
    position_scale : float, optional
        Deviation of a coordinate [m] that costs as much as a control deviation of `control_scale`.
        The scale of velocities is 10 · position_scale/duration. Default: 1 % of the structure's
        size.
    control_scale : float, optional
        Control deviation, of force densities [N/m] or of another control in its unit. Default: a
        tenth of the plan's mean force density, or the change of tensions or rest lengths that
        causes it. For rest-length rates, it is the scale of velocities; for torques, the torques of
        the mean tension.
    lower, upper : array_like, scalar or shape (nu,), optional
        Limits of the control, such as force densities [N/m] as in `ForceDensityLimits`. Default:
        those of the plan's problem; if it is unknown, 0 (rates and torques: −infinity) and
        infinity.

    Returns
    -------
    Tracker
        Regulator, a controller for `run`.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or the deviations grow too fast for the
        number of decisions.

    Notes
    -----
    The Riccati recursion minimizes Σ (δq/position_scale)² + (δv/speed)² + (δγ/control_scale)² of
    small deviations from the plan [1]_. The deviations are those of coordinates, or of distances
    between nodes if the structure is free. Each period is divided into substeps. Each substep is
    linearized at its midpoint and advanced by the Padé (2, 2) approximation of the matrix
    exponential. The linearization is projected onto an orthonormal basis of the changes that bars
    and joints allow.

    References
    ----------
    .. [1] B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods, Prentice Hall
       1990, section 2.4.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> ocp.track(plan, decisions=20)
    Tracker(20 decisions, 2 inputs, 1 s)
    """
    instance("plan", plan, PlanResult, "an ocp.Plan")
    model, T = plan.require_model("track"), float(plan.time[-1])
    shortest = float(np.diff(plan.time).min())
    most = 10_000
    default = min(int(np.ceil(T / shortest - 1e-6)), most)
    count = whole_number("decisions", default if decisions is None else decisions, 1, most)
    size = (
        0.01 * measure_diagonal(model.structure.nodes)
        if position_scale is None
        else positive_number("position_scale", position_scale)
    )
    force = (
        _default_scale(plan, model, 10 * size / T)
        if control_scale is None
        else positive_number("control_scale", control_scale)
    )
    own = _read_limits(plan, model, lower, upper)
    time = np.linspace(0.0, T, count + 1)
    gamma = profile_at(plan.control, plan.time, (time[:-1] + time[1:]) / 2)
    states = _planned(plan, model, time)
    rest = _rest(plan, model, own, size / T, force)
    try:
        with np.errstate(all="ignore"):  # an overflow is reported below
            gains = _regulate(
                model,
                states,
                gamma,
                rest,
                T / count,
                build_scaled_output(model, size, 10 * size / T),
                force**-2,
            )
    except (scipy.linalg.LinAlgError, ValueError):
        failed = "" if plan.success else ", which failed,"
        reason = f"deviations from the plan{failed} grow too fast for LQR gains"
        raise add_address(
            ValueError(f"decisions is {count}: {reason}, give more decisions")
        ) from None
    hold = Hold(rest.state, rest.control, gains[count]) if rest.state is not None else None
    return Tracker(model, time, states, gamma, gains[:count], *own, hold, rest.message)


def _default_scale(plan: PlanResult, model: Model, speed: float) -> float:
    """Compute the default scale of control deviations.

    `speed` is the scale of velocity deviations [m/s].
    """
    fraction = 1.0 if isinstance(model.scene.control, Winch) else 0.1  # torques that hold
    strength = fraction * float(plan.force_density.mean()) or 1.0
    return float(scale_deviations(model, strength, speed).mean())


def _read_limits(
    plan: PlanResult, model: Model, lower: ArrayLike | None, upper: ArrayLike | None
) -> tuple[Array, Array]:
    """Read the limits (nu,) of the control.

    Raises TypeError, ValueError. `lower` and `upper` are those of the user; None for the limits of
    the problem.
    """
    kind, structure = control_limits(model), model.scene.structure
    signed = not (isinstance(kind, type) and issubclass(kind, StringLimits))
    known = (-np.inf if signed else 0.0), np.inf
    least, most = known if plan.problem is None else plan.problem.control_limits
    if not signed:
        limits = cast("type[Any]", kind)(
            least if lower is None else lower, most if upper is None else upper
        )
        limits.check(structure)
        found: tuple[Array, Array] = limits.limits(structure)
        return found
    given = [
        np.broadcast_to(default, model.nu) if value is None else per_item(name, value, model.nu)
        for name, value, default in (("lower", lower, least), ("upper", upper, most))
    ]
    for k in np.flatnonzero(given[0] > given[1])[:1]:
        raise ValueError(
            f"lower is {given[0][k]:g} and upper is {given[1][k]:g} for input {k}: give lower ≤ upper"
        )
    return np.array(given[0]), np.array(given[1])


def _rest(
    plan: PlanResult, model: Model, limits: tuple[Array, Array], slow: float, margin: float
) -> Rest:
    """Find the control that keeps the plan's final state at rest.

    `limits` (2, nu) are those of the control. `slow` [m/s] and `margin` are those of `find_rest`.
    """
    end = plan.trajectory.states[-1]
    if model.scene.commands_forces:
        return find_rest(model, end, *limits, slow, margin)
    # strings that are about to go slack would not respond
    margin = 0.1 * float(plan.tension().mean())
    found = find_rest(model, end, *force_limits(model, plan.problem, end), slow, margin)
    return found if found.state is None else found._replace(control=np.clip(found.control, *limits))


def replay_tracked(plan: PlanResult) -> Trajectory:
    """Simulate a plan under the feedback of `track`.

    Raises ValueError if no gains are found or the model is unknown.
    """
    tracker, steps = track(plan), STEPS
    if tracker.model.scene.grounds:
        steps = max(steps, int(np.ceil(tracker.period / contact_step(tracker.model))))
    start = plan.trajectory.states[0]
    return run(tracker, float(plan.time[-1]), steps=steps, state=start).trajectory


def _planned(plan: PlanResult, model: Model, time: Array) -> Array:
    """Compute the planned states at given times [s].

    Raises ValueError for states that are not finite.
    """
    states = trace_motion(model, plan.time, plan.trajectory.states, plan.control, time)
    if not np.all(np.abs(states) <= LARGEST):
        raise ValueError(
            "plan has states that are not finite, or at which the linearization is not: give a plan that succeeded, or more intervals"
        )
    return states


def trace_motion(model: Model, nodes: Array, states: Array, control: Array, time: Array) -> Array:
    """Compute the states of a planned motion at given times.

    RK4 steps start from the preceding mesh point, so that errors do not accumulate.

    Parameters
    ----------
    model : Model
        Model of the motion.
    nodes : ndarray, shape (K + 1,)
        Mesh points [s].
    states : ndarray, shape (K + 1, nx)
        Planned states there.
    control : ndarray, shape (K, nu) or (K + 1, nu)
        Controls: piecewise constant, or piecewise linear.
    time : ndarray, shape (n,)
        Times [s], ≥ ``nodes[0]``.

    Returns
    -------
    ndarray, shape (n, nx)
        States at these times; after the last mesh point, the state there.
    """
    near = 1e-9 * nodes[-1]
    k = np.searchsorted(nodes, time + near, side="right") - 1
    since = np.where((k == len(nodes) - 1) | (time - nodes[k] <= near), 0.0, time - nodes[k])
    advance = RungeKutta4().step(model.ode).map(len(time))
    x = ca.DM(states[k].T)
    for part in range(STEPS):
        x = advance(
            x,
            profile_at(control, nodes, nodes[k] + (part + 0.5) / STEPS * since).T,
            since[None] / STEPS,
        )
    return np.asarray(x.full().T)


def _regulate(
    model: Model,
    states: Array,
    gamma: Array,
    rest: Rest,
    period: float,
    kept: ca.Function,
    effort: float,
) -> Array:
    """Compute the LQR gains (K, nu, nx) along the planned states.

    The controls are `gamma` (K, nu), constant in each `period` [s]. `kept` is the scaled output of
    `build_scaled_output`, and `effort` the weight of the control. If there is an equilibrium at the
    end (`rest`), the gain of its stationary LQR is appended.
    """
    ends = states
    if rest.state is not None:
        states, gamma, ends = (
            np.vstack([states[:-1], rest.state]),
            np.vstack([gamma, rest.control]),
            np.vstack([states, rest.state]),
        )
    else:
        states = states[:-1]
    looked_at = sorted({0, len(gamma) // 2, len(gamma) - 1})
    rate = max(fastest_rate(model, states[k], gamma[k]) for k in looked_at)
    count = MAX_SUBSTEPS
    if np.isfinite(rate):
        # a radian of the fastest vibration each
        count = int(np.clip(np.ceil(rate * period), 2, MAX_SUBSTEPS))
    A, B = _linearize(model, states, gamma, period, count)
    Z = [tangents(model, x) for x in ends]
    C = [kept(x)[1].full() @ basis for x, basis in zip(ends, Z, strict=True)]
    R = effort * np.eye(B.shape[2])
    P = C[-1].T @ C[-1]
    if rest.state is not None:
        P = compute_stationary_cost(Z[-1].T @ A[-1] @ Z[-1], Z[-1].T @ B[-1], P, R)
        Z[-2] = Z[-1]  # the end of the plan, but for its rounding
    return riccati_gains(A, B, Z, C, P, R)


def _linearize(
    model: Model, states: Array, controls: Array, period: float, count: int
) -> tuple[Array, Array]:
    """Linearize the dynamics over a sampling period at states (K, nx).

    Returns the Jacobians with respect to states and controls. `count` RK4 steps compute the states
    within the period [s], and `transitions` the Jacobians.
    """
    step, h = RungeKutta4().step(model.ode).mapaccum(count).map(len(states)), period / count
    held = np.repeat(controls, count, axis=0)
    ends = step(states.T, held.T, h).full().T.reshape(len(states), count, -1)
    starts = np.concatenate([states[:, None], ends[:, :-1]], axis=1)
    rows = len(held), model.nx
    lengths = np.full(len(held), h)
    return transitions(model, starts.reshape(rows), ends.reshape(rows), held, lengths, count)
