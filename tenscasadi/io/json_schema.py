"""JSON Schema of scene files, for editors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tenscasadi.io.document import HEAD, SECTIONS
from tenscasadi.io.scene_files import SCENE
from tenscasadi.io.structure_section import StructureSection
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.definitions import Definition
from tenscasadi.schema.field_types import NUMBER, FieldType, Schema, Schemas

_INCLUDE: Schema = {
    "type": "array",
    "items": {"type": "string", "pattern": r"\.(toml|json)$"},
    "description": "Files in this file's folder or below, read first: keys of this file override theirs.",
}


def scene_schema(sections: Mapping[str, Definition]) -> dict[str, Any]:
    """Build the JSON Schema of scene files.

    `sections` are the tables besides [structure] and [scene].
    """
    kinds: Schemas = {}
    known: Mapping[str, FieldType | Definition]
    known = {"structure": StructureSection(), "scene": SCENE, **sections}
    tables = {
        name: {"description": text, **known[name].schema(kinds)} for name, text in SECTIONS.items()
    }
    head = {name: {"const": value} for name, value in HEAD.items()}
    numbers = TableOf(NUMBER).schema(kinds)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scene file of tenscasadi",
        "description": "Tensegrity structures, scenes, simulations and plans in SI units. Numbers may be formulas in quotes.",
        "type": "object",
        "properties": {
            **{"$schema": {"type": "string"}, **head, "include": _INCLUDE},
            "numbers": {"description": "Numbers that formulas name.", **numbers},
            **tables,
        },
        "required": list(HEAD),
        "additionalProperties": False,
        "$defs": dict(sorted(kinds.items())),
    }
