"""The JSON Schema takes what is read, and refuses unknown keys and wrong kinds as reading does."""

from __future__ import annotations

import sys
from pathlib import Path

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from scene_strategies import scenes

import tenscasadi as tc
from ocp.io.plan_section import file_schema

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HEAD = 'format = 1\nunits = "SI"\n'
SCHEMA = file_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_it_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert (
        "N/m" in SCHEMA["$defs"]["prism"]["properties"]["stiffness"]["description"]
    )  # from the docstring


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(scenes())
def test_written_files_are_valid(tmp_path_factory, scene):
    path = tc.save_scene(tc.Simulation(scene, 1.0), tmp_path_factory.getbasetemp() / "schema.toml")
    VALIDATOR.validate(tomllib.loads(path.read_text(encoding="utf-8")))


SCENES = sorted((Path(__file__).parents[3] / "examples/scenes").glob("*.toml"))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_examples_are_valid(path):
    VALIDATOR.validate(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "text",
    [
        "[structure]\nshape = 'prism'\nradus = 1",
        "[structure]\nshape = 'prisn'",
        "[structure]\nshape = 'prism'\nradius = true",
        "[structure]\nnodes = [[0, 0]]",
        "[scene]\ngravty = 1",
        "[scene]\nends = 'lumpd'",
        "[scene]\nslack = 'Clp'",
        "[scene]\nground = {kind = 'Ground', stifness = 1}",
        "[simulation]\nt_end = 1\nscheme = {kind = 'Rattle', orders = 2}",
        "[simulation]\nstep = 1",
        "[start]\nvelocity = [1, 2]",
        "[strcture]",
    ],
)
def test_wrong_files_are_invalid(text, tmp_path):
    (tmp_path / "scene.toml").write_text(HEAD + text, encoding="utf-8")
    assert not VALIDATOR.is_valid(tomllib.loads(HEAD + text))
    assert VALIDATOR.is_valid(tomllib.loads(HEAD))
    with pytest.raises(tc.SceneFileError):
        tc.load_simulation(tmp_path / "scene.toml")
