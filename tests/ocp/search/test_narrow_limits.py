"""Limits that are too narrow: the message names them, and the amount that a plan needs."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from jumping import flight, jumping, push
from planning import driven, leaning_arm

import ocp
import tenscasadi as tc
from ocp.search.methods import program_of
from ocp.search.narrow_limits import explain_limits
from ocp.search.task import prepare
from ocp.solvers.relaxation import relax_limits

NAMES = ["back", "front", "right", "left"]
TOO_NARROW = re.compile(
    r"raise the limit of ([a-z ]+ of (?:string|bar|node) \d \(\w+\)) from [\d.]+ to ([\d.e+-]+) "
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


def jump(most):
    """A prism jumps, with limited force densities."""
    return jumping(push(), flight(0.2), bounds=[ocp.ForceDensityLimits(0.0, most)])


def wind(control, most):
    """A D-bar folds, whose strings are wound at a limited rate."""
    cross = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0, damping=2.0)
    folded = ocp.StringLengths(tc.shapes.d_bar(angle=0.75).string_lengths)
    return ocp.Problem(
        tc.Model(tc.Scene(cross, control=control)),
        0.6,
        goals=[folded, ocp.AtRest()],
        bounds=[ocp.RestLengthRateLimits(most), ocp.TensionLimits(upper=100.0)],
        costs=[ocp.Effort()],
    )


def pass_by(most):
    """A bar leans over by way of a place at a given time."""
    place = ocp.Waypoint([ocp.NodePositions({1: (0.4, None, None)})], time=0.5)
    goals = [place, ocp.NodePositions({1: (0.0, 0.1, None)}), ocp.AtRest()]
    return replace(leaning(ocp.ForceDensityLimits(1.0, most)), goals=goals)


def turn(most):
    limits = ocp.AngularMomentumLimits((-most, -most, -most), (most, most, most))
    return leaning(WIDE, limits)


def clear(least):
    return leaning(WIDE, ocp.Obstacle((0.25, 0.06, 0.95), least))


def stay(most):
    """A bar leans over, whose tip is kept behind a plane through its start."""
    box = ocp.InsideBox(upper=(None, most, None), nodes=[1])
    place = ocp.Waypoint([ocp.NodePositions({1: (None, 0.1, None)})], time=0.5)
    goals = [place, ocp.NodePositions({1: (0.1, 0.0, None)}), ocp.AtRest()]
    return replace(leaning(WIDE, box), goals=goals)


def motors(most):
    """A D-bar folds, whose strings are wound by motors."""
    return wind(tc.Winch(0.02, 1e-3, friction=1e-3, torque=most, speed=30.0), 10.0)


# problem of a limit, a value that no plan meets, and the quantity
ELSEWHERE = {
    "phases": (jump, 2.0, "force density of string"),
    "rest lengths": (partial(wind, tc.RestLength()), 0.04, "rest length rate of string"),
    "rates": (partial(wind, tc.RestLengthRate()), 0.04, "rest length rate of string"),
    "torque": (motors, 0.15, "motor torque of string"),
    "waypoint": (pass_by, 3.0, "force density of string"),
    "spin": (turn, 0.02, "angular momentum along y"),
    "obstacle": (clear, 0.2, "obstacle clear of bar 0 (mast)"),
    "limit 0": (stay, 0.0, "y of node 1 (tip)"),
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=[pytest.mark.slow] * (k not in ("waypoint", "limit 0")))
        for k in ELSEWHERE
    ],
)
def test_stated_amount_suffices(kind):
    build, limit, quantity = ELSEWHERE[kind]
    plan = ocp.solve(build(limit))
    assert not plan.success
    text = plan.message
    assert text.startswith("no plan: limits are too narrow: "), text
    pattern = f"to (raise|lower) the limit of {re.escape(quantity)}[^;]*? to ([\\d.e+-]+)"
    found = re.search(pattern, text)
    assert found is not None, text
    needed = float(found[2])
    assert (needed > limit) == (found[1] == "raise")
    assert ocp.solve(build(needed + 0.03 * abs(needed) * np.sign(needed - limit))).success


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
    found = re.search(r"or to take a duration of ([\d.]+) s", plan.message)
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


def test_limits_that_forbid_the_start_have_member_names():
    with pytest.raises(ValueError, match=r"start: compression of bar 0 .* \(bar 0: mast\)"):
        ocp.solve(leaning(WIDE, ocp.BarForceLimits(0.01)))
