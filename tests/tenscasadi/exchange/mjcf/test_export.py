"""Files for MuJoCo: it loads them, and follows our motion."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mujoco_runs import differences, mujoco_ends
from scenes import every_term
from structures import chain

import tenscasadi as tc
from tenscasadi.exchange.mjcf.body_tree import build_tree, inverse_weights

LAW = {"stiffness": 1000.0, "prestress": 50.0}
DOWN = {"gravity": tc.Gravity()}
FEET = {0: "xyz", 1: "xyz", 2: "xyz"}


def turning(s: tc.Structure) -> np.ndarray:
    return np.cross([1.0, 2.0, 3.0], s.nodes - s.nodes[0])


def above(s: tc.Structure, height: float = 0.02) -> tc.Structure:
    return s.replace(nodes=s.nodes + [0.0, 0.0, height - s.nodes[:, 2].min()])


prism, ball = tc.shapes.prism(**LAW), tc.shapes.six_bar_ball(**LAW)
heavy = tc.shapes.prism(bar_radius=0.05, node_mass=[0.1, 0.2, 0.3, 0.0, 0.5, 0.6], **LAW)
EXACT: dict[str, tuple[tc.Scene, Any]] = {  # without equalities: free bodies, ball joints, slides
    "prism": (tc.Scene(prism), turning(prism)),
    "ball": (tc.Scene(ball), turning(ball)),
    "prism with masses on nodes": (tc.Scene(heavy, **DOWN), turning(heavy)),
    "pendulum": (tc.Scene(tc.shapes.pendulum(), **DOWN), turning(tc.shapes.pendulum())),
    "double pendulum": (tc.Scene(tc.shapes.double_pendulum(), **DOWN), None),
    "pinned mast": (tc.Scene(tc.shapes.prism(pinned=FEET, **LAW), **DOWN), None),
    "damped mast": (tc.Scene(tc.shapes.prism(pinned=FEET, damping=2.0, **LAW), **DOWN), None),
    "rolling along axes": (
        tc.Scene(tc.shapes.prism(pinned={0: "z", 1: "z", 2: "xz"}, **LAW), **DOWN),
        None,
    ),
    "rolling on slopes": (
        tc.Scene(
            tc.shapes.prism(rollers={0: (1, 0, 1), 1: [(1, 1, 0), (0, 1, 1)]}, pinned=[2], **LAW),
            **DOWN,
        ),
        None,
    ),
    "massive strings": (
        tc.Scene(tc.shapes.prism(pinned=FEET, string_mass=0.1, **LAW), segments=3, **DOWN),
        None,
    ),
    "strings that push": (
        tc.Scene(
            tc.shapes.prism(pinned=FEET, stiffness=100.0, rest_length=0.9),
            slack=tc.Linear(),
            **DOWN,
        ),
        None,
    ),
    "rest lengths": (
        tc.Scene(tc.shapes.prism(pinned=FEET, damping=1.0, **LAW), control=tc.RestLength(), **DOWN),
        None,
    ),
    "force densities": (
        tc.Scene(tc.shapes.prism(pinned=FEET, **LAW), control=tc.ForceDensity(), **DOWN),
        None,
    ),
}
d_bar, swinging, t_bar = (
    tc.shapes.d_bar(**LAW),
    tc.shapes.d_bar(pinned=[0], **LAW),
    tc.shapes.t_bar(**LAW),
)
SOFT: dict[str, tuple[tc.Scene, Any]] = {  # loops of bars, or joints as connect
    "D-bar": (tc.Scene(d_bar), turning(d_bar)),
    "pinned D-bar": (tc.Scene(swinging, **DOWN), 0.3 * turning(swinging)),
    "T-bar": (tc.Scene(t_bar), turning(t_bar)),
    "double pendulum": (tc.Scene(tc.shapes.double_pendulum(), **DOWN), None),
    "pinned mast": (tc.Scene(tc.shapes.prism(pinned=FEET, **LAW), **DOWN), None),
}


@pytest.mark.parametrize("case", EXACT)
def test_mujoco_converges_to_our_motion(case: str, tmp_path: Any) -> None:
    scene, velocities = EXACT[case]
    coarse, fine = differences(scene, tmp_path / "scene.xml", velocities)
    assert fine < 1e-6
    assert (
        coarse / fine > 8 or fine < 1e-11
    )  # both are of order 4: what is left is MuJoCo's step, or rounding


@pytest.mark.parametrize("joints", ["ball", "connect"])
@pytest.mark.parametrize("case", SOFT)
def test_joints_either_way_converge_to_our_motion(case: str, joints: str, tmp_path: Any) -> None:
    scene, velocities = SOFT[case]
    coarse, fine = differences(
        scene, tmp_path / "scene.xml", velocities, joints, steps=(1e-3, 2.5e-4)
    )
    assert fine < 1e-3
    assert coarse / fine > 8 or fine < 1e-7  # equalities give by the square of the step


def test_a_ball_joint_is_exact_where_connect_gives(tmp_path: Any) -> None:
    scene, velocities = SOFT["T-bar"]
    balls, connected = (
        differences(scene, tmp_path / "t.xml", velocities, joints, steps=[1e-3])[0]
        for joints in ("ball", "connect")
    )
    assert balls < 1e-8 < 1e-7 < connected


def test_strings_that_go_slack_follow_to_the_order_of_the_switches(tmp_path: Any) -> None:
    scene = tc.Scene(tc.shapes.prism(pinned=FEET, stiffness=100.0, rest_length=0.9), **DOWN)
    assert differences(scene, tmp_path / "s.xml", steps=[2e-4])[0] < 1e-6


def test_a_membrane_of_points_follows(tmp_path: Any) -> None:
    net = tc.shapes.membrane(p=4, q=3)
    net = net.replace(rest_length=0.8 * net.string_lengths, pinned={0: "xyz", 1: "z"})
    assert (
        differences(tc.Scene(net, **DOWN), tmp_path / "s.xml", t_end=0.05, steps=[5e-4])[0] < 1e-5
    )  # some strings go slack


@pytest.mark.parametrize(
    "structure", [prism, heavy, d_bar, tc.Structure([(0, 0, 0)], node_mass=2.0)], ids=str
)
def test_the_ground_pushes_alike(structure: tc.Structure, tmp_path: Any) -> None:
    ground = tc.Ground(stiffness=2000.0, damping=20.0, height=0.5, normal=(0.1, 0, 1))
    raised = structure.replace(
        nodes=structure.nodes + [0, 0, 0.51 - (structure.nodes @ ground.normal).min()]
    )
    assert (
        differences(
            tc.Scene(raised, **DOWN, ground=ground), tmp_path / "s.xml", t_end=0.3, steps=[5e-4]
        )[0]
        < 1e-4
    )


@pytest.mark.parametrize(
    "s",
    [
        tc.shapes.t_bar(node_mass=[0.1, 0.2, 0.3, 0.4, 0.5]),
        tc.shapes.d_bar(pinned=[0]),
        tc.shapes.d_bar(pinned={0: "z"}),
    ],
    ids=str,
)
def test_contacts_are_scaled_by_the_masses_that_mujoco_reckons(
    s: tc.Structure, tmp_path: Any
) -> None:
    world = pytest.importorskip("mujoco").MjModel.from_xml_path(
        str(tc.export_mjcf(tc.Scene(s, ground=tc.Ground()), tmp_path / "s.xml"))
    )
    theirs = [world.body(f"bar{bar}").invweight0[0] for bar in range(len(s.bars))]
    assert inverse_weights(s, build_tree(s, True)) == pytest.approx(theirs, rel=1e-9)


def test_friction_stops_alike(tmp_path: Any) -> None:
    s = above(prism, 0.0)
    scene = tc.Scene(
        s, **DOWN, ground=tc.Ground(stiffness=2000.0, damping=50.0, friction=0.5, slip_speed=0.01)
    )
    V = np.tile([1.0, 0.0, 0.0], (6, 1))
    free = replace(scene, ground=replace(scene.ground, friction=None))
    slid = [
        mujoco_ends(tc.export_mjcf(each, tmp_path / "s.xml", V, step=2e-4), 0.4)[:, 0].mean()
        - s.nodes[:, 0].mean()
        for each in (scene, free)
    ]
    model = tc.Model(scene)
    ours = tc.simulate(
        model, 0.4, 2e-4, state=model.state(s.nodes, V), compiled=False, correction=tc.Projection()
    )
    assert slid[1] == pytest.approx(0.4, rel=1e-3)
    assert slid[0] == pytest.approx(
        ours.nodes[-1, :, 0].mean() - s.nodes[:, 0].mean(), rel=0.1
    )  # slip is not regularized alike


def test_controls_are_those_of_the_model(tmp_path: Any) -> None:
    s = tc.shapes.prism(pinned=FEET, damping=1.0, **LAW)
    for control, share in ((tc.RestLength(), 0.9), (tc.ForceDensity(), 2.0)):
        model = tc.Model(tc.Scene(s, control=control, **DOWN))
        u = share * model.initial_control
        ours = tc.simulate(model, 0.2, 5e-4, control=u, compiled=False, correction=tc.Projection())
        theirs = mujoco_ends(tc.export_mjcf(model.scene, tmp_path / "s.xml"), 0.2, control=u)
        assert theirs == pytest.approx(ours.nodes[-1], abs=1e-7)


def test_grounds_name_the_nodes_that_they_touch(tmp_path: Any) -> None:
    scene = tc.Scene(
        prism, ground=[tc.Ground(height=-1.0), tc.Ground(nodes=[2, 4], height=-3.0, friction=0.4)]
    )
    root = ET.parse(tc.export_mjcf(scene, tmp_path / "s.xml")).getroot()
    pairs = [
        (pair.get("geom1"), pair.get("geom2"), pair.get("condim")) for pair in root.iter("pair")
    ]
    assert pairs == [("ground0", f"n{node}", "1") for node in range(6)] + [
        ("ground1", "n2", "3"),
        ("ground1", "n4", "3"),
    ]


REFUSED: dict[str, tuple[Any, str]] = {
    "pressure": (
        {"pressure": tc.Pressure([(0, 1, 2)], 5.0)},
        r"Scene\.pressure has no counterpart",
    ),
    "forces": (
        {"forces": tc.NodalForce(np.ones((6, 3)))},
        r"Scene\.forces has no counterpart in MJCF: .* data\.xfrc_applied",
    ),
    "gravity": ({"gravity": tc.Gravity(lambda t: (0, 0, -t))}, r"Scene\.gravity changes over time"),
    "slack": ({"slack": {3: tc.Smooth(0.01)}}, r"Scene\.slack of string 3"),
    "parameters": ({"parameters": tc.Parameters("stiffness")}, r"Scene\.parameters"),
    "ground": ({"ground": tc.Terrain(np.zeros((2, 2)), (0, 0), (1, 1))}, r"Scene\.ground"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_counterpart_is_refused_by_name(name: str, tmp_path: Any) -> None:
    changes, words = REFUSED[name]
    with pytest.raises((TypeError, ValueError), match=words):
        tc.export_mjcf(tc.Scene(prism, **changes), tmp_path / "s.xml")
    assert not list(tmp_path.iterdir())


def test_wrong_arguments_are_refused_by_name(tmp_path: Any) -> None:
    path = tmp_path / "s.xml"
    s = tc.shapes.prism(string_mass=0.1)
    for call, words in {
        lambda: tc.export_mjcf(prism, path): "scene is",
        lambda: tc.export_mjcf(every_term(moved=False), path): "Scene",
        lambda: tc.export_mjcf(
            tc.Scene(chain()), path
        ): "node 2: it is fixed along 1 of three directions",
        lambda: tc.export_mjcf(
            tc.Scene(s, segments=2, control=tc.RestLength()), path
        ): "Scene.segments",
        lambda: tc.export_mjcf(
            tc.Scene(tc.shapes.prism(bar_mass=1e-20)), path
        ): "bar_mass of bar 0 is 1e-20",
        lambda: tc.export_mjcf(
            tc.Scene(tc.Structure([(0, 0, 0)], node_mass=1e-20)), path
        ): "node_mass of node 0",
        lambda: tc.export_mjcf(
            tc.Scene(prism), path, velocities=prism.nodes
        ): "velocities stretch bar 0",
        lambda: tc.export_mjcf(
            tc.Scene(tc.shapes.pendulum()), path, velocities=np.ones((2, 3))
        ): r"velocities\[0\] moves node 0",
        lambda: tc.export_mjcf(tc.Scene(prism), path, joints="hinge"): "joints is 'hinge'",
        lambda: tc.export_mjcf(tc.Scene(prism), path, step=0.0): "step is 0",
    }.items():
        with pytest.raises((TypeError, ValueError), match=words):
            call()


@pytest.mark.parametrize("control", [None, tc.RestLength(), tc.Tension()])
def test_cables_are_tendons_through_their_nodes(tmp_path, control):
    """Accelerations of a displaced prism are those of MuJoCo."""
    mujoco = pytest.importorskip("mujoco")
    prism = tc.shapes.prism(stiffness=500.0, prestress=30.0, damping=0.0)
    s = prism.replace(cables=[[0, 7, 4], [1, 8, 5], [2, 6, 3]])
    scene = tc.Scene(s, control=control, gravity=tc.Gravity())
    path = tc.export_mjcf(scene, tmp_path / "cables.xml")
    world = mujoco.MjModel.from_xml_path(str(path))
    assert world.ntendon == 3
    data = mujoco.MjData(world)
    if control is not None:
        mujoco.mj_resetDataKeyframe(world, data, 0)
        np.testing.assert_allclose(data.ctrl, tc.Model(scene).initial_control, rtol=1e-12)
    ends = mujoco_ends(path, 0.1, step=1e-4)
    run = tc.simulate(tc.Model(scene), 0.1, 1e-3, verify=False)
    np.testing.assert_allclose(ends, run.nodes[-1], atol=2e-4)


def test_rest_length_rates_are_integrators(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    prism = tc.shapes.prism(pinned=[0, 1, 2], stiffness=500.0, prestress=20.0, damping=2.0)
    scene = tc.Scene(prism, control=tc.RestLengthRate(), gravity=tc.Gravity())
    world = mujoco.MjModel.from_xml_path(str(tc.export_mjcf(scene, tmp_path / "rates.xml")))
    world.opt.timestep, world.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(world)
    mujoco.mj_resetDataKeyframe(world, data, 0)
    data.ctrl[:] = rates = np.linspace(-0.05, 0.05, 9)
    mujoco.mj_step(world, data, 100)
    mujoco.mj_forward(world, data)
    run = tc.simulate(tc.Model(scene), 0.1, 1e-3, control=rates)
    np.testing.assert_allclose(data.act, run.internal_states["rest length"][-1], atol=1e-12)
    ends = [data.site(f"n{node}").xpos for node in range(6)]
    np.testing.assert_allclose(ends, run.nodes[-1], rtol=0, atol=1e-9)


def test_motors_of_winches_are_rejected(tmp_path):
    scene = tc.Scene(tc.shapes.prism(), control=tc.Winch(0.02, 1e-3))
    with pytest.raises(ValueError, match=r"export a scene with control=RestLengthRate\(\)"):
        tc.export_mjcf(scene, tmp_path / "motors.xml")


def test_friction_of_cables_is_rejected(tmp_path):
    s = tc.shapes.prism().replace(cables=[[0, 1, 2]], cable_friction=0.1)
    with pytest.raises(ValueError, match="cable_friction has no counterpart in MJCF"):
        tc.export_mjcf(tc.Scene(s), tmp_path / "rough.xml")


def test_strength_is_left_out_if_not_strict(tmp_path):
    scene = tc.Scene(tc.shapes.prism(), strength=tc.Breaking(50.0))
    with pytest.raises(ValueError, match="give strict=False to leave it out"):
        tc.export_mjcf(scene, tmp_path / "strict.xml")
    with pytest.warns(UserWarning, match="its strings carry any tension, MJCF has no counterpart"):
        found = tc.export_mjcf(scene, tmp_path / "s.xml", strict=np.False_)
    bare = tc.export_mjcf(replace(scene, strength=None), tmp_path / "bare.xml")
    assert found.read_text(encoding="utf-8") == bare.read_text(encoding="utf-8")
