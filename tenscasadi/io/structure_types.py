"""Field types of the table [structure]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from tenscasadi.schema.containers import MapOf, TableOf, for_items
from tenscasadi.schema.field_types import (
    LIMITS,
    NUMBER,
    PER_ITEM,
    POINTS,
    VECTOR,
    FieldType,
    ListOf,
    Members,
    Numbers,
    Schema,
    Schemas,
)
from tenscasadi.schema.reading import Item, ItemKind, nearest
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array

PAIRS = ListOf(Members("node"))


@dataclass(frozen=True)
class Turn(Value, kind="Turn"):
    """Rotation about an axis through the origin, in files.

    Parameters
    ----------
    axis : sequence of float, shape (3,)
        Direction of the axis, of any length.
    angle : float
        Angle, rad, counterclockwise as seen against the axis.
    """

    axis: Annotated[Any, VECTOR]
    angle: float

    def matrix(self) -> Array:
        """Compute the rotation matrix (3×3).

        Raises ValueError.
        """
        size = float(np.linalg.norm(self.axis))
        if size == 0:
            raise ValueError("axis is (0, 0, 0): give a direction")
        x, y, z = np.asarray(self.axis) / size
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        bent = (1 - np.cos(self.angle)) * cross @ cross
        return np.asarray(np.eye(3) + np.sin(self.angle) * cross + bent)


@dataclass(frozen=True)
class PerItem(FieldType):
    """Field type of a property of nodes, bars or strings.

    `which` is "node", "bar" or "string". It is a number for all, a list, or a table of some of
    them. Items that a table does not name have the number `others`. If it is infinite, numbers may
    be.
    """

    which: ItemKind
    others: float

    def read(self, item: Item) -> Any:
        """Read a number or a list of numbers.

        `item` is the entry of the file.
        """
        if not isinstance(item.value, dict):
            return self._numbers.read(item)
        values = np.full(item.names.counts[self.which], self.others)
        one = replace(self._numbers, shapes=((),))
        for index, value in MapOf(self.which, one).read(item).items():
            values[index] = value
        return values.tolist()

    def write(self, value: Any) -> Any:
        """Write a number if all are equal, otherwise a list.

        `value` contains the numbers.
        """
        values = self._numbers.write(value)
        alike = isinstance(values, list) and len(set(map(repr, values))) == 1
        return values[0] if alike else values

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a number, list or table.

        `kinds` collects the schemas that several fields share.
        """
        return for_items(self.which, NUMBER, self._numbers).schema(kinds)

    @property
    def _numbers(self) -> Numbers:
        return LIMITS if np.isinf(self.others) else PER_ITEM


@dataclass(frozen=True)
class MemberGroups(FieldType):
    """Field type of bars or strings, as node pairs or named groups.

    `which` is "bar" or "string". A group is a list of pairs, or a table with `members` and
    properties.
    """

    which: Literal["bar", "string"]
    properties: tuple[str, ...]

    def read(self, item: Item) -> MembersRead:
        """Read the members of all groups with their properties.

        `item` is the entry of the file. Raises SceneFileError.
        """
        if not isinstance(item.value, dict):
            return MembersRead(PAIRS.read(item), [], {})
        found = MembersRead([], [], {})
        for name, group in item.table().items():
            _refuse_index(name, group, f"a group of {self.which}s")
            table = {"members": group}
            if not isinstance(group.value, list):
                wanted = f"a table with members and properties of the {self.which}s"
                table = group.table(wanted)
            known = ("members", *self.properties)
            for key, entry in table.items():
                if key not in known:
                    raise entry.error(f"is no property of {self.which}s: {nearest(key, known)}")
            if "members" not in table:
                example = 'pairs of nodes, such as members = [["foot", "top"]]'
                raise group.error(f"has no members: give {example}")
            pairs = PAIRS.read(table.pop("members"))
            for key, entry in table.items():
                value = (LIMITS if key == "bar_stiffness" else PER_ITEM).read(entry)
                if isinstance(value, list) and len(value) != len(pairs):
                    cure = f"give one number, or one for each of the {len(pairs)} members"
                    raise entry.error(f"has {len(value)} entries: {cure}")
                first = len(found.pairs)
                indices = range(first, first + len(pairs))
                found.properties.setdefault(key, []).append((indices, entry, value))
            found.pairs.extend(pairs)
            found.groups.append((name, len(pairs)))
        return found

    def write(self, value: Any) -> Any:
        """Convert members to pairs of nodes."""
        return np.asarray(value).tolist()

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of pairs or groups.

        `kinds` collects the schemas that several fields share.
        """
        pairs = PAIRS.schema(kinds)
        own = {name: PER_ITEM.schema(kinds) for name in self.properties}
        group = {
            "type": "object",
            "properties": {"members": pairs, **own},
            "required": ["members"],
            "additionalProperties": False,
        }
        groups = {"type": "object", "additionalProperties": {"anyOf": [pairs, group]}}
        return {"anyOf": [pairs, groups]}


class MembersRead(NamedTuple):
    """Bars or strings that were read from a file.

    `pairs` are their nodes. `groups` are names and sizes. `properties` are indices, item and value
    of each group.
    """

    pairs: list[list[int]]
    groups: list[tuple[str, int]]
    properties: dict[str, list[tuple[range, Item, Any]]]


class NodeTable(FieldType):
    """Field type of node positions, in a list or by name in a table."""

    def read(self, item: Item) -> tuple[list[Any], list[str]]:
        """Read the positions of nodes, and their names.

        `item` is the entry of the file.
        """
        if not isinstance(item.value, dict):
            if not item.entries():
                raise item.error("is empty: give at least one node")
            return POINTS.read(item), []
        table = item.table()
        for k, (name, entry) in enumerate(table.items()):
            if name != str(k):
                _refuse_index(name, entry, f"node {k}")
        names = ["" if name.isdigit() else name for name in table]
        return [VECTOR.read(entry) for entry in table.values()], names

    def write(self, value: Any) -> Any:
        """Convert positions (n, 3) to lists."""
        return POINTS.write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a list or a table.

        `kinds` collects the schemas that several fields share.
        """
        return {"anyOf": [POINTS.schema(kinds), TableOf(VECTOR).schema(kinds)]}


def _refuse_index(name: str, entry: Item, owner: str) -> None:
    if name.isascii() and name.isdigit():
        cure = f"give a name with letters, such as 'n{name[:9]}'"
        raise entry.error(f"is the name of {owner}, and an index, too: {cure}")
