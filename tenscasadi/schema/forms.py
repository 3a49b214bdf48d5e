"""Forms of fields: each reads a value, writes one, and has a JSON Schema."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.schema.reading import Item, Names, NotWritten, Which, nearest
from tenscasadi.util.validate import shown

Schema = dict[str, Any]
Schemas = dict[str, Schema]  # of kinds, by name: what `$ref` means

FREE = "free"  # stands for None among coordinates
_NUMBER: Schema = {"type": ["number", "string"]}
_FORMULA = "a number, or a formula in quotes such as 'height / 2 * cos(30 deg)'"


class Form(ABC):
    """The look of a value of a file."""

    @abstractmethod
    def read(self, item: Item, names: Names) -> Any:
        """Return the Python value. Raises SceneFileError."""

    @abstractmethod
    def write(self, value: Any) -> Any:
        """Return numbers, text, lists and tables that `read` makes this value of. Raises NotWritten."""

    @abstractmethod
    def schema(self, kinds: Schemas) -> Schema:
        """Return the JSON Schema; tables that have a kind are put into `kinds`, once."""


@dataclass(frozen=True)
class Numbers(Form):
    """A number or an array of numbers of one of some shapes (None: any size); each number may be a formula."""

    shapes: tuple[tuple[int | None, ...], ...] = ((),)

    def read(self, item: Item, names: Names) -> Any:
        """Return a float or nested lists of floats."""
        depth, sizes = 0, []
        value = item.value
        while isinstance(value, list):
            depth += 1
            sizes.append(len(value))
            value = value[0] if value else None
        if not any(
            len(shape) == depth
            and all(want is None or want == got for want, got in zip(shape, sizes, strict=True))
            for shape in self.shapes
        ):
            raise item.error(f"is {shown(item.value)}: give {self.wanted}")
        return self._read(item, sizes)

    def _read(self, item: Item, sizes: list[int]) -> Any:
        if not sizes:
            return item.number(_FORMULA)
        entries = item.entries(self.wanted)
        if len(entries) != sizes[0]:
            raise item.error(f"has {len(entries)} entries: give {sizes[0]}, as the first row has")
        return [self._read(entry, sizes[1:]) for entry in entries]

    def write(self, value: Any) -> Any:
        """Return a number or nested lists."""
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise NotWritten(f"{shown(value)} is no array of numbers") from None
        return array.tolist()

    def schema(self, kinds: Schemas) -> Schema:
        """Return the shapes."""
        options = []
        for shape in self.shapes:
            option = dict(_NUMBER)
            for size in reversed(shape):
                option = {
                    "type": "array",
                    "items": option,
                    **({} if size is None else {"minItems": size, "maxItems": size}),
                }
            options.append(option)
        return options[0] if len(options) == 1 else {"anyOf": options}

    @property
    def wanted(self) -> str:
        """The shapes in words."""
        return " or ".join(_in_words(shape) for shape in self.shapes)


def _in_words(shape: tuple[int | None, ...]) -> str:
    if not shape:
        return "a number"
    size = "" if shape[0] is None else f"{shape[0]} "
    return (
        f"a list of {size}numbers"
        if len(shape) == 1
        else f"a list of {size}rows, each {_in_words(shape[1:])}"
    )


NUMBER = Numbers()
VECTOR = Numbers(((3,),))
PER_ITEM = Numbers(((), (None,)))
TIMES = Numbers(((None,),))
PAIR = Numbers(((2,),))
PATH = Numbers(((None, None, 3),))
TABLE = Numbers(((None, None),))
POINTS = Numbers(((None, 3),))
STATE = Numbers(((None, 3), (None,)))  # positions of nodes, or a state
SPAN = Numbers(((), (2,)))  # one number, or the least and the greatest


@dataclass(frozen=True)
class Wholes(Form):
    """A whole number, or where `lists` is True also a list of them."""

    lists: bool = False

    def read(self, item: Item, names: Names) -> Any:
        """Return an int or a list of int."""
        if self.lists and isinstance(item.value, list):
            return [entry.whole() for entry in item.entries()]
        return item.whole()

    def write(self, value: Any) -> Any:
        """Return an int or a list of int."""
        return np.asarray(value).tolist()

    def schema(self, kinds: Schemas) -> Schema:
        """Return integers or formulas."""
        one: Schema = {"type": ["integer", "string"]}
        return {"anyOf": [one, {"type": "array", "items": one}]} if self.lists else one


WHOLE = Wholes()


@dataclass(frozen=True)
class Flag(Form):
    """True or false."""

    def read(self, item: Item, names: Names) -> bool:
        """Return a bool."""
        if not isinstance(item.value, bool):
            raise item.error(f"is {shown(item.value)}: give true or false")
        return item.value

    def write(self, value: Any) -> bool:
        """Return a bool."""
        return bool(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return a boolean."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Word(Form):
    """One of some words; without any, all text."""

    options: tuple[str, ...] = ()

    def read(self, item: Item, names: Names) -> str:
        """Return the word."""
        word = item.text(" or ".join(map(repr, self.options)) or "text")
        if self.options and word not in self.options:
            raise item.error(f"is {shown(word)}: {nearest(word, self.options)}")
        return word

    def write(self, value: Any) -> str:
        """Return the word."""
        return str(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return the words."""
        return {"enum": list(self.options)} if self.options else {"type": "string"}


@dataclass(frozen=True)
class Coordinates(Form):
    """Three coordinates, of which some may be ``"free"``, None in Python."""

    def read(self, item: Item, names: Names) -> tuple[float | None, ...]:
        """Return three numbers or None."""
        wanted = f'three coordinates, "{FREE}" where one is free'
        entries = item.entries(wanted)
        if len(entries) != 3:
            raise item.error(f"is {shown(item.value)}: give {wanted}")
        return tuple(
            None if entry.value == FREE else entry.number(f"a number, or '{FREE}'")
            for entry in entries
        )

    def write(self, value: Any) -> list[Any]:
        """Return three numbers or "free"."""
        return [FREE if entry is None else float(entry) for entry in value]

    def schema(self, kinds: Schemas) -> Schema:
        """Return three entries."""
        return {"type": "array", "items": dict(_NUMBER), "minItems": 3, "maxItems": 3}


POINT = Coordinates()


@dataclass(frozen=True)
class Index(Form):
    """A node, bar or string by its name or index."""

    which: Which

    def read(self, item: Item, names: Names) -> int:
        """Return the index."""
        return names.one(self.which, item.value, item)

    def write(self, value: Any) -> int:
        """Return the index."""
        return int(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return an index or a name."""
        return {"type": ["integer", "string"], "minimum": 0}


@dataclass(frozen=True)
class Members(Form):
    """A list of nodes, bars or strings by name or index; a group's name stands for all its members."""

    which: Which

    def read(self, item: Item, names: Names) -> list[int]:
        """Return the indices."""
        entries = item.entries(f"a list of names or indices of {self.which}s")
        return [index for entry in entries for index in names.find(self.which, entry.value, entry)]

    def write(self, value: Any) -> list[int]:
        """Return the indices."""
        return [int(index) for index in value]

    def schema(self, kinds: Schemas) -> Schema:
        """Return a list of indices or names."""
        return {"type": "array", "items": Index(self.which).schema(kinds)}


@dataclass(frozen=True)
class Limits(Form):
    """Limits: one number, or one for each string or bar; ``inf`` where there is none."""

    def read(self, item: Item, names: Names) -> Any:
        """Return a float or a list of floats."""
        if isinstance(item.value, list):
            return [self._read(entry) for entry in item.entries()]
        return self._read(item)

    def _read(self, item: Item) -> float:
        return float("inf") if item.value == float("inf") else item.number()

    def write(self, value: Any) -> Any:
        """Return a number or a list of numbers."""
        return np.asarray(value, dtype=float).tolist()

    def schema(self, kinds: Schemas) -> Schema:
        """Return a number or a list of numbers."""
        return PER_ITEM.schema(kinds)


LIMITS = Limits()

_NAMES_A_FILE = (
    "file",
    "lib",
    "path",
    "plugin",
    "dir",
    "load",
    "dump",
    "write",
)  # parts of the names of options


@dataclass(frozen=True)
class Plain(Form):
    """A number, a flag or a word, as options of solvers are; none that names a file or a library."""

    def read(self, item: Item, names: Names) -> Any:
        """Return the value."""
        word = str(item.key[-1])
        if any(part in word for part in _NAMES_A_FILE):
            raise item.error(
                "may name a file, and nothing is loaded or written because a scene file says so: leave it out"
            )
        if not isinstance(item.value, (bool, int, float, str)) or item.value != item.value:
            raise item.error(f"is {shown(item.value)}: give a number, true, false or a word")
        return item.value

    def write(self, value: Any) -> Any:
        """Return the value."""
        value = value.item() if isinstance(value, np.generic) else value
        if not isinstance(value, (bool, int, float, str)):
            raise NotWritten(f"{shown(value)} is no number, flag or word: leave it out")
        return value

    def schema(self, kinds: Schemas) -> Schema:
        """Return the types."""
        return {"type": ["number", "boolean", "string"]}


PLAIN = Plain()


class InPython(Form):
    """A field that only Python can give, such as a function: files leave it out."""

    def read(self, item: Item, names: Names) -> Any:
        """Reject the value. Raises SceneFileError."""
        raise item.error("is a field of Python alone: leave it out")

    def write(self, value: Any) -> Any:
        """Reject the value. Raises NotWritten."""
        raise NotWritten("a function in Python: leave it out")

    def schema(self, kinds: Schemas) -> Schema:
        """Return a schema that nothing fits."""
        return {"not": {}}


class ToldApart(InPython):
    """A field that another table of the file holds."""
