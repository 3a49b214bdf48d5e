"""Periodic motions: the replay ends as it began."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc

PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)
MODEL = driven(prism(1.0))


def planned(*goals, duration=1.0, intervals=12, model=MODEL, **changes):
    given = {"bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(
        ocp.Problem(model, duration, goals=goals, **given), ocp.MultipleShooting(intervals)
    )


def test_one_free_node_may_come_back_elsewhere():
    """Only its velocities are asked for."""
    nodes = [(0, 0, 0), (1, 0, 0), (-1, 0, 1), (-1, 0, -1), (-1, 1, 0), (-1, -1, 0)]
    hinged = tc.Structure(
        nodes, bars=[(0, 1)], strings=[(0, node) for node in range(2, 6)], pinned=range(1, 6)
    )
    plan = planned(
        ocp.Periodic((None, None, None)),
        model=driven(hinged),
        bounds=[ocp.ForceDensityLimits(0.0, 10.0)],
    )
    assert "3 → 2 rows: 1 bar" in plan.message
    assert plan.success, plan.message


def test_a_periodic_motion_repeats():
    plan = planned(
        ocp.Waypoint([ocp.StringLengths(prism(1.08).string_lengths)], share=0.5),
        ocp.Periodic(),
        intervals=16,
    )
    assert plan.success, plan.message
    twice = tc.simulate(
        MODEL, 2.0, 1e-3, control=np.tile(plan.force_density, (2, 1)), compiled=False
    )
    once = twice.nodes[np.argmin(abs(twice.time - 1.0))]
    assert once == pytest.approx(MODEL.structure.nodes, abs=1e-3)
    assert twice.nodes[-1] == pytest.approx(MODEL.structure.nodes, abs=3e-2)
