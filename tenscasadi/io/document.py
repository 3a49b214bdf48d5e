"""Parsed scene files, with includes and declared numbers."""

from __future__ import annotations

import graphlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tenscasadi.schema.formulas import RESERVED
from tenscasadi.schema.reading import Document, Item, SceneFileError, nearest
from tenscasadi.schema.text import TextError, parse, to_json, to_toml
from tenscasadi.util.validate import MAX_ENTRIES, FilePath, file_path, format_value
from tenscasadi.util.whole_file import whole_file

T = TypeVar("T")
HEAD: Mapping[str, Any] = {"format": 1, "units": "SI"}
ENDINGS = (".toml", ".json")
SECTIONS = {
    "structure": "Nodes, bars and strings, or a shape by its name.",
    "scene": "Control, loads, grounds, and models of the strings.",
    "start": "Initial positions and velocities.",
    "simulation": "Duration, scheme and steps of a simulation.",
    "plan": "Optimal control problem: goals, bounds, costs, and how to solve it.",
    "refinement": "Refinement of the plan until its replay is accurate.",
    "robustness": "Replays of the plan under random errors.",
    "closed_loop": "Simulation under a controller that solves the problem again and again.",
}
LARGEST_FILE = 16_000_000  # bytes of a file with its includes


class Change(NamedTuple):
    """Change of a scene file by a command-line option.

    The key is dotted, and the value is TOML. A value that is no TOML is text.
    """

    option: str
    key: str
    value: str


def read_document(path: FilePath, changes: Sequence[Change] = ()) -> Document:
    """Read a scene file with its includes, then apply changes.

    `path` is that of the file. Nothing in the files is run, and no other file is opened. Raises
    SceneFileError, OSError.
    """
    source = file_path("path", path)
    if not source.exists():
        raise FileNotFoundError(2, "No such file", os.fspath(path))
    reader = _Reader()
    data = reader.read(source, source.name, ())
    for change in changes:
        section, _, name = change.key.partition(".")
        known = data.get("numbers", {})
        if section == "numbers" and name not in known:
            cure = nearest(name, known)
            option = change.option.removesuffix(change.value).rstrip(" =")
            raise ValueError(f"{option} is no option and no number: {cure}")
        data = _merge(data, reader.parse(change.option, _format_change(change), "toml"))
    document = Document(source.name, data, {}, tuple(reader.sources))
    for name in data:
        if name not in (*HEAD, "include", "numbers", "$schema", *SECTIONS):
            cure = nearest(name, (*SECTIONS, *HEAD, "include", "numbers"))
            raise document.root.child(name).error(f"is no part of a scene file: {cure}")
    return replace(document, numbers=_compute_numbers(document))


def write_document(path: Path, tables: Mapping[str, Any]) -> Path:
    """Write tables to a scene file in TOML or JSON.

    The ending of the path selects the format. Returns the path. Raises OSError.
    """
    text = (to_json if path.suffix == ".json" else to_toml)({**HEAD, **tables})
    with whole_file(path) as file:
        file.write(text.encode("utf-8"))
    return path


def format_tables(tables: Mapping[str, Any]) -> str:
    """Format tables as JSON text for files of results."""
    return to_json({**HEAD, **tables})


def read_tables(field: str, content: Any, read: Callable[[Document], T]) -> T:
    """Read the tables in a text field of saved results.

    `content` is the text, and `read` converts its tables. Raises ValueError naming the field.
    """
    try:
        return read(Document(field, parse(str(content), "json")))
    except ValueError as error:
        raise ValueError(f"field {field!r} is damaged ({error})") from error


def _format_change(change: Change) -> str:
    if not re.fullmatch(r"[\w-]+(\.[\w-]+)+", change.key):
        cure = "give KEY=VALUE, such as simulation.step=0.01"
        raise ValueError(f"set is {format_value(change.key)}: {cure}")
    text = f"{change.key} = {change.value}"
    try:
        parse(text, "toml", MAX_ENTRIES)
    except TextError:
        return to_toml({"x": change.value}).replace("x", change.key, 1)
    return text


class _Reader:
    """Reader of a scene file and its includes, with limited size."""

    def __init__(self) -> None:
        self.sources: list[tuple[str, str]] = []
        self._bytes = self._values = 0

    def read(self, path: Path, name: str, above: tuple[Path, ...]) -> dict[str, Any]:
        """Read a file with its includes.

        `name` is that of the file `path` in messages. The files `above` include it, directly or
        indirectly.
        """
        content = self._load(path, name)
        own = self.parse(name, content, path.suffix[1:])
        document = Document(name, own, {}, ((name, content),))
        _check_head(document)
        data: dict[str, Any] = {}
        here = (*above, path.resolve())
        wanted = 'a list of files, such as ["mast.toml"]'
        for item in document.root.child("include").entries(wanted) if "include" in own else []:
            target = _find_included(item, path.parent)
            if target.resolve() in here:
                raise item.error(
                    f"is {item.value!r}, which includes this file again: leave one out"
                )
            inner = self.read(target, (Path(name).parent / str(item.value)).as_posix(), here)
            data = _merge(data, inner)
        self.sources += document.sources
        return _merge(data, own)

    def parse(self, name: str, text: str, language: str) -> dict[str, Any]:
        """Parse a text in a language, "toml" or "json".

        The number of its values is limited. `name` is that of the file. Raises SceneFileError.
        """
        try:
            data = parse(text, "json" if language == "json" else "toml", MAX_ENTRIES - self._values)
        except TextError as error:
            raise SceneFileError(str(error), name, error.line) from None
        self._values += sum(map(text.count, ",=:["))
        if name.startswith("--"):
            self.sources.append((name, text))
        return data

    def _load(self, path: Path, name: str) -> str:
        if not path.is_file():  # opening a FIFO would wait for another process
            raise SceneFileError("path is no regular file: give a file in TOML", name or '""')
        try:
            with open(path, "rb") as file:
                content = file.read(LARGEST_FILE - self._bytes + 1)
        except OSError as error:
            cure = f"it cannot be read ({error.strerror}): give a file that can"
            raise SceneFileError(cure, name) from None
        self._bytes += len(content) + LARGEST_FILE // 100  # so that includes have an end
        if self._bytes > LARGEST_FILE:
            most = f"{LARGEST_FILE / 1e6:g} MB or 100 files"
            raise SceneFileError(f"with its includes it has more than {most}: give less", name)
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise SceneFileError(
                "it is no text in UTF-8: give a file in TOML", name, line
            ) from None


def _check_head(document: Document) -> None:
    for name, right in HEAD.items():
        text = f'"{right}"' if isinstance(right, str) else f"{right}"
        if name not in document.data:
            message = f"it has no {name}: begin with {name} = {text}"
            raise SceneFileError(message, document.name, None, name)
        item = document.root.child(name)
        if item.value != right or isinstance(item.value, bool):
            raise item.error(
                f"is {format_value(item.value)}: give {text}, all that this version reads"
            )


def _find_included(item: Item, folder: Path) -> Path:
    """Find the path of an included file.

    `item` contains its name. The file is in the folder of the including file or below. Raises
    SceneFileError.
    """
    name = item.text('the name of a file, such as "mast.toml"')
    parts = name.split("/")
    odd = any(part in ("", ".", "..") or not part.isprintable() for part in parts)
    if not name.endswith(ENDINGS) or odd or set(name) & set('\\:*?"<>|'):
        cure = (
            "give a .toml or .json file in this file's folder or below, such as 'parts/mast.toml'"
        )
        raise item.error(f"is {format_value(name)}: {cure}")
    target = folder.joinpath(*parts)
    if not os.path.lexists(target):
        raise item.error(f"is {format_value(name)}: there is no such file")
    try:
        inside = target.resolve(strict=True).is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a link to itself
        inside = False
    if not inside:
        raise item.error(
            f"is {format_value(name)}, a link out of this file's folder: copy the file there"
        )
    return target


def _merge(data: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two tables key by key.

    Values of `over` replace those of `data`. A table with another `kind` or `shape` replaces the
    whole table.
    """
    merged = dict(data)
    for name, value in over.items():
        old = merged.get(name)
        whole = not isinstance(value, dict) or {"kind", "shape"} & value.keys()
        merged[name] = value if whole or not isinstance(old, dict) else _merge(old, value)
    return merged


def _compute_numbers(document: Document) -> dict[str, float]:
    """Compute the declared numbers, some of which refer to others.

    Raises SceneFileError.
    """
    section = document.root.child("numbers").table() if "numbers" in document.data else {}
    needs: dict[str, set[str]] = {}
    for name, item in section.items():
        if not (name.isidentifier() and name.isascii()) or name in RESERVED:
            cure = f"give letters, digits and _, and none of {', '.join(sorted(RESERVED))}"
            raise item.error(f"{name!r} cannot be the name of a number: {cure}")
        needs[name] = set(item.formula().names) if isinstance(item.value, str) else set()
    numbers: dict[str, float] = {}
    try:
        for name in graphlib.TopologicalSorter(needs).static_order():
            if name in section:
                computed = replace(document, numbers=numbers)
                numbers[name] = section[name]._replace(document=computed).number()
    except graphlib.CycleError as error:
        circle = list(reversed(error.args[1]))
        cure = "give one of them a value"
        message = f"depends on itself ({' needs '.join(circle)}): {cure}"
        raise section[circle[0]].error(message) from None
    return {name: numbers[name] for name in section}
