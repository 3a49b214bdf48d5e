"""Deferred correction of what was found: the rows of the motion are shifted until it moves as fine steps do."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from ocp.condensed.chain import Rows
from ocp.condensed.interior_point import Point, point_at, polish
from ocp.condensed.linear_chain import bar_directions
from ocp.condensed.motions import states_of, without_bars
from ocp.condensed.reduced import ReducedProblem
from ocp.solvers.deferred_correction import FINE_STEPS
from ocp.transcription.multiple_shooting import ramped_step, shooting_step
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.util.validate import Array

MOST_ROUNDS, MOST_LEFT = 20, 0.7  # of corrections, and what each leaves at most of the jumps
MOST_AIMS, HIT = (
    20,
    1e-12,
)  # rounds of the speeds with which fine steps lead from node to node, and of the size: near enough to it


class Corrected(NamedTuple):
    """A point whose motion is that of fine steps, their states (K + 1, nx), None where they diverge, and how far it is from them, m."""

    point: Point
    states: Array | None
    gap: float


def correct(
    of: ReducedProblem,
    point: Point,
    linear: bool,
    accuracy: float,
    met: float,
    deadline: float | None,
) -> Corrected:
    """Return a corrected point: one from whose nodes fine steps lead to the next ones, without a jump of their speeds.

    The rows of the motion are g = τ, τ what they leave where fine steps leave nothing (see
    `ocp.solvers.deferred_correction`). Each interval has fine steps of its own, so errors do not
    grow along the motion while it is corrected; `gap` tells how far those of the whole motion end
    from it. In each round the force densities take the shortest way to goals and motion; as the
    point is an optimum, what that costs more than the best way is of second order.
    """
    fine = _FineSteps(of, linear)
    best, before = Corrected(point, None, np.inf), np.inf
    for _ in range(MOST_ROUNDS + 1):
        states = fine.run(point)
        gap = fine.gap(point, states)
        if gap < best.gap:
            best = Corrected(point, states, gap)
        late = deadline is not None and time.perf_counter() > deadline
        if gap <= accuracy or late:
            break
        jumps = fine.jumps(point)
        size = float(np.abs(jumps).max(initial=0.0))
        if not size < MOST_LEFT * before:
            break
        before = size
        rows = of.chain.rows(of.strings(point.w), of.split(point.w)[1], point.motion)
        of.shift = Rows(rows.impulses - jumps, rows.lengths)
        point = polish(of, point_at(of, point.w, point.motion, point.slack), met)
        if point.worst > met:
            break
    return best


class _FineSteps:
    """Fine steps under the force densities of a point."""

    def __init__(self, of: ReducedProblem, linear: bool) -> None:
        self.of, self.linear = of, linear
        self.step = (ramped_step if linear else shooting_step)(
            of.problem.model, DormandPrince853(), FINE_STEPS
        )
        self.each, self.chain = self.step.map(of.chain.count), self.step.mapaccum(of.chain.count)
        self._sooner: Array | float = (
            # speeds with which they leave nodes for the next ones, less those of the discrete
            # motion
            0.0
        )

    def _held(self, point: Point) -> tuple[Array, ...]:
        gamma, lengths = (
            self.of.force_densities(point.w),
            self.of.split(point.w)[1] * self.of.chain.shares,
        )
        return (
            (gamma[:-1].T, gamma[1:].T, lengths[None]) if self.linear else (gamma.T, lengths[None])
        )

    def run(self, point: Point) -> Array:
        """Return the states (K + 1, nx) from the start on."""
        start = self.of.chain.start
        return np.column_stack([start, np.asarray(self.chain(start, *self._held(point)).full())]).T

    def gap(self, point: Point, states: Array) -> float:
        """Return how far places are from those of states, m, and rates at the taps, m per duration."""
        chain, duration = self.of.chain, self.of.split(point.w)[1]
        places, velocities = chain.unpack(states)
        ends = (
            (places, point.motion.places),
            (duration * velocities[chain.taps], point.motion.rates),
        )
        return max(float(np.abs(one - other).max(initial=0.0)) for one, other in ends)

    def jumps(self, point: Point) -> Array:
        """Return T (v⁺ − v⁻) at the stations (K + X, 3n).

        v⁻: with which fine steps arrive; v⁺: with which they lead to the next node, or Y/T at taps.
        """
        of, chain, motion = self.of, self.of.chain, point.motion
        c, duration = of.split(point.w)
        held, nq, free = self._held(point), of.problem.model.nq, chain.mech.free_index
        leaving, directions = (
            states_of(chain, c, duration, motion)[:-1],
            bar_directions(chain, motion.places[:-1]),
        )
        speeds, least = chain.unpack(leaving)[1].reshape(chain.count, -1, 1), np.inf
        aimed = without_bars(chain, directions, speeds + self._sooner)
        for _ in range(MOST_AIMS):
            leaving[:, nq : 2 * nq] = chain.mech.local(aimed[:, :, 0])[:, free]
            places, arrived = chain.unpack(np.asarray(self.each(leaving.T, *held).full()).T)
            missed = without_bars(
                chain, directions, (motion.places[1:] - places).reshape(chain.count, -1, 1)
            )
            size = float(np.abs(missed).max())
            if not size < 0.5 * least or size < HIT * of.length:
                break
            least, aimed = size, aimed + missed / (duration * chain.shares)[:, None, None]
        self._sooner = aimed - speeds
        arrived = np.concatenate([chain.first_rate[None], arrived])
        after = np.concatenate([duration * aimed.reshape(chain.count, -1, 3), motion.rates])
        return np.asarray((after - duration * arrived[chain.at]).reshape(len(chain.at), -1))
