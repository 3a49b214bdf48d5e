"""Table [structure]: a named shape, or nodes, bars and strings."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from tenscasadi.io.structure_types import MemberGroups, NodeTable, PerItem, Turn
from tenscasadi.schema.containers import MapOf, TableOf, for_items
from tenscasadi.schema.definitions import Definition, OneOf, definition
from tenscasadi.schema.field_types import (
    PER_ITEM,
    POINTS,
    TIMES,
    VECTOR,
    FieldType,
    ListOf,
    Members,
    Numbers,
    Schema,
    Schemas,
    Word,
)
from tenscasadi.schema.reading import Item, ItemKind, Names, call, nearest
from tenscasadi.structure.names import find_names, name_members
from tenscasadi.structure.rigid_body import RigidBody
from tenscasadi.structure.shapes import ShapeFamily
from tenscasadi.structure.structure import Structure

BARS = ("bar_mass", "bar_radius", "bar_stiffness", "bar_rest_length")
STRINGS = ("stiffness", "damping", "string_mass", "rest_length", "force_density")
_OTHERS = {  # properties of members, and the values where a file gives none
    **{"bar_mass": 1.0, "bar_radius": 0.0, "stiffness": 100.0, "damping": 0.0, "string_mass": 0.0},
    **{"rest_length": np.nan, "force_density": np.nan},
    **{"bar_stiffness": np.inf, "bar_rest_length": np.nan},
}
_TYPES: dict[str, FieldType] = {
    "nodes": NodeTable(),
    "bars": MemberGroups("bar", BARS),
    "strings": MemberGroups("string", STRINGS),
    **{name: PerItem("bar", _OTHERS[name]) for name in BARS},
    **{name: PerItem("string", _OTHERS[name]) for name in STRINGS},
    "node_mass": PerItem("node", 0.0),
    "pinned": for_items("node", Word(), Members("node")),
    "bodies": ListOf(OneOf(RigidBody)),
    "cables": ListOf(Members("string")),
    "cable_friction": PER_ITEM,
    "rollers": MapOf("node", Numbers(((3,), (None, 3)))),
    **dict.fromkeys(("node_names", "bar_names", "string_names"), ListOf(Word())),
}
_INDICES, _PAIRS = (Numbers((shape,), whole=True) for shape in ((None,), (None, 2)))
_DERIVED = TableOf(
    {"string_parent": _INDICES, "string_fraction": TIMES, "mass_share": TIMES, "ties": POINTS}
    | {"physical": _INDICES, "bar_columns": _PAIRS, "string_columns": _PAIRS}
)


@dataclass(frozen=True)
class _Placement:
    """Translation and other changes of a structure in a file.

    Parameters
    ----------
    force_density : array_like, shape (α,)
        Initial force density of strings, N/m, below their stiffness: it sets their rest lengths.
    turn : table
        Rotation of all nodes about an axis through the origin.
    move : sequence of float, shape (3,)
        Displacement of all nodes after that, m.
    derived : table
        Segments and columns of a structure that `Structure.subdivide` or `Structure.from_matrices`
        made. Saved files hold it; do not write it by hand.
    """

    force_density: Annotated[Any, PerItem("string", np.nan)] = None
    turn: Turn | None = None
    move: Annotated[Any, VECTOR] = None
    derived: Annotated[Any, _DERIVED] = None


_LATER = definition(_Placement).fields
_NAMES = ("node_names", "bar_names", "string_names")
# read before the options, which may use names
_FIRST = ("nodes", "bars", "strings", *_NAMES, "derived")
_PLAIN = definition(Structure, "nodes", "shape", types=tuple(_TYPES.items()))
NODES = replace(_PLAIN, fields={**_PLAIN.fields, **_LATER})
OPTIONS = {name: own for name, own in NODES.fields.items() if name not in _FIRST}


def find_shapes() -> dict[str, Definition]:
    """Return the file formats of all shapes.

    They have their own arguments and the options of `Structure`.
    """
    own = {name: definition(build, name, "shape") for name, build in ShapeFamily.members.items()}
    names = {name: NODES.fields[name] for name in _NAMES}
    return {
        name: replace(shape, fields={**shape.fields, **names, **OPTIONS})
        for name, shape in own.items()
    }


# --- reading and writing ---


@dataclass(frozen=True)
class StructureSection(FieldType):
    """Field type of the table [structure]."""

    def read(self, item: Item) -> Structure:
        """Read the structure from its table (`item`).

        Raises SceneFileError.
        """
        table = item.table()
        if "shape" not in table:
            return _read_nodes(item, table)
        name = table.pop("shape")
        if "nodes" in table:
            raise table["nodes"].error("is given beside shape: give one of them")
        known = find_shapes()
        if name.text("the name of a shape") not in known:
            raise name.error(f"is {name.value!r}: {nearest(name.value, known)}")
        return _read_shape(known[name.value], item, table)

    def write(self, value: Any) -> dict[str, Any]:
        """Convert a structure to nodes, bars and strings.

        The structure is `value`, and the result is a table.
        """
        fields = dict(value.to_fields())
        if all(axes == "xyz" for axes in value.pinned.values()):
            fields["pinned"] = list(value.pinned)
        for part, lengths in (("", value.string_lengths), ("bar_", value.bar_lengths)):
            if np.array_equal(fields[f"{part}rest_length"], lengths):
                del fields[f"{part}rest_length"]
        written = NODES.write(fields)
        del written["shape"]
        return {name: content for name, content in written.items() if content not in ([], {})}

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of nodes and of shapes.

        `kinds` collects the schemas that several fields share.
        """
        return {"anyOf": [NODES.schema(kinds), _build_shape_schema(kinds)]}


@dataclass(frozen=True)
class OfStructure(FieldType):
    """Field type of a structure's attribute, or of another type.

    `take` is the name of the attribute, and `other` the other type. In files the structure is given
    by its ``shape``.
    """

    take: Literal["nodes", "string_lengths"]
    other: FieldType

    def read(self, item: Item) -> Any:
        """Read the attribute of a structure, or the other type.

        `item` is this entry of the file.
        """
        if isinstance(item.value, dict) and "shape" in item.value:
            return getattr(StructureSection().read(item), self.take)
        return self.other.read(item)

    def write(self, value: Any) -> Any:
        """Write the value by the other type."""
        return self.other.write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Build the JSON Schema of a shape or the other type.

        `kinds` collects the schemas that several fields share.
        """
        return {"anyOf": [self.other.schema(kinds), _build_shape_schema(kinds)]}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices, by the other type.

        The names are in `value`. `field` is the name of the field in messages.
        """
        return self.other.resolve(field, value, names)


def _build_shape_schema(kinds: Schemas) -> Schema:
    """Add the JSON Schemas of all shapes to `kinds`."""
    if "NamedShape" not in kinds:
        shapes = [shape.schema(kinds, tagged=True) for shape in find_shapes().values()]
        several = {"type": "object", "discriminator": {"propertyName": "shape"}, "oneOf": shapes}
        kinds["NamedShape"] = {"description": "Shape of a structure by its name.", **several}
    return {"$ref": "#/$defs/NamedShape"}


Groups = Mapping[str, list[tuple[range, Item, Any]]]  # indices, items and values by property


def _read_shape(own: Definition, item: Item, table: dict[str, Item]) -> Structure:
    first = {name: entry for name, entry in table.items() if name not in OPTIONS}
    for name in ("force_density", "rest_length"):
        if name in table and "prestress" in first:
            cure = "leave one of them out"
            raise table[name].error(f"is given beside prestress, which defines it, too: {cure}")
    plain = {name: entry for name, entry in first.items() if name != "prestress"}
    names = own.read(item._replace(value={name: table[name].value for name in plain})).names
    given = own.read_fields(first) | _read_options(own, table, names)
    return _build(own.build, given, item, table, {})


def _read_nodes(item: Item, table: dict[str, Item]) -> Structure:
    for name in table:
        if name not in NODES.fields:
            cure = nearest(name, (*NODES.fields, "shape"))
            raise table[name].error(f"is no field of a structure: {cure}")
    if "nodes" not in table:
        cure = 'give nodes = [[0, 0, 0], [0, 0, 1]], or shape = "prism"'
        raise item.error(f"has neither nodes nor shape: {cure}")
    nodes, names = _TYPES["nodes"].read(table["nodes"])
    given: dict[str, Any] = {"nodes": nodes, "node_names": names}
    given |= NODES.read_fields(
        {name: table[name] for name in (*_NAMES, "derived") if name in table}
    )
    groups: dict[str, Any] = {}
    for which in ("bar", "string"):
        if (part := f"{which}s") in table:
            found = _TYPES[part].read(table[part]._replace(names=_find_names(given)))
            given = {part: found.pairs, f"{which}_names": name_members(found.groups)} | given
            groups |= found.properties
    given |= _read_options(NODES, table, _find_names(given))
    for name, parts in groups.items():
        if isinstance(given.get(name), list):
            cure = "give one number for the members of groups that do not"
            raise table[name].error(f"is a list, and groups define it, too: {cure}")
        count = len(given["bars" if name in BARS else "strings"])
        given[name] = np.full(count, given.get(name, _OTHERS[name]))
        for indices, _, value in parts:
            given[name][indices.start : indices.stop] = value
    return _build(Structure.from_fields, given, item, table, groups)


def _find_names(given: Mapping[str, Any]) -> Names:
    parts: tuple[ItemKind, ...] = ("node", "bar", "string")
    counts = {which: len(given.get(f"{which}s", ())) for which in parts}
    return find_names(counts, {which: given.get(f"{which}_names", ()) for which in parts})


def _read_options(own: Definition, table: Mapping[str, Item], names: Names) -> dict[str, Any]:
    named = {key: entry._replace(names=names) for key, entry in table.items() if key in OPTIONS}
    return own.read_fields(named)


def _build(
    build: Callable[..., Structure],
    given: dict[str, Any],
    item: Item,
    table: Mapping[str, Item],
    groups: Groups,
) -> Structure:
    """Build a structure, set its rest lengths, and move it into place.

    `build` is called with the arguments `given`. `table` contains the entries of the file's table
    `item`, and `groups` those of member groups by property. Raises SceneFileError.
    """

    def make(function: Callable[..., Structure], **fields: Any) -> Structure:
        try:
            return function(**fields)
        except (TypeError, ValueError) as error:
            found = re.match(r"(\w+) of (bar|string) (\d+) ", str(error))
            for indices, entry, _ in groups.get(found[1], []) if found else []:
                if found and int(found[3]) in indices:
                    raise entry.error(str(error)) from error
            return call(function, item, table, fields)  # type: ignore[no-any-return]

    later = {
        name: given.pop(name, None) for name in ("rest_length", "force_density", "turn", "move")
    }
    structure = make(build, **given)
    lengths, forces = np.full((2, len(structure.strings)), np.nan)
    for name, values in {"rest_length": lengths, "force_density": forces}.items():
        value = later[name]
        if isinstance(value, list) and len(value) != len(values):
            cure = f"give one number, or one for each of the {len(values)} strings"
            raise table[name].error(f"has {len(value)} entries: {cure}")
        values[:] = np.nan if value is None else value
    both = ~np.isnan(lengths) & ~np.isnan(forces)
    if both.any():
        text = "rest_length and force_density, which define the same: leave one of them out"
        raise item.error(f"gives string {int(np.argmax(both))} {text}")
    if not np.isnan(forces).all():
        stressed = make(structure.prestressed, force_density=np.nan_to_num(forces))
        lengths = np.where(np.isnan(forces), lengths, stressed.rest_length)
        if "bar_rest_length" not in given:
            structure = structure.replace(bar_rest_length=stressed.bar_rest_length)
    if not np.isnan(lengths).all():
        rest_length = np.where(np.isnan(lengths), structure.rest_length, lengths)
        structure = make(structure.replace, rest_length=rest_length)
    if later["turn"] is not None:
        rotation = call(later["turn"].matrix, table["turn"], {}, {})
        structure = make(structure.replace, nodes=structure.nodes @ rotation.T)
    if later["move"] is not None:
        structure = make(structure.replace, nodes=structure.nodes + np.asarray(later["move"]))
    return structure
