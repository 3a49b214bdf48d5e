"""Soft goals: costs of what is missed, which tell how much, and count neither as goals nor in success."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, integrated, prism, raising

import ocp

LENGTHS = ocp.StringLengths(prism(1.1).string_lengths)
REST = ocp.AtRest()


def planned(*goals, problem=None, **changes):
    return ocp.solve(
        raising(goals=goals, **changes) if problem is None else problem, ocp.Variational(16)
    )


def misses(plan, share=1.0):
    nodes = plan.model.nodes(integrated(plan, share))
    ends = nodes[plan.structure.strings]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) - LENGTHS.lengths


def test_a_wish_costs_what_it_is_missed_by():
    """The objective is effort and weight times miss², as SciPy integrates the plan; more weight, less miss."""
    met = planned(LENGTHS, REST)
    light, heavy = (planned(LENGTHS.soft(weight), REST) for weight in (1e3, 1e5))
    assert light.success
    assert heavy.success
    assert np.abs(misses(met)).max() < np.abs(misses(heavy)).max() < np.abs(misses(light)).max()
    for plan, weight in ((light, 1e3), (heavy, 1e5)):
        effort = np.sum(plan.force_density**2) / 16
        assert plan.objective == pytest.approx(
            effort + weight * np.sum(misses(plan) ** 2), rel=2e-3
        )
        missed = plan.report().missed
        assert sum(row.cost for row in missed) == pytest.approx(
            weight * np.sum(misses(plan) ** 2), rel=0.05
        )
        assert missed[0].miss == pytest.approx(np.abs(misses(plan)).max(), rel=0.05)
        assert f"missed by {missed[0].miss:.4g} m, costs" in str(plan.report())


def test_wishes_on_the_way_and_speeds():
    shape = [ocp.Shape(prism(1.0).nodes), REST]
    plain = planned(*shape)
    waypoint = ocp.Waypoint([LENGTHS], share=0.45).soft(1e6)
    plan = planned(waypoint, *shape)
    assert plan.success, plan.message
    assert np.abs(misses(plan, 0.45)).max() < 0.3 * np.abs(misses(plain, 0.45)).max()
    assert (
        plan.report()
        .missed[0]
        .name.startswith("waypoint at 0.45 of the duration, StringLengths: string ")
    )
    assert plan.problem.waypoints == []
    mixed = raising(goals=[ocp.Waypoint([LENGTHS, REST.soft(10.0)], share=0.5)])
    assert [len(goals) for _, goals in mixed.waypoints] == [1]


def test_a_wish_that_no_strings_meet_is_no_reason_to_fail():
    away = prism(1.0).nodes + [0.0, 0.0, 1.0]
    with pytest.raises(ocp.InfeasibleGoalError):
        planned(ocp.NodePositions(away), REST)
    plan = planned(ocp.NodePositions(away).soft(1e3), REST, model=driven(prism(1.0)))
    assert plan.success
    assert plan.replay_error < 1e-3
    assert plan.report().missed[0].miss > 0.5


def test_wishes_may_stand_with_costs():
    """Also those that need the model, and the start."""
    for wish in (ocp.CenterOfMass((None, None, 0.6)), ocp.Periodic()):
        among_goals, among_costs = (
            raising(goals=[wish.soft(1e3)]),
            raising(goals=(), costs=[ocp.Effort(), wish.soft(1e3)]),
        )
        one, other = (planned(problem=problem).objective for problem in (among_goals, among_costs))
        assert one == pytest.approx(other, rel=1e-9)


def test_wishes_are_kept_in_files_and_by_changed_problems(tmp_path):
    plan = planned(ocp.Waypoint([LENGTHS.soft(2e4)], share=0.5), LENGTHS.soft(1e5), REST)
    plan.save(tmp_path / "plan.npz")
    again = ocp.Plan.load(tmp_path / "plan.npz")
    assert [(row.name, row.cost) for row in again.report().missed] == [
        (row.name, row.cost) for row in plan.report().missed
    ]
    assert planned(problem=again.problem).objective == pytest.approx(plan.objective, rel=1e-6)
    assert len(again.problem.costs) == 3


BAD = {
    "weight": (lambda: REST.soft(0.0), ValueError, "SoftGoal.weight"),
    "twice": (lambda: REST.soft().soft(), TypeError, "SoftGoal.goal"),
    "waypoint": (
        lambda: ocp.SoftGoal(ocp.Waypoint([REST], share=0.5)),
        TypeError,
        "SoftGoal.goal is Waypoint",
    ),
    "free time": (
        lambda: raising(goals=[ocp.Waypoint([REST.soft()], time=(0.2, 0.3))]),
        ValueError,
        "a range as Waypoint.time makes phases",
    ),
    "period as a cost": (
        lambda: raising(start=ocp.FreeStart(), costs=[ocp.Periodic().soft()]),
        ValueError,
        "and the start is free",
    ),
    "start": (
        lambda: ocp.FreeStart(goals=[REST.soft()]),
        TypeError,
        r"FreeStart.goals\[0\] is a SoftGoal",
    ),
    "other nodes": (
        lambda: raising(goals=[ocp.NodePositions({9: (0, 0, 0)}).soft()]),
        ValueError,
        "node is 9",
    ),
    "period": (
        lambda: raising(start=ocp.FreeStart(), goals=[ocp.Periodic().soft()]),
        ValueError,
        r"Periodic\(\).soft\(\), and the start is free",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_wishes_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
