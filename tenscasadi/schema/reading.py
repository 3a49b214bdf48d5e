"""Entries of scene files, with file, line and key for messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from tenscasadi.schema.formulas import Formula
from tenscasadi.schema.text import Key, find_line
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    LARGEST,
    MAX_COUNT,
    Booleans,
    Indices,
    as_tuple,
    finite_array,
    format_value,
    node_index,
    node_pairs,
)

T = TypeVar("T")
# members: strings, then bars; inputs: cables and strings in no cable
ItemKind = Literal["node", "bar", "string", "member", "input"]


class SceneFileError(ValueError):
    r"""Error in a scene file.

    Its message is one line with file, line, key, value and cure.

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
        add_address(self)

    def __reduce__(self) -> Any:
        return type(self), (self.message, self.file, self.line, self.key)


class NotWritten(ValueError):
    """Raised for a value that files cannot hold."""


@dataclass(frozen=True)
class Names:
    """Counts and names of a structure's nodes, bars and strings.

    `counts` has the number of items of each kind, such as "node", and `named` the indices of each
    name by kind. A name is that of one item, or of a group of items.
    """

    counts: Mapping[ItemKind, int] = field(default_factory=dict)
    named: Mapping[ItemKind, Mapping[str, Sequence[int]]] = field(default_factory=dict)

    def add_inputs(self, cable_of: Indices) -> Names:
        """Return a copy with the control inputs, which have the names of their strings.

        `cable_of` (α,) is the input of each string: one for each cable and for each string in no
        cable.
        """
        inputs = cable_of.tolist()
        own = {
            name: sorted({inputs[string] for string in strings})
            for name, strings in self.named["string"].items()
        }
        count = max(inputs, default=-1) + 1
        return Names({**self.counts, "input": count}, {**self.named, "input": own})

    def find(self, which: ItemKind, word: Any) -> list[int]:
        """Find the indices for an index, a name or a group name.

        `which` is the kind of item, such as "node", and `word` the index or name. Raises
        ValueError.
        """
        named, count = self.named.get(which, {}), self.counts.get(which, 0)
        if isinstance(word, str) and word in named:
            return list(named[word])
        if isinstance(word, str) and re.fullmatch("[0-9]{1,9}", word):  # a key of a table
            word = int(word)
        if isinstance(word, str):
            cure = nearest(word, named) if named else f"give an index of a {which}"
            raise add_address(
                ValueError(f"names {which} {format_value(word)}, which is not there: {cure}")
            )
        if isinstance(word, bool) or not isinstance(word, int):
            raise ValueError(f"is {format_value(word)}: give the name or index of a {which}")
        if not 0 <= word < count:
            cure = (
                f"{which} indices run from 0 to {count - 1}" if count else f"there are no {which}s"
            )
            raise ValueError(f"names {which} {format_value(word)}: {cure}")
        return [word]

    def index(self, field: str, which: ItemKind, word: Any) -> int:
        """Convert the name or index of one item to its index.

        `which` is the kind of item, such as "node", `word` the name or index, and messages name
        `field`. Raises TypeError, ValueError.
        """
        found = self.resolve(field, which, word)
        return node_index(field, found, self.counts.get(which, 0), which)

    def resolve(self, field: str, which: ItemKind, word: Any) -> Any:
        """Replace the name of an item by its index.

        `which` is the kind of item, `word` the name, and messages name `field`. Values that are no
        names are returned unchanged. Raises ValueError.
        """
        found = self.expand(field, which, word)
        if len(found) != 1:
            group = f"{format_value(word)}, a group of {len(found)} {which}s"
            raise ValueError(f"{field} is {group}: give the name or index of one")
        return found[0]

    def resolve_all(self, field: str, which: ItemKind, words: Any) -> Any:
        """Replace the names of items and groups in a list by indices.

        `which` is the kind of item, `words` the list, and messages name `field`. Values that are no
        names are returned unchanged. Raises TypeError, ValueError.
        """
        entries = list_entries(field, words)
        if not any(isinstance(entry, str) for entry in entries or ()):
            return entries if isinstance(words, Iterator) else words
        return [index for entry in entries or () for index in self.expand(field, which, entry)]

    def resolve_lists(self, field: str, which: ItemKind, lists: Any) -> Any:
        """Replace names in a list of lists by indices.

        `which` is the kind of item, and messages name `field`. Values that are no names are
        returned unchanged. Raises TypeError, ValueError.
        """
        entries = list_entries(field, lists) or ()
        found = [self.resolve_all(f"{field}[{k}]", which, own) for k, own in enumerate(entries)]
        same = all(new is own for new, own in zip(found, entries, strict=True))
        return lists if same and not isinstance(lists, Iterator) else found

    def pairs(self, field: str, members: Any, item: str, parallel: bool = False) -> Indices:
        """Convert bars or strings to an array (items, 2) of node indices.

        Each of the `members` is a pair of nodes by name or index. `item` is "bar" or "string", and
        messages name `field`. Several members can join the same nodes only if `parallel`. Raises
        TypeError, ValueError.
        """
        own = self.resolve_lists(field, "node", members)
        return node_pairs(field, own, self.counts["node"], item, parallel)

    def mask(self, field: str, which: ItemKind, words: Any) -> Booleans:
        """Convert names and indices to Booleans, one for each item.

        Those of the items in `words` are True. `which` is the kind of item, and messages name
        `field`. Raises TypeError, ValueError.
        """
        indices = self.resolve_all(field, which, words)
        found = np.zeros(self.counts.get(which, 0), dtype=bool)
        for k, index in enumerate(as_tuple(field, indices, f"[0, 3] of {which} indices")):
            found[node_index(f"{field}[{k}]", index, len(found), which)] = True
        return found

    def resolve_keys(self, field: str, which: ItemKind, table: Any) -> Any:
        """Replace names by indices among the keys of a mapping, `table`.

        `which` is the kind of item, and messages name `field`. Groups are replaced by all their
        members. Values that are no mappings are returned unchanged. Raises ValueError.
        """
        if not isinstance(table, Mapping) or not any(isinstance(word, str) for word in table):
            return table
        found: dict[Any, Any] = {}
        for word, value in table.items():
            for index in self.expand(field, which, word):
                if index in found:
                    raise ValueError(f"{field} gives {which} {index} twice: leave one out")
                found[index] = value
        return found

    def place_rows(self, field: str, table: Any, shape: tuple[int | None, ...] = (3,)) -> Any:
        """Convert a mapping of vectors by node to an array (..., n, 3).

        Each value in `table` has this shape, such as (K, 3). Other nodes have zeros. Values that
        are no mappings are returned unchanged. Messages name `field`. Raises TypeError, ValueError.
        """
        if not isinstance(table, Mapping):
            return table
        given = {
            node_index(field, node, self.counts["node"]): finite_array(
                f"{field}[{format_value(node)}]", value, shape
            )
            for node, value in self.resolve_keys(field, "node", table).items()
        }
        first = next(iter(given.values()), np.zeros(3))
        rows = np.zeros((*first.shape[:-1], self.counts["node"], 3))
        for node, value in given.items():
            rows[..., node, :] = value
        return rows

    def expand(self, field: str, which: ItemKind, word: Any) -> list[Any]:
        """Return the indices for a name or a group name, as a list.

        `which` is the kind of item, `word` the name, and messages name `field`. A value that is no
        name is the only entry. Raises ValueError.
        """
        if not isinstance(word, str):
            return [word]
        try:
            return self.find(which, word)
        except ValueError as error:
            raise add_address(ValueError(f"{field} {error}")) from None


@dataclass(frozen=True)
class Document:
    """Parsed content of a scene file with its includes.

    Attributes
    ----------
    name : str
        Name of the file.
    data : mapping
        Merged tables.
    numbers : mapping of str to float
        Declared numbers.
    sources : tuple of (str, str)
        Names and texts of all files that were read; later ones take precedence.
    """

    name: str
    data: Mapping[str, Any]
    numbers: Mapping[str, float] = field(default_factory=dict)
    sources: tuple[tuple[str, str], ...] = ()

    @property
    def root(self) -> Item:
        """The whole document as an item."""
        return Item(self.data, (), self)

    def section(self, name: str) -> Item | None:
        """Find a table of the scene file by its name.

        Returns None without one. Raises SceneFileError.
        """
        if name not in self.data:
            return None
        found = self.root.child(name)
        found.table()
        return found

    def place(self, key: Key) -> tuple[str, int | None]:
        """Find the file and the line that contain a key."""
        places = [(*find_line(text, key), name) for name, text in reversed(self.sources)]
        words, line, file = max(places, key=lambda place: place[0], default=(0, 1, self.name))
        return (file, line) if words and not file.startswith("--") else (file or self.name, None)


class Item(NamedTuple):
    """Entry of a scene file, with its key for messages.

    `value` is its parsed content, `document` the file, and `names` are those of the structure,
    which the entry can contain.
    """

    value: Any
    key: Key
    document: Document
    names: Names = Names()

    def child(self, name: str | int) -> Item:
        """Select an entry of a table or a list.

        `name` is its name in the table, or its index in the list.
        """
        return Item(self.value[name], (*self.key, name), self.document, self.names)

    def table(self, wanted: str = "a table") -> dict[str, Item]:
        """Read the items of a table by name.

        The message for another value asks for `wanted`. Raises SceneFileError.
        """
        if not isinstance(self.value, dict):
            raise self.error(f"is {format_value(self.value)}: give {wanted}")
        return {name: self.child(name) for name in self.value}

    def entries(self, wanted: str = "a list") -> list[Item]:
        """Read the items of a list.

        The message for another value asks for `wanted`. Raises SceneFileError.
        """
        if not isinstance(self.value, list):
            raise self.error(f"is {format_value(self.value)}: give {wanted}")
        return [self.child(k) for k in range(len(self.value))]

    def text(self, wanted: str = "text") -> str:
        """Read a text.

        The message for another value asks for `wanted`. Raises SceneFileError.
        """
        if not isinstance(self.value, str):
            raise self.error(f"is {format_value(self.value)}: give {wanted}")
        return self.value

    def number(self, wanted: str = "a number, or a formula in quotes") -> float:
        """Read a number, also from a formula.

        The message for another value asks for `wanted`. Raises SceneFileError.
        """
        if isinstance(self.value, str):
            return self._call(lambda: Formula(self.value).value(self.document.numbers))
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise self.error(f"is {format_value(self.value)}: give {wanted}")
        if not abs(self.value) <= LARGEST:
            cure = f"give a finite number, at most {LARGEST:g} in size"
            raise self.error(f"is {format_value(self.value)}: {cure}")
        return float(self.value)

    def formula(self) -> Formula:
        """Parse a text entry as a formula.

        Raises SceneFileError.
        """
        return self._call(lambda: Formula(self.text("a formula in quotes")))

    def whole(self, wanted: str = "a whole number") -> int:
        """Read a whole number, also from a formula.

        The message for another value asks for `wanted`. Raises SceneFileError.
        """
        found = self.number(wanted)
        if found != int(found):
            raise self.error(f"is {found:g}: give {wanted}")
        return int(found)

    def indices(self, which: ItemKind, word: Any = None) -> list[int]:
        """Find the indices for a name, group name or index, `word`.

        By default it is the value of this entry. `which` is the kind of item, such as "node".
        Raises SceneFileError.
        """
        return self._call(lambda: self.names.find(which, self.value if word is None else word))

    def error(self, message: str) -> SceneFileError:
        """Build an error that names the place of this entry.

        An example of `message` is "is 3: give 4".
        """
        text = ""
        for word in self.key:
            text += f"[{word}]" if isinstance(word, int) else f".{word}" if text else str(word)
        key = text if len(text) <= 120 else f"{text[:120]} …"
        return SceneFileError(message, *self.document.place(self.key), key)

    def _call(self, function: Callable[[], T]) -> T:
        try:
            return function()
        except SceneFileError:
            raise
        except ValueError as error:
            raise self.error(str(error)) from None


def list_entries(field: str, value: Any) -> tuple[Any, ...] | None:
    """Return the entries of a list that can contain names.

    Returns None for other values, such as text and mappings. Messages name `field`. Raises
    TypeError for an iterator that fails, as it cannot be read again, and ValueError for more than
    MAX_COUNT entries.
    """
    numbers = isinstance(value, np.ndarray) and value.dtype.kind in "biufc"
    if numbers or isinstance(value, (str, bytes, Mapping)):
        return None
    try:
        entries = tuple(islice(value, MAX_COUNT + 1))
    except Exception as error:  # each kind of matrix raises its own error
        if isinstance(value, Iterator):
            raise TypeError(f"{field} is {format_value(value)} ({error}): give a list") from error
        return None
    if len(entries) > MAX_COUNT:
        raise ValueError(f"{field} has more than {MAX_COUNT} entries: give at most {MAX_COUNT}")
    return entries


def nearest(word: str, known: Iterable[str]) -> str:
    """Suggest the nearest known word, or list known ones.

    `word` is unknown, and `known` are the words that are allowed. Returns the end of a message.
    """
    names = list(known)
    if close := difflib.get_close_matches(word[:80], names, 1):
        return f"did you mean {close[0]!r}?"
    return f"give one of {', '.join(names[:30])}" if names else "leave it out"


def call(
    build: Callable[..., Any], item: Item, table: Mapping[str, Item], given: Mapping[str, Any]
) -> Any:
    """Call `build`, and add file and line to its errors.

    The keywords are `given`. A TypeError or ValueError becomes a SceneFileError. Its place is the
    first field in the message that is in `table`, else `item`.
    """
    try:
        return build(**given)
    except SceneFileError:
        raise
    except (TypeError, ValueError) as error:
        text = str(error)
        found = {name: re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text) for name in table}
        places = {name: match.start() for name, match in found.items() if match}
        where = table[min(places, key=lambda name: places[name])] if places else item
        raise where.error(text) from error
