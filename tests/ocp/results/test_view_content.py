"""Plans in pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content

PRISM = tc.shapes.prism(stiffness=1000.0, prestress=50.0)


@pytest.fixture(scope="module")
def plan():
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), ground=tc.Ground(height=-1.0)))
    place = tuple(PRISM.nodes[0] + [0, 0, 0.05])
    goals = [ocp.NodePositions({0: (None, None, place[2])})]
    bounds = [
        ocp.ForceDensityLimits(1.0, 200.0),
        ocp.Obstacle((3.0, 0, 0), 0.5),
        ocp.AboveGround(-0.9),
        ocp.TensionLimits(upper=500.0),
    ]
    problem = ocp.Problem(model, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    return ocp.solve(problem, ocp.Variational(6))


def test_a_plan_shows_its_replay_and_its_problem(plan):
    content = describe_content(plan)
    assert [motion.name for motion in content.motions] == ["replay", "plan"]
    np.testing.assert_array_equal(content.motions[0].nodes, plan.replay().nodes)
    np.testing.assert_array_equal(content.motions[1].nodes, plan.trajectory.nodes)
    assert content.grounds == plan.model.scene.grounds
    ((center, radius),) = content.obstacles
    assert (tuple(center), radius) == ((3.0, 0.0, 0.0), 0.5)
    assert content.boxes[0][0][2] == -0.9
    end = plan.trajectory.nodes[-1, 0]
    np.testing.assert_allclose(content.targets, [(end[0], end[1], PRISM.nodes[0, 2] + 0.05)])


def test_charts_of_a_plan_have_its_limits(plan):
    force_density, tension = describe_content(plan).charts
    assert (force_density.title, force_density.unit) == ("force density", "N/m")
    assert (tension.title, tension.unit) == ("tension of the replay", "N")
    np.testing.assert_array_equal(force_density.values, plan.force_density)
    assert force_density.upper.tolist() == [200.0] * 9
    assert tension.upper.tolist() == [500.0] * 9


def test_targets_of_waypoints_lie_on_the_plan(plan):
    wanted = ocp.NodePositions({0: (None, None, 1.0)})
    half, end = len(plan.time) // 2, len(plan.time) - 1
    for goal, row in (
        (ocp.Waypoint([wanted], share=0.5), half),
        (ocp.Waypoint([wanted.soft()], share=0.5), half),
        (wanted.soft(), end),
    ):
        problem = ocp.Problem(plan.model, goals=[goal])
        x, y, _ = plan.trajectory.nodes[row, 0]
        targets = describe_content(dataclasses.replace(plan, problem=problem)).targets
        np.testing.assert_allclose(targets, [(x, y, 1.0)], atol=1e-12)


def test_targets_of_phases_lie_at_their_ends(plan):
    phases = [ocp.Phase(0.5, goals=[ocp.NodePositions({k: (None, None, 1.0)})]) for k in (0, 1)]
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
    problem = ocp.Problem(model, phases=phases)
    ends = [plan.trajectory.nodes[row, k] for row, k in ((len(plan.time) // 2, 0), (-1, 1))]
    targets = describe_content(dataclasses.replace(plan, problem=problem)).targets
    np.testing.assert_allclose(targets, [(x, y, 1.0) for x, y, _ in ends], atol=1e-12)


def test_a_failed_plan_says_so(plan):
    failed = dataclasses.replace(plan, success=False)
    assert any("no plan was found" in note for note in describe_content(failed).notes)
    assert plan.success
    assert not any("no plan was found" in note for note in describe_content(plan).notes)
