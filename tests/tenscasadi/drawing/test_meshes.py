"""Meshes face outward, and their poses agree with SciPy's rotations."""

from __future__ import annotations

import zlib

import numpy as np
from scipy.spatial.transform import Rotation

from tenscasadi.drawing.meshes import (
    build_ball,
    build_cone,
    build_cylinder,
    place_balls,
    round_floats,
    stretch_cylinders,
)


def test_cylinders_end_at_the_members():
    ends = np.random.default_rng(0).normal(size=(6, 2, 3))
    ends[0, 1] = ends[0, 0] + (0, 0, 2.0)  # along z, and against it
    ends[1, 1] = ends[1, 0] - (0, 0, 3.0)
    poses = stretch_cylinders(ends, np.full(6, 0.1))
    w, x, y, z = poses.quaternions.T
    turns = Rotation.from_quat(np.stack([x, y, z, w], axis=1))
    tips = turns.apply(np.array([0, 0, 0.5]) * poses.scales[:, 2:]) + poses.positions
    np.testing.assert_allclose(tips, ends[:, 1], atol=1e-6)
    np.testing.assert_allclose(poses.scales[:, :2], 0.1, rtol=1e-6)


def test_infinite_positions_have_no_size():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)], dtype=float)
    poses = stretch_cylinders(nodes[[(0, 1), (1, 2), (2, 3), (0, 0)]], np.full(4, 0.1))
    assert np.isfinite(poses.positions).all()
    np.testing.assert_allclose(np.linalg.norm(poses.quaternions, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(poses.scales[:, 2], [1, 0, 0, 0])
    balls = place_balls(nodes, np.ones(4))
    assert np.isfinite(balls.positions).all()
    np.testing.assert_array_equal(balls.scales[:, 0], [1, 1, 0, 0])


def test_meshes_face_outward():
    for mesh in (build_cylinder(7), build_ball(), build_cone(), build_ball(2, 4)):
        corners = mesh.vertices[mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = mesh.vertices.mean(axis=0)
        outward = np.einsum("ij,ij->i", normal, corners.mean(axis=1) - middle)
        has_area = np.linalg.norm(normal, axis=1) > 1e-12  # not the lines at the poles of a ball
        assert (outward[has_area] > 0).all()


def test_rounded_values_are_close_and_compress_well():
    values = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    rounded = round_floats(values, 1e-4)
    assert rounded.dtype == np.float32
    assert np.abs(rounded - values).max() <= 0.5e-4
    assert len(zlib.compress(rounded.tobytes())) < 0.9 * len(zlib.compress(values.tobytes()))
    poses = place_balls(values, np.ones(5000))
    assert poses.round(0.0) is poses
    np.testing.assert_array_equal(poses.round(1e-4).positions, rounded)
