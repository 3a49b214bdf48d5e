"""Costs: each is the integral that it says, and keeps small what it should."""

from __future__ import annotations

import numpy as np
import pytest
from rising import along, raised

import ocp


def test_a_weight_on_time_shortens_the_plan(free):
    quick = raised(
        ocp.ForceDensityLimits(5.0, 15.0),
        costs=[ocp.Duration(100.0), ocp.Effort(1e-4)],
        duration=(0.5, 1.5),
    )
    assert quick.success
    assert quick.time[-1] < 0.7


def test_prestress_keeps_to_its_level():
    plan = raised(costs=[ocp.Prestress(12.0)])
    assert plan.success
    assert abs(plan.force_density.mean() - 12.0) < 1.0
    assert plan.objective == pytest.approx(0.1 * np.sum((plan.force_density - 12.0) ** 2), rel=1e-6)


def test_work_is_what_the_strings_do(free):
    """Over a motion from rest to rest the strings' power sums to nothing, and what they do is what they take."""
    plan = raised(costs=[ocp.Work(smoothing=0.5), ocp.Effort(1e-3)])
    assert plan.success, plan.message

    def done(one):
        power = -along(one, lambda now: now.control * now.lengths * now.rates)
        return np.maximum(power, 0.0).sum() * 0.1

    assert done(plan) < done(free)


BAD = {
    "prestress of wrong size": (
        lambda: raised(costs=[ocp.Prestress([1.0, 2.0])]),
        ValueError,
        "Prestress.level",
    ),
    "work without width": (lambda: ocp.Work(smoothing=0.0), ValueError, "Work.smoothing"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_costs_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
