"""YAML files as trees with line numbers.

The size is limited, nothing is executed, and keys are unique.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.exchange.source import Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.validate import LARGEST, MAX_COUNT, Array, format_value

LARGEST_ENTRY = LARGEST**0.25  # a mass is a product of four numbers


@dataclass(eq=False)
class YamlEntry:
    """Mapping, list or scalar of a YAML file.

    `value` contains its entries or text, and `path` is the file. `source` is the import that it
    belongs to. Its methods raise SceneFileError, which names file, line and key.
    """

    source: Source
    path: Path
    line: int
    key: str
    value: dict[str, YamlEntry] | list[YamlEntry] | str

    def error(self, text: str) -> SceneFileError:
        """Build an error that names file, line and key.

        `text` is its message.
        """
        return SceneFileError(text, _name(self.source, self.path), self.line, self.key)

    def leave_out(self, text: str) -> None:
        """Omit this entry from the import.

        `text` is the reason. Raises SceneFileError if the import is strict.
        """
        self.source.leave_out(self.error(text))

    def items(self, *known: str) -> Iterator[tuple[str, YamlEntry]]:
        """Yield the keys and values of a mapping.

        An empty entry yields nothing. If `known` keys are given, others are omitted.
        """
        if self.value == "":
            return
        if not isinstance(self.value, dict):
            raise self.error(f"is {self.format()}: give keys and values")
        for key, entry in self.value.items():
            if known and key not in known:
                entry.leave_out(f"is not known: the keys here are {', '.join(known)}")
            else:
                yield key, entry

    def parts(self, count: int | None = None) -> list[YamlEntry]:
        """Return the entries of a list.

        The list must have `count` entries, if this is given. An empty entry has none.
        """
        if self.value == "" and count is None:
            return []
        if not isinstance(self.value, list) or (count is not None and len(self.value) != count):
            length = "" if count is None else f" of {count}"
            raise self.error(f"is {self.format()}: give a list{length}")
        return self.value

    def word(self) -> str:
        """Read a nonempty text."""
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"is {self.format()}: give a word")
        return self.value

    def number(self) -> float:
        """Read a finite number."""
        try:
            found = float(self.word())
        except ValueError:
            raise self.error(f"is {self.format()}: give a number") from None
        if not abs(found) <= LARGEST_ENTRY:
            raise self.error(
                f"is {self.format()}: give a finite number, at most {LARGEST_ENTRY:g} in size"
            )
        return found

    def vector(self) -> Array:
        """Read three finite numbers (3,)."""
        return np.array([part.number() for part in self.parts(3)])

    def format(self) -> str:
        """Format the value for messages."""
        kinds = {dict: "a mapping", list: "a list"}
        return kinds.get(type(self.value)) or format_value(self.value)


def read_tree(source: Source, path: Path) -> YamlEntry:
    """Read the root of the YAML file `path`.

    `source` is the import that it belongs to. Raises ImportError, FileNotFoundError,
    SceneFileError.
    """
    try:
        import yaml
    except ImportError as error:
        raise ImportError("load_ntrt needs PyYAML: pip install 'tenscasadi[exchange]'") from error
    name = _name(source, path)
    try:
        text = source.read(path).decode("utf-8")
        # NTRT's reader takes lines after % for directives, and tabs for spaces
        lines = [
            "#" + line[1:] if line.startswith("%") else line.expandtabs(2)
            for line in text.split("\n")
        ]
        root = yaml.compose("\n".join(lines), Loader=yaml.SafeLoader)
        if root is None:
            raise SceneFileError("it is empty: give nodes and pair_groups", name)
        if _count(root, {}) > MAX_COUNT:
            message = f"it has more than {MAX_COUNT} entries with expanded aliases"
            raise SceneFileError(f"{message}: give a smaller file", name)
        return _build_entry(source, path, "the file", root)
    except SceneFileError:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        line = mark.line + 1 if mark else None
        raise SceneFileError(f"it is no YAML, {problem}: correct it there", name, line) from None
    except RecursionError:
        raise SceneFileError("it is nested too deeply: write it flatter", name) from None
    except ValueError as error:  # of the encoding, or of an alias
        raise SceneFileError(f"it is no structure: {error}", name) from None


def _name(source: Source, path: Path) -> str:
    """Return the path of a file relative to the folder of the main one."""
    return os.path.relpath(path, source.path.parent)


def _count(node: Any, known: dict[int, int]) -> int:
    """Count the YAML entries below a node, with expanded aliases.

    `known` has the counts of nodes by their id, −1 while a node is counted. Raises ValueError if an
    alias contains itself.
    """
    if id(node) not in known:
        known[id(node)] = -1
        inside = node.value if isinstance(node.value, list) else []
        children = [
            child for item in inside for child in (item if isinstance(item, tuple) else (item,))
        ]
        known[id(node)] = 1 + sum(_count(child, known) for child in children)
    if known[id(node)] < 0:
        raise ValueError(f"an alias in line {node.start_mark.line + 1} contains itself")
    return known[id(node)]


def _build_entry(source: Source, path: Path, key: str, node: Any) -> YamlEntry:
    """Build the entries of a node and its descendants.

    The node has the key `key` in the file `path`. Raises SceneFileError if a key is repeated or is
    not text.
    """
    found = YamlEntry(source, path, node.start_mark.line + 1, key, "")
    if isinstance(node.value, str):
        found.value = "" if node.value in ("~", "null") and node.style is None else node.value
    elif node.id != "mapping":
        found.value = [_build_entry(source, path, key, item) for item in node.value]
    elif node.value:
        found.value = {}
        for name, inside in node.value:
            entry = _build_entry(source, path, str(name.value), inside)
            entry.line = name.start_mark.line + 1  # the line of the key
            if not isinstance(name.value, str) or name.value in found.value:
                raise entry.error("is given twice, or is no word: leave one out")
            found.value[name.value] = entry
    return found
