"""Sizes that make the numbers of a problem of order one: of lengths, times, states, and of the objective."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.problem.control import controls_rest_lengths
from ocp.problem.costs import cost_terms
from ocp.problem.instant import symbolic
from ocp.problem.problem import Problem
from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes that make a problem's numbers of order one: length m, time s, mass kg, and one number for each entry of the state."""

    length: float
    time: float
    mass: float
    state: Array

    @staticmethod
    def of(problem: Problem) -> Scales:
        """Return the sizes from the structure's extent and mass, and the longest duration, or twice a typical one."""
        model = problem.model
        length = float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0))) or 1.0
        time = min(problem.longest, 2 * problem.typical_duration)
        parts = [
            np.full(model.nq, length),
            np.full(model.nq, length / time),
            np.full(model.nx - 2 * model.nq, time),
        ]
        return Scales(length, time, float(model.mechanism.M.sum()), np.concatenate(parts))

    @property
    def units(self) -> dict[str, float]:
        """The size that a number of order one stands for in each unit of length and time: m, m/s, m²/s, s."""
        speed = self.length / self.time
        return {"m": self.length, "m/s": speed, "m²/s": self.length * speed, "s": self.time}


def control_scale(problem: Problem, strength: float) -> Array:
    """Return the size (α,) of changes of what is decided: a typical γ, N/m; or the rest lengths, m, that elastic strings give it by."""
    structure = problem.model.scene.structure
    if not controls_rest_lengths(problem.model):
        return np.full(len(structure.strings), strength)
    return np.asarray(structure.string_lengths * np.minimum(strength / structure.stiffness, 1.0))


def typical_cost(
    problem: Problem, strength: float, states: Array, force_density: Array, duration: float
) -> float:
    """Return the costs of states (K + 1, nx) and controls (K, α) that swing once about `strength`, N/m: what makes the objective of order one.

    Were they to alternate from interval to interval, costs of their rates would grow with the
    square of the intervals, and the objective become small beside the solver's tolerance.
    """
    count = len(force_density)
    string, interval = np.indices(force_density.T.shape)
    pattern = strength * (
        1 + np.sqrt(0.5) * (-1.0) ** string * np.sin(2 * np.pi * (interval + 0.5) / count)
    )
    decided = force_density.T if controls_rest_lengths(problem.model) else pattern
    step, time = duration / count, np.linspace(0.0, duration, count + 1)
    now, terms = symbolic(problem.model), cost_terms(problem.costs)
    changed = np.diag(control_scale(problem, strength) / strength) @ pattern
    total = sum(
        float(ca.DM(expression(ca.DM(held), step)))
        for expressions, held in ((terms.control, pattern), (terms.changes, changed))
        for expression in expressions
    )
    for expression in terms.running:
        rate = ca.Function("rate", now.symbols, [expression(now)]).map(count)
        total += step * float(ca.sum2(rate(states.T[:, 1:], decided, time[None, 1:])))
    for share, expression in terms.instants:
        k = round(share * count)
        value = ca.Function("value", now.symbols, [expression(now)])
        total += float(value(states[k], decided[:, max(k - 1, 0)], share * duration))
    return abs(total) if np.isfinite(total) and total else 1.0
