"""Own costs and constraints: they hold, add up, and say what is wrong with them."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import integrated
from rising import MODEL, PRESTRESS, along, binds, raised

import ocp


def test_running_costs_are_integrals():
    plan = raised(
        costs=[
            ocp.Effort(),
            ocp.Integral("clock", lambda now: now.time**2, 3.0),
            ocp.AtEnd("top", lambda end: end.nodes[2, 3], 2.0),
        ]
    )
    assert plan.success
    parts = 0.1 * np.sum(plan.force_density**2), 3.0 / 3, 2.0 * plan.trajectory.nodes[-1, 3, 2]
    assert plan.objective == pytest.approx(sum(parts), rel=1e-6)


def test_own_constraints_hold(free):
    def rise(now):
        return now.velocities[2, 3:].T

    fastest = 0.95 * along(free, rise).max()
    binds(raised(ocp.Constraint("top speed", rise, upper=fastest)), free, rise, fastest)
    hold = ocp.Constraint(
        "early pull", lambda now: now.control[0] - 6.0 * (now.time < 0.15), lower=0.0
    )
    plan = raised(hold)
    assert plan.success
    assert plan.force_density[:2, 0].min() > 6.0 - 1e-5 > free.force_density[:2, 0].min()


def test_what_is_limited_at_the_end_is_free_along_the_way():
    """The top has to be low at the end alone: it starts above, and its speed, which is bounded along the way by nothing, is low there."""
    problem = {"bounds": [PRESTRESS], "costs": [ocp.Effort()]}

    def height(now):
        return now.nodes[2, 3]

    top = float(MODEL.structure.nodes[3, 2])
    given = ocp.Constraint(ocp.AtEnd("top", height, 2.0), upper=2 * (top - 0.02))
    slow = ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities), upper=1e-3, at_end=True)
    plan = ocp.solve(
        ocp.Problem(MODEL, 0.6, bounds=[*problem["bounds"], given, slow], costs=problem["costs"]),
        ocp.Variational(20),
    )
    assert plan.success, plan.message
    ended = integrated(plan)
    assert MODEL.nodes(ended)[3, 2] <= top - 0.02 + 1e-3
    assert np.sum(MODEL.velocities(ended) ** 2) <= 1.1e-3
    assert np.sum(plan.trajectory.velocities**2, axis=(1, 2)).max() > 2e-3
    assert len(plan.duals["top"]) == 1
    assert "top" in {finding.name for finding in plan.report().active}
    assert not {"top", "speed"} & {finding.name for finding in plan.report().violated}


def test_a_replay_that_breaks_a_limit_of_the_end_is_no_success():
    """On two intervals goals are met within the tolerance, and another node ends more than it beyond its limit; a finer mesh mends that."""
    model, node = MODEL, MODEL.structure.nodes[4, 0] - 0.1
    aside = ocp.Constraint("aside", lambda end: 3 * end.nodes[0, 4], upper=3 * node, at_end=True)
    goals = [
        ocp.NodePositions({3: (None, None, float(MODEL.structure.nodes[3, 2]))}),
        ocp.NodeVelocities({3: (None, None, 0.0)}),
    ]
    problem = ocp.Problem(
        model, goals=goals, bounds=[aside, ocp.ForceDensityLimits(0.0, 200.0)], costs=[ocp.Effort()]
    )
    coarse = ocp.solve(problem, ocp.ImplicitMidpoint(2), tolerance=6e-4)
    beyond = coarse.replay().nodes[-1, 4, 0] - node
    assert 6e-4 < beyond == pytest.approx(coarse.replay_error, rel=0.1)
    assert not coarse.success
    assert "aside violates its limit" in coarse.message
    fine = coarse.refine(6e-4)
    assert fine.success, fine.message
    assert fine.replay().nodes[-1, 4, 0] <= node + 6e-4


BAD = {
    "constraint of an end with an expression": (
        lambda: ocp.Constraint(ocp.AtEnd("a", lambda e: e.time), lambda e: e.time, 0.0),
        TypeError,
        "'a'",
    ),
    "constraint of an end without limit": (
        lambda: ocp.Constraint(ocp.AtEnd("a", lambda e: e.time)),
        ValueError,
        "'a': lower and upper",
    ),
    "constraint at some end": (
        lambda: ocp.Constraint("a", lambda e: e.time, 0.0, at_end=1),
        TypeError,
        "'a': at_end",
    ),
    "constraint without name": (
        lambda: ocp.Constraint("", lambda now: now.time, 0.0),
        TypeError,
        "Constraint.name",
    ),
    "constraint without limit": (
        lambda: ocp.Constraint("a", lambda now: now.time),
        ValueError,
        "Constraint 'a': lower and upper",
    ),
    "constraint without expression": (
        lambda: ocp.Constraint("a", 1.0, 0.0),
        TypeError,
        "Constraint 'a': expression",
    ),
    "constraint of a number": (
        lambda: raised(ocp.Constraint("a", lambda now: 1.0, 0.0)),
        TypeError,
        "'a' gives float",
    ),
    "constraint of wrong size": (
        lambda: raised(ocp.Constraint("a", lambda now: now.nodes[2, :], [0.0, 1.0])),
        ValueError,
        "'a': lower has 2 entries",
    ),
    "constraints of one name": (
        lambda: raised(
            *(ocp.Constraint("a", lambda now, n=n: now.nodes[2, n], -9.0) for n in (0, 1))
        ),
        ValueError,
        "Problem.bounds has two constraints named 'a'",
    ),
    "constraint crossed": (
        lambda: raised(ocp.Constraint("a", lambda now: now.time, 1.0, 0.0)),
        ValueError,
        "'a': lower is above upper",
    ),
    "integral of a column": (
        lambda: raised(costs=[ocp.Integral("a", lambda now: now.nodes)]),
        ValueError,
        "'a' gives 18 entries",
    ),
    "integral weight": (
        lambda: ocp.Integral("a", lambda now: now.time, 0.0),
        ValueError,
        "Integral 'a': weight",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_expressions_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
