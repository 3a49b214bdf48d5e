"""Lenient import of MJCF: features without a counterpart are listed and left out."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest
from mjcf_files import FREE, REFUSED, ROD, SITES, STRING, file

import tenscasadi as tc

MISTAKES = {
    *("include elsewhere", "slides that depend", "kind of joint", "nothing", "mesh"),
    *("sphere fromto", "size", "number", "infinite", "two turns", "no turn", "class"),
    *("same site", "no site", "connect to nothing", "connect without anchor", "short ctrl"),
    *("coordinates", "gravity", "negative", "urdf", "no world", "empty", "text"),
    *("unfinished", "twice", "encoding"),
}


def read(text: str, folder: Path, name: str = "scene.xml") -> tuple[tc.Scene, tuple[str, ...]]:
    """Import leniently; also returns the listed changes."""
    (folder / name).write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = tc.import_mjcf(folder / name, strict=False)
    return scene, caught[0].message.changes if caught else ()


@pytest.mark.parametrize("name", sorted(REFUSED.keys() - MISTAKES - {"include itself"}))
def test_features_without_counterpart_are_listed_and_left_out(name: str, tmp_path: Path) -> None:
    text, words = REFUSED[name]
    scene, changes = read(text, tmp_path)
    assert re.search(words, "\n".join(changes)), changes
    model = tc.Model(scene)
    control = None if model.nu == 0 else [1.0] * model.nu
    assert tc.simulate(model, 0.01, 1e-3, control=control, compiled=False).success


@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_mistakes_are_errors_all_the_same(name: str, tmp_path: Path) -> None:
    with pytest.raises(tc.SceneFileError, match=r"^scene\.xml"):
        read(REFUSED[name][0], tmp_path)


def test_exact_files_load_without_a_warning(tmp_path: Path) -> None:
    assert read(file(), tmp_path)[1] == ()


def test_strings_beside_the_axis_move_to_the_ends(tmp_path: Path) -> None:
    sites = '<site name="a" pos="0.1 0.02 0"/><site name="b" pos="0.98 -0.02 0"/>'
    strings = STRING + STRING.replace('"a"', '"b"')
    scene, changes = read(file(FREE + ROD + sites, strings), tmp_path)
    assert changes == (
        'line 4, <body name="bar">: has attached points up to 0.102 m from its ends',
    )
    assert scene.structure.nodes.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert scene.structure.strings.tolist() == [[0, 2], [1, 2]]


def test_a_tendon_through_three_sites_is_a_cable(tmp_path: Path) -> None:
    world = '<site name="v" pos="0 3 0"/>'
    through = STRING.replace("</sp", '<site site="v"/></sp').replace(">", ' springlength="0 2">', 1)
    (tmp_path / "scene.xml").write_text(file(tendon=through, world=world))
    structure = tc.import_mjcf(tmp_path / "scene.xml").structure
    assert structure.cables == ((0, 1),)
    assert structure.string_lengths.tolist() == [1.0, 2.0]
    assert structure.rest_length == pytest.approx([2 / 3, 4 / 3])
    tension = structure.stiffness * (structure.string_lengths - structure.rest_length)
    assert tension == pytest.approx([1.0, 1.0])  # of a spring of 1 N/m, 1 m longer than at rest


def test_a_hinge_that_slides_becomes_a_ball_joint(tmp_path: Path) -> None:
    joints = '<joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 0 1"/>'
    scene, _ = read(file(joints + ROD + SITES), tmp_path)
    assert dict(scene.structure.pinned) == {0: "xy", 2: "xyz"}


def test_included_files_are_part_of_the_scene(tmp_path: Path) -> None:
    whole = file()
    world = re.search(r"<worldbody>.*</worldbody>", whole, re.DOTALL)[0]
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "world.xml").write_text(f"<mujoco>{world}</mujoco>")
    text = whole.replace(world, '<include file="parts/world.xml"/>')
    (tmp_path / "scene.xml").write_text(text)
    scene = tc.import_mjcf(tmp_path / "scene.xml")
    assert scene.structure.nodes.tolist() == read(whole, tmp_path)[0].structure.nodes.tolist()
    (tmp_path / "parts" / "world.xml").write_text("<mujoco>\n<worldbody>\n<body x='3'/>")
    with pytest.raises(tc.SceneFileError, match=r"world\.xml, line 3"):
        read(text, tmp_path)


def test_positions_may_be_global(tmp_path: Path) -> None:
    local = file().replace('name="bar"', 'name="bar" pos="0 0 2"')
    rod = ROD.replace("0 0 0 1 0 0", "0 0 2 1 0 2")
    sites = SITES.replace('name="a"', 'name="a" pos="0 0 2"').replace("1 0 0", "1 0 2")
    whole = file(FREE + rod + sites, more='<compiler coordinate="global"/>')
    whole = whole.replace('name="bar"', 'name="bar" pos="0.5 0 2"')
    first, second = (read(text, tmp_path)[0].structure for text in (local, whole))
    assert first.nodes.tolist() == second.nodes.tolist()
    assert first.bar_mass.tolist() == second.bar_mass.tolist()


def test_a_payload_that_is_welded_to_a_bar_adds_its_mass(tmp_path: Path) -> None:
    payload = f'<body name="load">{FREE}<geom type="sphere" size="0.01" mass="3"/></body>'
    weld = '<equality><weld body1="bar" body2="load"/></equality>'
    strings = STRING + STRING.replace('"a"', '"b"')
    scene, _ = read(file(tendon=strings, world=payload, more=weld), tmp_path)
    assert scene.structure.node_mass.tolist() == pytest.approx([3.0, 0.0, 0.0], abs=1e-4)


def test_boxes_have_mass(tmp_path: Path) -> None:
    box = '<geom type="box" pos="0.5 0 0" size="0.5 0.01 0.01" mass="2"/>'
    strings = STRING + STRING.replace('"a"', '"b"')
    scene, _ = read(file(FREE + box + SITES, strings), tmp_path)
    assert scene.structure.bar_mass.tolist() == pytest.approx([2.0])


def test_a_motor_gives_way_to_control_by_rest_lengths(tmp_path: Path) -> None:
    tendon = STRING.replace("<spatial", '<spatial name="t" springlength="0 0.5"')
    scene, changes = read(
        file(tendon=tendon, more='<actuator><motor tendon="t"/></actuator>'), tmp_path
    )
    assert isinstance(scene.control, tc.RestLength)
    assert "adds a force to a string that goes slack" in changes[0]


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor tendon="t" gear="2"/>',
        '<general tendon="t" gainprm="2"/>',
        '<general tendon="t" gear="2" biastype="affine" biasprm="0"/>',
    ],
)
def test_a_motor_beside_a_linear_spring_is_read_exactly(actuator: str, tmp_path: Path) -> None:
    tendon = STRING.replace('stiffness="1"', 'name="t" springlength="0.5" stiffness="100"')
    key = '<keyframe><key ctrl="-3"/></keyframe>'
    path = tmp_path / "scene.xml"
    path.write_text(file(tendon=tendon, more=f"<actuator>{actuator}</actuator>{key}"))
    scene = tc.import_mjcf(path)  # strict
    length = scene.structure.string_lengths[0]
    model = tc.Model(scene)
    force = length * model.force_density(model.initial_state, model.initial_control)
    assert force.tolist() == pytest.approx([100 * (length - 0.5) + 6.0])


def test_linear_springs_of_tendon_and_actuator_add_up(tmp_path: Path) -> None:
    tendon = STRING.replace('stiffness="1"', 'name="t" springlength="0.5" stiffness="100"')
    more = (
        '<actuator><position tendon="t" kp="50"/></actuator><keyframe><key ctrl="0.8"/></keyframe>'
    )
    path = tmp_path / "scene.xml"
    path.write_text(file(tendon=tendon, more=more))
    scene = tc.import_mjcf(path)  # strict
    length = scene.structure.string_lengths[0]
    assert scene.structure.stiffness.tolist() == [150.0]
    tension = 150.0 * (length - scene.structure.rest_length[0])
    assert tension == pytest.approx(100 * (length - 0.5) + 50 * (length - 0.8))


def test_a_motor_without_a_spring_commands_the_tension(tmp_path: Path) -> None:
    tendon = STRING.replace('<spatial stiffness="1"', '<spatial name="t"')
    more = '<actuator><motor tendon="t"/></actuator><keyframe><key ctrl="-3"/></keyframe>'
    path = tmp_path / "scene.xml"
    path.write_text(file(tendon=tendon, more=more))
    scene = tc.import_mjcf(path)  # strict
    assert isinstance(scene.control, tc.Tension)
    assert tc.Model(scene).initial_control.tolist() == pytest.approx([3.0])


def test_force_densities_of_cables_become_tensions(tmp_path: Path) -> None:
    tendon = STRING.replace('stiffness="1"', 'name="t"').replace("</sp", '<site site="v"/></sp')
    law = 'gaintype="affine" gainprm="0 -1 0"'
    key = '<keyframe><key ctrl="2"/></keyframe>'
    more = f'<actuator><general tendon="t" {law}/></actuator>{key}'
    scene, changes = read(
        file(tendon=tendon, more=more, world='<site name="v" pos="0 3 0"/>'), tmp_path
    )
    assert "drives a cable by force density" in changes[0]
    assert tc.Model(scene).initial_control.tolist() == pytest.approx([2.0 * 3.0])


def test_integrators_beside_servos_keep_their_springs(tmp_path: Path) -> None:
    tendons = "".join(
        f'<spatial name="{name}"><site site="{name}"/><site site="w"/></spatial>' for name in "ab"
    )
    law = 'kp="50" kv="2" tendon'
    more = f'<actuator><position {law}="a"/><intvelocity {law}="b" actrange="0 1"/></actuator>'
    scene, changes = read(file(tendon=tendons, more=more), tmp_path)
    assert "controls its string in another way" in changes[0]
    assert scene.control == tc.RestLength()
    assert scene.structure.stiffness.tolist() == [50.0, 50.0]


def test_errors_name_the_lenient_import(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(file(tendon=STRING.replace("<spatial", '<spatial frictionloss="1"')))
    with pytest.raises(tc.SceneFileError, match="or give strict=False"):
        tc.import_mjcf(path)
