"""Feedback law of elastic, damped strings, which stabilizes simulations."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.problem.instant import symbolic
from ocp.problem.problem import Problem
from ocp.sampling.defaults import count_strings_per_node


def elastic_law(problem: Problem, strength: float, mass: float, interval: float) -> ca.Function:
    """Build the feedback law of elastic strings for sampling.

    The Function is x → k (1 − ℓ/s) + c ṡ/s (α,) [N/m]. The strings have lengths s, and ℓ at the
    start. Stiffness k and damping c are as large as stability allows if the feedback is constant
    over an interval.

    Parameters
    ----------
    strength : float
        Typical force density [N/m].
    mass : float
        Effective mass of a node [kg].
    interval : float
        Length of an interval [s].
    """
    ends = count_strings_per_node(problem)
    # k of 1.5 γ keeps shapes that constant force densities let collapse; the other factors are
    # shares of the stability limits of n strings on a node that is held for an interval
    k = min(1.5 * strength, 0.7 * mass / (ends * interval**2))
    c = min(mass / (ends * interval), 1.6 * float(np.sqrt(k * mass / ends)))
    now = symbolic(problem.model)
    first = ca.Function("lengths", list(now.symbols), [now.lengths])(problem.initial_state, 0, 0)
    return ca.Function(
        "law",
        [now.state],
        [ca.densify(k * (1 - first / now.lengths) + c * now.rates / now.lengths)],
    )
