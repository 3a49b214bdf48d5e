"""Strengths of strings: fields, scene files, limits of plans, and bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.scene.failed_strings import describe_overload, require_intact
from tenscasadi.scene.strength import (
    drop_states,
    insert_states,
    limit_tensions,
)

NAMED = tc.Structure(
    [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)],
    strings=[(0, 1), (1, 2), (2, 3)],
    node_mass=1.0,
    string_names=["guys[0]", "guys[1]", "top"],
)


@pytest.mark.parametrize("force", [7.0, [7.0, np.inf, 5.0], {1: 5.0, 2: 6.0}])
def test_scene_files_hold_strengths(force, tmp_path):
    scene = tc.Scene(NAMED, strength=tc.Breaking(force, margin=0.1))
    tc.save_scene(scene, tmp_path / "scene.toml")
    again = tc.load_scene(tmp_path / "scene.toml")
    assert again.strength == scene.strength
    assert again.breakable_inputs.tolist() == scene.breakable_inputs.tolist()


def test_scene_files_name_strings(tmp_path):
    tc.save_scene(tc.Scene(NAMED), tmp_path / "scene.toml")
    with (tmp_path / "scene.toml").open("a", encoding="utf-8") as file:
        file.write("\n[scene.strength]\nforce = {guys = 8.0}\n")
    scene = tc.load_scene(tmp_path / "scene.toml")
    assert scene.strength.list_forces(3).tolist() == [8.0, 8.0, np.inf]
    assert scene.breakable_inputs.tolist() == [0, 1]


def test_scene_files_hold_yielding(tmp_path):
    scene = tc.Scene(NAMED, strength=tc.Yielding({0: 7.0}, 2.0))
    tc.save_scene(scene, tmp_path / "scene.toml")
    again = tc.load_scene(tmp_path / "scene.toml")
    assert again.strength == scene.strength
    assert again.breakable_inputs.tolist() == []
    assert again.limited_inputs.tolist() == [0]


def test_plans_stay_below_the_least_strength_of_a_cable():
    structure = NAMED.replace(cables=[[0, 1]])
    scene = tc.Scene(structure, strength=tc.Breaking([10.0, 20.0, np.inf], margin=0.1))
    assert limit_tensions(scene.structure, scene.strength).tolist() == [9.0, np.inf]
    assert limit_tensions(NAMED, None).tolist() == [np.inf] * 3


def test_the_most_overloaded_string_is_named():
    heavy = NAMED.replace(string_mass=0.1)
    scene = tc.Scene(heavy, segments=2, strength=tc.Breaking(10.0))
    assert describe_overload(scene, np.full(6, 9.9)) == ""
    text = describe_overload(scene, np.array([1.0, 2.0, 11.0, 12.0, 3.0, 4.0]))
    assert text == "string 'guys[1]' breaks, its tension of 12 N reaches its strength of 10 N"
    assert describe_overload(scene, np.array([12.0, 2, 0, 0, 0, 0])).startswith("string 'guys[0]' ")
    assert describe_overload(tc.Scene(NAMED), np.full(3, 1e9)) == ""


@pytest.mark.parametrize("strength", [tc.Breaking({0: 7.0, 2: 9.0}), tc.Yielding(7.0, 2.0)])
def test_states_without_strength_come_back(strength):
    plain = tc.Model(tc.Scene(NAMED, control=tc.RestLengthRate()))
    model = tc.Model(replace(plain.scene, strength=strength))
    start = plain.initial_state + 0.1
    whole = insert_states(model.scene, start)
    assert whole.shape == (model.nx,)
    assert np.array_equal(drop_states(model.scene, whole), start)
    assert np.array_equal(insert_states(plain.scene, start), start)
    require_intact("start", model.scene, model.split(whole).internal)


@pytest.mark.parametrize(
    ("strength", "words"),
    [
        (tc.Breaking({0: 7.0, 2: 9.0}), "the broken string 'top': give a structure without it"),
        (
            tc.Yielding({0: 7.0, 2: 9.0}, 2.0),
            "the yielded string 'top': give a structure with its new rest length",
        ),
    ],
)
def test_states_with_failed_strings_are_rejected(strength, words):
    model = tc.Model(tc.Scene(NAMED, strength=strength))
    state = model.initial_state.copy()
    state[model.moving.stop - (3 if strength.breaks else 1)] = 0.5
    with pytest.raises(ValueError, match=f"start has {words}"):
        require_intact("start", model.scene, model.split(state).internal)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"force": 0.0}, "Breaking.force .* 0: it must be greater than 0"),
        ({"force": -1.0}, "Breaking.force .* -1"),
        ({"force": np.nan}, "Breaking.force is nan"),
        ({"force": [1.0, -2.0, 3.0]}, "Breaking.force of string 1 is -2"),
        (
            {"force": [1.0, 2.0]},
            "Breaking.force has 2 entries: give one number, or one for each of 3",
        ),
        ({"force": {}}, "Breaking.force is empty"),
        ({"force": {1: -1.0}}, r"Breaking.force\[1\] is -1"),
        ({"force": {3: 1.0}}, "Breaking.force, string is 3: string indices run from 0 to 2"),
        ({"force": 1.0, "margin": 1.0}, "Breaking.margin is 1: give less than 1"),
        ({"force": 1.0, "margin": -0.1}, "Breaking.margin is -0.1"),
    ],
)
def test_wrong_fields_are_rejected(fields, message):
    with pytest.raises(ValueError, match=message):
        tc.Scene(NAMED, strength=tc.Breaking(**fields))


def test_wrong_types_are_rejected():
    with pytest.raises(TypeError, match=r"Scene\.strength is 3"):
        tc.Scene(NAMED, strength=3)
    with pytest.raises(TypeError, match=r"Breaking\.force"):
        tc.Breaking("strong")
    with pytest.raises(ValueError, match=r"Breaking\.force names string 'a'"):
        tc.Scene(NAMED, strength=tc.Breaking({"a": 1.0}))


def test_other_programs_reject_strengths(tmp_path):
    scene = tc.Scene(NAMED, strength=tc.Breaking(1.0))
    with pytest.raises(ValueError, match=r"scene\.strength is .*or a scene with strength=None"):
        tc.export_mjcf(scene, tmp_path / "scene.xml")
