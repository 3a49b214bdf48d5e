"""Scene files as data: TOML with its includes merged and its declared numbers computed; every value knows where it stands."""

from __future__ import annotations

import graphlib
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tenscasadi.schema.formulas import RESERVED
from tenscasadi.schema.reading import Document, Item, Place, SceneFileError, nearest
from tenscasadi.schema.toml_places import MOST_PLACES, Key, TooMuch, find_lines
from tenscasadi.util.validate import file_path, shown

FORMAT = 1
HEAD = ("format", "units", "include", "numbers")
SECTIONS = ("structure", "scene", "start", "simulation", "plan")
LARGEST_FILE = 16_000_000  # bytes, of a file and of all that it includes
MOST_FILES = 32
MOST_NUMBERS = 1000
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_LINE = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)")


def read_document(path: str | os.PathLike[str]) -> Document:
    """Read a scene file and all that it includes; nothing in them is run, and no other file is opened.

    Raises SceneFileError, and OSError where there is no such file.
    """
    source = file_path("path", path)
    if not source.exists():
        raise FileNotFoundError(2, "No such file", os.fspath(path))
    reader = _Reader()
    data, places = reader.read(source, source.name, ())
    document = Document(source, data, {}, MappingProxyType(places))
    for name in data:
        if name not in (*HEAD, *SECTIONS):
            raise document.root.child(name).error(
                f"is no part of a scene file: {nearest(name, (*SECTIONS, *HEAD))}"
            )
    numbers = _numbers(document)
    return Document(source, MappingProxyType(data), MappingProxyType(numbers), document.places)


class _Reader:
    """Counts what is read, so that includes have an end."""

    def __init__(self) -> None:
        self._bytes = self._files = self._places = 0

    def read(
        self, path: Path, name: str, above: tuple[Path, ...]
    ) -> tuple[dict[str, Any], dict[Key, Place]]:
        """Return the data of a file, that of its includes below it, and the places of all keys; `above`: files that include it."""
        text = self._text(path, name)
        own, places = _parse(text, name, MOST_PLACES - self._places)
        self._places += len(places)
        document = Document(Path(name), own, {}, places)
        _check_head(document)
        data: dict[str, Any] = {}
        merged: dict[Key, Place] = {}
        here = path.resolve()
        for item in (
            document.root.child("include").entries('a list of files, such as ["mast.toml"]')
            if "include" in own
            else []
        ):
            target = _included(item, path.parent)
            if target.resolve() in (*above, here):
                raise item.error(
                    f"is {item.value!r}, which includes this file again: leave one out"
                )
            more, their = self.read(
                target, (Path(name).parent / str(item.value)).as_posix(), (*above, here)
            )
            _merge(data, more)
            merged |= their
        _merge(data, own)
        return data, merged | places

    def _text(self, path: Path, name: str) -> str:
        self._files += 1
        if self._files > MOST_FILES:
            raise SceneFileError(
                f"more than {MOST_FILES} files include each other: write fewer", name
            )
        if not path.is_file():  # opening a FIFO would wait for another process
            raise SceneFileError("path is no regular file: give a file in TOML", name or '""')
        try:
            with open(path, "rb") as file:
                content = file.read(LARGEST_FILE - self._bytes + 1)
        except OSError as error:
            raise SceneFileError(
                f"it cannot be read ({error.strerror}): give a file that can", name
            ) from None
        self._bytes += len(content)
        if self._bytes > LARGEST_FILE:
            raise SceneFileError(
                f"with its includes it has more than {LARGEST_FILE / 1e6:g} MB: give smaller files",
                name,
            )
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise SceneFileError(
                "it is no text in UTF-8: give a file in TOML", name, line
            ) from None


def _parse(text: str, name: str, most: int) -> tuple[dict[str, Any], dict[Key, Place]]:
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        lines = find_lines(text, most)
    except TooMuch as error:
        raise SceneFileError(str(error), name, error.line) from None
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        found = _LINE.search(str(error))
        fault = _LINE.sub("", str(error)) or "nested too deep"
        end = text.count("\n") + 1
        raise SceneFileError(
            f"it is no TOML, {fault}: correct it there",
            name,
            int(found[1] or end) if found else None,
        ) from None
    return data, {key: Place(name, line) for key, line in lines.items()}


def _check_head(document: Document) -> None:
    for name, right in {"format": FORMAT, "units": "SI"}.items():
        if name not in document.data:
            raise SceneFileError(
                f"it has no {name}: begin with {name} = {right!r}".replace("'", '"'),
                document.path.as_posix(),
                None,
                name,
            )
        item = document.root.child(name)
        if item.value != right or isinstance(item.value, bool):
            raise item.error(
                f"is {shown(item.value)}: give "
                + f"{right!r}, all that this version reads".replace("'", '"')
            )


def _included(item: Item, folder: Path) -> Path:
    """Return the file that an entry of `include` names, in the folder of the file that says it or below. Raises SceneFileError."""
    name = item.text('the name of a file, such as "mast.toml"')
    parts = name.split("/")
    if (
        not name.endswith(".toml")
        or any(part in ("", ".", "..") or not part.isprintable() for part in parts)
        or set(name) & set('\\:*?"<>|')
    ):
        raise item.error(
            f"is {shown(name)}: give a .toml file in this file's folder or below it, such as 'parts/mast.toml'"
        )
    target = folder.joinpath(*parts)
    if not os.path.lexists(target):
        raise item.error(f"is {shown(name)}: there is no such file")
    try:
        inside = target.resolve(strict=True).is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a link to itself
        inside = False
    if not inside:
        raise item.error(f"is {shown(name)}, a link out of this file's folder: copy the file there")
    return target


def _merge(data: dict[str, Any], over: Mapping[str, Any]) -> None:
    """Put `over` over `data`: keys of tables one by one, but a value of another kind takes the whole place."""
    for name, value in over.items():
        old = data.get(name)
        if (
            isinstance(old, dict)
            and isinstance(value, dict)
            and not {"kind", "shape"} & value.keys()
        ):
            old = data[name] = dict(old)
            _merge(old, value)
        else:
            data[name] = value


def _numbers(document: Document) -> dict[str, float]:
    """Return the declared numbers, each computed after those that it names. Raises SceneFileError."""
    section = document.root.child("numbers").table() if "numbers" in document.data else {}
    if len(section) > MOST_NUMBERS:
        raise document.root.child("numbers").error(
            f"has {len(section)} entries: give at most {MOST_NUMBERS}"
        )
    needs: dict[str, set[str]] = {}
    for name, item in section.items():
        if not _NAME.fullmatch(name) or name in RESERVED:
            raise item.error(
                f"{name!r} cannot be the name of a number: give letters, digits and _, and none of {', '.join(sorted(RESERVED))}"
            )
        needs[name] = (
            set(item.formula().names) & section.keys() if isinstance(item.value, str) else set()
        )
    try:
        order = list(graphlib.TopologicalSorter(needs).static_order())
    except graphlib.CycleError as error:
        circle = list(reversed(error.args[1]))
        raise section[circle[0]].error(
            f"depends on itself ({' needs '.join(circle)}): give one of them a value"
        ) from None
    numbers: dict[str, float] = {}
    for name in order:
        numbers[name] = Item(
            section[name].value,
            section[name].key,
            Document(document.path, {}, numbers, document.places),
        ).number()
    return {name: numbers[name] for name in section}
