"""Gauss-Newton on force densities: the last misses of a motion, by finite differences of many motions at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.sampling.motions import Motions, Watcher
from tenscasadi.util.validate import Array

MOST_UNKNOWNS = 500
PROBE = 1e-4  # of the directions: changes of finite differences
DAMPINGS = np.geomspace(
    1e-8, 1e1, 10
)  # of the largest singular value squared: all are tried at once
SETTLED = 0.02  # of the tolerance: misses that are smaller are none
STALLED, PATIENCE = 0.95, 4  # of the sum of squares before: what falls less so many times has ended
OVERSTEPPED = 1e-3  # of their scale: limits overstepped by more are broken


@dataclass(frozen=True, eq=False)
class Point:
    """γ that is wanted (K, α), a duration, s, what comes of them: γ (K, α), states (K + 1, nx), and rows that are to vanish, in tolerances."""

    wanted: Array
    duration: float
    force_density: Array
    states: Array
    rows: Array

    @property
    def worst(self) -> float:
        """The largest miss."""
        return (
            float(np.abs(self.rows).max(initial=0.0)) if np.all(np.isfinite(self.rows)) else np.inf
        )

    @property
    def merit(self) -> float:
        """The sum of squares."""
        return float(self.rows @ self.rows) if np.all(np.isfinite(self.rows)) else np.inf


class Descent:
    """Gauss-Newton on motions, in `finer` times as many steps. directions (g, α): γ of a group, changed by its scale."""

    def __init__(self, motions: Motions, directions: Array, finer: int = 1) -> None:
        self._motions, self._directions, self._finer, self._speed = motions, directions, finer, 1.0
        count = len(motions.fractions)
        knots = int(np.clip(MOST_UNKNOWNS // len(directions), min(count, 8), count))
        place = np.linspace(0.0, knots - 1.0, count)[:, None]
        basis = np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))  # linear between knots
        self._changes = np.einsum("ik,jl->kjil", basis, directions).reshape(
            knots * len(directions), count, -1
        )

    def run(
        self, wanted: Array, duration: float, speed: float, iterations: int, over: Watcher
    ) -> tuple[Point, int]:
        """Return the best point, and the iterations it took. speed: times their tolerance by which speeds may be off."""
        self._speed = speed
        point, stalls = self._points(wanted[None], [duration])[0], 0
        for k in range(iterations):
            if point.worst < SETTLED or stalls >= PATIENCE or not np.isfinite(point.merit):
                return point, k
            if over(
                f"Gauss-Newton, iteration {k + 1}: misses its goals by {point.worst * self._motions.place:.2g} m"
            ):
                return point, k
            best = self._step(point)
            stalls = 0 if best.merit < STALLED * point.merit else stalls + 1
            point = min(point, best, key=lambda one: one.merit)
        return point, iterations

    def again(self, point: Point, finer: int) -> float:
        """Return the largest miss of the same force densities in other steps."""
        motions = self._motions
        law, motions.law = motions.law, None
        states = motions.roll(
            motions.problem.first_state[None],
            point.force_density[None],
            point.duration,
            finer=finer,
        )[1]
        motions.law = law
        missed = motions.misses(states, point.duration)
        return float(np.abs(missed).max(initial=0.0)) if np.all(np.isfinite(missed)) else np.inf

    def _points(self, wanted: Array, durations: list[float]) -> list[Point]:
        """Return what comes of each γ that is wanted (n, K, α), all for one duration or each for its own."""
        if len(set(durations)) > 1:
            return [
                self._points(one[None], [duration])[0]
                for one, duration in zip(wanted, durations, strict=True)
            ]
        duration, motions = durations[0], self._motions
        gamma, states, _ = motions.roll(
            np.tile(motions.problem.first_state, (len(wanted), 1)),
            wanted,
            duration,
            finer=self._finer,
        )
        rows = np.concatenate(
            [
                motions.misses(states, duration, speed=self._speed),
                motions.excess(states, gamma, duration) / OVERSTEPPED,
            ],
            axis=1,
        )
        return [
            Point(*given)
            for given in zip(wanted, [duration] * len(wanted), gamma, states, rows, strict=True)
        ]

    def _step(self, point: Point) -> Point:
        """Return the best of the points that Gauss-Newton leads to."""
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
            _bounded_step(J, r, damping * float(np.linalg.norm(J, 2)) ** 2, room)
            for damping in DAMPINGS
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
    def _slopes(point: Point, moved: list[Point], by: Array) -> Array:
        """Return the derivatives of the rows (m, n); none where a motion diverges."""
        slopes = (np.array([one.rows for one in moved]) - point.rows).T / by
        return np.where(np.isfinite(slopes).all(axis=0), slopes, 0.0)


def _bounded_step(J: Array, r: Array, damping: float, room: list[Array]) -> Array:
    """Return the least d of |r + J d|² + damping |d|² that pushes nothing beyond a limit that it has reached; room: up and down."""
    held, count = np.zeros(J.shape[1], dtype=bool), len(room[0])
    while True:
        A = np.where(held, 0.0, J)
        d = -A.T @ np.linalg.solve(A @ A.T + damping * np.eye(len(r)), r)
        pushed = np.zeros_like(held)
        pushed[:count] = ((d[:count] > 0) & (room[0] <= 0)) | ((d[:count] < 0) & (room[1] <= 0))
        if not (pushed & ~held).any():
            return np.asarray(d)
        held |= pushed
