"""Forms of the [structure] of scene files: nodes, members in groups, and a property for each of them."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from tenscasadi.schema.containers import Either, ListOf, MapOf, TableOf
from tenscasadi.schema.definitions import OneOf
from tenscasadi.schema.forms import (
    NUMBER,
    PER_ITEM,
    POINTS,
    VECTOR,
    Form,
    Members,
    Numbers,
    Schema,
    Schemas,
    Word,
)
from tenscasadi.schema.reading import Item, Names, Which, nearest
from tenscasadi.schema.value import Value
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array


@dataclass(frozen=True)
class PerPart(Form):
    """A number for all nodes, bars or strings, a list, or a table from some of them, by name or index, to their numbers.

    Those that a table does not name have `others`: NaN stands for what nothing says.
    """

    which: Which
    others: float = 0.0

    def read(self, item: Item, names: Names) -> Any:
        """Return a float or a list of floats."""
        if not isinstance(item.value, dict):
            return PER_ITEM.read(item, names)
        values = np.full(names.counts[self.which], self.others)
        for index, value in MapOf(self.which, NUMBER).read(item, names).items():
            values[index] = value
        return values.tolist()

    def write(self, value: Any) -> Any:
        """Return a number where all are equal, else a list."""
        return _common(PER_ITEM.write(value))

    def schema(self, kinds: Schemas) -> Schema:
        """Return a number, a list or a table."""
        return {"anyOf": [PER_ITEM.schema(kinds), MapOf(self.which, NUMBER).schema(kinds)]}


def _common(values: Any) -> Any:
    return (
        values[0]
        if isinstance(values, list) and values and len(set(map(repr, values))) == 1
        else values
    )


PAIRS = ListOf(Members("node"))
_DEFAULTS = {
    name: parameter.default for name, parameter in inspect.signature(Structure).parameters.items()
}
BARS: Mapping[str, Form] = {
    name: PerPart("bar", _DEFAULTS[name]) for name in ("bar_mass", "bar_radius")
}
STRINGS: Mapping[str, Form] = {
    **{
        name: PerPart("string", _DEFAULTS[name]) for name in ("stiffness", "damping", "string_mass")
    },
    "rest_length": PerPart("string", np.nan),
    "force_density": PerPart("string", np.nan),  # read only: it becomes rest lengths
}
_NODES: Mapping[str, Form] = {
    "node_mass": PerPart("node"),
    "pinned": Either((Mapping,), MapOf("node", Word()), Members("node")),
    "rollers": MapOf("node", Numbers(((3,), (None, 3)))),
}


@dataclass(frozen=True)
class Turn(Value, kind="Turn"):
    """A rotation about an axis through the origin.

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
        """Return the rotation (3×3). Raises ValueError."""
        size = float(np.linalg.norm(self.axis))
        if size == 0:
            raise ValueError("axis is (0, 0, 0): give a direction")
        x, y, z = np.asarray(self.axis) / size
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.asarray(
            np.eye(3) + np.sin(self.angle) * cross + (1 - np.cos(self.angle)) * cross @ cross
        )


_PLACED: Mapping[str, Form] = {"turn": OneOf(Turn), "move": VECTOR}
OPTIONS: Mapping[str, Form] = {**BARS, **STRINGS, **_NODES, **_PLACED}


@dataclass(frozen=True)
class MemberGroups(Form):
    """Pairs of nodes, or groups of them by name: pairs, or a table with its `members` and properties."""

    which: Literal["bar", "string"]
    properties: tuple[str, ...]

    def read(self, item: Item, names: Names) -> dict[str, tuple[list[list[int]], dict[str, Any]]]:
        """Return (pairs, properties) of each group, by name; those without groups are the group "". Raises SceneFileError."""
        if not isinstance(item.value, dict):
            return {"": (PAIRS.read(item, names), {})}
        groups: dict[str, tuple[list[list[int]], dict[str, Any]]] = {}
        for name, group in item.table().items():
            refuse_digits(name, group, f"a group of {self.which}s")
            if isinstance(group.value, list):
                groups[name] = (PAIRS.read(group, names), {})
                continue
            table = group.table(f"a table with members and properties of the {self.which}s")
            for key, entry in table.items():
                if key not in {"members", *self.properties}:
                    raise entry.error(
                        f"is no property of {self.which}s: {nearest(key, ('members', *self.properties))}"
                    )
            if "members" not in table:
                raise group.error(
                    'has no members: give pairs of nodes, such as members = [["foot", "top"]]'
                )
            pairs = PAIRS.read(table.pop("members"), names)
            found = {key: PER_ITEM.read(entry, names) for key, entry in table.items()}
            for key, value in found.items():
                if isinstance(value, list) and len(value) != len(pairs):
                    raise table[key].error(
                        f"has {len(value)} entries: give one number, or one for each of the {len(pairs)} members"
                    )
            groups[name] = (pairs, found)
        return groups

    def write(self, value: Any) -> Any:
        """Return pairs of nodes."""
        return np.asarray(value).tolist()

    def schema(self, kinds: Schemas) -> Schema:
        """Return pairs or groups."""
        pairs = PAIRS.schema(kinds)
        properties = {
            "members": pairs,
            **{name: PER_ITEM.schema(kinds) for name in self.properties},
        }
        group = {
            "type": "object",
            "properties": properties,
            "required": ["members"],
            "additionalProperties": False,
        }
        return {
            "anyOf": [pairs, {"type": "object", "additionalProperties": {"anyOf": [pairs, group]}}]
        }


def refuse_digits(name: str, entry: Item, what: str) -> None:
    """Raise SceneFileError where a name could be taken for the index of another node or member."""
    if name.isascii() and name.isdigit():
        raise entry.error(
            f"is the name of {what}, and an index, too: give a name with letters, such as 'n{name[:9]}'"
        )


class NodesForm(Form):
    """Positions in a list, or by name in a table."""

    def read(self, item: Item, names: Names) -> Any:
        """Return the positions, and their names."""
        if isinstance(item.value, dict):
            table = item.table()
            for k, (name, entry) in enumerate(table.items()):
                if name != str(k):
                    refuse_digits(name, entry, f"node {k}")
            return [VECTOR.read(entry, names) for entry in table.values()], {
                name: [k] for k, name in enumerate(table)
            }
        if not item.entries():
            raise item.error("is empty: give at least one node")
        return POINTS.read(item, names), {}

    def write(self, value: Any) -> Any:
        """Return positions."""
        return POINTS.write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return a list or a table."""
        return {"anyOf": [POINTS.schema(kinds), TableOf(VECTOR).schema(kinds)]}
