"""Controllers at work: a prism that grows, an arm on a ball joint, and disturbances."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from planning import driven, prism

import ocp
import tenscasadi as tc

MODEL = driven(prism(1.0))
TALL = prism(1.15)
ARM = tc.Structure(
    [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)],
    bars=[(0, 1)],
    strings=[(1, 2), (1, 3), (1, 4), (1, 5)],
    pinned=[0, 2, 3, 4, 5],
)


def problem(*bounds):
    goals = [ocp.Shape(TALL.nodes), ocp.AtRest()]
    return ocp.Problem(
        MODEL,
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 100.0), *bounds],
        costs=[ocp.Effort()],
    )


def misfit(trajectory):
    """Compute the largest error of node distances at the end of a trajectory."""
    pairs = list(combinations(range(6), 2))
    return max(
        abs(
            np.linalg.norm(trajectory.nodes[-1, a] - trajectory.nodes[-1, b])
            - np.linalg.norm(TALL.nodes[a] - TALL.nodes[b])
        )
        for a, b in pairs
    )


def gust():
    """Build a heavier prism with opposite forces on two nodes."""
    wind = np.zeros((6, 3))
    wind[4, 0], wind[0, 0] = 0.3, -0.3
    return driven(prism(1.0, bar_mass=1.1), forces=tc.NodalForce(wind))
