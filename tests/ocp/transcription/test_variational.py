"""The discrete principle of least action: momenta kept, velocities only where they are asked for."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism, program, raising

import ocp
import tenscasadi as tc


def test_leapfrog_keeps_momenta():
    """A prism that falls and turns changes its shape: the planned motion keeps angular momentum to the solver's tolerance."""
    structure = prism(1.0)
    model = driven(structure, gravity=tc.Gravity())
    turning = np.cross([0.3, 0.2, 0.5], structure.nodes - structure.nodes.mean(axis=0))
    goals = [ocp.StringLengths({6: 0.95 * structure.string_lengths[6]})]
    problem = ocp.Problem(
        model, 0.5, start=model.state(structure.nodes, turning), goals=goals, costs=[ocp.Effort()]
    )
    found = ocp.solve(problem, ocp.Variational(10))
    assert found.success
    M = structure.mass_matrix().toarray()
    nodes, rates = found.trajectory.nodes[[0, -1]], found.trajectory.velocities[[0, -1]]
    momenta = [
        np.cross(N - N.mean(axis=0), M @ (V - V.mean(axis=0))).sum(axis=0)
        for N, V in zip(nodes, rates, strict=True)
    ]
    assert momenta[0] == pytest.approx(momenta[1], abs=1e-7)
    assert rates[1].mean(axis=0) - rates[0].mean(axis=0) == pytest.approx(
        [0.0, 0.0, -9.81 * 0.5], abs=1e-7
    )


def test_velocities_are_unknowns_only_where_they_are_asked_for():
    bare, asked = (
        program(raising(costs=costs), ocp.Variational(4))
        for costs in (
            [ocp.Effort()],
            [ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities))],
        )
    )
    count = [sum("velocity" in name for name in built.w_names) for built in (bare, asked)]
    assert count == [18, 4 * 18]
    slow = ocp.solve(
        raising(
            costs=[ocp.Effort(), ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities), 1e3)]
        ),
        ocp.Variational(12),
    )
    fast = ocp.solve(raising(), ocp.Variational(12))
    assert slow.success
    assert np.sum(slow.trajectory.velocities**2) < np.sum(fast.trajectory.velocities**2)


def test_structures_without_bars_have_plans():
    nodes = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.4, 0.1, 0.0)]
    net = tc.Structure(nodes, strings=[(0, 2), (1, 2)], node_mass=[0.0, 0.0, 1.0], pinned=[0, 1])
    model = tc.Model(tc.Scene(net, control=tc.ForceDensity()))
    problem = ocp.Problem(
        model, goals=[ocp.NodePositions({2: (0.5, None, None)})], costs=[ocp.Effort()]
    )
    plan = ocp.solve(problem, ocp.Variational(6), ocp.Ipopt())
    assert plan.success, plan.message
