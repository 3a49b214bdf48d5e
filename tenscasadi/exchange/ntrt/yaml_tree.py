"""Reader of YAML files as trees with line numbers.

The size is limited, nothing is executed, and keys are unique.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.util.validate import Array, shown

_MOST_BYTES, _MOST_ENTRIES = 5_000_000, 500_000
_LARGEST = 1e30  # a mass is a product of four numbers and must stay finite


class Entry:
    """Mapping, list or scalar of a YAML file.

    Its methods raise ValueError, which names file, line and key.
    """

    def __init__(
        self, path: Path, line: int, key: str, value: dict[str, Entry] | list[Entry] | str
    ) -> None:
        self.path, self.line, self.key, self.value = path, line, key, value

    def refusal(self, text: str) -> ValueError:
        """Build the error that names this place."""
        return ValueError(f"{self.path}, line {self.line}: {self.key} {text}")

    def items(self, *known: str) -> Iterator[tuple[str, Entry]]:
        """Yield keys and values of a mapping.

        If `known` keys are given, others are rejected. An empty entry yields nothing.
        """
        if self.value == "":
            return
        if not isinstance(self.value, dict):
            raise self.refusal(f"is {self.shown()}: give keys and values")
        for key, entry in self.value.items():
            if known and key not in known:
                raise entry.refusal(f"is not known: the keys here are {', '.join(known)}")
            yield key, entry

    def parts(self, count: int | None = None) -> list[Entry]:
        """Return the entries of a list.

        Its length must be `count`, if given.

        An empty entry has none.
        """
        if self.value == "" and count is None:
            return []
        if not isinstance(self.value, list) or (count is not None and len(self.value) != count):
            raise self.refusal(
                f"is {self.shown()}: give a list{'' if count is None else f' of {count}'}"
            )
        return self.value

    def word(self) -> str:
        """Read a nonempty text."""
        if not isinstance(self.value, str) or not self.value:
            raise self.refusal(f"is {self.shown()}: give a word")
        return self.value

    def number(self) -> float:
        """Read a finite number."""
        try:
            found = float(self.word())
        except ValueError:
            raise self.refusal(f"is {self.shown()}: give a number") from None
        if not abs(found) <= _LARGEST:
            raise self.refusal(
                f"is {self.shown()}: give a finite number, at most {_LARGEST:g} in size"
            )
        return found

    def vector(self) -> Array:
        """Read three finite numbers."""
        return np.array([part.number() for part in self.parts(3)])

    def shown(self) -> str:
        """Format the value for messages."""
        return shown(
            {dict: "a mapping", list: "a list"}.get(type(self.value), self.value)
            if not isinstance(self.value, str)
            else self.value
        )


def read_tree(path: Path, users: str) -> Entry:
    """Read the root of a YAML file.

    Raises ImportError, which names the `users`, FileNotFoundError, and ValueError.
    """
    try:
        import yaml
    except ImportError as error:
        raise ImportError(f"{users} needs PyYAML: pip install 'tenscasadi[exchange]'") from error
    if path.exists() and not path.is_file():
        raise ValueError(f"path is {path}, no regular file: give one in YAML")
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(
            f"{path} has more than {_MOST_BYTES / 1e6:g} MB: no structure needs as much"
        )
    try:
        root = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        if root is None:
            raise ValueError("there is nothing in it")
        if _count(root, {}) > _MOST_ENTRIES:
            raise ValueError(
                f"it has more than {_MOST_ENTRIES} entries once its aliases are written out"
            )
        return _entry(path, "the file", root)
    except yaml.YAMLError as error:
        mark, problem = (
            getattr(error, "problem_mark", None),
            getattr(error, "problem", None) or str(error),
        )
        raise ValueError(
            f"{path}{f', line {mark.line + 1}' if mark else ''}: this is no YAML: {' '.join(str(problem).split())}"
        ) from None
    except (RecursionError, UnicodeDecodeError, ValueError) as error:
        if str(error).startswith(str(path)):
            raise
        why = (
            "it is nested too deeply"
            if isinstance(error, RecursionError)
            else " ".join(str(error).split())
        )
        raise ValueError(f"{path}: this is no structure: {why}") from None


def _count(node: Any, known: dict[int, int]) -> int:
    """Count the entries below a node, with expanded aliases.

    Raises ValueError if an alias contains itself.
    """
    if id(node) not in known:
        known[id(node)] = -1
        inside = node.value if isinstance(node.value, list) else []
        children = [
            child for item in inside for child in (item if isinstance(item, tuple) else (item,))
        ]
        known[id(node)] = 1 + sum(_count(child, known) for child in children)
    if known[id(node)] < 0:
        raise ValueError(f"an alias in line {node.start_mark.line + 1} holds itself")
    return known[id(node)]


def _entry(path: Path, key: str, node: Any) -> Entry:
    """Build the entries of a node and its descendants.

    Raises ValueError if a key is repeated or is not text.
    """
    line, value = node.start_mark.line + 1, node.value
    if isinstance(value, str):
        return Entry(
            path, line, key, "" if value in ("~", "null") and node.style is None else value
        )
    if value and isinstance(value[0], tuple):
        found: dict[str, Entry] = {}
        for name, inside in value:
            entry = _entry(path, str(name.value), inside)
            entry.line = name.start_mark.line + 1  # the line of the key
            if not isinstance(name.value, str) or name.value in found:
                raise entry.refusal(
                    "is given twice: leave one out" if isinstance(name.value, str) else "is no word"
                )
            found[name.value] = entry
        return Entry(path, line, key, found)
    if node.id == "mapping":
        return Entry(path, line, key, "")
    return Entry(path, line, key, [_entry(path, key, item) for item in value])
