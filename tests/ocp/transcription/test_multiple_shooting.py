"""Multiple shooting: the same motion as simulate."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.initial_guess import make_guess

PRISM = tc.shapes.prism()
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), gravity=tc.Gravity()))
LENGTHS = ocp.StringLengths({0: 0.8, 6: 1.0})


def growing(shooting=ocp.MultipleShooting(4), **changes):
    problem = ocp.Problem(**{"model": MODEL, "duration": 0.4, "goals": [LENGTHS], **changes})
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    guess = make_guess(problem, target, shooting.intervals)
    return shooting.program(problem, target, scales, guess), guess, target


def test_gaps_close_on_a_simulated_motion():
    """Rows of the dynamics vanish on what simulate computes with the same scheme, steps and projection."""
    shooting = ocp.MultipleShooting(4, substeps=5)
    built, _, target = growing(shooting)
    controls = np.random.default_rng(2).uniform(0, 20, size=(4, 9))
    run = tc.simulate(
        MODEL,
        0.4,
        0.02,
        state=target.start,
        control=controls,
        correction=tc.Projection(every=5),
        save_every=5,
        compiled=False,
    )
    unscaled = built.unpack(np.ones_like(built.first))
    scales = np.concatenate([unscaled[1].full(), unscaled[0].full()[:, 1:]]).T
    w = (np.concatenate([controls, run.states[1:]], axis=1) / scales).ravel()
    states, forces, _ = (value.full().T for value in built.unpack(w))
    assert states == pytest.approx(run.states, abs=1e-12)
    assert forces == pytest.approx(controls, rel=1e-12)
    g = ca.Function("g", [built.problem["x"]], [built.problem["g"]])(w).full().ravel()
    rows = [name.startswith("dynamics") for name in built.names]
    assert sum(rows) == 4 * 36
    assert np.abs(g[rows]).max() < 1e-10
