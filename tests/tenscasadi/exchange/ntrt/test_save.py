"""Export to NTRT: what is written is read again, and changes are listed."""

from __future__ import annotations

import re

import numpy as np
import pytest

import tenscasadi as tc

pytest.importorskip("yaml", reason="tenscasadi[exchange] is not installed")


def reread(structure, folder, **options):
    return tc.load_ntrt(tc.save_ntrt(structure, folder / "x.yaml"), **options)


@pytest.mark.parametrize("unit", [1.0, 0.1])
def test_bars_and_strings_come_back(unit, tmp_path):
    prism = tc.shapes.prism(bar_radius=0.02, stiffness=800.0, prestress=30.0).replace(
        damping=np.linspace(0.0, 4.0, 9), bar_mass=[1.0, 2.0, 3.0]
    )
    path = tc.save_ntrt(prism, tmp_path / "x.yaml", length_unit=unit)
    again = tc.load_ntrt(path, length_unit=unit)
    order = np.argsort([np.flatnonzero(again.damping == c)[0] for c in prism.damping])
    assert (again.bars == prism.bars).all()
    assert (again.strings[np.argsort(order)] == prism.strings).all()
    for name in ("nodes", "bar_mass", "bar_radius", "stiffness", "damping", "rest_length"):
        assert np.sort(getattr(again, name), axis=0) == pytest.approx(
            np.sort(getattr(prism, name), axis=0), rel=1e-12, abs=1e-14
        ), name


def test_motion_of_the_copy_is_the_same(tmp_path):
    ball = tc.shapes.six_bar_ball(bar_radius=0.01, prestress=20.0, damping=1.0)
    ends = [
        tc.simulate(tc.Model(tc.Scene(s, gravity=tc.Gravity())), 0.2, 1e-3).nodes[-1]
        for s in (ball, reread(ball, tmp_path))
    ]
    assert ends[0] == pytest.approx(ends[1], abs=1e-11)


CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)], dtype=float)


@pytest.mark.parametrize(
    ("body", "more"),
    [
        (
            tc.RigidBody(range(4), 3.0, (1 / 6,) * 3, np.full((3, 3), 1 / 12) + 5 / 12 * np.eye(3)),
            0,
        ),
        (tc.RigidBody(range(5), 2.0), 6),  # point masses reach farther than rods between them
        (tc.RigidBody(range(5), 2.0, (3, 0, 0), (0.1, 0.2, 0.25)), 6),
        (tc.RigidBody(range(3), 1.5), 4),  # without thickness
    ],
)
def test_bodies_keep_mass_center_and_inertia(body, more, tmp_path):
    s = tc.Structure(CORNERS[: len(body.nodes)], bodies=[body])
    if more:
        with pytest.warns(UserWarning, match="body 0 with [46] more nodes, for its inertia"):
            path = tc.save_ntrt(s, tmp_path / "x.yaml")
    else:
        path = tc.save_ntrt(s, tmp_path / "x.yaml")
    again = tc.load_ntrt(path, ball_joints=False)
    assert len(again.nodes) == len(s.nodes) + more
    assert not len(again.bars)
    (own,) = again.bodies
    theirs = own.mass_properties(again.nodes[list(own.nodes)])
    ours = body.mass_properties(s.nodes[list(body.nodes)])
    assert theirs.mass == pytest.approx(ours.mass, rel=1e-10)
    assert theirs.center == pytest.approx(ours.center, abs=1e-10)
    assert theirs.moments == pytest.approx(ours.moments, abs=2e-9)


def test_pins_come_back(tmp_path):
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 0)],
        bars=[(2, 3)],
        strings=[(0, 2), (1, 3), (4, 3)],
        pinned=[0, 1, 4],
        bar_radius=0.1,
    )
    with pytest.warns(UserWarning, match="node 0 with one more pinned node below"):
        again = reread(s, tmp_path)
    assert again.nodes[:5] == pytest.approx(s.nodes)
    assert set(again.pinned) == {0, 1, 4, 5}
    assert (again.bars == s.bars).all()
    even = tc.Structure(
        s.nodes, s.bars, s.strings[:2], pinned=[0, 1], bar_radius=0.1, node_mass=np.eye(5)[4]
    )
    with pytest.warns(UserWarning, match="node 4 left out, without members"):
        again = reread(even, tmp_path)
    assert dict(again.pinned) == {0: "xyz", 1: "xyz"}
    assert len(again.nodes) == 4


def test_warning_lists_what_ntrt_lacks(tmp_path):
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1)],
        bars=[(0, 1), (1, 2), (3, 2)],
        strings=[(0, 2), (2, 1), (1, 3)],
        pinned={0: "xyz", 3: "z"},
        node_mass=[0, 1, 0, 0],
        bar_stiffness=[np.inf, 1e5, np.inf],
        stiffness=[10.0, 10.0, 0.0],
        rest_length=[2.0, 1.0, 1.0],
        cables=[[0, 1]],
    )
    with pytest.warns(UserWarning, match="differs from the structure") as caught:
        path = tc.save_ntrt(s, tmp_path / "x.yaml")
    with pytest.warns(UserWarning, match="NTRT welds them"):
        again = tc.load_ntrt(path)
    told = str(caught[0].message)
    for part in (
        "x.yaml differs from the structure",
        "node 3 free, as NTRT only fixes whole rods",
        "node 1 without node_mass",
        "bar 1 rigid, in place of bar_stiffness",
        "cable 0 as single strings",
        "bars 0, 1, 2 with the radius length/100",
        "node 1 welds bar 0, bar 1, in place of a ball joint",
        "node 0 welds bar 0, the ground, in place of a ball joint",
        "string 2 left out, without stiffness",
        "string 0 without slack",
    ):
        assert part in told
    assert len(again.strings) == 2
    assert again.rest_length[0] == pytest.approx(s.string_lengths[0])


def test_structures_that_ntrt_cannot_hold_are_rejected(tmp_path):
    net = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)],
        strings=[(0, 1), (1, 2)],
        pinned=[0, 2],
        node_mass=[0, 1, 0],
    )
    alone = tc.Structure([(0, 0, 0)], node_mass=1.0)
    for structure, options, told in (
        (net, {}, "node 1 has strings, but no bar, body or pin"),
        (alone, {}, "structure has no bars, bodies or pins"),
        (tc.shapes.prism(), {"length_unit": 0.0}, "length_unit is 0"),
        (tc.shapes.prism(), {"length_unit": 1e30}, "length_unit is 1e+30: with it a density is"),
    ):
        with pytest.raises(ValueError, match=re.escape(told)):
            tc.save_ntrt(structure, tmp_path / "x.yaml", **options)
    with pytest.raises(TypeError, match="structure is 3"):
        tc.save_ntrt(3, tmp_path / "x.yaml")
    assert not (tmp_path / "x.yaml").exists()
