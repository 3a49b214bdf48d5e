"""Reference page of scene files: their JSON Schema as tables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from ocp.io.plan_section import file_schema

_TYPES = {"number": "number", "integer": "integer", "boolean": "`true` or `false`"}


def scene_fields_page() -> str:
    """Build the Markdown of the page: each kind in the first section that uses it."""
    schema = file_schema()
    kinds = schema["$defs"]
    text = [
        "# Fields of scene files",
        "This page lists all tables of [scene files](scene_files.md) and their fields. Units are SI."
        " Formulas may replace numbers.",
    ]
    seen: set[str] = set()
    for section, own in schema["properties"].items():
        if not (names := [name for name in _find_kinds(own, kinds) if name not in seen]):
            continue
        seen.update(names)
        text += [f"## [{section}]", own["description"]]
        text += [_describe_kind(name, kinds[name], kinds["nodes"]) for name in names]
    return "\n\n".join(text)


def _find_kinds(schema: Any, kinds: Mapping[str, Any]) -> list[str]:
    """Find the kinds that a schema refers to, also indirectly, in the order of first use."""
    found: dict[str, None] = {}
    left = [_find_references(schema)]
    while left:
        name = next(left[-1], None)
        if name is None:
            left.pop()
        elif name not in found:
            found[name] = None
            left.append(_find_references(kinds[name]))
    return list(found)


def _find_references(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        if "$ref" in schema:
            yield schema["$ref"].removeprefix("#/$defs/")
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from _find_references(part)


def _describe_kind(name: str, kind: dict[str, Any], nodes: dict[str, Any]) -> str:
    head = f"### {_title(name)} {{: #{name} }}\n\n{kind.get('description', '')}"
    table = kind["anyOf"][0] if "anyOf" in kind else kind
    if "oneOf" in table:
        return f"{head} One of {', '.join(map(_describe_type, table['oneOf']))}."
    own = table["properties"]
    needed, hidden = table.get("required", []), {"kind", "shape"}
    if "shape" in needed:  # shapes take all properties of structures
        hidden |= nodes["properties"].keys() - {"nodes", "bars", "strings"}
        head += f" It takes the other fields of {_link('nodes')}, too."
    rows = [_row(field, own[field], field in needed) for field in own if field not in hidden]
    header = ["| field | type | meaning | default |", "|---|---|---|---|"]
    return "\n".join([f"{head}\n", *header, *rows]) if rows else head


def _row(field: str, form: dict[str, Any], needed: bool) -> str:
    default = "required" if needed else f"`{form['default']}`" if "default" in form else ""
    cells = (f"`{field}`", _describe_type(form), form.get("description", ""), default)
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _describe_type(form: dict[str, Any]) -> str:
    """Describe the type of a schema in a few words, with links to kinds."""
    if "$ref" in form:
        return _link(form["$ref"].removeprefix("#/$defs/"))
    if "enum" in form:
        return " or ".join(f'`"{word}"`' for word in form["enum"])
    several = form.get("anyOf") or form.get("oneOf")
    if several:
        words = [word for part in several for word in _describe_type(part).split(" or ")]
        return " or ".join(dict.fromkeys(words))
    if form.get("type") == "array":
        return f"list of {_plural(_describe_type(form['items']))}"
    if form.get("type") == "object":
        inner = form.get("additionalProperties")
        return f"table of {_plural(_describe_type(inner))}" if isinstance(inner, dict) else "table"
    given = form.get("type", [])
    words = [given] if isinstance(given, str) else [word for word in given if word != "string"]
    return " or ".join(_TYPES.get(word, "text") for word in words)


def _plural(words: str) -> str:
    return re.sub(r"\b(number|integer|list|table)\b", r"\1s", words)


def _title(name: str) -> str:
    return name.removeprefix("ocp.")


def _link(name: str) -> str:
    return f"[{_title(name)}](#{name})"
