"""Costs of the force densities and of the duration: quadratic, and coupled from one interval to the next at most."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ocp.problem.costs import Cost, Duration, Effort, Prestress, Smoothness
from ocp.problem.problem import Problem
from ocp.transcription.mesh import Profile, group_matrix, spans
from tenscasadi.util.validate import Array, Indices, per_item

TAKEN = (Effort, Prestress, Smoothness, Duration)


def foreign_costs(costs: Iterable[Cost]) -> list[str]:
    """Return the names of costs that are not quadratic in the force densities."""
    return [type(cost).__name__ for cost in costs if type(cost) not in TAKEN]


class Objective:
    """J(c, T) = T (½ cᵀH c − gᵀc + constant) + ½ cᵀR c / T + weight T, with H and R tridiagonal over time for each group.

    Diagonals (Kc, m), and what couples neighbours (Kc − 1, m).
    """

    def __init__(self, problem: Problem, fractions: Array, profile: Profile) -> None:
        self.given = bool(problem.costs)
        together = group_matrix(profile, problem.model.nu)
        span = spans(profile, fractions) if not profile.linear else np.arange(len(fractions))
        shares = np.bincount(span, weights=fractions)[:, None]
        count, m = len(shares) + profile.linear, together.shape[1]
        self.held, self.held_next = np.zeros((count, m)), np.zeros((max(count - 1, 0), m))
        self.varied, self.varied_next = np.zeros((count, m)), np.zeros((max(count - 1, 0), m))
        self.slope, self.constant, self.weight = np.zeros((count, m)), 0.0, 0.0
        members = together.sum(axis=0)
        spread = np.zeros((count, 1))  # ∫ of what each value counts for
        spread[: len(shares)] += shares / 2 if profile.linear else shares
        if profile.linear:
            spread[1:] += shares / 2
        for cost in problem.costs:
            if isinstance(cost, (Effort, Prestress)):
                level = (
                    per_item("Prestress.level", cost.level, problem.model.nu)
                    if isinstance(cost, Prestress)
                    else np.zeros(problem.model.nu)
                )
                self.slope += 2 * cost.weight * spread * (level @ together)
                self.constant += cost.weight * float(level @ level)
                if profile.linear:  # ∫ of a square is h (a² + a b + b²)/3
                    self.held[:-1] += 2 / 3 * cost.weight * shares * members
                    self.held[1:] += 2 / 3 * cost.weight * shares * members
                    self.held_next += cost.weight / 3 * shares * members
                else:
                    self.held += 2 * cost.weight * shares * members
            elif isinstance(cost, Smoothness) and count > 1:
                spacing = shares if profile.linear else _spacing(fractions, span)[:, None]
                change = 2 * cost.weight / spacing * members
                self.varied[:-1] += change
                self.varied[1:] += change
                self.varied_next -= change
            elif isinstance(cost, Duration):
                self.weight += cost.weight
        self.coupled = bool(self.held_next.any() or self.varied_next.any())

    def value(self, c: Array, duration: float) -> float:
        """Return J."""
        by_time, by_rate = self.parts(c)
        return duration * by_time + by_rate / duration + self.weight * duration

    def gradient(self, c: Array, duration: float) -> tuple[Array, float]:
        """Return the derivatives of J by c (Kc, m) and by T."""
        by_time, by_rate = self.parts(c)
        H, R = (_times(*matrix, c) for matrix in self._matrices)
        return duration * (
            H - self.slope
        ) + R / duration, by_time - by_rate / duration**2 + self.weight

    def curvature(
        self, c: Array, duration: float, step: Array, longer: float
    ) -> tuple[Array, float]:
        """Return how the gradient changes along a step."""
        H, R = (_times(*matrix, step) for matrix in self._matrices)
        own, varied = (_times(*matrix, c) for matrix in self._matrices)
        by_c = duration * H + R / duration + longer * (own - self.slope - varied / duration**2)
        by_T = (
            float(((own - self.slope - varied / duration**2) * step).sum())
            + 2 * longer * self.parts(c)[1] / duration**3
        )
        return by_c, by_T

    def metric(self, duration: float) -> tuple[Array, Array]:
        """Return the diagonal (Kc, m) and the coupling (Kc − 1, m) of the second derivatives by c."""
        return (
            duration * self.held + self.varied / duration,
            duration * self.held_next + self.varied_next / duration,
        )

    @property
    def _matrices(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        return (self.held, self.held_next), (self.varied, self.varied_next)

    def parts(self, c: Array) -> tuple[float, float]:
        """Return what is multiplied by the duration, and what is divided by it."""
        H, R = (float((c * _times(*matrix, c)).sum()) / 2 for matrix in self._matrices)
        return H - float((self.slope * c).sum()) + self.constant, R


def _spacing(fractions: Array, span: Indices) -> Array:
    """Return the shares of the duration between the middles of the intervals at which force densities change."""
    last = np.flatnonzero(np.diff(span))
    return np.asarray((fractions[last] + fractions[last + 1]) / 2)


def _times(diagonal: Array, coupling: Array, c: Array) -> Array:
    result = diagonal * c
    result[1:] += coupling * c[:-1]
    result[:-1] += coupling * c[1:]
    return result
