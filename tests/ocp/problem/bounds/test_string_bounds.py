"""Limits of strings: of rest lengths and how fast motors wind; each holds, binds where it should, and says what is wrong with it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism
from rising import GOALS, MODEL, PRESTRESS, raised

import ocp


def test_rest_lengths_have_limits(free):
    most = 0.9995 * free.rest_lengths().max()
    plan = raised(ocp.RestLengthLimits(upper=most))
    assert plan.success
    assert plan.rest_lengths().max() <= most * (1 + 1e-6)
    k = 0.98 * free.force_density.max()
    soft = raised(
        ocp.RestLengthLimits(stiffness=k)
    )  # without the limit its strings would need rest lengths below 0
    assert soft.success
    assert soft.force_density.max() <= k * (1 + 1e-6)


def test_motors_have_a_speed(free):
    speed = 0.98 * np.abs(np.diff(free.rest_lengths(), axis=0)).max() * 10
    plan = raised(ocp.RestLengthRateLimits(speed))
    assert plan.success
    assert np.abs(np.diff(plan.rest_lengths(), axis=0)).max() * 10 == pytest.approx(speed, rel=5e-3)


@pytest.mark.parametrize("profile", [ocp.PiecewiseConstant(), ocp.PiecewiseLinear()])
def test_force_densities_change_slowly(profile):
    def planned(*bounds):
        problem = ocp.Problem(
            MODEL,
            goals=GOALS,
            bounds=[ocp.ForceDensityLimits(1.0, 100.0), *bounds],
            costs=[ocp.Effort()],
        )
        return ocp.solve(problem, ocp.Variational(16, control=profile))

    def fastest(plan):
        return np.abs(np.diff(plan.force_density, axis=0)).max() * 16

    free = planned()
    limit = 0.7 * fastest(free)
    plan = planned(ocp.ForceDensityRateLimits(limit))
    assert plan.success, plan.message
    assert (
        (1 - 1e-3) * limit < fastest(plan) < (1 + 1e-6) * limit
    )  # an interior-point method ends a little within
    assert plan.objective > free.objective
    active = {finding.name: finding.unit for finding in plan.report().active}
    assert "N/(m s)" in {
        unit for name, unit in active.items() if name.startswith("force density rate of string")
    }


def rates(plan):
    """Of the rest lengths, from each time that has force densities to the next, m/s."""
    rest = plan.rest_lengths()
    return np.abs(np.diff(rest, axis=0)).max(axis=1) / np.diff(plan.time)[: len(rest) - 1]


@pytest.mark.slow
def test_motors_have_a_speed_up_to_the_end_of_linear_profiles():
    linear = ocp.MultipleShooting(12, control=ocp.PiecewiseLinear())
    asked = ocp.Problem(MODEL, 1.0, goals=GOALS, bounds=[PRESTRESS], costs=[ocp.Effort()])
    unlimited = ocp.solve(asked, linear)
    speed = 0.9 * rates(unlimited)[-1]
    plan = ocp.solve(replace(asked, bounds=[PRESTRESS, ocp.RestLengthRateLimits(speed)]), linear)
    assert plan.success
    assert len(rates(plan)) == 12
    assert rates(plan).max() <= speed * (1 + 1e-5)
    assert not plan.report().violated
    fast = replace(asked, bounds=[PRESTRESS, ocp.RestLengthRateLimits(2 * rates(unlimited).max())])
    assert ocp.solve(fast, linear).objective == pytest.approx(unlimited.objective, rel=1e-5)


def test_one_interval_of_a_linear_profile_has_a_rate():
    limited = ocp.Problem(
        MODEL,
        0.1,
        bounds=[PRESTRESS, ocp.RestLengthRateLimits(0.1)],
        costs=[ocp.Prestress(np.arange(9.0, 18.0)), ocp.Duration()],
    )
    plan = ocp.solve(limited, ocp.MultipleShooting(1, control=ocp.PiecewiseLinear()))
    assert rates(plan).max() <= 0.1 * (1 + 1e-5)
    names = ocp.solve(limited, ocp.MultipleShooting(1)).duals.names
    assert not any(name.startswith("rest length rate") for name in names)


def test_a_report_calls_rates_beyond_their_limit_violated(free):
    limit = 0.5 * rates(free).max()
    report = replace(
        free, problem=replace(free.problem, bounds=[PRESTRESS, ocp.RestLengthRateLimits(limit)])
    ).report()
    worst = max(report.violated, key=lambda one: abs(one.worst))
    assert worst.name.startswith("rest length rate of string")
    assert abs(worst.worst) == pytest.approx(2 * limit, rel=1e-9)
    assert worst.time in free.time[1:-1]
    assert not {(one.name, one.side) for one in report.violated} & {
        (one.name, one.side) for one in report.active
    }


class Broken:
    """NumPy cannot read it."""

    def __array__(self, *_, **__):
        raise RuntimeError("broken")


BAD = {
    "limit in words": (
        lambda: ocp.ForceDensityLimits(0.0, "200"),
        TypeError,
        "ForceDensityLimits.upper is not a real number",
    ),
    "limit by name": (
        lambda: ocp.ForceDensityLimits({"guy": 0.5}),
        TypeError,
        "ForceDensityLimits.lower is not a real number .* give one number, or a list of numbers$",
    ),
    "limits in words": (
        lambda: ocp.ForceDensityLimits(0.0, ["200"] * 9),
        TypeError,
        "ForceDensityLimits.upper is not an array of real numbers",
    ),
    "limit of truth": (
        lambda: ocp.TensionLimits(upper=True),
        TypeError,
        "TensionLimits.upper is not a real number",
    ),
    "speed in words": (
        lambda: ocp.RestLengthRateLimits("12"),
        TypeError,
        "RestLengthRateLimits.rate is not a real number",
    ),
    "groups without common ground": (
        lambda: ocp.solve(
            ocp.Problem(
                MODEL, bounds=[ocp.ForceDensityLimits([5, 20] + 7 * [5], [10, 50] + 7 * [100])]
            ),
            ocp.MultipleShooting(8, control=ocp.PiecewiseLinear(((2, 0, 1),))),
        ),
        ValueError,
        r"PiecewiseLinear.groups: strings 0, 1, 2 share a force density.*string 1 at 20 N/m or more.*string 0 at 10 N/m or less",
    ),
    "limits that NumPy cannot read": (
        lambda: ocp.ForceDensityLimits(upper=Broken()),
        TypeError,
        "ForceDensityLimits.upper",
    ),
    "limits of CasADi": (
        lambda: ocp.TensionLimits(upper=ca.MX.sym("x")),
        TypeError,
        "TensionLimits.upper",
    ),
    "limits under a mask": (
        lambda: ocp.ForceDensityLimits(upper=np.ma.array([1.0, 2.0], mask=[True, False])),
        ValueError,
        "ForceDensityLimits.upper has masked entries",
    ),
    "speed zero": (lambda: ocp.RestLengthRateLimits(0.0), ValueError, "RestLengthRateLimits.rate"),
    "no stiffness": (
        lambda: raised(ocp.RestLengthLimits(), model=driven(prism(1.0, stiffness=0.0))),
        ValueError,
        "RestLengthLimits.stiffness of string 0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_limits_of_strings_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
