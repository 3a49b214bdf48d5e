"""Copies of meshes stand where members are: compared with rotations by SciPy."""

from __future__ import annotations

import zlib

import numpy as np
from scipy.spatial.transform import Rotation

from tenscasadi.viewer.poses import (
    ball,
    coarse,
    cone,
    cylinder,
    member_poses,
    node_places,
    octahedron,
)


def test_a_cylinder_is_turned_onto_each_member():
    nodes = np.random.default_rng(0).normal(size=(12, 3))
    nodes[1] = nodes[0] + (0, 0, 2.0)  # along z, and against it
    nodes[3] = nodes[2] - (0, 0, 3.0)
    members = np.array([(0, 1), (2, 3), (4, 5), (6, 7), (8, 9), (10, 11)])
    places, turns, scales = member_poses(nodes, members, 0.1)
    w, x, y, z = turns.T
    ends = (
        Rotation.from_quat(np.stack([x, y, z, w], axis=1)).apply(
            np.array([0, 0, 0.5]) * scales[:, 2:]
        )
        + places
    )
    np.testing.assert_allclose(ends, nodes[members[:, 1]], atol=1e-6)
    np.testing.assert_allclose(scales[:, :2], 0.1, rtol=1e-6)


def test_what_is_lost_has_no_size():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)], dtype=float)
    places, turns, scales = member_poses(nodes, np.array([(0, 1), (1, 2), (2, 3), (0, 0)]), 0.1)
    assert np.isfinite(places).all()
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(scales[:, 2], [1, 0, 0, 0])
    np.testing.assert_array_equal(node_places(nodes)[2:], 0.0)


def test_meshes_are_closed_and_face_outwards():
    for mesh in (cylinder(7), ball(), cone(), octahedron()):
        corners = mesh.vertices[mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = mesh.vertices.mean(axis=0)
        outward = np.einsum("ij,ij->i", normal, corners.mean(axis=1) - middle)
        assert (
            outward[np.linalg.norm(normal, axis=1) > 1e-12] > 0
        ).all()  # at the poles of a ball half of the triangles are lines


def test_rounded_places_stay_near_and_pack_well():
    values = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    rounded = coarse(values, 1e-4)
    assert rounded.dtype == np.float32
    assert np.abs(rounded - values).max() <= 0.5e-4
    assert len(zlib.compress(rounded.tobytes())) < 0.9 * len(zlib.compress(values.tobytes()))
    assert coarse(values, 0.0) is values
