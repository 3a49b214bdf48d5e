"""Limits that are too narrow: the message names them, and the amount that a plan needs."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from planning import driven, leaning_arm

import ocp
from ocp.search.methods import program_of
from ocp.search.narrow_limits import explain_limits
from ocp.search.task import prepare
from ocp.solvers.relaxation import relax_limits

NAMES = ["back", "front", "right", "left"]
TOO_NARROW = re.compile(
    r"motion with ([a-z ]+ of (?:string|bar|node) \d \(\w+\)) up to ([\d.e+-]+) "
)


def leaning(*bounds, duration=1.0):
    """A bar leans over, whose members have names."""
    given = leaning_arm(1, 0.4)
    structure = given.model.scene.structure
    nodes = ["foot", "tip", *(f"anchor{k}" for k in range(4))]
    named = structure.replace(string_names=NAMES, bar_names=["mast"], node_names=nodes)
    return replace(given, model=driven(named), duration=duration, bounds=bounds)


WIDE = ocp.ForceDensityLimits(1.0, 300.0)
# limit as a function of its value, a value that is too small, and the quantity
LIMITS = {
    "force density": (lambda most: [ocp.ForceDensityLimits(1.0, most)], 1.3),
    "tension": (lambda most: [WIDE, ocp.TensionLimits(upper=most)], 1.9),
    "compression": (lambda most: [WIDE, ocp.BarForceLimits(most)], 4.2),
    "acceleration": (lambda most: [WIDE, ocp.NodeAccelerationLimits(most)], 1.0),
    "force density rate": (lambda most: [WIDE, ocp.ForceDensityRateLimits(most)], 0.5),
}


def find_needed(plan):
    found = TOO_NARROW.search(plan.message)
    assert found is not None, plan.message
    return found[1], float(found[2])


@pytest.mark.parametrize(
    "quantity",
    ["force density", *(pytest.param(name, marks=pytest.mark.slow) for name in list(LIMITS)[1:])],
)
def test_message_names_limit_and_amount(quantity):
    build, most = LIMITS[quantity]
    plan = ocp.solve(leaning(*build(most)))
    assert not plan.success
    name, needed = find_needed(plan)
    assert name.startswith(quantity)
    assert any(f"({own})" in name for own in (*NAMES, "mast", "tip"))
    amount = needed - most
    assert amount > 0
    assert ocp.solve(leaning(*build(most + 1.2 * amount))).success
    # plans that miss their goals by less than the default tolerance need a little less
    assert not ocp.solve(leaning(*build(most + 0.8 * amount)), tolerance=1e-4).success


def test_message_says_that_more_time_helps():
    plan = ocp.solve(leaning(ocp.ForceDensityLimits(1.0, 1.5)))
    found = re.search(r"or a duration of ([\d.]+) s", plan.message)
    assert found is not None, plan.message
    longer = ocp.solve(leaning(ocp.ForceDensityLimits(1.0, 1.5), duration=1.05 * float(found[1])))
    assert longer.success, longer.message


def test_message_says_that_more_time_does_not_help():
    plan = ocp.solve(leaning(WIDE, ocp.BarForceLimits(4.01)))
    assert not plan.success
    assert "no duration up to 3 s was found to help" in plan.message


def test_lower_limits_do_not_change_their_sign():
    """Strings that push would be no cure."""
    program = program_of(leaning(ocp.ForceDensityLimits(1.4, 1.5)), ocp.Variational(8))
    relaxed = relax_limits(program, (), "N/m")
    assert sorted(relaxed.program.w_upper[len(program.first) :]) == [0.0, 1.0, np.inf]


def test_wide_limits_are_not_blamed():
    task = prepare(leaning(WIDE), ocp.PiecewiseConstant(), 0.01)
    assert explain_limits(task) == ""
