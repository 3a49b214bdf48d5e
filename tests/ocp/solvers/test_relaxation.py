"""Limits of rates that no motion was found to keep: what is told is what a plan needs."""

from __future__ import annotations

import re

import numpy as np
import pytest
from planning import leaning_arm, raising

import ocp
from ocp.search.methods import program_of
from ocp.solvers.relaxation import relax_limits, solve_relaxed


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
    told = re.search(
        r"no plan: limits are too narrow: .* raise the limit of [a-z ]+ rate of string \d(?: \(.*?\))? from 0.03 to ([\d.e+-]+) N?m?/",
        none.message,
    )
    assert told is not None, none.message
    needed = float(told[1])
    assert needed > 1.1 * slow
    assert ocp.solve(problem(1.05 * needed)).success


def test_wide_limits_need_nothing():
    plan = ocp.solve(leaning(1e4))
    assert plan.success
    assert fastest(plan) < 1e4


def test_relaxed_rows_hold_from_the_needed_relaxation_on():
    program = program_of(winding(0.05), ocp.Variational(6))
    relaxed = relax_limits(program, ["rate"])
    wider = relaxed.program
    rng = np.random.default_rng(0)
    w = program.first + 0.01 * rng.normal(size=len(program.first))
    needed = relaxed.measure(w)
    rates = np.concatenate([np.arange(rows.start, rows.stop) for rows in wider.rows("rate")])
    broken = []
    for factor in (0.99, 1.01):
        g = (
            wider.derivatives()["nlp_jac_g"](np.append(w, factor * needed), [])[0]
            .full()
            .ravel()[rates]
        )
        broken.append(bool(np.any(g > wider.upper[rates]) or np.any(g < wider.lower[rates])))
    assert needed.max() > 0
    assert broken == [True, False]


def test_equations_and_signs_are_not_relaxed():
    """An equation is no limit; strings carry no compression, but nodes may pass a plane."""
    asked = leaning_arm(1, 0.4)
    bounds = [
        ocp.TensionLimits(lower=0.1),
        ocp.InsideBox(lower=(0.0, None, None), nodes=[1]),
        ocp.Constraint("height", lambda now: now.nodes[2, 0], lower=0.0, upper=0.0),
    ]
    problem = ocp.Problem(asked.model, goals=asked.goals, bounds=bounds, costs=asked.costs)
    relaxed = relax_limits(program_of(problem, ocp.Variational(4)), ["path"])
    most = dict(zip(relaxed.program.w_names, relaxed.program.w_upper, strict=True))
    assert most["relaxation of tension"] == 1.0
    assert most["relaxation of x"] == np.inf
    assert "relaxation of height" not in most


def test_widest_limits_keep_signs_only():
    asked = leaning_arm(1, 0.4)
    bounds = [ocp.ForceDensityLimits(1.0, 1.3), ocp.TensionLimits(1.0, 1.5)]
    problem = ocp.Problem(asked.model, goals=asked.goals, bounds=bounds, costs=asked.costs)
    relaxed = relax_limits(program_of(problem, ocp.Variational(4)), ["path"], "N/m")
    wide = relaxed.widen()
    for rows in wide.rows("path"):
        assert not wide.lower[rows].any()
        assert np.isinf(wide.upper[rows]).all()
    found = solve_relaxed(relaxed, ocp.Ipopt(), None)
    assert found.success
    assert relaxed.measure(found.w[: len(wide.first)]).max() > 0.01
