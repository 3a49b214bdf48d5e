"""The JSON Schema of scene files with their part [plan]: examples are valid, wrong plans are not."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jsonschema
import pytest

import ocp
from ocp.io.plan_section import file_schema
from tenscasadi.cli.main import main

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[3]
VALIDATOR = jsonschema.Draft202012Validator(file_schema())
FILES = [
    *sorted((ROOT / "tenscasadi/cli/templates").glob("*.toml")),
    *sorted((ROOT / "examples/scenes").glob("*.toml")),
]
HEAD = 'format = 1\nunits = "SI"\n[structure]\nshape = "prism"\n[plan]\n'


def test_it_is_a_schema_with_units():
    jsonschema.Draft202012Validator.check_schema(VALIDATOR.schema)
    assert (
        "N/m"
        in VALIDATOR.schema["$defs"]["ocp.ForceDensityLimits"]["properties"]["upper"]["description"]
    )


def test_the_command_line_prints_it(capsys):
    assert main(["schema"]) == 0
    told = capsys.readouterr().out
    assert json.loads(told) == VALIDATOR.schema


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_files_are_valid(path):
    VALIDATOR.validate(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "line",
    [
        "duration = [0.5, '2 * 0.4']",
        "goals = ['AtRest', { kind = 'Waypoint', share = 0.5, goals = [{ kind = 'Shape', nodes = { shape = 'prism', height = 1.1 } }] }]",
        "goals = [{ kind = 'NodePositions', positions = { 3 = [0, 'free', 1] } }]",
        "start = { near = { shape = 'prism' } }",
        "start = 'FreeStart'",
        "phases = [{ duration = 1, contact_nodes = [0] }]",
        "transcription = { kind = 'Variational', intervals = [1, 2] }",
    ],
)
def test_right_plans_are_valid(line):
    VALIDATOR.validate(tomllib.loads(HEAD + line))


@pytest.mark.parametrize(
    "line",
    [
        "duration = true",
        "goals = ['AtREst']",
        "goals = [{ kind = 'NodePositions', position = { 3 = [0, 0, 1] } }]",
        "goals = [{ kind = 'CenterOfMass', position = [0, 0] }]",
        "bounds = [{ lower = 1 }]",
        "costs = [{ kind = 'Effort', wight = 2 }]",
        "solver = 'Snopt'",
        "transcription = { kind = 'Variational', degree = 2 }",
        "gaols = []",
        "start = 'here'",
    ],
)
def test_wrong_plans_are_invalid(line, tmp_path):
    assert not VALIDATOR.is_valid(tomllib.loads(HEAD + line))
    (tmp_path / "scene.toml").write_text(HEAD + line, encoding="utf-8")
    with pytest.raises(ValueError, match=r"scene\.toml, line"):
        ocp.load_problem(tmp_path / "scene.toml")
