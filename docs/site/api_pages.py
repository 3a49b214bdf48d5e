"""Pages of the API: one for each folder of the packages, with its public names in the order of the packages' `__all__`."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("tenscasadi", "ocp")
IMPORTED_BY_NAME = (
    "tenscasadi.plots",
    "tenscasadi.envs",
    "tenscasadi.viewer",
)  # what needs more to be installed, or loaded


@cache
def api_pages() -> dict[str, str]:
    """The pages' Markdown by path."""
    rooms = _public_names()
    pages = {"api/index.md": _overview(rooms)}
    for room, names in rooms.items():
        about = ast.get_docstring(_syntax(room)) or ""
        blocks = [f"::: {name}\n" for name in names]
        pages[f"api/{room}.md"] = "\n".join([f"# {room}\n", about, "", *blocks])
    return pages


def _public_names() -> dict[str, list[str]]:
    """Public names by the folder that they come from, as `tenscasadi.structure`; as users write them, as `tenscasadi.Structure`."""
    rooms = defaultdict(list)
    for package in PACKAGES:
        for name, module in _exports(package).items():
            folder = ".".join(module.split(".")[:2])
            rooms[folder if _file(folder).exists() else package].append(f"{package}.{name}")
    for room in IMPORTED_BY_NAME:
        rooms[room] += [f"{room}.{name}" for name in _exports(room)]
    rooms["tenscasadi.plots"].append("tenscasadi.animation.animate")
    return {
        room: rooms[room] for package in PACKAGES for room in rooms if room.split(".")[0] == package
    }


def _exports(package: str) -> dict[str, str]:
    """What `__all__` of a package names, and the module that each comes from."""
    module = _syntax(package)
    found = {}
    for node in ast.walk(module):  # names that are loaded late stand under TYPE_CHECKING
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {
                alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names
            }
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return {name: found[name] for name in ast.literal_eval(node.value)}
    return {}


def _syntax(package: str) -> ast.Module:
    return ast.parse(_file(package).read_text(encoding="utf-8"))


def _file(package: str) -> Path:
    return ROOT / package.replace(".", "/") / "__init__.py"


def _overview(rooms: dict[str, list[str]]) -> str:
    lines = [
        "# API",
        "",
        "Each folder of both packages has a page, with all that is public there.",
        "",
        "| folder | names |",
        "|---|---|",
    ]
    for room, names in rooms.items():
        links = ", ".join(f"[`{name.split('.')[-1]}`][{name}]" for name in names)
        lines.append(f"| [{room}]({room}.md) | {links} |")
    return "\n".join(lines)
