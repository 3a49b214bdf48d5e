"""Fatrop: the same plans as IPOPT's, in stages that see only themselves, and what it says when it gives up."""

from __future__ import annotations

import numpy as np
import pytest
from planning import program, raising

import ocp
from ocp.solvers.fatrop import cut_into_stages

CASES = {
    "shooting": (ocp.MultipleShooting(8), {}),
    "midpoint": (ocp.ImplicitMidpoint(8), {}),
    "tension": (
        ocp.MultipleShooting(8),
        {"bounds": [ocp.ForceDensityLimits(5.0, 100.0), ocp.TensionLimits(upper=12.0)]},
    ),
    "smooth": (ocp.MultipleShooting(8), {"costs": [ocp.Effort(), ocp.Smoothness(1e-2)]}),
    "duration": (ocp.MultipleShooting(8), {"duration": (0.9, 1.1)}),
    "linear": (ocp.Variational(8, control=ocp.PiecewiseLinear()), {}),
}


@pytest.mark.parametrize("case", ["shooting", "midpoint", "tension", "smooth", "duration"])
def test_fatrop_finds_the_plan_of_ipopt(case):
    transcription, changes = CASES[case]
    problem = raising(**changes)
    one, other = (
        ocp.solve(problem, transcription, solver) for solver in (ocp.Ipopt(), ocp.Fatrop())
    )
    assert one.success
    assert other.success
    assert other.status == "Solve_Succeeded"
    assert other.iterations > 0
    assert other.objective == pytest.approx(one.objective, rel=1e-5)
    assert other.replay_error < 1e-3


@pytest.mark.parametrize("case", CASES)
def test_stages_see_themselves_and_what_is_handed_on(case):
    transcription, changes = CASES[case]
    built = program(raising(**changes), transcription)
    parts = cut_into_stages(built)
    assert sum(parts.states) + sum(parts.controls) == len(parts.first)
    assert sum(parts.states[1:]) + sum(parts.paths) == len(parts.lower) == len(parts.equality)
    assert parts.states[0] == 0
    stage = np.repeat(np.arange(len(parts.states)), np.add(parts.states, parts.controls))
    row, column = map(np.array, parts.nlp.jac_sparsity(1, 0).get_triplet())
    ends = np.cumsum(np.append(parts.states[1:], 0) + np.array(parts.paths))
    row_stage = np.searchsorted(ends, row, side="right")
    reach = stage[column] - row_stage
    assert reach.min() >= 0
    assert reach.max() <= 1
    # what reaches into the next stage is its state, once
    forward = reach == 1
    assert forward.sum() == sum(parts.states[1:])
    # the same values as the program's
    w = parts.first
    assert w[parts.original] == pytest.approx(built.first)


def test_too_few_iterations_of_fatrop_are_a_status():
    plan = ocp.solve(raising(), ocp.MultipleShooting(8), ocp.Fatrop(max_iterations=2))
    assert not plan.success
    assert plan.status == "Maximum_Iterations_Exceeded"
    assert "no plan" in plan.message


@pytest.mark.parametrize("options", [{"nope": 1}, {"mu_init": "large"}])
def test_options_that_fatrop_does_not_have_are_refused(options):
    with pytest.raises(ValueError, match=r"Fatrop.options is .*: give options that Fatrop has"):
        ocp.solve(raising(), ocp.Variational(6), ocp.Fatrop(options=options))


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: ocp.Fatrop(max_iterations=0), ValueError, "Fatrop.max_iterations is 0"),
        (lambda: ocp.Fatrop(tolerance=-1.0), ValueError, "Fatrop.tolerance"),
        (lambda: ocp.Fatrop(verbose=1), TypeError, "Fatrop.verbose is 1: give True or False"),
        (lambda: ocp.Fatrop(options=[1]), TypeError, "Fatrop.options"),
    ],
)
def test_wrong_values_are_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()
