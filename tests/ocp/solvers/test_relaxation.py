"""Limits of rates that no motion was found to keep: what is told is what a plan needs."""

from __future__ import annotations

import re

import numpy as np
import pytest
from planning import leaning_arm, raising

import ocp
from ocp.search.methods import program_of
from ocp.solvers.relaxation import TOO_SLOW, measure_relaxation, relax_limits


def leaning(rate):
    asked = leaning_arm(1, 0.4)
    return ocp.Problem(
        asked.model,
        1.0,
        goals=asked.goals,
        bounds=[*asked.bounds, ocp.ForceDensityRateLimits(rate)],
        costs=asked.costs,
    )


def winding(speed):
    return raising(
        bounds=[
            ocp.ForceDensityLimits(5.0, 100.0),
            ocp.RestLengthRateLimits(speed, stiffness=1000.0),
        ]
    )


def fastest(plan):
    return np.abs(np.diff(plan.force_density, axis=0)).max() / np.diff(plan.time)[0]


@pytest.mark.parametrize(
    "problem",
    [leaning, pytest.param(winding, marks=pytest.mark.slow)],
    ids=["force densities", "rest lengths"],
)
def test_what_is_told_suffices(problem):
    slow = 0.03
    none = ocp.solve(problem(slow))
    assert not none.success
    assert none.status == TOO_SLOW
    told = re.search(
        r"allow a faster [a-z ]+ of string \d, or a longer duration; with limits of rates ([\d.e+]+) times as wide this mesh has",
        none.message,
    )
    assert told is not None, none.message
    times = float(told[1])
    assert times > 1.1
    assert "Variational" in none.message
    assert "MultipleShooting" not in none.message  # nothing else is tried
    assert none.replay_error < 0.02  # it is a way to the goals
    if problem is leaning:
        assert fastest(none) == pytest.approx(times * slow, rel=1e-2)
        assert ocp.solve(problem(1.1 * times * slow)).success


def test_wide_limits_need_nothing():
    plan = ocp.solve(leaning(1e4))
    assert plan.success
    assert fastest(plan) < 1e4


def test_the_program_of_the_share():
    """Its rows hold at a point if, and only if, rates are within limits that are wider by the share there."""
    program = program_of(winding(0.05), ocp.Variational(6))
    relaxed = relax_limits(program, ["rate"])
    wider = relaxed.program
    rng = np.random.default_rng(0)
    w = program.first + 0.01 * rng.normal(size=len(program.first))
    share = measure_relaxation(program, w)
    shares = np.isfinite(wider.w_lower[len(w) :]) * 1.0
    rates = np.concatenate([np.arange(rows.start, rows.stop) for rows in wider.rows("rate")])
    broken = []
    for factor in (0.99, 1.01):
        g = (
            wider.derivatives()["nlp_jac_g"](np.append(w, factor * share * shares), [])[0]
            .full()
            .ravel()[rates]
        )
        broken.append(bool(np.any(g > wider.upper[rates]) or np.any(g < wider.lower[rates])))
    assert share > 0
    assert broken == [True, False]
