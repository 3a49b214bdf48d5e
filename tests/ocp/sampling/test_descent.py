"""Derivatives of simulated motions agree with differences of whole motions; a step with feedback follows its prediction."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from loading import load_example
from planning import raising

import ocp
from ocp.problem.scaling import Scales
from ocp.results.report import violated_limits
from ocp.sampling.batch_simulation import BatchSimulation
from ocp.sampling.descent import Descent

contact_problems = load_example("contact_problems")


@pytest.fixture(scope="module")
def motions():
    """Motions with a waypoint, limits of each kind, held force densities and a free duration."""
    jump = contact_problems.prism_jumps(0.2)
    goals = [ocp.Waypoint([ocp.CenterOfMass((None, None, 0.3))], share=0.43), *jump.goals]
    limits = [ocp.ForceDensityRateLimits(50.0), ocp.TensionLimits(5.0, 20.0)]
    problem = replace(jump, duration=(0.2, 0.4), goals=goals, bounds=[*jump.bounds, *limits])
    mesh = ocp.MultipleShooting(12, control=ocp.PiecewiseConstant(max_changes=5))
    return BatchSimulation(
        problem, Scales.of(problem), mesh.fractions, mesh.control, 40, 20.0, 0.01, 1
    )


def simulate_any(motions):
    """Simulate force densities that violate limits, of three groups of strings."""
    directions = np.kron(np.eye(3), np.ones(3))
    descent = Descent(motions, directions)
    levels = 30.0 + 20.0 * np.random.default_rng(0).random((12, 3))
    levels = levels[np.searchsorted(np.unique(motions._spans), motions._spans)]
    return descent, directions, descent.simulate((levels @ directions)[None], 0.3)[0]


def test_derivatives_agree_with_differences_of_motions(motions):
    descent, directions, point = simulate_any(motions)
    used = np.flatnonzero(point.rows)
    near = descent._linearize(point)
    assert len(used) > len(motions.asked) + 20  # limits are violated
    assert np.ptp(motions.row_intervals[used]) > 5
    size = np.abs(near.by_control).max()
    starts = np.flatnonzero(np.diff(motions._spans, prepend=-1))
    for k in starts:
        for g, change in enumerate(directions):
            moved = point.force_density.copy()
            moved[motions._spans == motions._spans[k]] += 1e-5 * change
            slope = (descent.simulate(moved[None], 0.3)[0].rows[used] - point.rows[used]) / 1e-5
            assert np.abs(slope - near.by_control[:, k, g]).max() < 1e-4 * size
    assert not np.delete(near.by_control, starts, axis=1).any()
    longer = descent.simulate(point.force_density[None], 0.3 * (1 + 1e-6))[0]
    slope = (longer.rows[used] - point.rows[used]) / 1e-6
    assert near.by_state[0, :, -1] == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
def test_limits_have_the_tolerance_of_reports(share, kept):
    """The acceptance test demands that plans satisfy them within this tolerance."""
    mesh, gamma = ocp.MultipleShooting(4), np.tile(20.0, (1, 4, 9))

    def simulate(*bounds):
        problem = raising(bounds=[ocp.ForceDensityLimits(5.0, 100.0), *bounds])
        options = mesh.fractions, mesh.control, 40, 20.0, 0.01, 1
        motions = BatchSimulation(problem, Scales.of(problem), *options)
        return motions, Descent(motions, np.eye(9)).simulate(gamma, 0.3)[0]

    highest = simulate()[1].states[:, :18].max()
    limit = float(highest / (1 + share * 1e-4))
    every = ocp.Constraint("coordinate", lambda now: ca.vec(now.nodes), upper=limit)
    motions, point = simulate(every)
    goals = motions.misses(point.states[None], 0.3).shape[1]
    assert bool(point.rows[goals:].max() <= 1.0) is kept
    time = np.linspace(0.0, 0.3, 5)
    broken = violated_limits(motions.problem, time, point.states, point.force_density)
    assert (not broken) is kept
