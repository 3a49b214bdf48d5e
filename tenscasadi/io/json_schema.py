"""JSON Schema of scene files, by which editors complete and check them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tenscasadi.io.document import HEAD, SECTIONS
from tenscasadi.io.scene_files import SCENE
from tenscasadi.io.simulation_section import SIMULATION, START
from tenscasadi.io.structure_section import StructureSection
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.definitions import Definition
from tenscasadi.schema.field_types import NUMBER, Schema, Schemas

_OWN = {"scene": SCENE, "start": START, "simulation": SIMULATION}
_INCLUDE: Schema = {
    "type": "array",
    "items": {"type": "string", "pattern": r"\.(toml|json)$"},
    "description": "Files in this file's folder or below, read first: keys of this file override theirs.",
}


def scene_schema(more: Mapping[str, Definition] = MappingProxyType({})) -> dict[str, Any]:
    """Build the JSON Schema of scene files.

    `more` are definitions of sections that other packages read, such as the plan.
    """
    kinds: Schemas = {}
    sections = {"structure": StructureSection().schema(kinds)}
    sections |= {name: own.schema(kinds) for name, own in (_OWN | dict(more)).items()}
    tables = {
        name: {"description": text, **sections.get(name, {"type": "object"})}
        for name, text in SECTIONS.items()
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
