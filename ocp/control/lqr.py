"""Time-varying LQR: a linear-quadratic regulator that keeps to a plan, from exact derivatives along it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ocp.boundary.invariants import invariants
from ocp.boundary.sensitivities import Motion
from ocp.control.departures import departures
from ocp.plan.plan import Plan
from ocp.problem.string_bounds import ForceDensityLimits
from ocp.transcription.mesh import profile_at
from tenscasadi.dynamics.model import Model
from tenscasadi.ensemble.feedback import Feedback
from tenscasadi.util.validate import LARGEST, Array, finite_array, instance, positive_number, whole_number

MOST = 10_000  # decisions: each has a gain


@dataclass(frozen=True, eq=False)
class Tracker:
    """Time-varying LQR about a plan, γ = γ_plan − G (x − x_plan) within limits; a controller for `run`, made by `track`.

    After the plan its last gain holds its last state.

    Attributes
    ----------
    model : Model
        The model of the plan.
    time : ndarray, shape (K + 1,)
        Times of the decisions, and the end of the plan, s.
    states : ndarray, shape (K + 1, nx)
        The plan's states at these times, m and m/s.
    force_density : ndarray, shape (K, α)
        The plan's force densities, N/m.
    gains : ndarray, shape (K, α, nx)
        Gains G.
    lower, upper : ndarray, shape (α,)
        Limits of the force densities, N/m.

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
    force_density: Array
    gains: Array
    lower: Array
    upper: Array

    def __repr__(self) -> str:
        return f"Tracker({len(self.gains)} decisions, {self.force_density.shape[1]} strings, {self.time[-1]:g} s)"

    @property
    def period(self) -> float:
        """Seconds from one decision to the next."""
        return float(self.time[1] - self.time[0])

    @property
    def feedback(self) -> Feedback:
        """The same regulator as `tenscasadi.rollouts` takes it: for thousands of motions at once."""
        return Feedback(self.time, self.force_density, self.states, self.gains, self.lower, self.upper)

    def control(self, time: float, state: Array) -> Array:
        """Decide the force densities until the next decision.

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
        time, state = positive_number("time", time, zero=True), finite_array("state", state, (self.model.nx,))
        k = min(int(time / self.period + 1e-9), len(self.gains) - 1)
        after = time > self.time[-1] - 1e-9
        away = state - self.states[-1 if after else k]
        self.model.split(away)[2][:] = 0.0
        return np.asarray(np.clip(self.force_density[k] - self.gains[k] @ away, self.lower, self.upper))


def track(
    plan: Plan,
    *,
    decisions: int | None = None,
    place: float | None = None,
    effort: float | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> Tracker:
    """Make a time-varying LQR that keeps to a plan.

    Parameters
    ----------
    plan : Plan
        What to keep to.
    decisions : int, optional
        How many, at equal times. Default: one per interval of the plan.
    place : float, optional
        Departure of a coordinate, m, that counts as much as `effort`; of velocities 10 of it in the duration. Default: 1 % of the
        structure's size.
    effort : float, optional
        Departure of a force density, N/m. Default: a tenth of the plan's mean force density.
    lower, upper : array_like, scalar or shape (α,), optional
        Limits of the force densities, N/m, as in `ForceDensityLimits`. Default: those of the plan's problem; 0 and none where it is not known.

    Returns
    -------
    Tracker
        The regulator, a controller for `run`.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the steps of so few decisions diverge, or departures do.

    Notes
    -----
    Riccati's recursion minimises Σ (δq/place)² + (δv/speed)² + (δγ/effort)² of small departures from the plan: of coordinates or, of free
    structures, of distances between nodes. Derivatives are those of the integrated steps, in an orthonormal basis of the changes that bars
    and joints allow [1]_.

    References
    ----------
    .. [1] B. D. O. Anderson, J. B. Moore, "Optimal Control: Linear Quadratic Methods", Prentice Hall, 1990, section 2.4.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> ocp.track(plan, decisions=20)
    Tracker(20 decisions, 2 strings, 1 s)
    """
    instance("plan", plan, Plan, "an ocp.Plan")
    model, T = plan.known_model("track"), float(plan.time[-1])
    count = len(plan.time) - 1 if decisions is None else whole_number("decisions", decisions, 1, MOST)
    size = 0.01 * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0))) if place is None else positive_number("place", place)
    force = 0.1 * float(plan.force_density.mean()) or 1.0 if effort is None else positive_number("effort", effort)
    known = (0.0, np.inf) if plan.problem is None else plan.problem.force_density_limits
    limits = ForceDensityLimits(known[0] if lower is None else lower, known[1] if upper is None else upper)
    limits.check(model.scene.structure)
    time = np.linspace(0.0, T, count + 1)
    gamma = profile_at(plan.force_density, plan.time, (time[:-1] + time[1:]) / 2)
    motion = Motion(model, count, 2)
    states, points = motion.states(plan.trajectory.states[0], gamma, T / count)
    if not np.all(np.abs(states) <= LARGEST):
        raise ValueError(f"decisions is {count}: steps of {T / count / 2:g} s diverge along the plan, give more decisions")
    A, B = motion.derivatives(points, gamma, T / count)
    kept = departures(model, size, 10 * size / T)
    tangents = Tangents(model, states[0])
    Z = [tangents(x) for x in states]
    C = [np.asarray(kept(x)[1].full()) @ basis for x, basis in zip(states, Z, strict=True)]
    try:
        with np.errstate(all="ignore"):  # what overflows is told
            gains = _gains(A, B, Z, C, force**-2)
    except (scipy.linalg.LinAlgError, ValueError):
        told = f"departures along the motion{'' if plan.success else ' of a plan that failed'} grow too fast for gains to be found"
        raise ValueError(f"decisions is {count}: {told}, give more decisions") from None
    return Tracker(model, time, states, gamma, gains, *limits.limits(model.scene.structure))


Plan._track = staticmethod(track)


class Tangents:
    """Orthonormal bases of the small changes of a state that bars and joints allow, of places and velocities together."""

    def __init__(self, model: Model, start: Array) -> None:
        x = ca.SX.sym("x", model.nx)
        rigid = [group.value for group in invariants(model, start, x, 0) if group.kind in ("bar", "joint", "clock")]
        self._jacobian = ca.Function("jacobian", [x], [ca.densify(ca.jacobian(ca.vertcat(ca.SX(0, 1), *rigid), x))])
        self._size = model.nx

    def __call__(self, state: Array) -> Array:
        """Return the basis (nx, d) at a state (nx,)."""
        J = np.asarray(self._jacobian(state).full())
        if not J.shape[0]:
            return np.eye(self._size)
        _, values, right = np.linalg.svd(J)
        return np.asarray(right[int(np.sum(values > 1e-9 * values.max(initial=0.0))) :].T)


def _gains(A: Array, B: Array, Z: list[Array], C: list[Array], effort: float) -> Array:
    """Feedback (K, α, nx) by Riccati's recursion in the reduced coordinates Zᵀ δx, from the end."""
    gains = np.zeros((len(A), B.shape[2], A.shape[1]))
    P = C[-1].T @ C[-1]
    R = effort * np.eye(B.shape[2])
    for k in reversed(range(len(A))):
        a, b = Z[k + 1].T @ A[k] @ Z[k], Z[k + 1].T @ B[k]
        L = scipy.linalg.solve(R + b.T @ P @ b, b.T @ P @ a, assume_a="pos")
        closed = a - b @ L
        P = closed.T @ P @ closed + L.T @ R @ L + C[k].T @ C[k]
        P = (P + P.T) / 2
        gains[k] = L @ Z[k].T
    return gains
