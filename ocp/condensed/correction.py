"""Deferred correction of what was found: the rows of the motion are shifted until it moves as fine steps do."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from ocp.condensed.chain import Motion
from ocp.condensed.interior_point import Point, point_at, polish
from ocp.condensed.motions import states_of
from ocp.condensed.reduced import ReducedProblem
from ocp.solvers.deferred_correction import FAR, FINE_STEPS, MOST_LEFT, MOST_ROUNDS, keep_to
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
    step = (ramped_step if linear else shooting_step)(model, DormandPrince853(), FINE_STEPS)
    steps = step.mapaccum(chain.count)
    far, kept = FAR * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0))), False
    offset: Array | float = 0.0  # of fine states from those that follow from places
    best, before = Corrected(point, None, np.inf), np.inf
    for _ in range(MOST_ROUNDS + 1):
        gamma, (c, duration) = of.force_densities(point.w), of.split(point.w)
        lengths = duration * chain.shares
        held = (gamma[:-1].T, gamma[1:].T) if linear else (gamma.T,)
        fine = np.column_stack([chain.start, np.asarray(steps(chain.start, *held, lengths[None]).full())]).T
        motion = _moving(of, point, fine, duration)
        alone = gap = _apart(motion, point.motion)
        kept = kept or (not gap < min(MOST_LEFT * before, far) and not linear and len(c) == chain.count)
        if kept and not alone <= accuracy:
            steady = keep_to(step, model, states_along(of, c, duration, point.motion) + offset, gamma, lengths, of.together)
            if steady is not None:
                fine, change = steady
                c, motion = c + change, _moving(of, point, fine, duration)
                gap, offset = _apart(motion, point.motion), fine - states_along(of, c, duration, motion)
        if gap < best.gap or alone <= accuracy:
            best = Corrected(point, fine, gap)
        late = deadline is not None and time.perf_counter() > deadline
        if alone <= accuracy or late or not gap < MOST_LEFT * before:
            break
        before = gap
        of.shift = chain.rows(duration**2 * chain.controls.at_stations(c), duration, motion)
        point = polish(of, point_at(of, point.w, motion), met)
        if point.worst > met:
            break
    return best


def _moving(of: ReducedProblem, point: Point, states: Array, duration: float) -> Motion:
    """Return the motion through states (K + 1, nx), with the bars of a point."""
    places, velocities = of.chain.unpack(states)
    return Motion(places, duration * velocities[of.chain.taps], point.motion.bars)


def _apart(one: Motion, other: Motion) -> float:
    """Return how far places are apart, m, and rates at the taps, m per duration."""
    return max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(one[:2], other[:2], strict=True))


def states_along(of: ReducedProblem, c: Array, duration: float, motion: Motion) -> Array:
    """Return the states (K + 1, nx) of a motion under force densities c (Kc, m)."""
    chain, model = of.chain, of.problem.model
    clock = (chain.clock + duration * chain.time[:, None])[:, : model.nx - 2 * model.nq]
    return states_of(chain, duration**2 * chain.controls.before_nodes(c), duration, motion, clock)
