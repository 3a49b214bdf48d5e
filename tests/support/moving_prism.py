"""A prism on three pins, and the same without pins, whose momentum and orientation are goals."""

from __future__ import annotations

import ocp
import tenscasadi as tc

PRISM = tc.shapes.prism()
FREE = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
PINNED = tc.Model(tc.Scene(PRISM.replace(pinned=(0, 1, 2)), control=tc.ForceDensity()))


def problem(goals, *bounds, model=PINNED, lower=1.0):
    """Build a problem of 1 s that minimizes the squared force densities."""
    limits = [ocp.ForceDensityLimits(lower, 200.0), *bounds]
    return ocp.Problem(model, 1.0, goals=goals, bounds=limits, costs=[ocp.Effort()])


def rise(height=0.05):
    """Build goals: one node rises and is at rest."""
    place = {3: (None, None, PRISM.nodes[3, 2] + height)}
    return [ocp.NodePositions(place), ocp.AtRest()]
