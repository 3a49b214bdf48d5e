"""Cables in scene files and in saved results."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc

FILE = """format = 1
units = "SI"

[structure]
nodes = {left = [-1, 0, 0], load = [0, 0, -0.8], right = [1, 0, 0]}
pinned = ["left", "right"]
node_mass = {load = 2.0}
stiffness = 1000.0
cables = [["line"]]
cable_friction = 0.1

[structure.strings]
line = [["left", "load"], ["load", "right"]]

[scene]
control = "Tension"
"""


def test_file_names_the_strings_of_a_cable(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text(FILE, encoding="utf-8")
    scene = tc.load_scene(path)
    assert scene.structure.cables == ((0, 1),)
    assert scene.structure.cable_friction.tolist() == [0.1]
    assert scene.control == tc.Tension()
    assert scene.nu == 1


@pytest.mark.parametrize("ending", ["toml", "json"])
def test_scene_with_cables_comes_back(tmp_path, ending):
    s = tc.shapes.prism().replace(cables=[[0, 1, 2], [4, 3]], cable_friction=[0.1, 0.2])
    scene = tc.Scene(s, control=tc.RestLength())
    loaded = tc.load_scene(tc.save_scene(scene, tmp_path / f"scene.{ending}"))
    assert loaded.structure.cables == s.cables
    assert loaded.structure.cable_friction.tolist() == [0.1, 0.2]
    assert tc.Model(loaded).ode.serialize() == tc.Model(scene).ode.serialize()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('cables = [["line"]]', "cables = [[0, 5]]", "5"),
        ('cables = [["line"]]', "cables = 3", "cables"),
        ("cable_friction = 0.1", "cable_friction = -0.1", "cable_friction of cable 0 is -0.1"),
        ('control = "Tension"', 'control = "ForceDensity"', "give Tension"),
    ],
)
def test_wrong_cables_of_files_are_rejected(tmp_path, old, new, message):
    assert old in FILE
    path = tmp_path / "line.toml"
    path.write_text(FILE.replace(old, new), encoding="utf-8")
    with pytest.raises(tc.SceneFileError, match=message):
        tc.load_scene(path)


def test_trajectory_keeps_its_cables(tmp_path):
    s = tc.shapes.prism(prestress=10.0).replace(cables=[[0, 1, 2]])
    run = tc.simulate(tc.Model(tc.Scene(s)), 0.01, 1e-3, verify=False)
    loaded = tc.Trajectory.load(run.save(tmp_path / "run.npz"))
    assert loaded.scene.structure.cables == ((0, 1, 2),)
    np.testing.assert_array_equal(loaded.tension, run.tension)
