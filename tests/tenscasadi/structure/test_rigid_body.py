"""Input of rigid bodies."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tenscasadi as tc

TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)])


def test_defaults_are_point_masses_on_the_nodes():
    body = tc.RigidBody(range(4), 2.0)
    own = body.mass_properties(TETRAHEDRON)
    arms = TETRAHEDRON - TETRAHEDRON.mean(axis=0)
    np.testing.assert_allclose(own.center, TETRAHEDRON.mean(axis=0))
    np.testing.assert_allclose(own.moments, 0.5 * arms.T @ arms)


def test_a_diagonal_matrix_equals_its_diagonal():
    assert tc.RigidBody((0, 1), 1.0, None, np.diag([1.0, 2.0, 2.5])) == tc.RigidBody(
        [0, 1], 1.0, inertia=(1.0, 2.0, 2.5)
    )


def test_copies_and_pickles_are_equal():
    body = tc.RigidBody(range(4), 2.0, (0.1, 0.2, 0.3), np.diag([1.0, 1.2, 1.1]))
    assert pickle.loads(pickle.dumps(body)) == body  # noqa: S301  own data


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"nodes": 3}, r"RigidBody.nodes is 3: give a list"),
        ({"nodes": (0,)}, "at least two nodes"),
        ({"nodes": (0, 1, 1)}, "node 1 twice"),
        ({"nodes": (0, -1)}, r"nodes\[1\] is -1"),
        ({"nodes": (0, 1.5)}, r"nodes\[1\] is 1.5"),
        ({"mass": 0.0}, "RigidBody.mass is 0: it must be greater than 0"),
        ({"mass": -1.0}, "RigidBody.mass is -1"),
        ({"mass": np.nan}, "RigidBody.mass is nan"),
        ({"center": (0, 0)}, r"RigidBody.center has shape \(2,\)"),
        ({"inertia": (1.0, 1.0)}, r"RigidBody.inertia has shape \(2,\)"),
        ({"inertia": (1.0, 1.0, -0.1)}, "principal moments .* at least 0"),
        ({"inertia": (0.0, 0.0, 0.0)}, "two of them greater"),
        ({"inertia": (1.0, 1.0, 2.1)}, "none may exceed the sum of the others"),
        ({"inertia": np.eye(3) + np.eye(3, k=1)}, "symmetric"),
        ({"faces": [(0, 1)]}, r"RigidBody.faces\[0\] is \(0, 1\): give three different nodes"),
        ({"faces": [(0, 1, 2), (3, 1, 3)]}, r"RigidBody.faces\[1\] .* three different nodes"),
    ],
)
def test_wrong_fields_are_rejected(fields, message):
    usual = {"nodes": (0, 1, 2, 3), "mass": 1.0, "inertia": (1.0, 1.0, 1.0)}
    with pytest.raises((TypeError, ValueError), match=message):
        tc.RigidBody(**usual | fields)


@given(st.lists(st.floats(0.01, 10.0), min_size=3, max_size=3))
def test_any_distribution_of_mass_is_accepted(moments):
    """Second moments of any sign are impossible, positive ones are a body."""
    inertia = sum(moments) - np.array(moments)
    assert tc.RigidBody(range(4), 1.0, None, inertia).mass == 1.0


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3),
)
def test_a_body_follows_its_nodes(turn, shift):
    from scipy.spatial.transform import Rotation

    R = Rotation.from_rotvec(turn).as_matrix()
    inertia = np.array([[0.30, 0.02, -0.01], [0.02, 0.45, 0.03], [-0.01, 0.03, 0.60]])
    body = tc.RigidBody(range(4), 2.0, (0.1, 0.2, 0.3), inertia)
    moved = body.follow(TETRAHEDRON, TETRAHEDRON @ R.T + shift)
    np.testing.assert_allclose(moved.center, R @ body.center + shift, atol=1e-12)
    np.testing.assert_allclose(moved.inertia, R @ inertia @ R.T, atol=1e-12)


def test_files_give_faces_by_name(tmp_path):
    names = ["a", "b", "c", "d"]
    path = tmp_path / "body.toml"
    path.write_text(
        'format = 1\nunits = "SI"\n[structure]\n'
        f"nodes = {np.eye(4, 3).tolist()}\nnode_names = {names}\n"
        f'[[structure.bodies]]\nnodes = {names}\nmass = 1.0\nfaces = [["a", "b", "d"]]\n'
    )
    (body,) = tc.load_scene(path).structure.bodies
    assert body.faces == ((0, 1, 3),)
