"""Public names of earlier versions."""

from __future__ import annotations

from tenscasadi.util.renamed import find_attribute

__getattr__ = find_attribute(
    "ocp",
    {},
    {
        "UnreachableGoal": "InfeasibleGoalError",
        "Fatrop": "Ipopt",
        "Arrays": "TrajectoryGuess",
        "Equilibrium": "EquilibriumGuess",
        "CentreOfMass": "CenterOfMass",
        "Collocation": "DirectCollocation",
        "replay_wound": "replay_rest_lengths",
        "reachable": "is_realizable",
        "load_arguments": "load_solve_arguments",
    },
)
