"""NTRT's YAML files: structures measured by hand, and errors with file, line, key and cure."""

from __future__ import annotations

import random
import re
import sys
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscasadi as tc

pytest.importorskip("yaml", reason="tenscasadi[exchange] is not installed")

# a box of rods: four upright ones, held by strings below and above
BOX = """
nodes:
  a0: [0, 0, 0]
  b0: [4, 0, 0]
  c0: [4, 0, 4]
  a1: [0, 3, 0]  # y points up
  b1: [4, 3, 0]
  c1: [4, 3, 4]
pair_groups:
  rod tall:
    - [a0, a1]
    - [b0, b1]
    - [c0, c1]
  string:
    - [a0, b0]
    - [b0, c0]
    - [c0, a0]
    - [a1, b1]
    - [b1, c1]
    - [c1, a1]
builders:
  rod:
    class: tgRodInfo
    parameters: {density: 0.5, radius: 0.25, friction: 0.9, restitution: 0}
  string:
    class: tgBasicActuatorInfo
    parameters:
      stiffness: 200
      damping: 3
      pretension: 100
      history: 0
      moveCablePointAToEdge: false
"""


def write(folder, text, name="x.yaml"):
    path = folder / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text(text, encoding="utf-8")
    return path


def load(folder, text, **options):
    return tc.load_ntrt(write(folder, text), **options)


def test_rods_and_strings_in_si_units(tmp_path):
    box = load(tmp_path, BOX, length_unit=0.1)
    assert box.nodes.tolist() == pytest.approx(
        0.1 * np.array([(0, 0, 0), (4, 0, 0), (4, -4, 0), (0, 0, 3), (4, 0, 3), (4, -4, 3)])
    )
    assert box.bars.tolist() == [[0, 3], [1, 4], [2, 5]]
    assert box.strings.tolist()[:3] == [[0, 1], [1, 2], [2, 0]]
    assert box.bar_mass == pytest.approx(
        np.pi * 0.25**2 * 3 * 0.5
    )  # kg: density is per unit of volume
    assert box.bar_radius == pytest.approx(0.025)
    assert set(box.stiffness) == {200.0}  # kg/s² in any unit of length
    assert set(box.damping) == {3.0}
    tension = box.stiffness * (box.string_lengths - box.rest_length)
    assert tension == pytest.approx(100 * 0.1)  # kg dm/s² in N
    assert load(tmp_path, BOX).nodes[3].tolist() == [0.0, 0.0, 3.0]


def test_defaults_are_those_of_ntrt(tmp_path):
    box = load(tmp_path, BOX[: BOX.index("builders")])
    assert box.bar_mass == pytest.approx(np.pi * 0.5**2 * 3)
    assert set(box.stiffness) == {1000.0}
    assert set(box.damping) == {10.0}
    assert box.rest_length == pytest.approx(box.string_lengths)


def test_builders_fit_by_tags_the_last_one_wins_and_rods_come_first(tmp_path):
    more = (
        BOX
        + "  tall rod:\n    class: tgRodInfo\n    parameters: {density: 2}\n  tall:\n    class: tgKinematicActuatorInfo\n"
    )
    assert load(tmp_path, more).bar_mass == pytest.approx(np.pi * 0.5**2 * 3 * 2)
    swapped = BOX.replace(
        "  string:\n    class: tgBasicActuatorInfo", "  muscle:\n    class: tgBasicContactCableInfo"
    )
    assert set(load(tmp_path, swapped).stiffness) == {1000.0}
    assert set(
        load(
            tmp_path, swapped.replace("  string:\n    - [a0", "  string muscle:\n    - [a0")
        ).stiffness
    ) == {200.0}


def test_nodes_that_nothing_uses_are_left_out_and_those_at_one_place_are_one(tmp_path):
    box = load(
        tmp_path,
        BOX.replace(
            "pair_groups", "  spare: [9, 9, 9]\n  b0_again: [4, 1.0e-12, 0]\npair_groups"
        ).replace("[a0, b0]", "[a0, b0_again]"),
    )
    assert len(box.nodes) == 6
    assert box.strings[0].tolist() == [0, 1]


def joined(attributes="", bonds="", more="") -> str:
    return (
        f"substructures:\n  low/high:\n    path: parts/box.yaml\n    {attributes}\n{bonds}\n{more}"
    )


STRUNG = "bond_groups:\n  string:\n    low/high/node_node:\n      - [a1, a0]\n      - [b1, b0]\n"


def test_substructures_are_turned_scaled_and_moved(tmp_path):
    write(tmp_path / "parts", BOX, "box.yaml")
    attributes = "offset: [0, 5, 0]\n    translation: [1, 0, 0]\n    scale: 2\n    rotation: {axis: [0, 2, 0], angle: 90, reference: [1, 1, 1]}"
    both = load(tmp_path, joined(attributes, STRUNG))
    assert (len(both.bars), len(both.strings)) == (6, 14)
    box = load(tmp_path, BOX).nodes[:, [0, 2, 1]] * [1, 1, -1]  # as NTRT has it
    turned = 1 + Rotation.from_rotvec([0, 90, 0], degrees=True).apply(box - 1)
    grown = turned.mean(axis=0) + 2 * (turned - turned.mean(axis=0)) + [1, 0, 0]
    for k, nodes in enumerate((both.nodes[:6], both.nodes[6:])):
        assert nodes[:, [0, 2, 1]] * [1, 1, -1] == pytest.approx(grown + k * np.array([0, 5, 0]))
    assert both.strings[:2].tolist() == [
        [3, 6],
        [4, 7],
    ]  # bonds stand in the whole, before its parts
    assert both.bar_mass == pytest.approx(np.pi * 0.25**2 * 6 * 0.5)


def test_substructures_turn_about_their_middle(tmp_path):
    write(tmp_path / "parts", BOX, "box.yaml")
    both = load(
        tmp_path, joined("rotation: {axis: [1, 1, 0], angle: -30}\n    offset: [20, 0, 0]", STRUNG)
    )
    box = load(tmp_path, BOX).nodes
    assert both.nodes[:6].mean(axis=0) == pytest.approx(box.mean(axis=0))
    assert np.linalg.norm(both.nodes[:6, None] - both.nodes[None, :6], axis=2) == pytest.approx(
        np.linalg.norm(box[:, None] - box[None], axis=2)
    )


def test_the_builder_of_the_whole_wins_over_those_of_its_parts_and_names_of_parts_are_tags(
    tmp_path,
):
    write(tmp_path / "parts", BOX, "box.yaml")
    own = "builders:\n  string:\n    class: tgBasicActuatorInfo\n    parameters: {stiffness: 7}\n"
    both = load(tmp_path, joined("offset: [0, 9, 0]", STRUNG, own))
    assert set(both.stiffness) == {7.0}
    high = "builders:\n  string high:\n    class: tgBasicActuatorInfo\n    parameters: {stiffness: 7}\n"
    both = load(tmp_path, joined("offset: [0, 9, 0]", STRUNG, high))
    assert both.stiffness.tolist() == [
        7.0,
        7.0,
        *[200.0] * 6,
        *[7.0] * 6,
    ]  # bonds have the names of both as tags


EDGES = """bond_groups:
  low/high/node_edge:
    string:
      - [a1, a0/b0]
      - [b1, b0/c0]
      - [c1, c0/a0]
"""
# a twisted prism on an equilateral triangle: its upper nodes can meet the middles of the next one's
# lower strings
CORNERS = [(float(np.cos(angle)), float(np.sin(angle))) for angle in np.deg2rad([0, 120, 240])]
TRIANGLE = BOX
for _place, (_x, _z) in enumerate(CORNERS):
    for _old, _half, _height in (("0", 2, 0), ("1", 1, 3)):
        TRIANGLE = TRIANGLE.replace(
            ["  %s: [0, %d, 0]", "  %s: [4, %d, 0]", "  %s: [4, %d, 4]"][_place]
            % ("abc"[_place] + _old, _height),
            f"  {'abc'[_place]}{_old}: [{_half * _x!r}, {_height}, {_half * _z!r}]",
        )


def test_nodes_meet_the_middles_of_strings(tmp_path):
    write(tmp_path / "parts", TRIANGLE, "box.yaml")
    both = load(tmp_path, joined(bonds=EDGES))
    low, high = both.nodes[:6], both.nodes[6:]
    assert np.ptp(both.nodes[:, 2]) == pytest.approx(6.0)
    for node, (first, last) in zip(low[3:], ((0, 1), (1, 2), (2, 0)), strict=True):
        assert node == pytest.approx(
            (high[first] + high[last]) / 2, abs=1e-9
        )  # side 2√3: its middle is at 1 from the axis
    assert (
        len(both.strings) == 12 - 3 - 3 + 6
    )  # edges and strings between the nodes give way to two for each edge
    assert both.strings[:2].tolist() == [[6, 3], [3, 7]]
    assert both.string_lengths[:6] == pytest.approx(np.sqrt(3))
    apart = np.linalg.norm(low[:, None] - low[None], axis=2)
    assert np.linalg.norm(high[:, None] - high[None], axis=2) == pytest.approx(
        apart
    )  # moved as a rigid body


def test_a_substructure_upside_down_is_turned_about(tmp_path):
    write(tmp_path / "parts", TRIANGLE, "box.yaml")
    below = (
        EDGES.replace("[a1, a0/b0]", "[a0/b0, a1]")
        .replace("[b1, b0/c0]", "[b0/c0, b1]")
        .replace("[c1, c0/a0]", "[c0/a0, c1]")
    )
    assert np.ptp(load(tmp_path, joined(bonds=below)).nodes[:, 2]) == pytest.approx(6.0)
    mirrored = (
        EDGES.replace("b1, b0/c0", "x").replace("c1, c0/a0", "b1, c0/a0").replace("x", "c1, b0/c0")
    )
    flat = load(
        tmp_path, joined(bonds=mirrored)
    ).nodes  # the other way round about the normal: the second one hangs down
    assert np.ptp(flat[:, 2]) == pytest.approx(3.0)
    for node, (first, last) in zip(flat[3:6], ((0, 1), (2, 0), (1, 2)), strict=True):
        assert node == pytest.approx((flat[6 + first] + flat[6 + last]) / 2, abs=1e-9)


def test_rods_that_meet_turn_freely_with_a_warning(tmp_path):
    corner = (
        BOX.replace("[b0, b1]", "[a0, b1]")
        .replace("    - [b0, c0]\n", "")
        .replace("    - [a0, b0]\n", "")
    )
    told = r"2 rods meet at node a0: NTRT welds them .*"
    with pytest.warns(tc.InexactImportWarning, match=rf"1 change: {told} turn freely") as caught:
        jointed = load(tmp_path, corner)
    assert caught[0].filename == __file__
    assert len(jointed.bars) == 3
    assert len(jointed.nodes) == 5


def inertia_of(body):
    """Inertia matrix (3, 3) of a body [kg m²]."""
    return np.diag(body.inertia) if np.ndim(body.inertia) == 1 else np.array(body.inertia)


def test_welded_rods_form_one_body(tmp_path):
    text = """
nodes: {a: [0, 0, 0], b: [4, 0, 0], c: [0, 0, 6], d: [9, 1, 0], e: [9, 5, 0]}
pair_groups: {rod: [[a, b], [a, c], [d, e]], string: [[b, d], [c, e]]}
builders: {rod: {class: tgRodInfo, parameters: {density: 0.5, radius: 0.2}}}
"""
    welded = load(tmp_path, text, ball_joints=False, length_unit=0.1)
    assert welded.bars.tolist() == [[3, 4]]
    (body,) = welded.bodies
    assert body.nodes == (0, 1, 2)
    masses = np.pi * 0.04 * 0.5 * np.array([4.0, 6.0])
    assert body.mass == pytest.approx(masses.sum())
    assert body.center == pytest.approx((masses @ [[0.2, 0, 0], [0, -0.3, 0]]) / masses.sum())
    # cylinders of 0.4 and 0.6 m with a radius of 0.02 m, from the file's points, about the corner
    own = body.mass_properties(welded.nodes[:3])
    about = own.moments + body.mass * np.outer(own.center, own.center)
    across = masses * 0.02**2 / 4
    along = masses * np.array([0.4, 0.6]) ** 2 / 3
    expected = np.diag([along[0] + across[1], along[1] + across[0], across.sum()])
    assert about == pytest.approx(expected, abs=1e-12)
    run = tc.simulate(tc.Model(tc.Scene(welded, gravity=tc.Gravity())), t_end=0.05, step=1e-3)
    assert run.success, run.message


def test_welded_rods_in_a_row_form_a_thin_body(tmp_path):
    text = """
nodes: {a: [0, 0, 0], b: [1, 0, 0], c: [4, 0, 0]}
pair_groups: {rod: [[a, b], [b, c]]}
builders: {rod: {class: tgRodInfo, parameters: {density: 2, radius: 0.1}}}
"""
    (body,) = load(tmp_path, text, ball_joints=False).bodies
    whole = 2 * np.pi * 0.01 * 4
    turning = whole * (16 / 12 + 0.01 / 4)
    assert inertia_of(body) == pytest.approx(np.diag([0, turning, turning]), abs=1e-12)


def test_boxes_become_bodies_with_their_corners(tmp_path):
    text = """
nodes: {a: [0, 0, 0], b: [4, 0, 0], c: [0, 5, 0], d: [0, 9, 0]}
pair_groups: {box: [[a, b]], rod: [[c, d]], string: [[a, c], [b, d]]}
builders: {box: {class: tgBoxInfo, parameters: {density: 0.25, width: 0.5, height: 1.5}}}
"""
    boxed = load(tmp_path, text)
    (body,) = boxed.bodies
    mass = 0.25 * 4 * 1.0 * 3.0
    assert body.mass == pytest.approx(mass)
    assert body.center == pytest.approx((2, 0, 0))
    # NTRT turns the upright box by the smallest rotation: the width is upright, the height level
    size = np.ptp(boxed.nodes[list(body.nodes)], axis=0)
    assert size == pytest.approx([4, 3, 1], abs=1e-12)
    expected = mass / 12 * np.array([9 + 1, 16 + 1, 16 + 9])
    assert inertia_of(body) == pytest.approx(np.diag(expected), abs=1e-12)
    assert len(boxed.nodes) == 4 + 8
    fixed = load(tmp_path, text.replace("density: 0.25", "density: 0"))
    assert (dict(fixed.pinned), fixed.bodies) == ({0: "xyz", 1: "xyz"}, ())


def test_rods_of_density_0_do_not_move(tmp_path):
    box = load(tmp_path, BOX.replace("density: 0.5", "density: 0"))
    assert dict(box.pinned) == dict.fromkeys(range(6), "xyz")
    assert (box.bar_mass > 0).all()


def test_directives_and_tabs_are_read_as_ntrt_does(tmp_path):
    text = "%YAML of a box" + BOX.replace("  b0: [4, 0, 0]", "\tb0: [4, 0, 0]")
    assert load(tmp_path, text).nodes.tolist() == load(tmp_path, BOX).nodes.tolist()


def test_lenient_import_lists_and_leaves_out_unknown_entries(tmp_path):
    text = BOX.replace("    - [a0, b0]\n", "    - [a0, b0]\n    - [b0, b0]\n")
    text = text.replace("  string:\n    - [a0", "  frame:\n    - [a0, c1]\n  string:\n    - [a0")
    text += "  ball:\n    class: tgSphereInfo\n    parameters: {radius: 1}\ncolor: red\n"
    with pytest.raises(ValueError, match="line 39, color: is not known"):
        load(tmp_path, text)
    with pytest.warns(tc.InexactImportWarning) as caught:
        box = load(tmp_path, text, strict=False)
    assert [change.partition(":")[0] for change in caught[0].message.changes] == [
        "line 39, color",
        "line 37, class",
        "line 15, frame",
        "line 18, string",
    ]
    assert box.strings.tolist() == load(tmp_path, BOX).strings.tolist()


def test_lenient_import_keeps_strings_of_too_much_pretension_short(tmp_path):
    text = BOX.replace("pretension: 100", "pretension: 900")
    with pytest.warns(tc.InexactImportWarning, match="has the pretension 900 on a length of 4"):
        box = load(tmp_path, text, strict=False)
    assert box.rest_length[0] == pytest.approx(0.01 * box.string_lengths[0])
    assert box.rest_length[2] == pytest.approx(box.string_lengths[2] - 4.5)


def test_substructures_share_attributes_across_keys(tmp_path):
    write(tmp_path / "parts", BOX, "box.yaml")
    more = "  high:\n    translation: [0, 20, 0]\n"
    text = joined().rstrip() + "\n" + more + STRUNG
    both = load(tmp_path, text)
    assert both.nodes[6:] - both.nodes[:6] == pytest.approx(np.tile([0, 0, 20], (6, 1)))
    with pytest.raises(ValueError, match="line 4, top: has no path"):
        load(tmp_path, text.replace("  high:", "  top:"))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "nodes:",
            "knots:",
            "line 2, knots: is not known: the keys here are nodes, pair_groups, builders, substructures, bond_groups",
        ),
        ("  b0: [4, 0, 0]", "  b0: [4, 0]", "line 4, b0: is a list: give a list of 3"),
        ("  b0: [4, 0, 0]", "  b0: [4, 0, x]", "line 4, b0: is 'x': give a number"),
        ("  b0: [4, 0, 0]", "  b0: [4, 0, .inf]", "line 4, b0: is '.inf': give a"),
        ("  b0: [4, 0, 0]", "  b0: [4, 0, 1e300]", "line 4, b0: is '1e300': give a finite number"),
        ("  b0: [4, 0, 0]", "  a0: [4, 0, 0]", "line 4, a0: is given twice, or is no word"),
        ("    - [a0, b0]", "    - [a0, b9]", "line 15, string: names the node 'b9': there is none"),
        (
            "    - [a0, b0]",
            "    - [a0, box.b0]",
            "line 15, string: names the substructure 'box': there is none",
        ),
        ("    - [a0, b0]", "    - [a0, b0, c0]", "line 15, string: is a list: give a list of 2"),
        (
            "    - [a0, b0]",
            "    - [a0, a0]",
            "line 15, string: joins a0 and a0, which are at one place",
        ),
        (
            "  string:\n    - [a0",
            "  cable:\n    - [a0",
            "line 15, cable: has the tags cable, which no builder fits: NTRT builds nothing there",
        ),
        (
            "class: tgRodInfo",
            "class: tgSphereInfo",
            "line 23, class: is 'tgSphereInfo' for rod: only tgRodInfo, ",
        ),
        ("    class: tgRodInfo\n", "", "line 22, rod: has no class: give one of tgRodInfo"),
        (
            "radius: 0.25",
            "girth: 0.25",
            "line 24, girth: is not known: the keys here are radius, density, friction",
        ),
        (
            "stiffness: 200",
            "stiffness: 0",
            "line 28, stiffness: is 0 for string: it must be greater than 0",
        ),
        ("damping: 3", "damping: -3", "line 29, damping: is -3 for string: it must be at least 0"),
        (
            "pretension: 100",
            "pretension: 800",
            "line 15, string: has the pretension 800 on a length of 4: it must be less than 800",
        ),
        ("    - [a0, a1]\n", "", "node a0 has strings, and no rod ends there"),
        ("    - [b0, c0]", "    - [a1, b1\n    - [b0, c0]", "line 17: it is no YAML"),
        (
            "nodes:",
            "nodes: !!python/object/apply:os.system ['touch hacked']\nmore:",
            "line 3, more: is not known",
        ),
        ("nodes:", "nodes: &a {x: *a}\nmore:", "an alias in line 2 contains itself"),
    ],
)
def test_what_is_wrong_is_told_with_file_line_and_cure(old, new, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert old in BOX
    with pytest.raises(ValueError, match=re.escape(told)) as caught:
        load(tmp_path, BOX.replace(old, new, 1))
    assert str(caught.value).startswith("x.yaml")
    assert len(str(caught.value).splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["x.yaml"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (joined("size: 3"), "line 4, size: is not known: the keys here are path, rotation"),
        (joined("rotation: {angle: 3}"), "line 4, rotation: needs an axis and an angle"),
        (
            joined("rotation: {axis: [0, 0, 0], angle: 3}"),
            "line 4, axis: is (0, 0, 0): give a direction",
        ),
        (
            joined().replace("parts/box.yaml", "../../../box.yaml"),
            "path: is '../../../box.yaml': give a .yaml file in",
        ),
        (
            joined().replace("parts/box.yaml", "/etc/passwd"),
            "path: is '/etc/passwd': give a .yaml file in",
        ),
        (
            joined().replace("parts/box.yaml", "parts/box.txt"),
            "path: is 'parts/box.txt': give a .yaml file in",
        ),
        (
            joined().replace("parts/box.yaml", "parts/none.yaml"),
            "path: is 'parts/none.yaml': there is no such file",
        ),
        (joined().replace("parts/box.yaml", "x.yaml"), "path: is 'x.yaml', which contains itself"),
        (joined().replace("path: parts/box.yaml", ""), "low/high: has no path"),
        (
            joined(bonds=STRUNG.replace("node_node", "node_face")),
            "is of the bond low/high/node_face: give two substructures or more",
        ),
        (
            joined(bonds=STRUNG.replace("low/high/node_node", "node_node")),
            "stands in string: give tags and a bond",
        ),
        (
            joined(bonds=STRUNG.replace("low/high", "low/top")),
            "names the substructure 'top': there is none",
        ),
        (
            joined(bonds=EDGES.replace("      - [c1, c0/a0]\n", "")),
            "has fewer than 3 pairs of a node and an edge",
        ),
        (joined(bonds=EDGES.replace("c0/a0", "c0")), "does not pair a node with an edge"),
        (joined(bonds=EDGES.replace("c0/a0", "c0/a0/b0")), "an edge has two ends"),
        (
            joined(bonds=EDGES.replace("c0/a0", "a0/a1")),
            "has the rod a0/a1 for an edge: only strings can be edges",
        ),
        (
            joined(bonds=EDGES.replace("[c1, c0/a0]", "[a1, a0/b0]")),
            "pairs places on one line: their first three must span a plane",
        ),
        (
            joined(),
            "line 11, rod tall: is a rod or box that is given twice",
        ),  # both parts at one place
    ],
)
def test_wrong_substructures_and_bonds_are_told(text, told, tmp_path):
    write(tmp_path / "parts", BOX, "box.yaml")
    write(tmp_path / "parts", BOX, "box.txt")
    with pytest.raises(ValueError, match=re.escape(told)) as caught:
        load(tmp_path, text)
    assert "yaml" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_files_of_other_folders_need_their_folder(tmp_path):
    write(tmp_path / "parts", BOX, "box.yaml")
    text = joined("offset: [0, 9, 0]", STRUNG)
    near = write(tmp_path / "near", text.replace("parts/box.yaml", "../parts/box.yaml"))
    assert len(tc.load_ntrt(near).bars) == 6
    far = write(tmp_path / "far" / "off", text.replace("parts/box.yaml", "../../parts/box.yaml"))
    with pytest.raises(ValueError, match="or another folder by load_ntrt"):
        tc.load_ntrt(far)
    assert len(tc.load_ntrt(far, folder=tmp_path).bars) == 6


LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 10)}]\n"
    for before, name in pairwise("abcdefghij")
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LAUGHS, "more than 100000 entries"),
        ("nodes: " + "[" * 5000, "nested too deeply|no YAML"),
        ("nodes: {a: " + "9" * 16_000_000 + "}", "more than 16 MB"),
        ("", "it is empty"),
        ("\0\1\2", "no YAML"),
        ("- a\n- b\n", "the file: is a list: give keys and values"),
    ],
    ids=["laughs", "deep", "large", "empty", "binary", "list"],
)
def test_files_that_want_memory_are_refused(text, told, tmp_path):
    with pytest.raises(ValueError, match=rf"(?s)x\.yaml.*({told})") as caught:
        load(tmp_path, text)
    assert len(str(caught.value)) < 800


def test_substructures_that_multiply_are_refused(tmp_path):
    for level in range(12):
        below = f"low/mid/high:\n    path: level{level + 1}.yaml"
        write(tmp_path, f"substructures:\n  {below}\n", f"level{level}.yaml")
    write(tmp_path, BOX, "level12.yaml")
    with pytest.raises(ValueError, match="makes more than 100000 nodes, pairs and substructures"):
        tc.load_ntrt(tmp_path / "level0.yaml")


def test_damaged_files_are_refused_or_read(tmp_path):
    write(tmp_path / "parts", TRIANGLE, "box.yaml")
    draw, refused = random.Random(1), 0
    for source in (BOX, joined("offset: [0, 5, 0]", STRUNG), joined(bonds=EDGES)):
        for _ in range(100):
            content = bytearray(source.encode())
            for _ in range(draw.choice([1, 3, 10])):
                content[draw.randrange(len(content))] = draw.randrange(256)
            (tmp_path / "x.yaml").write_bytes(content)
            try:
                tc.load_ntrt(tmp_path / "x.yaml")
            except ValueError as error:
                refused += 1
                assert ".yaml" in str(error)  # noqa: PT017  some damages load
                assert len(str(error).splitlines()) == 1  # noqa: PT017
    assert refused > 100


def test_wrong_arguments_and_what_is_missing(tmp_path, monkeypatch):
    path = write(tmp_path, BOX)
    for options, error, told in (
        ({"length_unit": 0.0}, ValueError, "length_unit is 0"),
        ({"ball_joints": 1}, TypeError, "ball_joints is 1"),
        ({"folder": 3}, TypeError, "folder is 3"),
    ):
        with pytest.raises(error, match=told):
            tc.load_ntrt(path, **options)
    with pytest.raises(FileNotFoundError):
        tc.load_ntrt(tmp_path / "missing.yaml")
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(
        ImportError, match=r"load_ntrt needs PyYAML: pip install 'tenscasadi\[exchange\]'"
    ):
        tc.load_ntrt(path)
