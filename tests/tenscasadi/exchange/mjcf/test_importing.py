"""Tensegrities from MuJoCo's files: the same scene back, files as others write them, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjcf_files import file

import tenscasadi as tc
from tenscasadi.exchange.mjcf.bodies import Bodies
from tenscasadi.exchange.mjcf.elements import read_elements
from tenscasadi.exchange.mjcf.frames import Units
from tenscasadi.exchange.mjcf.words import Defaults
from tenscasadi.exchange.source import Source
from tenscasadi.structure.structure import PARAMETERS

LAW = {"stiffness": 1000.0, "prestress": 50.0}
FEET = {0: "xyz", 1: "xyz", 2: "xyz"}
masses = [0.1, 0.2, 0.3, 0.0, 0.5, 0.6]
STRUCTURES: dict[str, tc.Structure] = {
    "prism": tc.shapes.prism(**LAW),
    "thick bars and masses": tc.shapes.prism(
        bar_radius=0.05, bar_mass=[1.0, 2.0, 3.0], node_mass=masses, damping=0.5, **LAW
    ),
    "thin bars": tc.shapes.prism(bar_radius=[1e-4, 1e-3, 0.0], **LAW),
    "ball": tc.shapes.six_bar_ball(**LAW),
    "D-bar": tc.shapes.d_bar(pinned=[0], **LAW),
    "T-bar": tc.shapes.t_bar(node_mass=0.2, **LAW),
    "pendulum": tc.shapes.double_pendulum(),
    "mast": tc.shapes.prism(pinned=FEET, node_mass=masses, **LAW),
    "rolling": tc.shapes.prism(pinned={0: "z", 1: "z", 2: "xz"}, **LAW),
    "membrane": tc.shapes.membrane(p=4, q=3, pinned={0: "xyz", 1: "z", 2: "xy"}),
    "pinned nodes alone": tc.Structure(
        [(0, 0, 0), (0, 0, -1), (1, 0, 0), (2, 0, 0)],
        [(0, 1)],
        node_mass=[0, 0, 1, 2],
        pinned=[0, 2, 3],
    ),
    "point": tc.Structure([(1, 2, 3)], node_mass=2.0),
}


def assert_same(one: tc.Structure, other: tc.Structure) -> None:
    for name in PARAMETERS:
        if name.endswith("_names"):
            continue
        given, found = getattr(one, name), getattr(other, name)
        if name in ("pinned", "rollers", "string_mass"):
            assert name == "string_mass" or given == found
        elif name in ("bars", "strings"):
            assert np.array_equal(given, found)
        else:
            assert found == pytest.approx(given, abs=1e-13, rel=1e-12), name


@pytest.mark.parametrize("joints", ["ball", "connect"])
@pytest.mark.parametrize("name", STRUCTURES)
def test_what_was_written_reads_back_the_same(name: str, joints: Any, tmp_path: Path) -> None:
    scene = tc.Scene(STRUCTURES[name], gravity=tc.Gravity((0.5, 0, -9.81)))
    found = tc.import_mjcf(tc.export_mjcf(scene, tmp_path / "s.xml", joints=joints))
    assert_same(scene.structure, found.structure)
    assert replace(found, structure=scene.structure) == scene


def test_laws_controls_and_segments_read_back(tmp_path: Path) -> None:
    prism, path = (
        tc.shapes.prism(pinned=FEET, damping=1.0, string_mass=0.1, **LAW),
        tmp_path / "s.xml",
    )
    for scene in (
        tc.Scene(prism, slack={0: tc.Linear(), 3: tc.Linear()}, segments=2),
        tc.Scene(prism, control=tc.RestLength(), slack={1: tc.Linear()}),
        tc.Scene(prism, slack=tc.Linear()),
    ):
        found = tc.import_mjcf(tc.export_mjcf(scene, path))
        assert_same(scene.modelled, found.structure)
        assert found.control == scene.control
        assert found.compression_strings.tolist() == scene.compression_strings.tolist()
    for control in (tc.ForceDensity(), tc.Tension()):
        scene = tc.Scene(prism, control=control)
        found = tc.import_mjcf(tc.export_mjcf(scene, path))
        assert found.control == control
        starts = [tc.Model(own).initial_control for own in (scene, found)]
        np.testing.assert_allclose(*starts, rtol=1e-12)


@pytest.mark.parametrize("control", [None, tc.RestLength(), tc.RestLengthRate(), tc.Tension()])
def test_cables_read_back(control: Any, tmp_path: Path) -> None:
    prism = tc.shapes.prism(pinned=FEET, damping=1.0, **LAW).replace(cables=[[3, 4, 5], [0, 1]])
    scene = tc.Scene(prism, control=control, gravity=tc.Gravity())
    found = tc.import_mjcf(tc.export_mjcf(scene, tmp_path / "s.xml"))
    assert found.structure.cables == prism.cables
    assert found.structure.strings.tolist() == prism.strings.tolist()
    assert found.control == control
    ends = [tc.simulate(tc.Model(own), 0.1, 1e-3).nodes[-1] for own in (scene, found)]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-9)


def test_thin_rods_read_back_as_bars(tmp_path: Path) -> None:
    rod = tc.RigidBody((0, 1), 2.0, inertia=(0, 2 / 12, 2 / 12))
    scene = tc.Scene(tc.Structure([(0, 0, 0), (1, 0, 0)], pinned=[0], bodies=[rod]))
    found = tc.import_mjcf(tc.export_mjcf(scene, tmp_path / "s.xml")).structure
    assert found.bars.tolist() == [[0, 1]]
    assert found.bar_mass == pytest.approx([2.0])


@pytest.mark.parametrize(
    ("actuator", "control"),
    [
        ('<intvelocity kp="50" kv="2" actrange="0 3"', tc.RestLengthRate()),
        ('<motor gear="-1"', tc.Tension()),
        ('<general gear="2" gaintype="affine" gainprm="0 -0.25 0"', tc.ForceDensity()),
    ],
)
def test_actuators_of_other_files_are_controls(actuator: str, control: Any, tmp_path: Path) -> None:
    bare = '<spatial name="s"><site site="a"/><site site="w"/></spatial>'
    actuators = f'<actuator>{actuator} tendon="s"/></actuator>'
    (tmp_path / "s.xml").write_text(file(tendon=bare, more=actuators))
    assert tc.import_mjcf(tmp_path / "s.xml").control == control


def test_actuators_without_dynamics_start_at_their_control(tmp_path: Path) -> None:
    bare = '<spatial name="s"><site site="a"/><site site="w"/></spatial>'
    law = 'gainprm="50" biastype="affine" biasprm="0 -50 0" dyntype="none"'
    more = f'<actuator><general tendon="s" {law}/></actuator><keyframe><key ctrl="0.3"/></keyframe>'
    (tmp_path / "s.xml").write_text(file(tendon=bare, more=more))
    assert tc.import_mjcf(tmp_path / "s.xml").structure.rest_length == pytest.approx([0.3])


def test_actuators_of_joints_drive_no_unnamed_tendon(tmp_path: Path) -> None:
    (tmp_path / "s.xml").write_text(file(more='<actuator><motor joint="j"/></actuator>'))
    with pytest.raises(tc.SceneFileError, match="actuators to tendons alone"):
        tc.import_mjcf(tmp_path / "s.xml")


def test_tendons_through_one_place_are_rejected(tmp_path: Path) -> None:
    tendon = "<spatial>" + 3 * '<site site="a"/>' + "</spatial>"
    (tmp_path / "s.xml").write_text(file(tendon=tendon))
    with pytest.raises(tc.SceneFileError, match="joins a node to itself"):
        tc.import_mjcf(tmp_path / "s.xml")


def test_rollers_hold_along_the_same_directions(tmp_path: Path) -> None:
    s = tc.shapes.prism(rollers={0: (1, 0, 1), 1: [(1, 1, 0), (0, 1, 1)]}, pinned=[2])
    found = tc.import_mjcf(tc.export_mjcf(tc.Scene(s), tmp_path / "s.xml")).structure
    for node, normals in s.rollers.items():
        same = [
            np.transpose(each) @ np.array(each) for each in (normals, found.rollers[node])
        ]  # projectors
        assert same[1] == pytest.approx(same[0], abs=1e-12)


@pytest.mark.parametrize("name", ["prism", "thick bars and masses", "D-bar", "T-bar", "point"])
def test_grounds_read_back(name: str, tmp_path: Path) -> None:
    first = tc.Ground(2000.0, 20.0, height=-0.5, normal=(0.1, 0, 1))
    grounds = [
        first,
        tc.Ground(
            100.0,
            friction=0.3,
            slip_speed=0.02,
            height=-3.0,
            nodes=[0] if name == "point" else [1, 3],
        ),
    ]
    found = tc.import_mjcf(
        tc.export_mjcf(tc.Scene(STRUCTURES[name], ground=grounds), tmp_path / "s.xml")
    )
    for wanted, ground in zip(grounds, found.grounds, strict=True):
        for field in (
            "stiffness",
            "damping",
            "height",
            "normal",
            *(["slip_speed"] if wanted.friction else []),
        ):
            assert getattr(ground, field) == pytest.approx(getattr(wanted, field), rel=1e-9), field
        assert ground.friction == wanted.friction
        assert ground.nodes == (None if name == "point" else wanted.nodes)


@pytest.mark.parametrize("friction", [None, 0.3])
def test_capsules_read_back(friction: float | None, tmp_path: Path) -> None:
    s = tc.shapes.prism(bar_radius=0.03)
    law = {"stiffness": 2000.0, "damping": 20.0, "friction": friction, "slip_speed": 0.02}
    ground = tc.Ground(height=-1.0, bars=[0, 2], nodes=[int(s.bars[1, 0])], **law)
    contact = tc.BarContact([(0, 1), (1, 2)], **law)
    found = tc.import_mjcf(
        tc.export_mjcf(tc.Scene(s, ground=ground, bar_contact=contact), tmp_path / "s.xml")
    )
    points, bars = found.grounds
    assert (points.nodes, points.bars) == (ground.nodes, None)
    assert (bars.nodes, bars.bars) == ((), (0, 2))
    assert found.bar_contact.pairs == ((0, 1), (1, 2))
    for name in ("stiffness", "damping", *(["slip_speed"] if friction else [])):
        for own in (points, bars, found.bar_contact):
            assert getattr(own, name) == pytest.approx(law[name], rel=1e-6), name
            assert own.friction == friction
    assert bars.height == pytest.approx(-1.0)


def test_pairs_with_several_laws_are_named(tmp_path: Path) -> None:
    s = tc.shapes.prism(bar_radius=0.03)
    scene = tc.Scene(s, bar_contact=tc.BarContact([(0, 1), (1, 2)], 2000.0))
    path = tc.export_mjcf(scene, tmp_path / "s.xml")
    text = path.read_text(encoding="utf-8")
    solref = re.findall(r'solref="(-[^ ]*) ', text)[1]
    first, second = text.split("<pair", 2)[1:]
    path.write_text(
        text.split("<pair", 1)[0] + "<pair" + first + "<pair" + second.replace(solref, "-5.0"),
        encoding="utf-8",
    )
    with pytest.raises(tc.SceneFileError, match="another law than the first pair of bars"):
        tc.import_mjcf(path)


# Files as others write them.

FREE_PRISM = """<mujoco model="cell">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="1e-4" integrator="RK4" gravity="0 0 0"/>
  <default>
    <geom type="capsule" contype="0" conaffinity="0" density="900" rgba="0.2 0.2 0.3 1"/>
    <site size="0.006"/>
    <default class="cable"> <tendon stiffness="200" width="0.0025"/> <geom size="0.01"/> </default>
  </default>
  <visual><headlight ambient="0.4 0.4 0.4"/></visual>
  <worldbody>
    <light pos="0 0 2" dir="0 0 -1"/>
    <camera name="side" pos="1 0 0" xyaxes="0 1 0 0 0 1"/>
    <body name="a" pos="0.1 0 0.05" childclass="cable"><freejoint/><geom fromto="0 0 0 -0.15 0.06 0.3"/>
      <site name="a0"/><site name="a1" pos="-0.15 0.06 0.3"/></body>
    <body name="b" pos="-0.05 0.0866 0.05"><freejoint/><geom class="cable" fromto="0 0 0 0.02 -0.16 0.3"/>
      <site name="b0"/><site name="b1" pos="0.02 -0.16 0.3"/></body>
    <body name="c" pos="-0.05 -0.0866 0.05"><freejoint/><geom size="0.01" fromto="0 0 0 0.13 0.1 0.3"/>
      <site name="c0"/><site name="c1" pos="0.13 0.1 0.3"/></body>
  </worldbody>
  <tendon>
    <spatial class="cable" springlength="0 0.1"><site site="a0"/><site site="b0"/></spatial>
    <spatial class="cable" springlength="0 0.1"><site site="b0"/><site site="c0"/></spatial>
    <spatial class="cable" springlength="0 0.1"><site site="c0"/><site site="a0"/></spatial>
    <spatial class="cable" springlength="0 0.1"><site site="a1"/><site site="b1"/></spatial>
    <spatial class="cable" springlength="0 0.1"><site site="b1"/><site site="c1"/></spatial>
    <spatial class="cable" springlength="0 0.1"><site site="c1"/><site site="a1"/></spatial>
    <spatial class="cable" damping="1" springlength="0.25"><site site="a0"/><site site="c1"/></spatial>
    <spatial class="cable" damping="1" springlength="0.25"><site site="b0"/><site site="a1"/></spatial>
    <spatial class="cable" damping="1" springlength="0.25"><site site="c0"/><site site="b1"/></spatial>
  </tendon>
</mujoco>"""

ROBOT = """<mujoco model="rods with motors and end caps, told in the world's coordinates">
  <compiler inertiafromgeom="true"/>
  <option timestep="1e-4" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>
  <default>
    <geom density="1000" friction="0.5 0.005 0.9" solref="-5000 -50"/>
    <tendon stiffness="10000" damping="10" springlength="1.5"/>
  </default>
  <asset><texture name="plain" builtin="flat" type="2d" width="8" height="8"/><material name="grey" texture="plain"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 1" material="grey"/>
    <body name="r01">
      <geom name="rod" type="cylinder" fromto="1 -1 2 -1 1 3" size="0.016" mass="41.8"/>
      <freejoint name="move01"/>
      <geom type="sphere" pos="1 -1 2" size="0.175" mass="10.5"/>
      <geom type="sphere" pos="-1 1 3" size="0.175" mass="10.5"/>
      <geom type="cylinder" fromto="0.8 -0.8 2.1 0.5 -0.5 2.25" size="0.175" mass="35.3"/>
      <geom type="cylinder" fromto="-0.8 0.8 2.9 -0.5 0.5 2.75" size="0.175" mass="35.3"/>
      <site name="s0" pos="1 -1 2"/><site name="s1" pos="-1 1 3"/>
    </body>
    <body name="r23">
      <geom type="cylinder" fromto="-1 -1 2 1 1 2.5" size="0.016" mass="41.8"/>
      <freejoint name="move23"/>
      <geom type="sphere" pos="-1 -1 2" size="0.175" mass="10.5"/>
      <geom type="sphere" pos="1 1 2.5" size="0.175" mass="20.5"/>
      <site name="s2" pos="-1 -1 2"/><site name="s3" pos="1 1 2.5"/>
    </body>
  </worldbody>
  <tendon>
    <spatial><site site="s0"/><site site="s2"/></spatial>
    <spatial><site site="s0"/><site site="s3"/></spatial>
    <spatial><site site="s1"/><site site="s2"/></spatial>
    <spatial stiffness="20000"><site site="s1"/><site site="s3"/></spatial>
  </tendon>
  <sensor><framepos objtype="site" objname="s0"/></sensor>
</mujoco>"""

MAST = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="1e-4" integrator="RK4"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 -1"/>
    <site name="tip" pos="0.1 0.1 1.2"/>
    <body name="lower" pos="0.1 0 0" euler="0.2 0.1 -0.3">
      <joint type="ball"/>
      <geom type="capsule" size="0.01 0.25" pos="0 0 0.25" mass="0.3" contype="0" conaffinity="0"/>
      <site name="middle" pos="0 0 0.5"/>
      <body name="upper" pos="0 0 0.5" axisangle="1 1 0 0.4">
        <joint type="ball"/>
        <inertial pos="0.2 0 0" mass="0.5" diaginertia="0.001 0.01 0.01"/>
        <geom type="box" size="0.2 0.01 0.01" pos="0.2 0 0"/>
        <site name="top" pos="0.4 0 0"/>
        <body name="payload" pos="0.4 0 0"><geom type="sphere" size="0.02" mass="0.1" contype="0" conaffinity="0"/></body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="up" stiffness="100" springlength="0 0.5"><site site="tip"/><site site="top"/></spatial>
    <spatial name="down" stiffness="50" springlength="0.2"><site site="tip"/><site site="middle"/></spatial>
  </tendon>
</mujoco>"""


def read(text: str, tmp_path: Path) -> tc.Scene:
    path = tmp_path / "scene.xml"
    path.write_text(text)
    return tc.import_mjcf(path)


def sites(path: Path, time: float) -> np.ndarray:
    """Places of all sites after MuJoCo's run."""
    mujoco = pytest.importorskip("mujoco")
    world = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(world)
    mujoco.mj_step(world, data, round(time / world.opt.timestep))
    mujoco.mj_kinematics(world, data)
    return np.array(data.site_xpos)


CASES = [(FREE_PRISM, (6, 3, 9), 0.1), (ROBOT, (4, 2, 4), 0.2), (MAST, (4, 2, 2), 0.2)]


@pytest.mark.parametrize(("text", "size", "time"), CASES, ids=["prism", "robot", "mast"])
def test_scenes_of_other_peoples_files_move_as_in_mujoco(
    text: str, size: tuple[int, ...], time: float, tmp_path: Path
) -> None:
    scene = read(text, tmp_path)
    assert (
        len(scene.structure.nodes),
        len(scene.structure.bars),
        len(scene.structure.strings),
    ) == size
    run = tc.simulate(
        tc.Model(scene), time, time / 2000, correction=tc.Projection(), compiled=False
    )
    theirs = sites(tmp_path / "scene.xml", time)
    assert abs(run.nodes[-1] - run.nodes[0]).max() > 1e-3
    moving = [node for node in range(size[0]) if node not in scene.structure.pinned]
    away = [abs(theirs - run.nodes[-1, node]).max(axis=1).min() for node in moving]
    assert max(away) < 1e-6


def test_masses_are_those_that_mujoco_reckons(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    for text in (FREE_PRISM, ROBOT, MAST):
        s = read(text, tmp_path).structure
        world = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
        assert s.bar_mass.sum() + s.node_mass.sum() == pytest.approx(
            world.body_mass.sum(), rel=1e-12
        )


TURNS = {
    "degree": [
        'quat="0.5 -0.3 0.7 0.1"',
        'axisangle="1 -2 0.5 70"',
        'euler="10 -120 55"',
        'xyaxes="1 2 0.3 -1 1 0.2"',
        'zaxis="0.3 -1 -2"',
        'zaxis="0 0 -3"',
    ],
    "radian": [
        'quat="0 0 -2 0"',
        'axisangle="0 0 -1 3"',
        'euler="1 -0.5 3"',
        'xyaxes="0 0 1 0 1 0"',
        'zaxis="0 0 1"',
        'zaxis="1 0 0"',
    ],
}


@pytest.mark.parametrize("sequence", ["xyz", "XYZ", "zYx", "xzX"])
@pytest.mark.parametrize("angle", TURNS)
def test_orientations_are_as_mujoco_reads_them(angle: str, sequence: str, tmp_path: Path) -> None:
    turns = TURNS[angle]
    rod = '<geom type="cylinder" size="0.01 0.5" pos="0.1 0.2 0.3" {} mass="1"/><joint type="ball" pos="0.1 0.2 0.3"/>'
    bodies = ""
    for k, turn in enumerate(turns):
        inner = turns[k - 1]
        place = f'pos="{k} {k % 3} {k % 2}"'
        bodies += f'<body name="b{k}" {place} {turn}><body name="c{k}" pos="0.3 0 0" {inner}>{rod.format(turn)}</body></body>'
    text = f'<mujoco><compiler angle="{angle}" eulerseq="{sequence}"/><worldbody>{bodies}</worldbody></mujoco>'
    (tmp_path / "scene.xml").write_text(text)
    mujoco = pytest.importorskip("mujoco")
    world = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(world)
    mujoco.mj_kinematics(world, data)
    root = read_elements(Source(tmp_path / "scene.xml"))
    bodies_read = Bodies(root, Defaults(root), Units(angle == "degree", sequence), None)
    for k, piece in bodies_read.moving():
        assert piece.anchor == pytest.approx(data.xanchor[k - 1], abs=1e-12)
        middle, axis = data.geom_xpos[k - 1], data.geom_xmat[k - 1].reshape(3, 3)[:, 2]
        assert piece.geoms[0].rod.ends == pytest.approx(
            np.array([middle - axis / 2, middle + axis / 2]), abs=1e-12
        )


FLOOR = """<mujoco>
  <option timestep="1e-4" integrator="RK4"/>
  <default><geom mass="0.12" type="capsule" size="0.011"/><default class="rough"><geom friction="1.7"/></default></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 -0.4"/>
    <geom name="wall" type="plane" size="5 5 0.1" pos="-3 0 0" zaxis="1 0 0" contype="2" conaffinity="2"/>
    <geom name="look" type="box" size="1 1 1" pos="0 0 9" contype="0" conaffinity="0"/>
    <body name="one" pos="0.16 0 0.35"><freejoint/>
      <geom name="left" fromto="0 0 -0.3 0 0 0.3"/><site name="a" pos="0 0 -0.3"/><site name="b" pos="0 0 0.3"/></body>
    <body name="two" pos="-0.16 0 0.35"><freejoint/>
      <geom class="rough" fromto="0 0 -0.3 0 0 0.3"/><site name="c" pos="0 0 -0.3"/><site name="d" pos="0 0 0.3"/></body>
  </worldbody>
  <tendon><spatial stiffness="900" springlength="0 0.3"><site site="b"/><site site="d"/></spatial></tendon>
  <equality><connect body1="one" anchor="0 0 -0.3"/></equality>
  <contact><pair geom1="wall" geom2="left" condim="1" solref="-400 -6"/></contact>
</mujoco>"""


def test_planes_become_grounds_of_the_nodes_that_touch_them(tmp_path: Path) -> None:
    scene = read(FLOOR, tmp_path)
    s = scene.structure
    foot = next(iter(s.pinned))
    assert s.pinned == {foot: "xyz"}
    assert s.nodes[foot] == pytest.approx([0.16, 0, 0.05], abs=1e-12)
    rough = sorted(s.bars[1].tolist())
    top = next(node for node in s.bars[0].tolist() if node != foot)
    floor = [ground for ground in scene.grounds if ground.normal == (0, 0, 1)]
    assert {ground.nodes: ground.friction for ground in floor} == {
        (top,): 1.0,
        tuple(rough): 1.7,
    }  # the greater of plane and geom
    (wall,) = (ground for ground in scene.grounds if ground.normal != (0, 0, 1))
    assert wall.nodes == (top,)
    assert wall.friction is None
    assert wall.height == pytest.approx(-3 + 0.011)
    assert wall.stiffness == pytest.approx(400 * 0.12)  # per the mass that MuJoCo reckons
    assert wall.damping == pytest.approx(6 * 0.12)
    assert all(ground.height == pytest.approx(-0.4 + 0.011) for ground in floor)
    assert all(
        ground.stiffness == pytest.approx(0.12 / 0.02**2) for ground in floor
    )  # of MuJoCo's time constant and damping ratio


def test_contacts_that_are_switched_off_leave_no_ground(tmp_path: Path) -> None:
    off = '<flag contact="disable"/></option>'
    assert (
        read(FLOOR.replace('integrator="RK4"/>', 'integrator="RK4">' + off), tmp_path).ground
        is None
    )
    apart = FLOOR.replace("<contact>", '<contact><exclude body1="world" body2="two"/>')
    assert {node for ground in read(apart, tmp_path).grounds for node in ground.nodes} <= set(
        read(apart, tmp_path).structure.bars[0].tolist()
    )


def test_a_body_that_connect_pins_swings_as_in_mujoco(tmp_path: Path) -> None:
    scene = replace(read(FLOOR, tmp_path), ground=None)
    hung = FLOOR.replace("<connect", '<connect solref="2e-4 1" solimp="0.9999 0.9999 0.001"')
    (tmp_path / "scene.xml").write_text(
        hung.replace('integrator="RK4"/>', 'integrator="RK4"><flag contact="disable"/></option>')
    )
    run = tc.simulate(tc.Model(scene), 0.1, 1e-4, correction=tc.Projection(), compiled=False)
    theirs = sites(tmp_path / "scene.xml", 0.1)
    assert abs(run.nodes[-1] - run.nodes[0]).max() > 0.01
    assert max(abs(theirs - node).max(axis=1).min() for node in run.nodes[-1]) < 1e-5


@pytest.mark.parametrize("joints", ["ball", "connect"])
@pytest.mark.parametrize("name", STRUCTURES)
def test_what_mujoco_saves_reads_back(name: str, joints: Any, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    structure = STRUCTURES[name]
    path, saved = tmp_path / "s.xml", str(tmp_path / "saved.xml")
    for control in (None, tc.RestLength(), tc.ForceDensity()) if len(structure.strings) else [None]:
        ground = tc.Ground(2000.0, 20.0, friction=0.4, height=-9.0, normal=(0.1, 0, 1))
        tc.export_mjcf(tc.Scene(structure, control=control, ground=ground), path, joints=joints)
        mujoco.mj_saveLastXML(saved, mujoco.MjModel.from_xml_path(str(path)))  # in six digits
        found = tc.import_mjcf(saved)
        assert found.control == control
        assert found.structure.nodes == pytest.approx(structure.nodes, abs=1e-5)
        assert np.sort(found.structure.bars).tolist() == np.sort(structure.bars).tolist()
        assert found.structure.strings.tolist() == structure.strings.tolist()
        assert found.structure.bar_inertia == pytest.approx(structure.bar_inertia, rel=1e-5)
        assert found.ground.stiffness == pytest.approx(2000.0, rel=1e-4)
        if control == tc.RestLength():
            assert found.structure.rest_length == pytest.approx(structure.rest_length, rel=1e-5)


def test_a_servo_told_as_a_general_actuator_is_a_control_by_rest_lengths(tmp_path: Path) -> None:
    law = 'gaintype="fixed" gainprm="50" biastype="affine" biasprm="0 -50 -2" ctrlrange="0 1"'
    text = (
        MAST.replace(' stiffness="100"', "")
        .replace(' stiffness="50"', "")
        .replace('"0 0.5"', '"-1"')
    )
    actuators = f'<actuator><general tendon="up" {law}/><position tendon="down" kp="50" kv="2"/></actuator></mujoco>'
    scene = read(text.replace("</mujoco>", actuators), tmp_path)
    assert scene.control == tc.RestLength()
    assert scene.structure.stiffness.tolist() == [50.0, 50.0]
    assert scene.structure.damping.tolist() == [2.0, 2.0]
    assert scene.compression_strings.tolist() == [0, 1]


DRIVEN = """<mujoco>
  <option gravity="0 0 0" integrator="RK4" timestep="5e-4"/>
  <worldbody>
    <site name="w" pos="0 1 0"/><site name="v" pos="-0.5 0.2 0.7"/>
    <body name="bar">
      <joint type="free"/>
      <geom type="cylinder" fromto="0 0 0 1 0 0" size="0.02" mass="1"/>
      <site name="a"/><site name="b" pos="1 0 0"/>
    </body>
  </worldbody>
  <default><tendon {spring}/></default>
  <tendon>
    <spatial name="s"><site site="a"/><site site="w"/></spatial>
    <spatial name="t"><site site="b"/><site site="v"/></spatial>
  </tendon>
  <actuator>{actuators}</actuator>
  <keyframe><key ctrl="{control}"/></keyframe>
</mujoco>"""
LINEAR = 'springlength="0.6" stiffness="40" damping="0.5"'


@pytest.mark.parametrize(
    ("spring", "actuators", "control"),
    [
        (LINEAR, '<motor tendon="s" gear="2"/><motor tendon="t" gear="3"/>', "-2 -1.5"),
        (
            LINEAR,
            '<position tendon="s" kp="30"/><position tendon="t" kp="20" kv="0.3"/>',
            "0.5 0.7",
        ),
        ("", '<motor tendon="s" gear="2"/><general tendon="t" gainprm="1.5"/>', "-2 -1.5"),
    ],
    ids=["motors beside springs", "two springs", "motors alone"],
)
def test_driven_strings_move_as_in_mujoco(spring, actuators, control, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "scene.xml"
    path.write_text(DRIVEN.format(spring=spring, actuators=actuators, control=control))
    run = tc.simulate(tc.Model(tc.import_mjcf(path)), 0.1, 5e-4, compiled=False)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:] = model.qpos0
    for _ in range(200):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    ends = [data.site(name).xpos for name in "ab"]
    assert np.linalg.norm(ends[1] - [1.0, 0.0, 0.0]) > 0.03
    assert np.abs(run.nodes[-1][:2] - ends).max() < 1e-8
