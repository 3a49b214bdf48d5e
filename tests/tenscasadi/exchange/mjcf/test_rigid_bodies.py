"""Rigid bodies in files for MuJoCo, there and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mujoco_runs import differences

import tenscasadi as tc

ANGLE = np.deg2rad([90, 210, 330])
PLATE = 0.4 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE), np.zeros(3)])
FRAME = 0.8 * np.column_stack(
    [np.cos(ANGLE + np.pi / 3), np.sin(ANGLE + np.pi / 3), np.ones(3) / 0.8]
)
STRINGS = [(0, 3), (1, 4), (2, 5), (0, 5), (1, 3), (2, 4)]
INERTIA = np.array([[0.10, 0.01, 0.0], [0.01, 0.12, 0.02], [0.0, 0.02, 0.18]])


def platform(pinned: tuple[int, ...] = (), more: Any = ((0, 0, -0.3),), **options: Any) -> tc.Scene:
    """A body on six strings; some of its nodes may be pinned."""
    nodes = np.vstack([PLATE, FRAME, *more])
    body = tc.RigidBody((0, 1, 2, *range(6, len(nodes))), 3.0, (0.05, 0, -0.05), INERTIA)
    s = tc.Structure(
        nodes,
        strings=STRINGS,
        pinned=(3, 4, 5, *pinned),
        bodies=[body],
        stiffness=60.0,
        rest_length=0.3,
        node_mass=np.where(np.arange(len(nodes)) == 6, 0.2, 0.0),
    )
    return tc.Scene(s, gravity=tc.Gravity(), **options)


@pytest.mark.parametrize("pinned", [(), (6,), (0, 1)], ids=["free", "ball", "hinge"])
def test_mujoco_moves_a_body_alike(pinned, tmp_path):
    scene = platform(pinned)
    coarse, fine = differences(scene, tmp_path / "plate.xml")
    assert fine < 1e-8
    assert fine < 0.3 * coarse or coarse < 1e-9


def test_mujoco_starts_with_the_velocities(tmp_path):
    scene = platform()
    s = scene.structure
    V = np.cross((0.5, -1.0, 2.0), s.nodes) + (0.1, 0.2, 0.3)
    V[3:6] = 0.0
    assert differences(scene, tmp_path / "plate.xml", V)[-1] < 1e-8


def test_joints_of_bodies_converge(tmp_path):
    """A second body and a bar hang on the first one; MuJoCo's connect is soft."""
    base = platform((6,)).structure
    nodes = np.vstack(
        [base.nodes, (0.2, 0.4, -0.2), (0.1, 0.5, -0.4), (-0.1, 0.6, -0.1), (-0.4, -0.2, -0.5)]
    )
    s = tc.Structure(
        nodes,
        bars=[(1, 10)],
        pinned=(6,),
        bodies=[
            base.bodies[0],
            tc.RigidBody((0, 7, 8, 9), 0.5, (0.05, 0.5, -0.2), (0.01, 0.012, 0.015)),
        ],
        node_mass=np.where((np.arange(11) > 2) & (np.arange(11) < 6), 1.0, 0.0),
    )
    coarse, fine = differences(tc.Scene(s, gravity=tc.Gravity()), tmp_path / "joints.xml")
    assert fine < 2e-3
    assert fine < 0.7 * coarse


def test_files_are_read_back(tmp_path):
    scene = platform()
    again = tc.import_mjcf(tc.export_mjcf(scene, tmp_path / "plate.xml"))
    s, back = scene.structure, again.structure
    np.testing.assert_allclose(back.nodes, s.nodes, atol=1e-12)
    np.testing.assert_array_equal(back.strings, s.strings)
    np.testing.assert_allclose(back.node_mass, s.node_mass)
    (body,), (given,) = back.bodies, s.bodies
    assert body.nodes == given.nodes
    assert body.mass == pytest.approx(given.mass)
    np.testing.assert_allclose(body.center, given.center, atol=1e-12)
    np.testing.assert_allclose(body.inertia, given.inertia, atol=1e-9)
    assert back.pinned == s.pinned


def test_bodies_with_geoms_are_read(tmp_path):
    text = """<mujoco><worldbody><site name="top" pos="0 0 2"/>
      <body pos="0 0 1"><freejoint/><geom type="box" size="0.2 0.1 0.05" mass="2"/>
        <site name="a" pos="0.2 0.1 0.05"/><site name="b" pos="-0.2 0.1 0.05"/>
        <site name="c" pos="0 -0.1 0.05"/></body></worldbody>
      <tendon><spatial stiffness="10" springlength="0 1"><site site="top"/><site site="a"/></spatial>
      <spatial stiffness="10" springlength="0 1"><site site="top"/><site site="b"/></spatial>
      <spatial stiffness="10" springlength="0 1"><site site="top"/><site site="c"/></spatial></tendon></mujoco>"""
    path = tmp_path / "box.xml"
    path.write_text(text, encoding="utf-8")
    (body,) = tc.import_mjcf(path).structure.bodies
    assert len(body.nodes) == 3
    assert body.mass == pytest.approx(2.0)
    np.testing.assert_allclose(body.center, (0, 0, 1), atol=1e-12)
    expected = 2 / 3 * np.array([0.1**2 + 0.05**2, 0.2**2 + 0.05**2, 0.2**2 + 0.1**2])
    np.testing.assert_allclose(body.inertia, expected, atol=1e-12)


def test_unsupported_bodies_are_rejected(tmp_path):
    with pytest.raises(ValueError, match="no contact of bodies"):
        tc.export_mjcf(platform(ground=tc.Ground(height=-3.0)), tmp_path / "plate.xml")
    s = platform().structure.replace(pinned={0: "z", 3: "xyz", 4: "xyz", 5: "xyz"})
    with pytest.raises(ValueError, match="node 0 of a body"):
        tc.export_mjcf(tc.Scene(s), tmp_path / "plate.xml")
