"""Step of the condensed Newton method by conjugate gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.solvers.condensed_newton.condensed_program import Expansion, Residual
from ocp.solvers.condensed_newton.metric import Projector
from tenscasadi.util.validate import Array, Indices


class TrialStep(NamedTuple):
    """Step of the condensed Newton method.

    Attributes
    ----------
    d : ndarray, shape (n,)
        Step of the independent variables u.
    slack : ndarray, shape (p,)
        Step of the slacks with it.
    normal, tangential : float
        Norms, in the metric, of the part that reduces violations and of the part along the constraints.
    duals : ndarray, shape (m,)
        Duals of the goals at its end.
    at_boundary, negative_curvature : bool
        Whether the conjugate gradients ended at the trust region, or by negative curvature.
    products : int
        Number of products with second derivatives.
    """

    d: Array
    slack: Array
    normal: float
    tangential: float
    duals: Array
    at_boundary: bool
    negative_curvature: bool
    products: int


class QuadraticModel:
    """Quadratic model of cost and barriers about an iterate.

    It is a function of the step of u.

    Parameters
    ----------
    stiffness : ndarray, shape (n,)
        Second derivatives of the barriers of the bounds on u.
    gradient : ndarray, shape (n,)
        Gradient of the cost with barrier terms.
    working : ndarray of int
        Path constraints that are soft constraints of the projector.
    exact : bool
        Whether second derivatives are exact, or replaced by the metric.
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
        self.expansion, self.stiffness, self.projector = expansion, stiffness, projector
        self.working, self.gradient, self.exact = working, gradient, exact

    def step(self, left: Residual, radius: float) -> TrialStep:
        """Compute a step by normal and tangential steps.

        The normal step removes the violations `left` of the linearized goals. The tangential step
        minimizes the model within a trust region of the given radius.
        """
        expansion, projector = self.expansion, self.projector
        drift = expansion.follow(None, left.defects)
        drifted = expansion.path_change(drift)[self.working]
        normal = -projector.shortest(
            np.append(left.goals + expansion.change(drift), left.paths[self.working] + drifted)
        )
        if self.exact:
            moved = expansion.follow(normal, left.defects)
            curved = expansion.curvature(moved) + self.stiffness * normal
        else:
            curved = projector.times(normal) + projector.soft.T @ (projector.resisting * drifted)
        found = self._descend(self.gradient + curved, radius)
        tangential, change, at_boundary, negative_curvature, products = found
        d, curved = normal + tangential, curved + change
        return TrialStep(
            d,
            expansion.path_change(expansion.follow(d, left.defects)) + left.paths,
            projector.norm(normal),
            projector.norm(tangential),
            projector.duals(self.gradient + curved),
            at_boundary,
            negative_curvature,
            products,
        )

    def _times(self, step: Array) -> Array:
        """Multiply the model's Hessian by a step of u."""
        if not self.exact:
            return self.projector.times(step)
        curved = self.expansion.curvature(self.expansion.follow(step, None))
        return curved + self.stiffness * step

    def _descend(self, force: Array, radius: float) -> tuple[Array, Array, bool, bool, int]:
        """Minimize by Steihaug's conjugate gradients along the constraints.

        `force` (n,) is the gradient, `radius` the trust region. Returns the step, the change of the
        gradient, whether it ended at the trust region or by negative curvature, and the number of
        products with the Hessian.
        """
        most = 30  # products with the second derivatives
        metric, project = self.projector, self.projector.project
        total, change = np.zeros_like(force), np.zeros_like(force)
        r = force
        g = project(r)
        p, left = -g, r @ g
        first = left
        for count in range(1, most + 1):
            if not left > 0.05**2 * first or not first > 0:  # of the projected gradient
                return total, change, False, False, count - 1
            Hp, Dp = self._times(p), metric.times(p)
            bend, size, along = p @ Hp, p @ Dp, total @ Dp
            room = radius**2 - total @ metric.times(total)
            farthest = (-along + np.sqrt(np.maximum(along**2 + size * room, 0.0))) / size
            negative = bool(bend <= 1e-8 * size)  # less curvature than rounding
            if negative or left / bend > farthest:
                return total + farthest * p, change + farthest * Hp, True, negative, count
            share = left / bend
            total, change, r = total + share * p, change + share * Hp, r + share * Hp
            g = project(r)
            before, left = left, r @ g
            p = -g + left / before * p
        return total, change, False, False, most
