"""Orientation and angular velocity of rigid bodies."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscasadi as tc
from tenscasadi.dynamics.body_motion import body_frame

SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.0)])
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.7, 0.4, -0.3]])


@pytest.mark.parametrize("nodes", [SQUARE, SQUARE[:3], CORNERS], ids=["4", "3", "5"])
def test_frame_of_a_rigid_motion_is_exact(nodes):
    rng = np.random.default_rng(0)
    s = tc.Structure(nodes, bodies=[tc.RigidBody(range(len(nodes)), 1.0)])
    frame = body_frame(s, 0)
    for _ in range(3):
        R, spin, drift = Rotation.random(rng=rng).as_matrix(), *rng.normal(size=(2, 3))
        moved = nodes @ R.T + drift
        speeds = drift + np.cross(spin, moved)
        found = (
            frame.rotation(ca.DM(moved.T)),
            frame.angular_velocity(ca.DM(moved.T), ca.DM(speeds.T)),
        )
        np.testing.assert_allclose(found[0].full(), R, atol=1e-13)
        np.testing.assert_allclose(found[1].full().ravel(), spin, atol=1e-13)


def test_trajectory_of_a_steady_rotation(tmp_path):
    nodes, spin = SQUARE - SQUARE.mean(axis=0), np.array([0.0, 0.0, 2.0])
    model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=[tc.RigidBody(range(4), 1.0)])))
    state = model.state(nodes, np.cross(spin, nodes))
    run = tc.simulate(model, 1.0, 1e-2, scheme=tc.DormandPrince853(), state=state)
    expected = Rotation.from_rotvec(run.time[:, None] * spin).as_matrix()
    np.testing.assert_allclose(run.orientation(0), expected, atol=1e-10)
    np.testing.assert_allclose(
        run.angular_velocity(0), np.tile(spin, (len(run.time), 1)), atol=1e-10
    )
    run.save(tmp_path / "run.npz")
    loaded = tc.Trajectory.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(loaded.orientation(0), run.orientation(0))


def test_wrong_bodies_are_rejected():
    rod = tc.RigidBody((0, 1), 1.0)
    plate = tc.RigidBody((1, 2, 3), 1.0)
    model = tc.Model(tc.Scene(tc.Structure(SQUARE, bodies=[rod, plate])))
    run = tc.simulate(model, 0.1, 0.05)
    with pytest.raises(ValueError, match="body 0 is a thin rod"):
        run.orientation(0)
    with pytest.raises(ValueError, match="body is 2: it must be at most 1"):
        run.angular_velocity(2)
    with pytest.raises(TypeError, match="body is 'plate'"):
        run.orientation("plate")
    bare = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), 0.1, 0.05)
    with pytest.raises(ValueError, match="the structure has no bodies"):
        bare.orientation(0)
