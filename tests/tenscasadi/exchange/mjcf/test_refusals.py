"""MJCF files that are wrong or hostile: errors of one line with file, line, element and cure."""

from __future__ import annotations

import os
import random
import re
import warnings
from pathlib import Path

import pytest
from mjcf_files import REFUSED, file

import tenscasadi as tc
from tenscasadi.exchange.source import DEEPEST


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
    for _ in range(120):
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
    assert used < 100
