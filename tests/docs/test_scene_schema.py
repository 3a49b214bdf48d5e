"""The JSON Schema in the documents is the one that the definitions make, and takes all scene files that there are."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import jsonschema
import pytest

from ocp.io.plan_section import file_schema

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
SCHEMA = json.loads((ROOT / "docs/scene_schema.json").read_text(encoding="utf-8"))
FILES = sorted(
    [
        *(ROOT / "examples/scenes").glob("*.toml"),
        *(ROOT / "tenscasadi/cli/templates").glob("*.toml"),
    ]
)
BLOCKS = re.findall(
    r"^```toml\n(format.*?)^```",
    (ROOT / "docs/scene_files.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE | re.DOTALL,
)


def test_the_schema_is_current():
    made = json.loads(json.dumps(file_schema()))
    assert made == SCHEMA, "write it again: tenscasadi schema > docs/scene_schema.json"


@pytest.mark.parametrize("text", [*(path.read_text(encoding="utf-8") for path in FILES), *BLOCKS])
def test_scene_files_are_valid(text):
    jsonschema.Draft202012Validator(SCHEMA).validate(tomllib.loads(text))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("StringLengths", "StringLength"),
        ('lower = "lower"', 'lowr = "lower"'),
        ("duration = 1.0", "duration = true"),
    ],
)
def test_wrong_plans_are_invalid(old, new):
    text = (ROOT / "tenscasadi/cli/templates/prism.toml").read_text(encoding="utf-8")
    assert old in text
    assert not jsonschema.Draft202012Validator(SCHEMA).is_valid(
        tomllib.loads(text.replace(old, new))
    )
