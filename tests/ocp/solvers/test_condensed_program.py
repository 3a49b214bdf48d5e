"""Derivatives of condensed programs against finite differences of motions."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.search.methods import program_of
from ocp.solvers.condensed_newton.condensed_program import CondensedProgram, Expansion

PRISM = tc.shapes.prism()
ASKED = {
    "model": tc.Model(tc.Scene(PRISM, control=tc.ForceDensity())),
    "duration": (0.5, 1.5),
    "goals": [ocp.StringLengths({6: 0.95}), ocp.AtRest()],
    "bounds": [ocp.ForceDensityLimits(1, 200), ocp.TensionLimits(upper=300.0)],
    "costs": [ocp.Effort(), ocp.Smoothness(0.1), ocp.Duration(3.0)],
}
METHODS = [
    ocp.Variational(6),
    ocp.ImplicitMidpoint(6),
    ocp.MultipleShooting(6),
    ocp.DirectCollocation(4),
]


def settled(of, u, s):
    """Unknowns s for which the defects vanish."""
    for _ in range(12):
        s = s + Expansion(of, u, s).follow(None, of.values(u, s)[2])[: len(s)]
    return s


@pytest.mark.parametrize("transcription", METHODS, ids=lambda one: type(one).__name__)
def test_derivatives_are_those_of_the_motion(transcription):
    program = program_of(ocp.Problem(**ASKED), transcription)
    of, rng = CondensedProgram(program), np.random.default_rng(0)
    u = program.first[of.u]
    s = settled(of, u, program.first[of.s])
    about, way, e = Expansion(of, u, s), rng.normal(size=len(u)), 1e-5
    y, z = rng.normal(size=of.goals), rng.normal(size=len(of.path_rows))
    about.weigh(y, z, np.zeros(len(z)))
    followed = about.follow(way, None)
    path_change, curvature = about.path_change(followed), about.curvature(followed)
    values, slopes = [], []
    for sign in (1, -1):
        moved = u + sign * e * way
        own = settled(of, moved, s)
        at = Expansion(of, moved, own)
        values.append(of.values(moved, own))
        slopes.append(at.slope + y @ at.jacobian + at.of_paths(z[:, None])[0])
    cost, goals, _, paths = ((a - b) / (2 * e) for a, b in zip(*values, strict=True))
    assert about.slope @ way == pytest.approx(cost, rel=1e-5, abs=1e-6)
    assert about.jacobian @ way == pytest.approx(goals, rel=1e-5, abs=1e-5)
    assert path_change == pytest.approx(paths, rel=1e-5, abs=1e-5)
    curved = (slopes[0] - slopes[1]) / (2 * e)
    assert curvature == pytest.approx(curved, rel=1e-4, abs=1e-4 * np.abs(curved).max())
