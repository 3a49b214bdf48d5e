"""Gauss-Newton method with finite differences of simulations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.sampling.batch_simulation import BatchSimulation, Watcher
from tenscasadi.util.validate import Array

PROBE = 1e-4  # change of finite differences, in units of the directions
SETTLED = 0.3  # residual in units of the tolerance below which the method ends


@dataclass(frozen=True, eq=False)
class Candidate:
    """Controls of a candidate plan with their simulation.

    Attributes
    ----------
    wanted : ndarray, shape (K, α)
        Force densities without the feedback law of elastic strings [N/m].
    duration : float
        Duration [s].
    force_density : ndarray, shape (K, α)
        Applied force densities [N/m].
    states : ndarray, shape (K + 1, nx)
        States [m, m/s].
    rows : ndarray, shape (m,)
        Residuals of goals and limits, in units of their tolerances.
    """

    wanted: Array
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


class Descent:
    """Gauss-Newton method with finite-difference Jacobians of goals and limits.

    A batch of simulations (`motions`) yields each Jacobian. The unknowns are factors of the changes
    `directions` (g, α) of the force densities [N/m]. They are linear in time between at most 500 /
    g knots. `finer` multiplies the number of time steps.
    """

    def __init__(self, motions: BatchSimulation, directions: Array, finer: int = 1) -> None:
        self._motions, self._directions, self._finer, self._speed = motions, directions, finer, 1.0
        count = len(motions.fractions)
        knots = int(np.clip(500 // len(directions), min(count, 8), count))
        place = np.linspace(0.0, knots - 1.0, count)[:, None]
        basis = np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))  # linear between knots
        self._changes = np.einsum("ik,jl->kjil", basis, directions).reshape(
            knots * len(directions), count, -1
        )

    def run(
        self, wanted: Array, duration: float, speed: float, iterations: int, over: Watcher
    ) -> tuple[Candidate, int]:
        """Iterate until residuals are small.

        `wanted` (K, α) are the initial force densities. `over` reports progress and returns whether
        to stop. `speed` multiplies the tolerance of velocities. There are at most `iterations`.
        `duration` is in seconds. Returns the best candidate and the number of iterations.
        """
        self._speed = speed
        point, stalls = self._points(wanted[None], [duration])[0], 0
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
        """Compute the largest residual in a simulation with finer steps.

        The candidate `point` is simulated with `finer` times as many steps. The residual is
        relative to its tolerance, and inf if the simulation diverges.
        """
        motions = self._motions
        law, motions.law = motions.law, None
        states = motions.roll(
            motions.problem.initial_state[None],
            point.force_density[None],
            point.duration,
            finer=finer,
        )[1]
        motions.law = law
        missed = motions.misses(states, point.duration)
        return float(np.abs(missed).max(initial=0.0)) if np.all(np.isfinite(missed)) else np.inf

    def _points(self, wanted: Array, durations: list[float]) -> list[Candidate]:
        """Simulate force densities (n, K, α) and build candidates.

        `wanted` are the force densities, `durations` the n durations [s].
        """
        if len(set(durations)) > 1:
            return [
                self._points(one[None], [duration])[0]
                for one, duration in zip(wanted, durations, strict=True)
            ]
        duration, motions = durations[0], self._motions
        gamma, states, _ = motions.roll(
            np.tile(motions.problem.initial_state, (len(wanted), 1)),
            wanted,
            duration,
            finer=self._finer,
        )
        rows = np.concatenate(
            [
                motions.misses(states, duration, speed=self._speed),
                1e3 * motions.excess(states, gamma, duration),
            ],
            axis=1,
        )
        return [
            Candidate(*given)
            for given in zip(wanted, [duration] * len(wanted), gamma, states, rows, strict=True)
        ]

    def _step(self, point: Candidate) -> Candidate:
        """Try steps with ten damping parameters, and return the best.

        Steps begin at the candidate `point`.
        """
        problem, changes = self._motions.problem, self._changes
        lower, upper = problem.force_density_limits
        room = [
            np.where(changes > 0, side, 0.0).sum(axis=(1, 2))
            for side in (upper - point.wanted, point.wanted - lower)
        ]
        sign = np.where(room[0] >= room[1], 1.0, -1.0)
        probes = np.clip(point.wanted + PROBE * sign[:, None, None] * changes, lower, upper)
        J = self._slopes(point, self._points(probes, [point.duration] * len(probes)), PROBE * sign)
        free = problem.shortest < problem.longest
        if free:
            side = -PROBE if point.duration * (1 + PROBE) > problem.longest else PROBE
            J = np.column_stack(
                [
                    J,
                    self._slopes(
                        point,
                        self._points(point.wanted[None], [point.duration * (1 + side)]),
                        np.array([side]),
                    ),
                ]
            )
        used = np.flatnonzero(J.any(axis=1) & (point.rows != 0))
        J, r = J[used], point.rows[used]
        if not J.size:
            return point
        steps = [
            _find_bounded_step(J, r, damping * float(np.linalg.norm(J, 2)) ** 2, room)
            for damping in np.geomspace(1e-8, 1e1, 10)
        ]
        tried = np.clip(
            [point.wanted + np.tensordot(step[: len(changes)], changes, 1) for step in steps],
            lower,
            upper,
        )
        stretched = [point.duration * (1 + step[-1]) if free else point.duration for step in steps]
        spans = np.clip(np.array(stretched), problem.shortest, problem.longest).tolist()
        return min(self._points(tried, spans), key=lambda one: one.merit)

    @staticmethod
    def _slopes(point: Candidate, moved: list[Candidate], by: Array) -> Array:
        """Compute the Jacobian (m, n) of the residuals by finite differences.

        It is that with respect to the unknowns. Candidate k of `moved` differs from `point` by the
        change by[k] of unknown k. Columns are 0 if a simulation diverges.
        """
        slopes = (np.array([one.rows for one in moved]) - point.rows).T / by
        return np.where(np.isfinite(slopes).all(axis=0), slopes, 0.0)


def _find_bounded_step(J: Array, r: Array, damping: float, room: list[Array]) -> Array:
    """Minimize |r + J d|² + damping |d|² within limits of d.

    r (m,) are residuals and J (m, n) is their Jacobian. `room` are the distances from the upper and
    the lower limits. Returns d (n,).
    """
    held, count = np.zeros(J.shape[1], dtype=bool), len(room[0])
    while True:
        A = np.where(held, 0.0, J)
        d = -A.T @ np.linalg.solve(A @ A.T + damping * np.eye(len(r)), r)
        pushed = np.zeros_like(held)
        pushed[:count] = ((d[:count] > 0) & (room[0] <= 0)) | ((d[:count] < 0) & (room[1] <= 0))
        if not (pushed & ~held).any():
            return np.asarray(d)
        held |= pushed
