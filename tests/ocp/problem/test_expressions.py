"""Own costs and constraints: they hold, add up, and say what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest
from rising import along, binds, raised

import ocp


def test_running_costs_are_integrals():
    plan = raised(costs=[ocp.Effort(), ocp.Integral("clock", lambda now: now.time**2, 3.0), ocp.AtEnd("top", lambda end: end.nodes[2, 3], 2.0)])
    assert plan.success
    parts = 0.1 * np.sum(plan.force_density**2), 3.0 / 3, 2.0 * plan.trajectory.nodes[-1, 3, 2]
    assert plan.objective == pytest.approx(sum(parts), rel=1e-6)


def test_own_constraints_hold(free):
    def rise(now):
        return now.velocities[2, 3:].T

    fastest = 0.95 * along(free, rise).max()
    binds(raised(ocp.Constraint("top speed", rise, upper=fastest)), free, rise, fastest)
    hold = ocp.Constraint("early pull", lambda now: now.control[0] - 6.0 * (now.time < 0.15), lower=0.0)
    plan = raised(hold)
    assert plan.success
    assert plan.force_density[:2, 0].min() > 6.0 - 1e-5 > free.force_density[:2, 0].min()


BAD = {
    "constraint without name": (lambda: ocp.Constraint("", lambda now: now.time, 0.0), TypeError, "Constraint.name"),
    "constraint without limit": (lambda: ocp.Constraint("a", lambda now: now.time), ValueError, "Constraint 'a': lower and upper"),
    "constraint without expression": (lambda: ocp.Constraint("a", 1.0, 0.0), TypeError, "Constraint 'a': expression"),
    "constraint of a number": (lambda: raised(ocp.Constraint("a", lambda now: 1.0, 0.0)), TypeError, "'a' gives float"),
    "constraint of wrong size": (
        lambda: raised(ocp.Constraint("a", lambda now: now.nodes[2, :], [0.0, 1.0])),
        ValueError,
        "'a': lower has 2 entries",
    ),
    "constraints of one name": (
        lambda: raised(*(ocp.Constraint("a", lambda now, n=n: now.nodes[2, n], -9.0) for n in (0, 1))),
        ValueError,
        "Problem.bounds has two constraints named 'a'",
    ),
    "constraint crossed": (lambda: raised(ocp.Constraint("a", lambda now: now.time, 1.0, 0.0)), ValueError, "'a': lower is above upper"),
    "integral of a column": (lambda: raised(costs=[ocp.Integral("a", lambda now: now.nodes)]), ValueError, "'a' gives 18 entries"),
    "integral weight": (lambda: ocp.Integral("a", lambda now: now.time, 0.0), ValueError, "Integral 'a': weight"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_expressions_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
