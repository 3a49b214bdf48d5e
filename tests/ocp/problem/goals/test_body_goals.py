"""Goals and limits of rigid bodies, and plans of a plate on six strings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ocp
import tenscasadi as tc

ANGLE = np.deg2rad([90, 210, 330])
PLATE = 0.4 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE), np.zeros(3)])
FRAME = 0.8 * np.column_stack(
    [np.cos(ANGLE + np.pi / 3), np.sin(ANGLE + np.pi / 3), np.ones(3) / 0.8]
)
STRINGS = [(0, 3), (1, 4), (2, 5), (0, 5), (1, 3), (2, 4)]


def platform(*more: object) -> tc.Model:
    """A plate on six strings under gravity; `more` are additional nodes of the plate."""
    nodes = np.vstack([PLATE, FRAME, *more])
    plate = tc.RigidBody((0, 1, 2, *range(6, len(nodes))), 3.0, (0, 0, 0), (0.1, 0.1, 0.18))
    s = tc.Structure(nodes, strings=STRINGS, pinned=(3, 4, 5), bodies=[plate])
    return tc.Model(tc.Scene(s, gravity=tc.Gravity(), control=tc.ForceDensity()))


def turn(model: tc.Model, rotation: object, **more: object) -> ocp.Plan:
    """Plan a turn of the plate, which also rises."""
    height = ocp.NodePositions({0: (None, None, 0.1)})
    goals = [ocp.BodyOrientation(0, rotation), height, ocp.AtRest()]
    bounds = [ocp.ForceDensityLimits(1.0, 200.0), *more.pop("bounds", [])]
    problem = ocp.Problem(model, 1.0, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    return ocp.solve(problem, **more)


@pytest.mark.parametrize("more", [(), ((0, 0, 0),), ((0, 0, 0.1),)], ids=["3", "flat", "4"])
def test_plate_on_six_strings_turns(more):
    rotation = Rotation.from_euler("zyx", [20, 5, 0], degrees=True)
    plan = turn(platform(*more), rotation.as_rotvec())
    assert plan.success, plan.message
    assert plan.replay_error < 1e-3
    replay = plan.replay()
    np.testing.assert_allclose(replay.orientation(0)[-1], rotation.as_matrix(), atol=1e-3)
    assert np.abs(replay.angular_velocity(0)[-1]).max() < 1e-2


def test_spin_stays_within_a_limit():
    limit = ocp.Constraint("spin", lambda now: now.angular_velocity(0)[2], upper=0.5)
    free = turn(platform(), (0, 0, 0.4))
    limited = turn(platform(), (0, 0, 0.4), bounds=[limit])
    assert limited.success, limited.message
    assert free.trajectory.angular_velocity(0)[:, 2].max() > 0.55
    assert limited.trajectory.angular_velocity(0)[:, 2].max() < 0.5 + 1e-3


def test_orientation_is_a_constraint_along_the_way():
    limit = ocp.Constraint("turn", lambda now: now.orientation(0)[0, 1], lower=-0.41)
    assert turn(platform(), (0, 0, 0.4), bounds=[limit]).success


def test_center_of_mass_off_the_plane_of_the_nodes_is_rejected():
    nodes = np.vstack([PLATE, FRAME])
    for height, fits in ((0.0, True), (0.1, False)):
        plate = tc.RigidBody((0, 1, 2), 3.0, (0, 0, height), (0.1, 0.1, 0.18))
        s = tc.Structure(nodes, strings=STRINGS, pinned=(3, 4, 5), bodies=[plate])
        model = tc.Model(tc.Scene(s, control=tc.ForceDensity()))
        goal = ocp.CenterOfMass((None, None, 0.1))
        if fits:
            assert goal.bind(model, None).masses.sum() == pytest.approx(3.0)
        else:
            with pytest.raises(ValueError, match="off the plane of its nodes"):
                goal.bind(model, None)


def test_matrix_and_rotation_vector_agree():
    vector = (0.3, -0.2, 0.5)
    matrix = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(ocp.BodyOrientation(0, vector).matrix, matrix, atol=1e-15)
    np.testing.assert_array_equal(ocp.BodyOrientation(0, matrix).matrix, matrix)
    np.testing.assert_array_equal(ocp.BodyOrientation(0, (0, 0, 0)).matrix, np.eye(3))


def test_goal_moves_nodes_to_its_orientation():
    s = platform().structure
    goal = ocp.BodyOrientation(0, (0, 0, 0.5))
    moved = goal.move(s, s.nodes + [1, 2, 3])
    rows = goal.rows(s, moved.T, 0 * moved.T).value
    np.testing.assert_allclose(np.array(rows), 0, atol=1e-12)
    np.testing.assert_array_equal(moved[3:], s.nodes[3:] + [1, 2, 3])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ((-1, (0, 0, 0)), "BodyOrientation.body is -1"),
        ((0, (0, 0)), r"rotation has shape \(2,\)"),
        ((0, 2 * np.eye(3)), "orthonormal with determinant 1"),
        ((0, np.diag([1, 1, -1])), "orthonormal with determinant 1"),
    ],
)
def test_wrong_fields_are_rejected(fields, message):
    with pytest.raises(ValueError, match=message):
        ocp.BodyOrientation(*fields)


def test_a_body_that_does_not_exist_is_rejected():
    with pytest.raises(ValueError, match="body is 1: it must be at most 0"):
        ocp.Problem(platform(), 1.0, goals=[ocp.BodyOrientation(1, (0, 0, 0))])


def test_problem_files_hold_the_goal(tmp_path):
    goals = [ocp.BodyOrientation(0, (0, 0, 0.5)), ocp.AtRest()]
    problem = ocp.Problem(platform(), 1.0, goals=goals, costs=[ocp.Effort()])
    ocp.save_problem(problem, tmp_path / "plate.toml")
    again = ocp.load_problem(tmp_path / "plate.toml")
    np.testing.assert_array_equal(again.goals[0].rotation, (0, 0, 0.5))
    assert again.model.structure.bodies == problem.model.structure.bodies


@pytest.mark.slow
def test_spine_of_vertebrae_bends():
    """Each vertebra of four tips hangs in eight strings; the lowest one is pinned."""
    tips = 0.1 * np.array([(1, 1, -1), (-1, -1, -1), (1, -1, 1), (-1, 1, 1)])
    nodes = np.vstack([tips + (0, 0, 0.12 * k) for k in range(3)])
    strings = [
        (4 * k + i, 4 * k + 4 + j)
        for k in range(2)
        for i, j in [*((tip, tip) for tip in range(4)), (2, 0), (2, 1), (3, 0), (3, 1)]
    ]
    bodies = [
        tc.RigidBody(range(4 * k, 4 * k + 4), 0.3, (0, 0, 0.12 * k), (2e-3, 2e-3, 2e-3))
        for k in (1, 2)
    ]
    s = tc.Structure(nodes, strings=strings, pinned=range(4), bodies=bodies)
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity(), control=tc.ForceDensity()))
    problem = ocp.Problem(
        model,
        0.5,
        goals=[ocp.BodyOrientation(1, (0, 0.3, 0)), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(2.0, 300.0)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    expected = Rotation.from_rotvec((0, 0.3, 0)).as_matrix()
    np.testing.assert_allclose(plan.replay().orientation(1)[-1], expected, atol=1e-3)


def test_contact_nodes_on_bodies_are_rejected():
    s = tc.Structure(0.1 * np.eye(4, 3), strings=[(0, 3)], bodies=[tc.RigidBody(range(4), 1.0)])
    ground = tc.Ground(friction=0.5)
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity(), ground=ground, control=tc.ForceDensity()))
    with pytest.raises(ValueError, match="node 3 of a rigid body"):
        ocp.Problem(model, phases=[ocp.Phase((0.1, 0.5), contact_nodes=[3])])
