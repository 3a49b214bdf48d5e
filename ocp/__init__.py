"""Plans of force densities for tensegrity structures: problem → transcription → solver → plan, replayed by tenscasadi."""

from __future__ import annotations

from ocp.bounds import ForceDensityLimits, TensionLimits
from ocp.costs import Effort, Smoothness
from ocp.goals import AtRest, NodePositions, StringLengths
from ocp.plan import Plan
from ocp.problem import Problem
from ocp.solve import solve
from ocp.solver import Ipopt
from ocp.target import UnreachableGoal
from ocp.transcription import MultipleShooting

__all__ = [
    # what is asked
    "Problem",
    "StringLengths",
    "NodePositions",
    "AtRest",
    "ForceDensityLimits",
    "TensionLimits",
    "Effort",
    "Smoothness",
    # how it is solved
    "MultipleShooting",
    "Ipopt",
    "solve",
    # what comes of it
    "Plan",
    "UnreachableGoal",
]
