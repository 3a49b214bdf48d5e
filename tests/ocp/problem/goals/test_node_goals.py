"""Goals of where nodes are, together or each: met as SciPy integrates the plan, and refused by name where no strings bring them about."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from flights import centre
from planning import driven, integrated, prism, raising

import ocp
import tenscasadi as tc

LIMITS = ocp.ForceDensityLimits(0.0, 200.0)


def planned(model, *goals, duration=0.6, **changes):
    given = {"bounds": [LIMITS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(ocp.Problem(model, duration, goals=goals, **given), ocp.MultipleShooting(20))


def test_the_centre_of_mass_is_put_in_its_place_at_the_end_and_on_the_way():
    model = driven(prism(1.0, pinned=[0, 1, 2], node_mass=[0.1, 0.2, 0.3, 0.4, 0.5, 2.0]))
    begun = centre(model, model.structure.nodes)
    goals = [ocp.CenterOfMass((begun[0] + 0.01, None, begun[2] - 0.02)), ocp.AtRest()]
    plan = planned(
        model, *goals, ocp.Waypoint([ocp.CenterOfMass((None, begun[1] + 0.01, None))], share=0.5)
    )
    assert plan.success, plan.message
    ended, passed = (centre(model, model.nodes(integrated(plan, share))) for share in (1.0, 0.5))
    assert ended[[0, 2]] == pytest.approx([begun[0] + 0.01, begun[2] - 0.02], abs=2e-4)
    assert passed[1] == pytest.approx(begun[1] + 0.01, abs=1e-3)


def test_a_node_passes_a_place_at_a_velocity():
    model = driven(prism(1.0, pinned=[0, 1, 2]))
    place, velocity = model.structure.nodes[3] + [0.0, 0.0, 0.01], (None, 0.1, 0.15)
    goals = [
        ocp.Waypoint([ocp.NodePositions({3: (None, None, place[2])})], share=1.0),
        ocp.NodeVelocities({3: velocity}),
    ]
    plan = planned(model, *goals)
    assert plan.success, plan.message
    ended = integrated(plan)
    assert model.nodes(ended)[3, 2] == pytest.approx(place[2], abs=2e-4)
    assert model.velocities(ended)[3, 1:] == pytest.approx(velocity[1:], abs=1e-3)


def test_a_waypoint_at_the_end_is_a_goal_of_the_end():
    def found(*goals):
        return ocp.solve(raising(goals=goals), ocp.Variational(10))

    goals = raising().goals
    plain = found(*goals)
    for when in ({"share": 1.0}, {"time": 1.0}, {"share": 1 - 1e-12}):
        again = found(ocp.Waypoint(goals, **when))
        assert again.objective == pytest.approx(plain.objective, rel=1e-9)
        assert again.replay_error == pytest.approx(plain.replay_error, rel=1e-3)


def test_strings_do_not_give_what_is_free_a_speed():
    with pytest.raises(
        ocp.InfeasibleGoalError,
        match=r"NodeVelocities: node . x misses its goal by .* as the center of mass keeps its speed along x",
    ):
        planned(driven(prism(1.0)), ocp.NodeVelocities(np.tile([1.0, 0.0, 0.0], (6, 1))))


def test_masses_inside_strings_count():
    structure = prism(1.0, string_mass=0.5)
    model = driven(structure, segments=2)
    problem = ocp.Problem(model, goals=[ocp.CenterOfMass((None, None, 0.5))])
    assert np.sum(problem.goals[0].masses) == pytest.approx(
        structure.bar_mass.sum() + structure.string_mass.sum()
    )
    assert len(problem.goals[0].masses) == len(model.structure.nodes)


def test_strings_do_not_move_the_centre_of_mass_of_what_is_free():
    model = driven(prism(1.0))
    height = centre(model, model.structure.nodes)[2]
    with pytest.raises(
        ocp.InfeasibleGoalError,
        match=r"CenterOfMass: z misses its goal by 0\.1 m at best, as the center of mass follows",
    ):
        planned(model, ocp.CenterOfMass((None, None, height + 0.1)))
    with pytest.raises(
        ocp.InfeasibleGoalError, match=r"waypoint at 0\.5 of the duration: CenterOfMass: x misses"
    ):
        planned(model, ocp.Waypoint([ocp.CenterOfMass((9.0, None, None))], share=0.5))


def test_what_falls_is_where_galilei_says():
    model = driven(prism(1.0), gravity=tc.Gravity((0, 0, -9.81)))
    height = centre(model, model.structure.nodes)[2]
    plan = planned(model, ocp.CenterOfMass((None, None, height - 9.81 * 0.6**2 / 2)))
    assert plan.success, plan.message
    with pytest.raises(
        ocp.InfeasibleGoalError, match=r"CenterOfMass: z misses its goal by 1\.77 m at best"
    ):
        planned(model, ocp.CenterOfMass((None, None, height)))


def test_files_and_pickles_hold_them(tmp_path):
    model = driven(prism(1.0, pinned=[0, 1, 2]))
    height = centre(model, model.structure.nodes)[2]
    plan = planned(model, ocp.CenterOfMass((None, None, height - 0.01)))
    plan.save(tmp_path / "plan.npz")
    again = ocp.Plan.load(tmp_path / "plan.npz").problem.goals[0]
    assert again.position == (None, None, height - 0.01)
    assert np.array_equal(again.masses, deepcopy(plan.problem).goals[0].masses)


BAD = {
    "two coordinates": (
        lambda: ocp.CenterOfMass((1.0, 2.0)),
        ValueError,
        "CenterOfMass.position .* give three coordinates",
    ),
    "no coordinate": (
        lambda: ocp.CenterOfMass((None, None, None)),
        ValueError,
        "CenterOfMass.position",
    ),
    "no place": (lambda: ocp.CenterOfMass(1.0), TypeError, "CenterOfMass.position is 1.0"),
    "no mass": (
        lambda: ocp.CenterOfMass((1.0, None, None), np.zeros(6)),
        ValueError,
        "CenterOfMass.masses are all 0",
    ),
    "two components": (
        lambda: ocp.NodeVelocities({0: (1.0, 2.0)}),
        ValueError,
        r"NodeVelocities.velocities\[0\] .* give three",
    ),
    "no velocity": (
        lambda: ocp.NodeVelocities({}),
        ValueError,
        r"NodeVelocities.velocities is empty: give {node: \(vx, vy, vz\)}",
    ),
    "velocity of no node": (
        lambda: planned(driven(prism(1.0)), ocp.NodeVelocities({9: (1.0, 0, 0)})),
        ValueError,
        "velocities: node is 9",
    ),
    "velocity of a pin": (
        lambda: planned(driven(prism(1.0, pinned=[2])), ocp.NodeVelocities({2: (1.0, 0, 0)})),
        ValueError,
        "wants x = 1 m/s of node 2, which is pinned along it: leave that axis None",
    ),
    "few masses": (
        lambda: planned(driven(prism(1.0)), ocp.CenterOfMass((1.0, None, None), np.ones(5))),
        ValueError,
        "CenterOfMass.masses has 5",
    ),
    "many masses": (
        lambda: planned(driven(prism(1.0)), ocp.CenterOfMass((1.0, None, None), np.ones(7))),
        ValueError,
        r"CenterOfMass.masses .* \(6",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_goals_of_nodes_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
