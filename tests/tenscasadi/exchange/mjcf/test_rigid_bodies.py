"""Rigid bodies in files for MuJoCo, there and back."""

from __future__ import annotations

from itertools import product
from pathlib import Path
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


def compare_motion(path: Path, sites: tuple[str, ...], t_end: float = 0.3) -> float:
    """Largest distance [m] of sites between MuJoCo's motion of a file and ours."""
    mujoco = pytest.importorskip("mujoco")
    world = mujoco.MjModel.from_xml_path(str(path))
    world.opt.timestep, world.opt.integrator = 2e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(world)
    mujoco.mj_kinematics(world, data)
    start = np.array([data.site(name).xpos for name in sites])
    scene = tc.import_mjcf(path)
    nodes = scene.structure.nodes
    at = [int(np.argmin(np.linalg.norm(nodes - place, axis=1))) for place in start]
    np.testing.assert_allclose(nodes[at], start, atol=1e-9)
    run = tc.simulate(tc.Model(scene), t_end, 2e-4, correction=tc.Projection(), compiled=False)
    assert run.success, run.message
    mujoco.mj_step(world, data, round(t_end / 2e-4))
    mujoco.mj_kinematics(world, data)
    ends = np.array([data.site(name).xpos for name in sites])
    assert np.linalg.norm(ends - start, axis=1).max() > 0.02
    return float(np.linalg.norm(run.nodes[-1, at] - ends, axis=1).max())


FLAGS = '<mujoco><option><flag contact="disable"/></option><worldbody>'
ROD = '<geom type="capsule" size="0.05" fromto="0 0 0 0.5 0 0" mass="1.5"/>'
HINGED = {
    "door": f"""{FLAGS}<body pos="0 0 1"><joint type="hinge" axis="0 1 0.3" pos="-0.1 0 0"/>
      <geom type="box" size="0.2 0.1 0.05" pos="0.15 0 0" mass="2"/><site name="a" pos="0.2 0.1 0"/>
      <site name="b" pos="0.2 -0.1 0.1"/></body></worldbody><tendon><spatial stiffness="20"
      springlength="0 0.1"><site site="a"/><site site="w"/></spatial><spatial stiffness="5"><site
      site="b"/><site site="w"/></spatial></tendon></mujoco>""".replace(
        "<worldbody>", '<worldbody><site name="w" pos="0.3 0.8 1"/>'
    ),
    "two rods": f"""{FLAGS}<body><joint type="hinge" axis="0 1 0"/>{ROD}<site name="a" pos="0.5 0 0"/>
      <body pos="0.5 0 0"><joint type="hinge" axis="0 1 1"/>{ROD}<site name="b" pos="0.5 0 0"/></body>
      </body></worldbody></mujoco>""",
    "hinge of a hanging rod": f"""{FLAGS}<body><joint type="ball"/>{ROD}<site name="a" pos="0.5 0 0"/>
      <body pos="0.5 0 0"><joint type="hinge" axis="0 0 1"/>{ROD}<body pos="0.5 0 0" euler="0 90 90">
      {ROD}<site name="b" pos="0.5 0 0"/></body></body></body></worldbody></mujoco>""",
    "welded cross": f"""{FLAGS}<site name="w" pos="0 0 2"/><body name="one"><freejoint/>{ROD}
      <site name="a" pos="0.5 0 0"/></body><body name="two" euler="0 0 90"><freejoint/>{ROD}
      <site name="b" pos="0.5 0 0"/></body></worldbody><equality><weld body1="one" body2="two"
      solref="0.001 1" solimp="0.9999 0.9999 0.001 0.5 2"/></equality><tendon><spatial stiffness="30">
      <site site="a"/><site site="w"/></spatial></tendon></mujoco>""",
}


@pytest.mark.parametrize("name", sorted(HINGED))
def test_hinges_and_fixed_bodies_move_as_in_mujoco(name, tmp_path):
    path = tmp_path / "hinged.xml"
    path.write_text(HINGED[name], encoding="utf-8")
    soft = name == "welded cross"
    assert compare_motion(path, ("a", "b")) < (2e-3 if soft else 1e-6)


def test_hinged_bodies_are_read_back(tmp_path):
    scene = platform((0, 1))
    again = tc.import_mjcf(tc.export_mjcf(scene, tmp_path / "plate.xml"))
    s, back = scene.structure, again.structure
    np.testing.assert_allclose(back.nodes, s.nodes, atol=1e-12)
    assert (back.pinned, back.bodies[0].nodes) == (s.pinned, s.bodies[0].nodes)
    options = {"t_end": 0.2, "step": 1e-3, "compiled": False}
    runs = [tc.simulate(tc.Model(each), **options).nodes for each in (scene, again)]
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)


def test_bodies_that_share_an_axis_are_read_back(tmp_path):
    box = {"mass": 2.0, "inertia": (0.05, 0.06, 0.07)}
    nodes = [(0, 0, 0), (0, 1, 0), (0.5, 0, -1), (0.5, 1, -1), (1, 0.2, -2), (1, 0.8, -1.5)]
    bodies = [tc.RigidBody((0, 1, 2, 3), **box), tc.RigidBody((2, 3, 4, 5), **box)]
    s = tc.Structure(nodes, pinned=(0, 1), bodies=bodies)
    again = tc.import_mjcf(tc.export_mjcf(tc.Scene(s), tmp_path / "doors.xml")).structure
    assert [body.nodes for body in again.bodies] == [body.nodes for body in bodies]
    np.testing.assert_allclose(again.nodes, s.nodes, atol=1e-12)


@pytest.mark.parametrize("pinned", [(), (7,)], ids=["free", "ball"])
def test_bodies_touch_the_ground_alike(pinned, tmp_path):
    corners = np.array(list(product((0, 0.4), (0, 0.3), (0, 0.2))))
    turn = np.linalg.qr([[1.0, 0.2, 0.1], [-0.2, 1.0, 0.3], [0.0, -0.3, 1.0]])[0]
    nodes = corners @ turn.T
    nodes[:, 2] -= nodes[:, 2].min()
    body = tc.RigidBody(range(8), 2.0, inertia=(0.02, 0.03, 0.04))
    mass = np.where(np.arange(8) == 0, 0.1, 0.0)
    s = tc.Structure(nodes, pinned=pinned, bodies=[body], node_mass=mass)
    ground = tc.Ground(stiffness=2e3, damping=1.0)
    scene = tc.Scene(s, gravity=tc.Gravity(), ground=ground)
    assert differences(scene, tmp_path / "box.xml", t_end=0.15)[-1] < 1e-4
    (again,) = tc.import_mjcf(tmp_path / "box.xml").grounds
    assert again.stiffness == pytest.approx(2e3)
    assert (again.damping, again.nodes) == (pytest.approx(1.0), None)


def test_unsupported_bodies_are_rejected(tmp_path):
    s = platform().structure.replace(pinned={0: "z", 3: "xyz", 4: "xyz", 5: "xyz"})
    with pytest.raises(ValueError, match="node 0 of a body"):
        tc.export_mjcf(tc.Scene(s), tmp_path / "plate.xml")
