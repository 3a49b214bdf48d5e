"""Field types: conversion between files and Python, checks, JSON Schema."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.schema.formulas import FormulaError
from tenscasadi.schema.reading import Item, ItemKind, Names, NotWritten, list_entries, nearest
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.util.validate import as_tuple, finite_array, format_value, index_or_name

Schema = dict[str, Any]
Schemas = dict[str, Schema]  # definitions that `$ref` refers to, by name

FREE = "free"  # in files, in place of None for a coordinate
_FORMULA = "a number, or a formula in quotes such as 'height / 2 * cos(30 deg)'"


class FieldType(ABC):
    """Base class of field types.

    A field type reads, writes, checks and describes the values of a field.
    """

    @abstractmethod
    def read(self, item: Item) -> Any:
        """Convert an entry of a file, `item`, to a Python value.

        Raises SceneFileError.
        """

    @abstractmethod
    def write(self, value: Any) -> Any:
        """Convert a Python value to numbers, text, lists and tables.

        Raises NotWritten.
        """

    @abstractmethod
    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of values of this type.

        Definitions of classes, to which it refers, are added to `kinds`.
        """

    def check(self, field: str, value: Any) -> Any:
        """Check a Python value, see `check_fields`.

        Messages name `field`. Most values are checked by their class instead. Raises TypeError,
        ValueError.
        """
        return value

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices in a Python value.

        They are names of nodes, bars and strings of a structure, given by `names`. Messages begin
        with `field`. Other values are returned unchanged, for the checks of their class. Raises
        TypeError, ValueError.
        """
        return value


@dataclass(frozen=True)
class Numbers(FieldType):
    """Field type of a number, or an array of one of several shapes.

    Parameters
    ----------
    shapes : tuple of tuple of int or None
        Allowed shapes; None stands for any size.
    whole, free, unbounded : bool
        Whether entries are integers; may be "free", which is None in Python; may be infinite.
    varying : bool
        Whether entries of the first shape may be formulas of the time t.
    """

    shapes: tuple[tuple[int | None, ...], ...] = ((),)
    whole: bool = False
    free: bool = False
    unbounded: bool = False
    varying: bool = False

    def read(self, item: Item) -> Any:
        """Read a number, nested lists, or a function of time.

        `item` is its entry in a file.
        """
        sizes, value = [], item.value
        while isinstance(value, list):
            sizes.append(len(value))
            value = value[0] if value else None
        fits = [
            len(shape) == len(sizes)
            and all(size in (None, own) for size, own in zip(shape, sizes, strict=True))
            for shape in self.shapes
        ]
        if not any(fits):
            raise item.error(f"is {format_value(item.value)}: give {self._describe()}")
        found = self._read(item, sizes, self.varying and fits[0])
        if not _has_text(found):
            return tuple(found) if self.free else found
        return TimeFormula(_as_tuples(found), tuple(item.document.numbers.items()))

    def check(self, field: str, value: Any) -> Any:
        """Convert a constant to a finite array of the only shape.

        Other values are returned unchanged. Messages name `field`.
        """
        if len(self.shapes) > 1 or self.free or self.varying or self.whole or self.unbounded:
            return value
        return finite_array(field, value, self.shapes[0])

    def _read(self, item: Item, sizes: list[int], varying: bool) -> Any:
        if sizes:
            entries = item.entries(self._describe())
            if len(entries) != sizes[0]:
                cure = f"give {sizes[0]}, as the first row has"
                raise item.error(f"has {len(entries)} entries: {cure}")
            return [self._read(entry, sizes[1:], varying) for entry in entries]
        if self.free and item.value == FREE:
            return None
        if self.unbounded and item.value in (np.inf, "inf"):
            return np.inf
        if varying and isinstance(item.value, str) and (formula := item.formula()).varies:
            numbers = item.document.numbers
            for word in sorted(formula.names - numbers.keys() - {"t"}):
                raise item.error(f"{word!r} is not declared: {nearest(word, numbers)} in [numbers]")
            return item.value
        return item.whole() if self.whole else item.number(_FORMULA)

    def write(self, value: Any) -> Any:
        """Convert numbers, arrays or functions of time for a file."""
        if isinstance(value, TimeFormula):
            try:
                return value.plain()
            except FormulaError as error:  # with the numbers it is longer
                raise NotWritten(f"with its numbers {error}") from None
        if callable(value):
            raise NotWritten("a function of time in Python: give formulas or a table at times")
        if self.free:
            return [FREE if entry is None else float(entry) for entry in value]
        try:
            return np.asarray(value, dtype=int if self.whole else float).tolist()
        except (TypeError, ValueError):
            raise NotWritten(f"{format_value(value)} is no array of numbers") from None

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of all permitted shapes."""
        options = []
        for shape in self.shapes:
            option: Schema = {"type": ["integer" if self.whole else "number", "string"]}
            for size in reversed(shape):
                limits = {} if size is None else {"minItems": size, "maxItems": size}
                option = {"type": "array", "items": option, **limits}
            options.append(option)
        return options[0] if len(options) == 1 else {"anyOf": options}

    def _describe(self) -> str:
        """Describe the permitted shapes for messages."""
        unit = f'numbers, "{FREE}" where one is free' if self.free else "numbers"
        words = []
        for shape in self.shapes:
            lists = [f"a list of {'' if size is None else f'{size} '}" for size in shape]
            one = "a whole number" if self.whole else "a number"
            words.append("rows, each ".join([*lists[:-1], lists[-1] + unit]) if lists else one)
        return " or ".join(words) + (", also formulas of the time t" if self.varying else "")


def _has_text(value: Any) -> bool:
    return any(map(_has_text, value)) if isinstance(value, list) else isinstance(value, str)


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value


NUMBER = Numbers()
VECTOR = Numbers(((3,),))
PER_ITEM = Numbers(((), (None,)))
LIMITS = Numbers(((), (None,)), unbounded=True)
TIMES = Numbers(((None,),))
PAIR = Numbers(((2,),))
PATH = Numbers(((None, None, 3),))
TABLE = Numbers(((None, None),))
POINTS = Numbers(((None, 3),))
STATE = Numbers(((None, 3), (None,)))  # positions of nodes, or a state
SPAN = Numbers(((), (2,)))  # one number, or the least and the greatest
POINT = Numbers(((3,),), free=True)
MOVING_POINT = Numbers(((3,),), varying=True)
MOVING_PLACE = Numbers(((3,),), free=True, varying=True)
WHOLE = Numbers(whole=True)
WHOLES = Numbers(((), (None,)), whole=True)


def varying(*shape: int | None) -> Numbers:
    """Build the field type of a quantity that may change with time."""
    return Numbers((shape, (None, *shape)), varying=True)


@dataclass(frozen=True)
class Flag(FieldType):
    """Field type of a Boolean."""

    def read(self, item: Item) -> bool:
        """Read a Boolean from a file."""
        if not isinstance(item.value, bool):
            raise item.error(f"is {format_value(item.value)}: give true or false")
        return item.value

    def write(self, value: Any) -> bool:
        """Convert a Boolean for a file."""
        return bool(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a Boolean."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Word(FieldType):
    """Field type of text, or of one of the words `options`."""

    options: tuple[str, ...] = ()

    def read(self, item: Item) -> str:
        """Read a word from a file, and check it."""
        word = item.text(" or ".join(map(repr, self.options)) or "text")
        if self.options and word not in self.options:
            raise item.error(f"is {format_value(word)}: {nearest(word, self.options)}")
        return word

    def write(self, value: Any) -> str:
        """Convert a word for a file."""
        return str(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of the permitted words."""
        return {"enum": list(self.options)} if self.options else {"type": "string"}


def names_file(option: str) -> bool:
    """Return whether a solver option names a file or a library."""
    parts = ("file", "lib", "path", "plugin", "dir", "load", "dump", "write")
    return any(part in option for part in parts)


@dataclass(frozen=True)
class Option(FieldType):
    """Field type of a solver option: a number, a flag or a word.

    Options that name files or libraries are rejected.
    """

    def read(self, item: Item) -> Any:
        """Read a solver option from a file, and check it."""
        if names_file(str(item.key[-1])):
            reason = "nothing is loaded or written because a scene file says so"
            raise item.error(f"may name a file, and {reason}: leave it out")
        if not isinstance(item.value, (bool, int, float, str)) or item.value != item.value:
            raise item.error(f"is {format_value(item.value)}: give a number, true, false or a word")
        return item.value

    def write(self, value: Any) -> Any:
        """Convert a solver option for a file."""
        value = value.item() if isinstance(value, np.generic) else value
        if not isinstance(value, (bool, int, float, str)):
            raise NotWritten(f"{format_value(value)} is no number, flag or word: leave it out")
        return value

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a solver option."""
        return {"type": ["number", "boolean", "string"]}


@dataclass(frozen=True)
class Index(FieldType):
    """Field type of a node, bar or string, by its name or index.

    `which` is "node", "bar" or "string".
    """

    which: ItemKind

    def read(self, item: Item) -> int:
        """Read an index, or the index of a name, from a file."""
        found = item.indices(self.which)
        if len(found) != 1:
            group = f"a group of {len(found)} {self.which}s"
            raise item.error(f"is {format_value(item.value)}, {group}: give the index of one")
        return found[0]

    def write(self, value: Any) -> int | str:
        """Convert an index or a name for a file."""
        return str(value) if isinstance(value, str) else int(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of an index or a name."""
        return {"type": ["integer", "string"], "minimum": 0}

    def check(self, field: str, value: Any) -> Any:
        """Check that a value is an index, at least 0, or a name.

        Messages begin with `field`.
        """
        return index_or_name(field, value)

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace a name by its index.

        An index is returned unchanged. `names` are those of the structure; messages begin with
        `field`.
        """
        return names.resolve(field, self.which, value)


@dataclass(frozen=True)
class Members(FieldType):
    """Field type of a list of nodes, bars or strings.

    `which` is "node", "bar" or "string". The name of a group stands for all its members.
    """

    which: ItemKind

    def read(self, item: Item) -> list[int]:
        """Read a list of indices, or of names as indices.

        `item` is its entry in a file.
        """
        entries = item.entries(f"a list of names or indices of {self.which}s")
        return [index for entry in entries for index in entry.indices(self.which)]

    def write(self, value: Any) -> list[int | str]:
        """Convert indices and names for a file."""
        return [Index(self.which).write(entry) for entry in value]

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a list of indices or names."""
        return {"type": "array", "items": Index(self.which).schema(kinds)}

    def check(self, field: str, value: Any) -> Any:
        """Convert a list to a tuple of indices and names.

        Messages name `field`.
        """
        return as_tuple(field, value, "[0, 1]")

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names of items and groups in a list by indices.

        `names` are those of the structure, and messages name `field`.
        """
        return names.resolve_all(field, self.which, value)


@dataclass(frozen=True)
class ListOf(FieldType):
    """Field type of a list of values of one type.

    Parameters
    ----------
    type : FieldType
        Type of the entries.
    single : bool
        Whether a value may stand for a list of one.
    count : int, optional
        Number of entries.
    """

    type: FieldType
    single: bool = False
    count: int | None = None

    def read(self, item: Item) -> list[Any]:
        """Read the entries of a list in a file, `item`."""
        if self.single and not isinstance(item.value, list):
            return [self.type.read(item)]
        entries = item.entries()
        if self.count not in (None, len(entries)):
            raise item.error(f"has {len(entries)} entries: give {self.count}")
        return [self.type.read(entry) for entry in entries]

    def write(self, value: Any) -> Any:
        """Convert the entries for a file.

        A single one may become an entry without a list.
        """
        alone = self.single and not isinstance(value, (Sequence, np.ndarray))
        written = [self.type.write(entry) for entry in ([value] if alone else value)]
        return written[0] if self.single and len(written) == 1 else written

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a list."""
        one = self.type.schema(kinds)
        limits = {} if self.count is None else {"minItems": self.count, "maxItems": self.count}
        many: Schema = {"type": "array", "items": one, **limits}
        return {"anyOf": [one, many]} if self.single else many

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices in the entries of a list.

        See `FieldType.resolve`.
        """
        entries = list_entries(field, value)
        if entries is None:
            return self.type.resolve(field, value, names) if self.single else value
        found = [
            self.type.resolve(f"{field}[{k}]", entry, names) for k, entry in enumerate(entries)
        ]
        same = all(new is entry for new, entry in zip(found, entries, strict=True))
        return value if same and not isinstance(value, Iterator) else found


class InPython(FieldType):
    """Field type of values that files cannot hold, such as functions."""

    def read(self, item: Item) -> Any:
        """Reject an entry in a file by SceneFileError."""
        raise item.error("is a field of Python alone: leave it out")

    def write(self, value: Any) -> Any:
        """Reject a value by NotWritten, as files cannot hold it."""
        raise NotWritten("a function in Python: leave it out")

    def schema(self, kinds: Schemas) -> Schema:
        """Build a JSON Schema that permits no value."""
        return {"not": {}}


class ElsewhereInFile(InPython):
    """Field type of values that another table of the file holds."""
