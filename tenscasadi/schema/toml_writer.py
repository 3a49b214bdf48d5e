"""TOML text of tables of numbers, text, lists and tables: every number reads back to the last bit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

_WIDTH = 120  # characters of a line
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(data: Mapping[str, Any]) -> str:
    """Return a TOML text of a table."""
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def _table(data: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    later = {}
    for name, value in data.items():
        if not path and isinstance(value, Mapping):
            later[name] = value
            continue
        line = f"{_key(name)} = {_inline(value)}"
        if len(line) <= _WIDTH or not (_tables(value) or isinstance(value, list)):
            yield line
        elif _tables(value):
            later[name] = value
        else:
            yield from (f"{_key(name)} = [", *(f"    {_inline(entry)}," for entry in value), "]")
    for name, value in later.items():
        own = (*path, name)
        for entry, double in (
            [(value, False)] if isinstance(value, Mapping) else [(entry, True) for entry in value]
        ):
            head = ".".join(map(_key, own))
            yield from ("", f"[[{head}]]" if double else f"[{head}]", *_table(entry, own))


def _tables(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(entry, Mapping) for entry in value)
    )


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(f"{_key(name)} = {_inline(entry)}" for name, entry in value.items())
            + " }"
            if value
            else "{}"
        )
    return "[" + ", ".join(map(_inline, value)) + "]"


def _key(name: str) -> str:
    return (
        name
        if _BARE.fullmatch(name)
        else json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
    )
