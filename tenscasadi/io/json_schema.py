"""The JSON Schema of scene files, from the definitions that reading and writing use: editors complete and check files by it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tenscasadi.io.document import FORMAT, SECTIONS
from tenscasadi.io.scene_files import SCENE
from tenscasadi.io.simulation_section import SIMULATION, START
from tenscasadi.io.structure_section import STRUCTURE
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.definitions import Definition
from tenscasadi.schema.forms import NUMBER, Schema, Schemas

_INCLUDE: Schema = {
    "type": "array",
    "items": {"type": "string", "pattern": r"\.toml$"},
    "description": "Files in this file's folder or below, whose tables come first: keys of this file replace theirs.",
}
_TEXTS = {
    "structure": "Nodes, bars and strings, or a shape by its name.",
    "scene": "Control, loads, grounds, and how strings are modelled.",
    "start": "How a motion starts.",
    "simulation": "How long, with which scheme and steps a motion is simulated.",
    "plan": "A problem of optimal control: goals, bounds, costs, and how it is solved.",
}


def scene_schema(more: Mapping[str, Definition] = MappingProxyType({})) -> dict[str, Any]:
    """Return the JSON Schema of scene files; `more`: definitions of sections that other packages read, such as the plan."""
    kinds: Schemas = {}
    sections: dict[str, Schema] = {
        "structure": STRUCTURE.schema(kinds),
        **{
            name: own.schema(kinds, tag="")
            for name, own in {
                "scene": SCENE,
                "start": START,
                "simulation": SIMULATION,
                **more,
            }.items()
        },
    }
    tables = {
        name: {"description": _TEXTS[name], **sections.get(name, {"type": "object"})}
        for name in SECTIONS
    }
    numbers = TableOf(NUMBER).schema(kinds)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scene file of tenscasadi",
        "description": "Tensegrity structures, scenes, simulations and plans in SI units. Numbers may be formulas in quotes over [numbers].",
        "type": "object",
        "properties": {
            "format": {"const": FORMAT, "description": "Version of the format."},
            "units": {"const": "SI", "description": "m, kg, s, N, rad."},
            "include": _INCLUDE,
            "numbers": {"description": "Numbers that formulas name.", **numbers},
            **tables,
        },
        "required": ["format", "units"],
        "additionalProperties": False,
        "$defs": dict(sorted(kinds.items())),
    }
