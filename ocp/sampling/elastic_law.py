"""Force densities that answer as elastic, damped strings do: motions under them are stable, and what they were is a plan."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.problem.instant import symbolic
from ocp.problem.problem import Problem

STIFFNESS = (
    1.5  # of a typical γ; that keeps shapes which constant force densities would let collapse
)
MOST_STIFFNESS, MOST_DAMPING, CRITICAL = (
    0.7,
    1.0,
    1.6,
)  # of m/(n h²), of m/(n h), of √(k m/n): for n strings on a node of mass m, each h seconds


def elastic_law(problem: Problem, strength: float, mass: float, interval: float) -> ca.Function:
    """Return the Function x → k (1 − ℓ/s) + c ṡ/s (α,), N/m, for strings of length s, ℓ at the start, as is stable where it is held for an interval.

    strength: a typical γ, N/m. mass: kg, that an end of a bar moves with. interval: s.
    """
    structure = problem.model.scene.structure
    ends = max(1.0, 2 * len(structure.strings) / len(structure.nodes))
    k = min(STIFFNESS * strength, MOST_STIFFNESS * mass / (ends * interval**2))
    c = min(MOST_DAMPING * mass / (ends * interval), CRITICAL * float(np.sqrt(k * mass / ends)))
    now = symbolic(problem.model)
    first = ca.Function("lengths", list(now.symbols), [now.lengths])(problem.first_state, 0, 0)
    return ca.Function(
        "law",
        [now.state],
        [ca.densify(k * (1 - first / now.lengths) + c * now.rates / now.lengths)],
    )
