"""The page of all fields of scene files: their JSON Schema as tables."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ocp.io.plan_section import PLAN
from tenscasadi.io.json_schema import scene_schema

_PARTS = {
    "Structure": (
        "nodes",
        "pendulum",
        "double_pendulum",
        "prism",
        "d_bar",
        "t_bar",
        "six_bar_ball",
        "membrane",
        "Turn",
    ),
    "Scene": (
        "Scene",
        "ForceDensity",
        "RestLength",
        "Clip",
        "Smooth",
        "Linear",
        "Gravity",
        "Ground",
        "Terrain",
        "Pressure",
        "NodalForce",
    ),
    "Moved supports and parameters": ("SupportMotion", "Parameters"),
    "Start and simulation": (
        "start",
        "Simulation",
        "RungeKutta4",
        "DormandPrince54",
        "DormandPrince853",
        "Rattle",
        "Collocation",
        "Cvodes",
        "Idas",
    ),
    "Corrections": ("Projection", "BarLengthCorrection"),
}


def scene_fields_page() -> str:
    """The page's Markdown."""
    schema = scene_schema({"plan": PLAN})
    kinds = schema["$defs"]
    common = kinds["nodes"]["properties"].keys() - {"nodes", "bars", "strings"}
    told = {name for names in _PARTS.values() for name in names}
    parts = {**_PARTS, "Plan": tuple(name for name in kinds if name not in told)}
    text = [
        "# Fields of scene files",
        "All kinds of tables that [scene files](scene_files.md) hold. Units are SI.",
    ]
    for part, names in parts.items():
        text.append(f"## {part}")
        text += [
            _table(name, kinds[name], common if "shape" in kinds[name].get("required", ()) else ())
            for name in names
        ]
    return "\n\n".join(text)


def _table(name: str, kind: dict[str, Any], properties: Iterable[str] = ()) -> str:
    table = kind["anyOf"][0] if "anyOf" in kind else kind
    needed = table.get("required", [])
    rows = [
        _row(field, form, field in needed)
        for field, form in table["properties"].items()
        if field not in ("kind", "shape", *properties)
    ]
    passed = " It takes the properties of `nodes`, too." if properties else ""
    head = f"### {name.removeprefix('ocp.')}\n\n{kind.get('description', '')}{passed}"
    return (
        "\n".join([f"{head}\n", "| field | meaning | default |", "|---|---|---|", *rows])
        if rows
        else head
    )


def _row(field: str, form: dict[str, Any], needed: bool) -> str:
    default = "needed" if needed else f"`{form['default']}`" if "default" in form else ""
    return f"| `{field}` | {form.get('description', '').replace('|', '&#124;')} | {default} |"
