"""Forms of values that only [plan] has: limits that may be open, options of solvers, pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tenscasadi.files.document import Item
from tenscasadi.files.forms import (
    FREE,
    PER_ITEM,
    Coordinates,
    Form,
    Names,
    NotWritten,
    Schema,
    Schemas,
)
from tenscasadi.files.structure_table import SHAPES, StructureForm
from tenscasadi.files.time_formula import OverTime, TimeFormula
from tenscasadi.util.validate import shown

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


@dataclass(frozen=True)
class Pair(Form):
    """A pair of arrays, in Python a tuple."""

    form: Form

    def read(self, item: Item, names: Names) -> tuple[Any, ...]:
        """Return both."""
        entries = item.entries("two lists")
        if len(entries) != 2:
            raise item.error(f"has {len(entries)} entries: give two")
        return tuple(self.form.read(entry, names) for entry in entries)

    def write(self, value: Sequence[Any]) -> list[Any]:
        """Return both."""
        return [self.form.write(entry) for entry in value]

    def schema(self, kinds: Schemas) -> Schema:
        """Return a list of two."""
        return {"type": "array", "items": self.form.schema(kinds), "minItems": 2, "maxItems": 2}


LIMITS = Limits()
PLAIN = Plain()


@dataclass(frozen=True)
class MovingPlace(Form):
    """Three coordinates, each a number, a formula of the time t, or ``"free"``, None in Python."""

    def read(self, item: Item, names: Names) -> Any:
        """Return three numbers or None, or a function of time."""
        wanted = (
            f'three coordinates, "{FREE}" where one is free; formulas of the time t where it moves'
        )
        entries = item.entries(wanted)
        if len(entries) != 3:
            raise item.error(f"is {shown(item.value)}: give {wanted}")
        found = [
            None if entry.value == FREE else OverTime(()).read(entry, names) for entry in entries
        ]
        moving = [entry for entry in found if isinstance(entry, TimeFormula)]
        if not moving:
            return tuple(found)
        numbers = {name: value for entry in moving for name, value in entry.numbers}
        return TimeFormula(
            tuple(entry.entries if isinstance(entry, TimeFormula) else entry for entry in found),
            tuple(numbers.items()),
        )

    def write(self, value: Any) -> list[Any]:
        """Return three numbers, formulas or "free"."""
        if callable(value) and not isinstance(value, TimeFormula):
            raise NotWritten(
                "a function of time in Python: give a place, or keep the problem in Python"
            )
        return [
            FREE if entry is None else entry
            for entry in (value.plain() if isinstance(value, TimeFormula) else value)
        ]

    def schema(self, kinds: Schemas) -> Schema:
        """Return three entries."""
        return Coordinates().schema(kinds)


@dataclass(frozen=True)
class OfStructure(Form):
    """Values of a structure, given by a table with a ``shape`` as in [structure]; or by another form."""

    take: Literal["nodes", "string_lengths"]
    other: Form

    def read(self, item: Item, names: Names) -> Any:
        """Return what the structure has, or what the other form reads."""
        if isinstance(item.value, dict) and "shape" in item.value:
            structure, _ = StructureForm().read(item, Names())
            return getattr(structure, self.take)
        return self.other.read(item, names)

    def write(self, value: Any) -> Any:
        """Return what the other form writes."""
        return self.other.write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return both."""
        return {
            "anyOf": [
                self.other.schema(kinds),
                *(shape.schema(kinds, "shape", tagged=True) for shape in SHAPES),
            ]
        }
