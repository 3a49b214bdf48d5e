"""Files as trees of items: every value knows where it stands, and errors say so."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tenscasadi.schema.formulas import Formula, FormulaError
from tenscasadi.schema.toml_places import Key
from tenscasadi.util.validate import LARGEST, shown

Which = Literal["node", "bar", "string"]
MOST_ENTRIES = 200_000  # of nodes, members, segments


class SceneFileError(ValueError):
    r"""A fault of a scene file: in which file, line and key, the value, and the cure, on one line.

    Parameters
    ----------
    message : str
        The fault and its cure.
    file : str
        Name of the file.
    line : int, optional
        Line, from 1 on.
    key : str
        Key, such as ``structure.bar_mass``.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import tenscasadi as tc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "mast.toml")
    ...     _ = path.write_text("format = 1\nunits = 'SI'\nstructure.shape = 'prisn'")
    ...     try:
    ...         tc.load_scene(path)
    ...     except tc.SceneFileError as error:
    ...         print(error.line, error.key)
    3 structure.shape
    """

    def __init__(self, message: str, file: str, line: int | None = None, key: str = "") -> None:
        place = ", ".join([file, *([f"line {line}"] if line else []), *([key] if key else [])])
        super().__init__(f"{place}: " + " ".join(message.split()))
        self.file, self.line, self.key = file, line, key
        self.message = message

    def __reduce__(self) -> Any:
        return type(self), (self.message, self.file, self.line, self.key)


class Place(NamedTuple):
    """Where a key stands."""

    file: str
    line: int


@dataclass(frozen=True)
class Document:
    """A scene file with its includes: plain `data`, the declared `numbers` by name, and the `places` of keys."""

    path: Path
    data: Mapping[str, Any]
    numbers: Mapping[str, float]
    places: Mapping[Key, Place]

    @property
    def root(self) -> Item:
        """The whole file as an item."""
        return Item(self.data, (), self)

    def section(self, name: str) -> Item | None:
        """Return one of `SECTIONS` where the file has it. Raises SceneFileError where it is no table."""
        if name not in self.data:
            return None
        found = self.root.child(name)
        found.table()
        return found


class Item(NamedTuple):
    """A value of a document, and its key."""

    value: Any
    key: Key
    document: Document

    def child(self, name: str | int) -> Item:
        """Return the value of a key of a table, or the entry of a list."""
        return Item(self.value[name], (*self.key, name), self.document)

    def table(self, wanted: str = "a table") -> dict[str, Item]:
        """Return the items of a table by name. Raises SceneFileError."""
        if not isinstance(self.value, dict):
            raise self.error(f"is {shown(self.value)}: give {wanted}")
        return {name: self.child(name) for name in self.value}

    def entries(self, wanted: str = "a list") -> list[Item]:
        """Return the items of a list. Raises SceneFileError."""
        if not isinstance(self.value, list):
            raise self.error(f"is {shown(self.value)}: give {wanted}")
        if len(self.value) > MOST_ENTRIES:
            raise self.error(f"has {len(self.value)} entries: give at most {MOST_ENTRIES}")
        return [self.child(k) for k in range(len(self.value))]

    def text(self, wanted: str = "text") -> str:
        """Return a text. Raises SceneFileError."""
        if not isinstance(self.value, str):
            raise self.error(f"is {shown(self.value)}: give {wanted}")
        return self.value

    def number(self, wanted: str = "a number, or a formula in quotes") -> float:
        """Return a number, or the value of a formula. Raises SceneFileError."""
        if isinstance(self.value, str):
            formula = self.formula()
            try:
                return formula.value(self.document.numbers)
            except FormulaError as error:
                raise self.error(str(error)) from None
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise self.error(f"is {shown(self.value)}: give {wanted}")
        if not abs(self.value) <= LARGEST:
            raise self.error(
                f"is {shown(self.value)}: give a finite number, at most {LARGEST:g} in size"
            )
        return float(self.value)

    def formula(self) -> Formula:
        """Return a text as a formula. Raises SceneFileError."""
        try:
            return Formula(self.text("a formula in quotes"))
        except FormulaError as error:
            raise self.error(str(error)) from None

    def whole(self, wanted: str = "a whole number") -> int:
        """Return a whole number, or the value of a formula that is one. Raises SceneFileError."""
        found = self.number(wanted)
        if found != int(found):
            raise self.error(f"is {found:g}: give {wanted}")
        return int(found)

    def error(self, message: str) -> SceneFileError:
        """Return the error that tells where this value stands and `message`, which begins as in "is 3: give 4"."""
        key: Key = self.key
        while key and key not in self.document.places:
            key = key[:-1]
        place = self.document.places.get(key)
        told = dotted(self.key)
        return SceneFileError(
            message,
            place.file if place else self.document.path.name,
            place.line if place else None,
            told,
        )


def dotted(key: Iterable[str | int]) -> str:
    """Return a key as messages show it, such as ``structure.nodes[3]``."""
    text = ""
    for word in key:
        text += f"[{word}]" if isinstance(word, int) else f".{word}" if text else str(word)
    return text if len(text) <= 120 else f"{text[:120]} …"


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the cure for a word that is none of those known: the nearest, or a list of them."""
    names = list(known)
    close = difflib.get_close_matches(word[:80], names, 1)
    return (
        f"did you mean {close[0]!r}?"
        if close
        else f"give one of {', '.join(names[:30])}"
        if names
        else "leave it out"
    )


class NotWritten(ValueError):
    """A value that no file can hold; the message says why and what to do."""


@dataclass(frozen=True)
class Names:
    """How many nodes, bars and strings there are, and which indices a name stands for: a node, or all members of a group."""

    counts: Mapping[Which, int] = field(default_factory=dict)
    named: Mapping[Which, Mapping[str, Sequence[int]]] = field(default_factory=dict)

    def find(self, which: Which, word: Any, item: Item) -> list[int]:
        """Return the indices that an index or a name stands for. Raises SceneFileError."""
        named, count = self.named.get(which, {}), self.counts.get(which, 0)
        if isinstance(word, str) and word in named:
            return list(named[word])
        if isinstance(word, str) and word.isascii() and word.isdigit() and len(word) < 10:  # a key
            word = int(word)
        if isinstance(word, str):
            raise item.error(
                f"names {which} {shown(word)}, which is not there: {nearest(word, named) if named else f'give an index of a {which}'}"
            )
        if isinstance(word, bool) or not isinstance(word, int):
            raise item.error(f"is {shown(word)}: give the name or index of a {which}")
        if not 0 <= word < count:
            raise item.error(
                f"names {which} {shown(word)}: "
                + (
                    f"{which} indices run from 0 to {count - 1}"
                    if count
                    else f"there are no {which}s"
                )
            )
        return [word]

    def one(self, which: Which, word: Any, item: Item) -> int:
        """Return the index that an index or a name stands for. Raises SceneFileError, also where it is a group of several."""
        found = self.find(which, word, item)
        if len(found) != 1:
            raise item.error(
                f"is {shown(word)}, a group of {len(found)} {which}s: give the index of one"
            )
        return found[0]


def call(
    build: Callable[..., Any], item: Item, table: Mapping[str, Item], given: Mapping[str, Any]
) -> Any:
    """Return build(**given); a TypeError or ValueError becomes the error of the field that it names first. Raises SceneFileError."""
    try:
        return build(**given)
    except SceneFileError:
        raise
    except (TypeError, ValueError) as error:
        text = str(error)
        places = {
            name: found.start()
            for name in table
            if (found := re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text))
        }
        where = table[min(places, key=lambda name: places[name])] if places else item
        raise where.error(text) from error
