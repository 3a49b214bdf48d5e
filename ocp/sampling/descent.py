"""Gauss-Newton method with feedback, for simulated motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.problem.path_constraints import MARGIN
from ocp.sampling.batch_simulation import PROBE, BatchSimulation, Feedback, Watcher
from tenscasadi.util.validate import Array, Indices

SETTLED = 0.3  # residual in units of the tolerance below which the method ends


@dataclass(frozen=True, eq=False)
class Candidate:
    """Controls of a candidate plan with their simulation.

    Attributes
    ----------
    duration : float
        Duration [s].
    force_density : ndarray, shape (K, α)
        Force densities [N/m].
    states : ndarray, shape (K + 1, nx)
        States [m, m/s].
    rows : ndarray, shape (m,)
        Residuals of goals and limits, in units of their tolerances.
    """

    duration: float
    force_density: Array
    states: Array
    rows: Array

    @property
    def worst(self) -> float:
        """Largest residual."""
        return (
            float(np.abs(self.rows).max(initial=0.0)) if np.all(np.isfinite(self.rows)) else np.inf
        )

    @property
    def merit(self) -> float:
        """Sum of squared residuals."""
        return float(self.rows @ self.rows) if np.all(np.isfinite(self.rows)) else np.inf


@dataclass(frozen=True, eq=False)
class Linearization:
    """Residuals near a motion, as linear functions of deviations from it.

    Attributes
    ----------
    residuals : ndarray, shape (m,)
        Residuals of the motion.
    by_state : ndarray, shape (K, m, nx + 1)
        Derivatives with respect to the state at the start of an interval, and to the duration
        relative to that of the motion.
    by_control : ndarray, shape (m, K, g)
        Derivatives with respect to changes along g directions; 0 where a limit forbids them.
    """

    residuals: Array
    by_state: Array
    by_control: Array

    def solve(self, first: int, residuals: Array, damping: Array, more: Array) -> Array:
        """Solve (U Uᵀ + damping) y = residuals, for controls from interval `first` on.

        U are the derivatives with respect to them, and `more` (m, c) further columns. `residuals`
        and y are (n, m), and `damping` (n,).
        """
        U = np.concatenate([self.by_control[:, first:].reshape(len(more), -1), more], axis=1)
        systems = U @ U.T + damping[:, None, None] * np.eye(len(U))
        return np.asarray(np.linalg.solve(systems, residuals[..., None])[..., 0])


class Descent:
    """Gauss-Newton method for the residuals of goals and limits.

    The unknowns are changes of the force densities along `directions` (g, α) [N/m] in each
    interval. `finer` multiplies the number of time steps. A trial motion computes its change in an
    interval from its own state there, as the damped step that the remaining intervals need. This
    feedback keeps trial motions near the linear prediction, along which open-loop motions diverge:
    with contact, predictions hold for tiny changes only.
    """

    def __init__(self, motions: BatchSimulation, directions: Array, finer: int = 1) -> None:
        self._motions, self._directions, self._finer = motions, directions, finer

    def run(self, point: Candidate, iterations: int, over: Watcher) -> tuple[Candidate, int]:
        """Iterate from a candidate until its residuals are small.

        `over` reports progress and returns whether to stop. There are at most `iterations`. Returns
        the best candidate and the number of iterations.
        """
        stalls = 0
        for k in range(iterations):
            if point.worst < SETTLED or stalls >= 4 or not np.isfinite(point.merit):
                return point, k
            if over(
                f"Gauss-Newton, iteration {k + 1}: residual of the goals {point.worst * self._motions.place:.2g} m"
            ):
                return point, k
            best = self._step(point)
            if not best.merit < point.merit:  # the next step would be the same
                return point, k
            stalls = 0 if best.merit < 0.95 * point.merit else stalls + 1
            point = best
        return point, iterations

    def measure_finer(self, point: Candidate, finer: int) -> float:
        """Compute the largest residual of the end in a simulation with finer steps.

        The candidate `point` is simulated with `finer` times as many steps. The residual of a goal
        or a terminal limit is relative to its tolerance, and inf if the simulation diverges.
        """
        motions = self._motions
        start = motions.problem.initial_state[None]
        gamma, states, _ = motions.roll(
            start, point.force_density[None], point.duration, finer=finer
        )
        over = motions.excess(states, gamma, point.duration, last_only=True)
        over *= motions.scales.length / motions.place  # as for goals
        missed = np.concatenate([motions.misses(states, point.duration), over], axis=1)
        return float(np.abs(missed).max(initial=0.0)) if np.all(np.isfinite(missed)) else np.inf

    def simulate(
        self, force_density: Array, duration: float, law: Feedback | None = None
    ) -> list[Candidate]:
        """Simulate force densities (n, K, α) for a duration [s], and build candidates.

        The feedback `law` adds to them.
        """
        motions = self._motions
        starts = np.tile(motions.problem.initial_state, (len(force_density), 1))
        gamma, states, _ = motions.roll(starts, force_density, duration, 0, self._finer, law)
        rows = self._residuals(states, gamma, duration)
        return [Candidate(duration, *own) for own in zip(gamma, states, rows, strict=True)]

    def _residuals(self, states: Array, gamma: Array, duration: float) -> Array:
        """Compute the residuals (n, m) of goals and limits, in units of their tolerances."""
        motions = self._motions
        over = motions.excess(states, gamma, duration) / MARGIN
        return np.concatenate([motions.misses(states, duration), over], axis=1)

    def _step(self, point: Candidate) -> Candidate:
        """Try steps with several damping parameters and lengths, and return the best.

        Steps begin at the candidate `point`.
        """
        problem, near = self._motions.problem, self._linearize(point)
        if not near.by_control.any():
            return point
        norm = float(np.linalg.norm(near.by_control.reshape(len(near.residuals), -1), 2))
        damping = np.tile(np.geomspace(1e-10, 1e-1, 10) * norm**2, 2)
        share = np.repeat([1.0, 0.3], 10)
        free = problem.shortest < problem.longest
        by_duration = near.by_state[0, :, -1:] if free else np.zeros((len(near.residuals), 0))
        wanted = share[:, None] * near.residuals
        longer = -near.solve(0, wanted, damping, by_duration) @ by_duration
        stretch = 1 + longer.sum(axis=1)
        durations = np.clip(stretch * point.duration, problem.shortest, problem.longest)

        def law(own: Indices) -> Feedback:
            ratio = durations[own] / point.duration - 1

            def feedback(k: int, states: Array) -> Array:
                away = np.column_stack([states - point.states[k], ratio])
                away[~np.isfinite(away).all(axis=1)] = 0.0  # motions that diverge
                missed = wanted[own] + away @ near.by_state[k].T
                y = near.solve(k, missed, damping[own], by_duration[:, :0])
                return -(y @ near.by_control[:, k]) @ self._directions

            return feedback

        tried: list[Candidate] = []
        for duration in np.unique(durations):
            own = np.flatnonzero(durations == duration)
            gamma = np.repeat(point.force_density[None], len(own), axis=0)
            tried += self.simulate(gamma, float(duration), law(own))
        return min(tried, key=lambda one: one.merit)

    def _linearize(self, point: Candidate) -> Linearization:
        """Linearize the residuals that are not 0 about a candidate.

        Derivatives with respect to the states are propagated backward from interval to interval.
        """
        motions, nx = self._motions, point.states.shape[1]
        over_interval = motions.linearize(
            point.states, point.force_density, point.duration, self._directions, self._finer
        )
        used = np.flatnonzero(point.rows)
        at_points, by_control = self._row_slopes(point, used)
        transitions = np.eye(nx + 1)[None].repeat(len(over_interval), 0)
        transitions[:, :nx] = over_interval[..., : nx + 1]
        by_state, later = np.empty((len(transitions), len(used), nx + 1)), at_points[-1]
        for k in range(len(transitions) - 1, -1, -1):
            by_control[:, k] += later[:, :nx] @ over_interval[k][:, nx + 1 :]
            later = at_points[k] + later @ transitions[k]
            by_state[k] = later
        by_control = motions.gather_spans(by_control)
        r = point.rows[used]
        by_control[:, self._find_blocked(point, np.tensordot(r, by_control, 1))] = 0.0
        return Linearization(r, by_state, by_control)

    def _find_blocked(self, point: Candidate, gradient: Array) -> Array:
        """Return whether a limit forbids the change (K, g) against the gradient of the merit."""
        lower, upper = self._motions.problem.force_density_limits
        ahead = self._directions > 0
        up, down = (
            np.where(ahead, side[:, None], 0.0).sum(axis=2)
            for side in (upper - point.force_density, point.force_density - lower)
        )
        return np.asarray(((gradient < 0) & (up <= 0)) | ((gradient > 0) & (down <= 0)))

    def _row_slopes(self, point: Candidate, used: Indices) -> tuple[Array, Array]:
        """Compute the derivatives of residuals with respect to their own instants.

        A residual depends on both ends of its interval, and on the controls there. All even, or all
        odd, instants change at once. Returns the derivatives (K + 1, m, nx + 1) with respect to the
        states and to the relative duration, and (m, K, g) with respect to controls, of the m
        residuals `used`.
        """
        motions, scale = self._motions, PROBE * self._motions.scales.state
        count, nx = len(point.force_density), len(scale)
        rows, place = point.rows[used], motions.row_intervals[used]
        at_points = np.zeros((count + 1, len(used), nx + 1))
        by_control = np.zeros((len(used), count, len(self._directions)))
        for parity in (0, 1):
            at = place + (place + parity) % 2
            states = np.tile(point.states, (nx, 1, 1))
            states[:, parity::2] += np.diag(scale)[:, None]
            gamma = np.tile(point.force_density, (len(self._directions), 1, 1))
            gamma[:, parity::2] += PROBE * self._directions[:, None]
            by_x = self._residuals(
                states, np.tile(point.force_density, (nx, 1, 1)), point.duration
            )[:, used]
            by_u = self._residuals(
                np.tile(point.states, (len(gamma), 1, 1)), gamma, point.duration
            )[:, used]
            at_points[at, np.arange(len(used)), :nx] = (by_x - rows).T / scale
            inside = at < count
            by_control[inside, at[inside]] = ((by_u - rows) / PROBE).T[inside]
        longer = self._residuals(
            point.states[None], point.force_density[None], point.duration * (1 + PROBE)
        )[0, used]
        at_points[place, np.arange(len(used)), nx] = (longer - rows) / PROBE
        return np.nan_to_num(at_points), np.nan_to_num(by_control)
