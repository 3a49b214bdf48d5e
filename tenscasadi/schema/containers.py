"""Field types of tables, and of alternatives between two types."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.schema.field_types import FieldType, Index, Schema, Schemas, varying
from tenscasadi.schema.reading import Item, ItemKind, Names, nearest
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.util.validate import format_value


@dataclass(frozen=True)
class MapOf(FieldType):
    """Field type of a table from nodes, bars or strings to values.

    `which` is "node", "bar" or "string", and `type` the type of the values. The name of a group
    stands for all its members.
    """

    which: ItemKind
    type: FieldType

    def read(self, item: Item) -> dict[int, Any]:
        """Read a table of a file, `item`, as values by index."""
        found: dict[int, Any] = {}
        for word, entry in item.table(f"a table from {self.which}s to values").items():
            value = self.type.read(entry)
            for index in entry.indices(self.which, word):
                if index in found:
                    raise entry.error(f"gives {self.which} {index} a second time: leave one out")
                found[index] = value
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Convert a mapping `value` to a table of a file."""
        key = Index(self.which)
        return {str(key.write(index)): self.type.write(entry) for index, entry in value.items()}

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of an object with any keys."""
        return {"type": "object", "additionalProperties": self.type.schema(kinds)}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices, among keys and in values.

        `value` is a mapping, `names` are those of the structure, and messages name `field`.
        """
        return names.resolve_keys(
            field, self.which, _resolve_values(field, value, lambda word: self.type, names)
        )


@dataclass(frozen=True)
class TableOf(FieldType):
    """Field type of a table from words to values.

    Parameters
    ----------
    type : FieldType or mapping of str to FieldType
        Type of all values, or of the value of each known word.
    """

    type: FieldType | Mapping[str, FieldType]

    def read(self, item: Item) -> dict[str, Any]:
        """Read a table of a file, `item`, as values by word."""
        found = {}
        for word, entry in item.table().items():
            if isinstance(self.type, Mapping) and word not in self.type:
                raise entry.error(f"is not known: {nearest(word, self.type)}")
            found[word] = self._type(word).read(entry)
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Convert a mapping `value` to a table of a file."""
        return {str(word): self._type(word).write(entry) for word, entry in dict(value).items()}

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of an object."""
        if isinstance(self.type, FieldType):
            return {"type": "object", "additionalProperties": self.type.schema(kinds)}
        entries = {word: own.schema(kinds) for word, own in self.type.items()}
        return {"type": "object", "properties": entries, "additionalProperties": False}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names of items by indices in the values.

        `value` is a mapping, `names` are those of nodes, bars and strings, and messages name
        `field`.
        """
        return _resolve_values(field, value, self._type, names)

    def _type(self, word: str) -> FieldType:
        return self.type if isinstance(self.type, FieldType) else self.type[word]


def _resolve_values(
    field: str, value: Any, choose: Callable[[Any], FieldType], names: Names
) -> Any:
    """Replace names of items by indices in a mapping's values.

    `value` is the mapping, and `choose` finds the type of the value of a key. `names` are those of
    nodes, bars and strings, and messages name `field`. Other values are returned unchanged.
    """
    if not isinstance(value, Mapping):
        return value
    found = {
        word: choose(word).resolve(f"{field}[{format_value(word)}]", entry, names)
        for word, entry in value.items()
    }
    return value if all(found[word] is entry for word, entry in value.items()) else found


@dataclass(frozen=True)
class Either(FieldType):
    """Field type that is one of two types.

    The first is for values of some Python classes, the other for all else.

    Parameters
    ----------
    classes : tuple of type
        Classes of the first type.
    first, other : FieldType
        The types.
    unless : str
        Key that makes a table one of the other type.
    """

    classes: tuple[type, ...]
    first: FieldType
    other: FieldType
    unless: str = ""

    def read(self, item: Item) -> Any:
        """Read an entry of a file by the type that fits."""
        return self._choose(item.value).read(item)

    def write(self, value: Any) -> Any:
        """Convert a value for a file by the type that fits."""
        return self._choose(value).write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema that permits both types."""
        return {"anyOf": [self.first.schema(kinds), self.other.schema(kinds)]}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices in a value of either type.

        See `FieldType.resolve`.
        """
        return self._choose(value).resolve(field, value, names)

    def _choose(self, value: Any) -> FieldType:
        other = isinstance(value, Mapping) and self.unless in value
        return self.first if isinstance(value, self.classes) and not other else self.other


def for_items(which: ItemKind, type: FieldType, other: FieldType) -> Either:
    """Build the type of a table by nodes, bars or strings, or another type.

    `which` is "node", "bar" or "string", `type` the type of the values of a table, and `other` that
    of anything else.
    """
    return Either((Mapping,), MapOf(which, type), other)


@dataclass(frozen=True)
class NodeForceTable(FieldType):
    """Field type of forces on all or some nodes, also over time."""

    def read(self, item: Item) -> Any:
        """Read forces on nodes, constant or over time.

        They are (n, 3), (K, n, 3) or a function of time. `item` is an array, or a table by node, of
        n nodes and K times.
        """
        if not isinstance(item.value, dict):
            return varying(None, 3).read(item)
        given: dict[int, Any] = MapOf("node", varying(3)).read(item)
        rows = [given.get(node, [0.0] * 3) for node in range(item.names.counts["node"])]
        if any(isinstance(row, TimeFormula) for row in rows):
            entries = tuple(
                row.entries if isinstance(row, TimeFormula) else tuple(row) for row in rows
            )
            if any(isinstance(entry, list) for row in entries for entry in row):
                raise item.error("has tables beside formulas of t: give one of them")
            return TimeFormula(entries, tuple(item.document.numbers.items()))
        try:
            return np.stack(np.broadcast_arrays(*rows), axis=-2).tolist()
        except ValueError:
            raise item.error("has tables of several lengths: give each as many rows") from None

    def write(self, value: Any) -> Any:
        """Convert forces to a table of the nodes that have some."""
        written = varying(None, 3).write(value)
        if callable(value):
            return written
        array = np.moveaxis(np.asarray(value), -2, 0)
        some = [k for k, row in enumerate(array) if row.any() or np.signbit(row).any()]
        return {str(node): array[node].tolist() for node in some}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Convert a mapping of forces by node to an array.

        The array is (n, 3) or (K, n, 3). `names` are those of the structure, and messages name
        `field`. Other values are returned unchanged.
        """
        over_time = isinstance(value, Mapping) and any(np.ndim(row) > 1 for row in value.values())
        return names.place_rows(field, value, (None, 3) if over_time else (3,))

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of an array or a table."""
        return for_items("node", varying(3), varying(None, 3)).schema(kinds)
