"""Forms of values that hold others: lists, tables, and either of two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.files.document import Item, nearest
from tenscasadi.files.forms import Form, Names, Schema, Schemas, Which


@dataclass(frozen=True)
class ListOf(Form):
    """A list of values of one form; `single`: one value may stand for a list of one."""

    form: Form
    single: bool = False

    def read(self, item: Item, names: Names) -> list[Any]:
        """Return the values."""
        if self.single and not isinstance(item.value, list):
            return [self.form.read(item, names)]
        return [self.form.read(entry, names) for entry in item.entries()]

    def write(self, value: Any) -> Any:
        """Return the values, one alone without a list where it may be."""
        values = (
            list(value)
            if isinstance(value, (Sequence, np.ndarray))
            else [value]
            if self.single
            else list(value)
        )
        written = [self.form.write(entry) for entry in values]
        return written[0] if self.single and len(written) == 1 else written

    def schema(self, kinds: Schemas) -> Schema:
        """Return a list."""
        one = self.form.schema(kinds)
        many: Schema = {"type": "array", "items": one}
        return {"anyOf": [one, many]} if self.single else many


@dataclass(frozen=True)
class MapOf(Form):
    """A table from nodes, bars or strings, by name or index, to values of one form; a group's name stands for all its members."""

    which: Which
    form: Form

    def read(self, item: Item, names: Names) -> dict[int, Any]:
        """Return the values by index."""
        found: dict[int, Any] = {}
        for word, entry in item.table(f"a table from {self.which}s to values").items():
            value = self.form.read(entry, names)
            for index in names.find(self.which, word, entry):
                if index in found:
                    raise entry.error(f"gives {self.which} {index} a second time: leave one out")
                found[index] = value
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Return a table."""
        return {str(int(index)): self.form.write(entry) for index, entry in value.items()}

    def schema(self, kinds: Schemas) -> Schema:
        """Return an object with any keys."""
        return {"type": "object", "additionalProperties": self.form.schema(kinds)}


@dataclass(frozen=True)
class TableOf(Form):
    """A table from words to values of one form."""

    form: Form
    words: tuple[str, ...] = ()

    def read(self, item: Item, names: Names) -> dict[str, Any]:
        """Return the values by word."""
        found = {}
        for word, entry in item.table().items():
            if self.words and word not in self.words:
                raise entry.error(f"is not known: {nearest(word, self.words)}")
            found[word] = self.form.read(entry, names)
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Return a table."""
        return {str(word): self.form.write(entry) for word, entry in dict(value).items()}

    def schema(self, kinds: Schemas) -> Schema:
        """Return an object."""
        one = self.form.schema(kinds)
        if self.words:
            return {
                "type": "object",
                "properties": dict.fromkeys(self.words, one),
                "additionalProperties": False,
            }
        return {"type": "object", "additionalProperties": one}


@dataclass(frozen=True)
class Either(Form):
    """One of two forms: the first for values of these types, in files and in Python, the other for all else."""

    kinds: tuple[type, ...]
    first: Form
    other: Form

    def read(self, item: Item, names: Names) -> Any:
        """Return what the form that fits reads."""
        return (self.first if isinstance(item.value, self.kinds) else self.other).read(item, names)

    def write(self, value: Any) -> Any:
        """Return what the form that fits writes."""
        return (self.first if isinstance(value, self.kinds) else self.other).write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return both."""
        return {"anyOf": [self.first.schema(kinds), self.other.schema(kinds)]}
