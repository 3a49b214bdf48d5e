"""One step of the reduced problem: towards the goals, and along them towards less cost, by projected conjugate gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.condensed.chain import Motion
from ocp.condensed.metric import Projector
from ocp.condensed.reduced import Expansion, Leftover
from tenscasadi.util.validate import Array, Indices

LEAST_LEFT = 0.05  # of the projected gradient: conjugate gradients end
MOST_PRODUCTS = 30  # with the second derivatives, in one step
FLAT = 1e-8  # of the metric's: less curvature is none


class Step(NamedTuple):
    """A step d of w: normal, the part that leads to the goals; tangential, the metric's size of the rest.

    slack: the step (p,) of what is limited along the way, that belongs to it; multipliers: those of
    the goals at its end. hit: whether the trust region ends it; bent: whether curvature is negative
    along it.
    """

    d: Array
    slack: Array
    normal: float
    tangential: float
    multipliers: Array
    hit: bool
    bent: bool
    products: int


class Model:
    """The quadratic model of costs and barriers about a point: exact, or, without multipliers, its metric alone.

    stiffness (n,): of the barriers before limits of w; working: the limits along the way that give
    way in the projector.
    """

    def __init__(
        self,
        expansion: Expansion,
        stiffness: Array,
        projector: Projector,
        working: Indices,
        gradient: Array,
        exact: bool,
    ) -> None:
        self.expansion, self.stiffness, self.projector, self.working = (
            expansion,
            stiffness,
            projector,
            working,
        )
        self.gradient, self.exact = gradient, exact

    def step(self, left: Leftover, radius: float) -> Step:
        """Return the step that meets the goals, linearised, and then minimises the model within a radius, in the metric, of that."""
        expansion, projector = self.expansion, self.projector
        drift = expansion.follow(None, left.rows)
        drifted = expansion.path_change(drift, None)[self.working]
        normal = -projector.shortest(
            np.append(left.goals + expansion.change(drift), left.paths[self.working] + drifted)
        )
        if self.exact:
            curved = self._curved(normal, expansion.follow(normal, left.rows))
        else:
            soft = drifted[len(drifted) - len(projector.soft) :]  # rows that are met come first
            curved = projector.times(normal) + projector.soft.T @ (projector.resisting * soft)
        tangential, change, hit, bent, products = self._descend(self.gradient + curved, radius)
        d, curved = normal + tangential, curved + change
        return Step(
            d,
            expansion.path_change(expansion.follow(d, left.rows), d) + left.paths,
            projector.norm(normal),
            projector.norm(tangential),
            projector.multipliers(self.gradient + curved),
            hit,
            bent,
            products,
        )

    def _times(self, step: Array) -> Array:
        """Return the second derivatives along a step of w that the motion follows."""
        return (
            self._curved(step, self.expansion.follow(step, None))
            if self.exact
            else self.projector.times(step)
        )

    def _curved(self, step: Array, moved: Motion) -> Array:
        return self.expansion.curvature(step, moved) + self.stiffness * step

    def _descend(self, force: Array, radius: float) -> tuple[Array, Array, bool, bool, int]:
        """Conjugate gradients that J does not see, preconditioned by the metric (Steihaug's), with the change of the gradient."""
        metric, project = self.projector, self.projector.project
        total, change = np.zeros_like(force), np.zeros_like(force)
        r = force
        g = project(r)
        p, left = -g, r @ g
        first = left
        for count in range(1, MOST_PRODUCTS + 1):
            if not left > LEAST_LEFT**2 * first or not first > 0:
                return total, change, False, False, count - 1
            Hp, Dp = self._times(p), metric.times(p)
            bend, size, along = p @ Hp, p @ Dp, total @ Dp
            room = radius**2 - total @ metric.times(total)
            farthest = (-along + np.sqrt(np.maximum(along**2 + size * room, 0.0))) / size
            bent = bool(bend <= FLAT * size)
            if bent or left / bend > farthest:
                return total + farthest * p, change + farthest * Hp, True, bent, count
            share = left / bend
            total, change, r = total + share * p, change + share * Hp, r + share * Hp
            g = project(r)
            before, left = left, r @ g
            p = -g + left / before * p
        return total, change, False, False, MOST_PRODUCTS
