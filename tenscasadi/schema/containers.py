"""Forms of values that hold others: lists, tables, and either of two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.schema.forms import Form, Members, Schema, Schemas, Wholes
from tenscasadi.schema.reading import Item, Names, Which, nearest


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


@dataclass(frozen=True)
class EachOf(Form):
    """A value for all items, a list with one for each, or a table from some items to theirs; the others have `others`."""

    which: Which
    form: Form
    others: Any

    def read(self, item: Item, names: Names) -> Any:
        """Read a value, a list or a mapping."""
        if isinstance(item.value, list):
            return ListOf(self.form).read(item, names)
        if isinstance(item.value, dict) and "kind" not in item.value:
            return MapOf(self.which, self.form).read(item, names)
        return self.form.read(item, names)

    def write(self, value: Any) -> Any:
        """Write a value, or a table of the items that have another than `others`."""
        if not isinstance(value, tuple):
            return self.form.write(value)
        return {
            str(k): self.form.write(entry) for k, entry in enumerate(value) if entry != self.others
        }

    def schema(self, kinds: Schemas) -> Schema:
        """Return all three."""
        return {
            "anyOf": [
                self.form.schema(kinds),
                ListOf(self.form).schema(kinds),
                MapOf(self.which, self.form).schema(kinds),
            ]
        }


@dataclass(frozen=True)
class GroupsOf(Form):
    """For quantities the groups of items that share a value, by name or index, or "all"."""

    items: Mapping[str, Any]  # "node", "bar", "string", or "ground", by quantity

    def read(self, item: Item, names: Names) -> dict[str, Any]:
        """Return groups of indices by quantity."""
        found: dict[str, Any] = {}
        for name, entry in item.table().items():
            which = self.items.get(name)
            if which is None:
                raise entry.error(f"has no groups: {nearest(name, self.items)}")
            if entry.value == "all":
                found[name] = "all"
            elif which == "ground":
                found[name] = ListOf(ListOf(Wholes())).read(entry, names)
            else:
                found[name] = ListOf(Members(which)).read(entry, names)
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Return groups of indices by quantity."""
        return {
            name: "all" if groups == ((),) else [list(group) for group in groups]
            for name, groups in value
        }

    def schema(self, kinds: Schemas) -> Schema:
        """Return a table of the quantities that have groups."""
        groups = {"anyOf": [{"const": "all"}, ListOf(Members("node")).schema(kinds)]}
        return {
            "type": "object",
            "properties": dict.fromkeys(self.items, groups),
            "additionalProperties": False,
        }
