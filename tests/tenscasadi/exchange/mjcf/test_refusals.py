"""Files for MuJoCo that are wrong, hostile, or say what a scene has not: one line with file, line, element and cure."""

from __future__ import annotations

import os
import random
import re
import warnings
from pathlib import Path

import pytest

import tenscasadi as tc
from tenscasadi.exchange.mjcf.elements import DEEPEST

FREE = '<joint type="free"/>'
INERTIAL = FREE + '<inertial pos="0.5 0 0" mass="1" diaginertia="{}"/>'
ROD = '<geom type="capsule" size="0.01" fromto="0 0 0 1 0 0"/>'
SITES = '<site name="a"/><site name="b" pos="1 0 0"/>'
STRING = '<spatial stiffness="1"><site site="a"/><site site="w"/></spatial>'


def file(
    body: str = FREE + ROD + SITES, tendon: str = STRING, more: str = "", world: str = ""
) -> str:
    """A file of one bar and one string, each line an element of its own."""
    inside = f'<worldbody>\n<site name="w" pos="0 1 0"/>{world}\n<body name="bar">{body}</body>\n</worldbody>\n<tendon>{tendon}</tendon>\n{more}\n'
    return f"<mujoco>\n{inside}</mujoco>"


def refusal(text: str | bytes, tmp_path: Path) -> str:
    path = tmp_path / "scene.xml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(tc.SceneFileError) as caught:
        tc.import_mjcf(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("scene.xml")
    return str(caught.value)


def test_the_file_itself_is_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(file())
    scene = tc.import_mjcf(path)
    assert scene.structure.bars.tolist() == [[0, 1]]
    assert scene.structure.pinned == {2: "xyz"}


REFUSED: dict[str, tuple[str, str]] = {
    "include": (file(more='<include file="/etc/passwd"/>'), r"line 7, <include> has no counterpart|line 7, <include>: has no counterpart .*one file"),
    "hinge": (file("<joint/>" + ROD + SITES), r"line 4, <joint> type: is a hinge.* ball"),
    "damped joint": (file('<joint type="ball" damping="0.1"/>' + ROD + SITES), r"<joint> damping: is '0.1', which has no counterpart"),
    "limits": (file('<joint type="ball" range="0 1"/>' + ROD + SITES), "<joint> range: limits a joint"),
    "two joints": (file(FREE + FREE + ROD + SITES), "<joint>: follows a joint"),
    "free inside": (file(FREE + ROD + SITES + f"<body>{FREE}{ROD}</body>"), "is free inside another body"),
    "slides without turning": (file('<joint type="slide"/>' + ROD + SITES), 'line 4, <body name="bar">: is a bar that slides without turning'),
    "slide along nothing": (file('<joint type="slide" axis="0 0 0"/>' + ROD + SITES), "<joint> axis: slides in another body, or along no direction"),
    "slides that depend": (file('<joint type="slide"/>' * 2 + '<joint type="ball"/>' + ROD + SITES), "slides along directions that depend"),
    "kind of joint": (file('<joint type="screw"/>' + ROD + SITES), "is 'screw': tenscasadi reads hinge or slide"),
    "third place": (file(FREE + ROD + SITES + '<site name="c" pos="0.5 0 0"/>', STRING + STRING.replace('"a"', '"b"') + STRING.replace('"a"', '"c"')),
                    'line 4, <body name="bar">: has strings or joints at 3 places'),
    "beside the end": (file(FREE + ROD + '<site name="a" pos="0.5 0 0"/>'), "bars have them at their ends"),
    "no mass": (file(FREE + '<geom type="capsule" size="0.01" fromto="0 0 0 1 0 0" mass="0"/>' + SITES, STRING + STRING.replace('"a"', '"b"')),
                "has no mass between its ends"),
    "nothing": (file(FREE, ""), "has no mass: give an <inertial> or a geom"),
    "mass beside the middle": (file(INERTIAL.format("1 1 1").replace("0.5", "0.3") + ROD + SITES), "which is not the middle of its ends"),
    "light in the middle": (file(INERTIAL.format("1e-3 1e-3 1e-3") + ROD + SITES), "less than a thin rod"),
    "not round": (file(INERTIAL.format("0.1 0.1 0.2") + ROD + SITES), "bars are round"),
    "box": (file(FREE + '<geom type="box" size="0.5 0.1 0.1"/>' + SITES), "<geom> type: is 'box', whose mass is not read"),
    "sphere fromto": (file(FREE + ROD.replace("capsule", "sphere") + SITES), "<geom> fromto: is given to a sphere"),
    "size": (file(FREE + ROD.replace("0.01", "-1") + SITES), "<geom> size: is '-1': give lengths greater than 0"),
    "number": (file(FREE + ROD.replace("0.01", "thin") + SITES), "<geom> size: is 'thin': give 1 or 2 or 3 finite numbers"),
    "infinite": (file(FREE + ROD.replace("1 0 0", "1 0 inf") + SITES), "<geom> fromto: is '0 0 0 1 0 inf': give 6 finite numbers"),
    "two turns": (file(FREE + ROD + SITES).replace('name="bar"', 'quat="1 0 0 0" euler="0 0 0"'), "<body> euler: is given beside quat"),
    "no turn": (file(FREE + ROD + SITES).replace('name="bar"', 'quat="0 0 0 0"'), "<body> quat: is '0 0 0 0': give directions of some length"),
    "mocap": (file(FREE + ROD + SITES).replace('name="bar"', 'mocap="true"'), "<body> mocap: is moved from outside"),
    "class": (file(FREE + ROD.replace("type", 'class="thin" type') + SITES), "names the class 'thin'"),
    "same site": (file(FREE + ROD + SITES * 2), '<site name="a"> name: is the name of two sites'),
    "wrapping": (file(tendon='<spatial><site site="a"/><geom geom="g"/><site site="w"/></spatial>'), "<geom>: has no counterpart in a scene: .*wrap"),
    "three sites": (file(tendon=STRING.replace("</sp", '<site site="b"/></sp')), "runs through 3 sites"),
    "no site": (file(tendon=STRING.replace('"w"', '"v"')), "<site> site: is 'v', which is no site"),
    "fixed tendon": (file(tendon='<fixed><joint joint="j" coef="1"/></fixed>'), "<fixed>: has no counterpart"),
    "limited tendon": (file(tendon=STRING.replace("<spatial", '<spatial range="0 1"')), "<spatial> range: limits the length"),
    "friction": (file(tendon=STRING.replace("<spatial", '<spatial frictionloss="0.5"')), "<spatial> frictionloss: is '0.5'"),
    "deadband": (file(tendon=STRING.replace("<spatial", '<spatial springlength="0.5 1"')), "<spatial> springlength: is '0.5 1': give one length"),
    "no length": (file(tendon=STRING.replace("<spatial", '<spatial springlength="0"')), "<spatial> springlength: is 0"),
    "polynomial": (file(tendon=STRING.replace('"1"', '"1 2"')), "<spatial> stiffness: is '1 2', a polynomial"),
    "weld": (file(more='<equality><weld body1="bar"/></equality>'), "line 7, <weld>: has no counterpart"),
    "connect to nothing": (file(more='<equality><connect body1="b" anchor="0 0 0"/></equality>'), "<connect> body1: is 'b', which is no body"),
    "connect without anchor": (file(more='<equality><connect body1="bar"/></equality>'), "<connect> anchor: is not given: give 3 numbers"),
    "sites apart": (file(more='<equality><connect site1="a" site2="w"/></equality>'), "<connect>: joins sites that are apart"),
    "motor": (file(more='<actuator><motor tendon="t"/></actuator>'), "<motor>: has no counterpart in a scene: give a position actuator"),
    "actuator of nothing": (file(more='<actuator><position tendon="t"/></actuator>'), "<position> tendon: is 't'"),
    "gain": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'), more='<actuator><general tendon="t"/></actuator>'),
             "<general> gainprm: pulls by another law"),
    "tension limits": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                            more='<actuator><position tendon="t" forcerange="-5 0"/></actuator>'), "<position> forcerange: is '-5 0'"),
    "two laws": (file(tendon=STRING.replace("<spatial", '<spatial name="t"'), more='<actuator><position tendon="t"/></actuator>'),
                 "stiffness: has stiffness or damping beside an actuator"),
    "some driven": (file(tendon=STRING + STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                         more='<actuator><position tendon="t"/></actuator>'), "<spatial>: has no actuator, while others have"),
    "short ctrl": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                        more='<actuator><position tendon="t"/></actuator><keyframe><key ctrl="1 2"/></keyframe>'),
                   "<key> ctrl: is '1 2': give 1 finite number"),
    "wind": (file(more='<option wind="1 0 0"/>'), "<option> wind: is '1 0 0'"),
    "collision": (file(more='<option collision="predefined"/>'), "<option> collision: has no counterpart"),
    "coordinates": (file(more='<compiler coordinate="global"/>'), "coordinate: is 'global': tenscasadi reads local"),
    "total mass": (file(more='<compiler settotalmass="3"/>'), "<compiler> settotalmass: is '3'"),
    "gravity": (file(more='<option gravity="0 0"/>'), "gravity: is '0 0': give 3 finite numbers"),
    "obstacle": (file(world='<geom type="box" size="1 1 1"/>'), r"<geom> type: is touched by bodies: tenscasadi's grounds are planes"),
    "composite": (file(world='<composite type="cable"/>'), "<composite>: has no counterpart"),
    "plugin": (file(more="<extension><plugin/></extension>"), "<extension>: has no counterpart"),
    "negative": (file(tendon=STRING.replace('"1"', '"-1"')), "stiffness of string 0 is -1"),
    "urdf": ("<robot/>", "<robot>: is no MJCF"),
    "no world": ("<mujoco/>", "<mujoco>: has no <worldbody>"),
    "empty": ("", "it is no XML"),
    "text": ("structure = 3", "line 1: it is no XML"),
    "unfinished": (file()[:-5], "line 8: it is no XML"),
    "twice": (file(FREE + '<geom size="1" size="2"/>'), "line 4: it is no XML, duplicate attribute"),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><mujoco/>', "encoding"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_counterpart_is_refused_by_name(name: str, tmp_path: Path) -> None:
    text, words = REFUSED[name]
    assert re.search(words, refusal(text, tmp_path)), refusal(text, tmp_path)


BOMB = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
HOSTILE = {
    "laughs": f'<!DOCTYPE mujoco [<!ENTITY l0 "ha">{BOMB}]><mujoco model="&l9;"/>',
    "external": '<!DOCTYPE mujoco [<!ENTITY secret SYSTEM "file:///etc/passwd">]><mujoco model="&secret;"/>',
    "outer subset": '<!DOCTYPE mujoco SYSTEM "http://localhost/mujoco.dtd"><mujoco/>',
    "parameter": '<!DOCTYPE mujoco [<!ENTITY % more SYSTEM "file:///etc/passwd"> %more;]><mujoco/>',
    "defaults of attributes": '<!DOCTYPE mujoco [<!ATTLIST mujoco model CDATA "x">]><mujoco/>',
}


@pytest.mark.parametrize("name", HOSTILE)
def test_document_types_and_entities_are_refused(name: str, tmp_path: Path) -> None:
    for text in (HOSTILE[name], HOSTILE[name].encode("utf-16")):
        assert "line 1: it has a document type" in refusal(text, tmp_path)


def test_entities_that_nobody_declares_are_refused(tmp_path: Path) -> None:
    assert "undefined entity" in refusal('<mujoco model="&secret;"/>', tmp_path)


def test_sizes_are_checked_before_memory_is_taken(tmp_path: Path) -> None:
    assert "16 MB" in refusal(b"<mujoco>" + b" " * 16_000_000 + b"</mujoco>", tmp_path)
    assert "nested more than" in refusal("<mujoco><worldbody>" + "<body>" * (DEEPEST + 1), tmp_path)
    assert "nested more than" in refusal("<mujoco>" + "<default>" * (DEEPEST + 1), tmp_path)
    assert "more than 100000 elements" in refusal(
        "<mujoco><worldbody>" + "<site/>" * 100_001, tmp_path
    )
    deep = (
        "<mujoco><worldbody>"
        + "<body>" * (DEEPEST - 3)
        + "</body>" * (DEEPEST - 3)
        + "</worldbody></mujoco>"
    )
    assert "nodes is empty" in refusal(deep, tmp_path)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        tc.import_mjcf(tmp_path / "missing.xml")
    with pytest.raises(TypeError, match="path is 3"):
        tc.import_mjcf(3)
    with pytest.raises(tc.SceneFileError, match="no regular file"):
        tc.import_mjcf(tmp_path)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(tc.SceneFileError, match="no regular file"):
        tc.import_mjcf(tmp_path / "fifo")


ODD = [
    "",
    "nan",
    "-1",
    "0",
    "1e308",
    "x",
    "1 2 3 4 5 6 7",
    "0 0 0",
    "true",
    "🦴",
    "1e-300",
    "-1 -1",
    "&lt;",
    " ",
    "auto",
    "n0",
    "bar1",
    "ground0",
]


def damaged(draw: random.Random, text: str) -> str:
    """A file with an attribute changed, or an element lost, doubled, or renamed."""
    way = draw.randrange(4)
    if way < 2:
        spots = list(re.finditer(r'(?<==")[^"]*', text))
        spot = draw.choice(spots)
        return text[: spot.start()] + draw.choice(ODD) + text[spot.end() :]
    if way == 2:
        spot = draw.choice(list(re.finditer(r"<\w+[^<>]*/>", text)))
        return text[: spot.start()] + spot.group() * draw.choice([0, 2]) + text[spot.end() :]
    spot = draw.choice(list(re.finditer(r"(?<=<)\w+|(?<= )\w+(?==)", text)))
    return (
        text[: spot.start()]
        + draw.choice(["geom", "joint", "site", "body", "pos", "default", "size", "mass"])
        + text[spot.end() :]
    )


@pytest.mark.parametrize("joints", ["ball", "connect"])
def test_damaged_files_are_refused_or_of_use(joints: str, tmp_path: Path) -> None:
    s = tc.shapes.d_bar(pinned=[0], node_mass=0.1, stiffness=1000.0, prestress=50.0)
    ground = tc.Ground(height=-2.0, friction=0.4)
    path, draw = tmp_path / "scene.xml", random.Random(1)
    whole = tc.export_mjcf(
        tc.Scene(s, ground=ground, control=tc.RestLength()), path, joints=joints
    ).read_text()
    used = 0
    for _ in range(300):
        text = damaged(draw, whole)
        path.write_text(text)
        try:
            scene = tc.import_mjcf(path)
        except tc.SceneFileError as error:
            assert re.fullmatch(r"scene\.xml.*", str(error)), text  # noqa: PT017  most damages are seen
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tc.Model(scene)
            used += 1
    assert used < 250
