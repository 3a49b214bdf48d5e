"""Deferred correction of what was found: the rows of the motion are shifted until it moves as fine steps do."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from ocp.condensed.chain import Motion
from ocp.condensed.interior_point import Point, point_at, polish
from ocp.condensed.reduced import ReducedProblem
from ocp.solvers.deferred_correction import FINE_STEPS, MOST_LEFT, MOST_ROUNDS
from ocp.transcription.multiple_shooting import ramped_step, shooting_step
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.util.validate import Array


class Corrected(NamedTuple):
    """A point whose motion is that of fine steps, their states (K + 1, nx), None where they diverge, and how far it is from them, m."""

    point: Point
    states: Array | None
    gap: float


def correct(of: ReducedProblem, point: Point, linear: bool, accuracy: float, met: float, deadline: float | None) -> Corrected:
    """Return a corrected point: rows are imposed as g = τ, τ what they leave at the states of fine steps (see `ocp.solvers.deferred_correction`).

    In each round the force densities take the shortest way to goals and motion; as the point is an optimum, what that costs more than the
    best way is of second order.
    """
    chain, model = of.chain, of.problem.model
    step = (ramped_step if linear else shooting_step)(model, DormandPrince853(), FINE_STEPS).mapaccum(chain.count)
    best, before = Corrected(point, None, np.inf), np.inf
    for _ in range(MOST_ROUNDS + 1):
        gamma, duration = of.force_densities(point.w), of.split(point.w)[1]
        held = (gamma[:-1].T, gamma[1:].T) if linear else (gamma.T,)
        fine = np.column_stack([chain.start, np.asarray(step(chain.start, *held, duration * chain.shares[None]).full())]).T
        places, velocities = chain.unpack(fine)
        motion = Motion(places, duration * velocities[chain.taps], point.motion.bars)
        gap = max(float(np.abs(one - other).max(initial=0.0)) for one, other in zip(motion[:2], point.motion[:2], strict=True))
        if gap < best.gap:
            best = Corrected(point, fine, gap)
        late = deadline is not None and time.perf_counter() > deadline
        if gap <= accuracy or late or not gap < MOST_LEFT * before:
            break
        before = gap
        of.shift = chain.rows(of.strings(point.w), duration, motion)
        point = polish(of, point_at(of, point.w, motion), met)
        if point.worst > met:
            break
    return best
