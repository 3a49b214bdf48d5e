"""The [structure] of scene files: a shape by its name, or nodes, bars and strings, alone or in groups with their properties."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from tenscasadi.dynamics.serialize import structure_to_arrays
from tenscasadi.io.structure_forms import BARS, OPTIONS, STRINGS, MemberGroups, NodesForm, Turn
from tenscasadi.schema.definitions import Definition, definition
from tenscasadi.schema.forms import (
    Form,
    Schema,
    Schemas,
)
from tenscasadi.schema.reading import Item, Names, NotWritten, Which, call, nearest
from tenscasadi.structure.shapes import Shape
from tenscasadi.structure.structure import PARAMETERS, Structure
from tenscasadi.util.validate import Array

_Groups = Mapping[
    str, tuple[list[list[int]], dict[str, Any]]
]  # members and properties of each group


def _finish(
    structure: Structure,
    item: Item,
    table: Mapping[str, Item],
    groups: Mapping[str, _Groups],
    force_density: Any,
    rest_length: Any,
    turn: Turn | None,
    move: Any,
) -> Structure:
    """Return the structure with the force densities or rest lengths of its strings, turned, then moved. Raises SceneFileError.

    Parameters
    ----------
    force_density : array_like, shape (α,)
        Force density with which strings start, N/m, below their stiffness: it sets their rest
        lengths.
    turn : table
        Rotation of all nodes about an axis through the origin.
    move : sequence of float, shape (3,)
        Displacement of all nodes after that, m.
    """
    count = len(structure.strings)
    lengths, pulls = (
        _per_string(name, value, count, table)
        for name, value in (("rest_length", rest_length), ("force_density", force_density))
    )
    both = ~np.isnan(lengths) & ~np.isnan(pulls)
    if both.any():
        raise item.error(
            f"gives string {int(np.argmax(both))} rest_length and force_density, which say the same: leave one of them out"
        )
    if not np.isnan(pulls).all():
        structure = _build(
            item,
            table,
            groups,
            {"force_density": np.where(np.isnan(pulls), 0.0, pulls)},
            structure.prestressed,
        )
    if not np.isnan(lengths).all():
        rest_lengths = np.where(np.isnan(lengths), structure.rest_length, lengths)
        structure = _build(item, table, groups, {"rest_length": rest_lengths}, structure.replace)
    return _place(structure, turn, move, item, table)


def shapes() -> dict[str, Definition]:
    """Return the definitions of all shapes by name: their own arguments, and those of `Structure`."""
    return {
        name: Definition(
            build, {**definition(build, name).fields, **OPTIONS}, name, more=(Structure, _finish)
        )
        for name, build in Shape.members.items()
    }


def _pins(structure: Structure) -> Any:
    """Return the nodes that are pinned, with axes where some are pinned along some only."""
    return (
        list(structure.pinned)
        if all(axes == "xyz" for axes in structure.pinned.values())
        else structure.pinned
    )


FROM_NODES = Definition(
    Structure,
    {
        "nodes": NodesForm(),
        "bars": MemberGroups("bar", tuple(BARS)),
        "strings": MemberGroups("string", tuple(STRINGS)),
        **OPTIONS,
    },
    "nodes",
    more=(_finish,),
)


@dataclass(frozen=True)
class StructureForm(Form):
    """The table [structure]."""

    def read(self, item: Item, names: Names) -> tuple[Structure, Names]:
        """Return the structure, and what its parts are called."""
        table = item.table()
        if "shape" not in table:
            return _read_nodes(item, table)
        name = table["shape"].text("the name of a shape")
        if "nodes" in table:
            raise table["nodes"].error("stands beside shape: give one of them")
        known = shapes()
        if name not in known:
            raise table["shape"].error(f"is {name!r}: {nearest(name, known)}")
        own = {key: entry for key, entry in table.items() if key != "shape"}
        return _read_shape(known[name], item, own)

    def write(self, value: Any) -> dict[str, Any]:
        """Return nodes, bars and strings. Raises NotWritten where `subdivide` or `from_matrices` made the structure."""
        plain = Structure(**{name: getattr(value, name) for name in PARAMETERS})
        other = structure_to_arrays(plain)
        if any(
            not np.array_equal(array, other[name])
            for name, array in structure_to_arrays(value).items()
        ):
            raise NotWritten(
                "Structure: it has columns or segments that `from_matrices` or `subdivide` made, which files do not hold: "
                "give Scene(segments=...) in place of subdivide, or keep it in Python"
            )
        given = {name: getattr(value, name) for name in PARAMETERS} | {"pinned": _pins(value)}
        written = FROM_NODES.write(given)
        written.pop("rest_length", None)
        if not np.array_equal(value.rest_length, value.string_lengths):
            written["rest_length"] = FROM_NODES.fields["rest_length"].write(value.rest_length)
        return {name: content for name, content in written.items() if content not in ([], {})}

    def schema(self, kinds: Schemas) -> Schema:
        """Return all shapes, and nodes."""
        return {
            "anyOf": [
                *(shape.schema(kinds, "shape", tagged=True) for shape in shapes().values()),
                FROM_NODES.schema(kinds, "shape"),
            ]
        }


STRUCTURE = StructureForm()


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
                *(shape.schema(kinds, "shape", tagged=True) for shape in shapes().values()),
            ]
        }


def _read_shape(own: Definition, item: Item, table: dict[str, Item]) -> tuple[Structure, Names]:
    first = {name: entry for name, entry in table.items() if name not in OPTIONS}
    arguments = own.read_fields(first, Names())
    bare = own.make(
        item, table, {name: value for name, value in arguments.items() if name != "prestress"}
    )
    names = _names_of(own, bare, arguments)
    options = own.read_fields(
        {name: entry for name, entry in table.items() if name in OPTIONS}, names
    )
    for name in ("force_density", "rest_length"):
        if name in options and "prestress" in arguments:
            raise table[name].error(
                "stands beside prestress, which says the same: leave one of them out"
            )
    later = {
        name: options.pop(name, None) for name in ("force_density", "rest_length", "turn", "move")
    }
    structure = own.make(item, table, arguments | options)
    return _finish(structure, item, table, {}, **later), names


def _names_of(own: Definition, structure: Structure, arguments: Mapping[str, Any]) -> Names:
    """Return what parts of a shape are called: rings of prisms and membranes, and the strings between them."""
    counts: dict[Which, int] = {
        "node": len(structure.nodes),
        "bar": len(structure.bars),
        "string": len(structure.strings),
    }
    if own.kind == "prism":
        p = len(structure.bars)
        ends = {"bottom": range(p), "top": range(p, 2 * p)}
        return Names(counts, {"node": ends, "string": {**ends, "vertical": range(2 * p, 3 * p)}})
    if own.kind == "membrane":
        p, q = (arguments.get(name, own.defaults[name]) for name in ("p", "q"))
        ends = {"bottom": range(p), "top": range(p * (q - 1), p * q)}
        return Names(
            counts,
            {
                "node": ends,
                "string": {
                    **ends,
                    "rings": range(p, p * (q - 1)),
                    "helices": range(p * q, counts["string"]),
                },
            },
        )
    return Names(counts)


def _read_nodes(item: Item, table: dict[str, Item]) -> tuple[Structure, Names]:
    for name, entry in table.items():
        if name not in FROM_NODES.fields:
            raise entry.error(
                f"is no field of a structure: {nearest(name, (*FROM_NODES.fields, 'shape'))}"
            )
    if "nodes" not in table:
        raise item.error(
            'has neither nodes nor shape: give nodes = [[0, 0, 0], [0, 0, 1]], or shape = "prism"'
        )
    nodes, node_names = FROM_NODES.fields["nodes"].read(table["nodes"], Names())
    names = Names({"node": len(nodes)}, {"node": node_names})
    groups = {
        part: FROM_NODES.fields[part].read(table[part], names) if part in table else {}
        for part in ("bars", "strings")
    }
    names = _count(names, groups)
    rest = {name: entry for name, entry in table.items() if name not in ("nodes", *groups)}
    given: dict[str, Any] = FROM_NODES.read_fields(rest, names)
    for part, properties in {"bars": BARS, "strings": STRINGS}.items():
        for name in properties:
            value = _gathered(name, groups[part], given.get(name), table)
            if value is not None:
                given[name] = value
    later = {
        name: given.pop(name, None) for name in ("force_density", "rest_length", "turn", "move")
    }
    members = {
        part: [pair for pairs, _ in found.values() for pair in pairs]
        for part, found in groups.items()
    }
    structure = _build(item, table, groups, {"nodes": nodes, **members, **given})
    return _finish(structure, item, table, groups, **later), names


def _build(
    item: Item,
    table: Mapping[str, Item],
    groups: Mapping[str, _Groups],
    given: Mapping[str, Any],
    build: Any = Structure,
) -> Structure:
    """Return build(**given); what is wrong with a member is told with the place of its group. Raises SceneFileError."""
    try:
        return build(**given)  # type: ignore[no-any-return]
    except (TypeError, ValueError) as error:
        found = re.search(r"^(\w+) of (bar|string) (\d+) ", str(error))
        part, index = (f"{found[2]}s", int(found[3])) if found else ("", 0)
        for name, (pairs, properties) in groups.get(part, {}).items():
            if 0 <= index < len(pairs) and found and found[1] in properties:
                raise table[part].child(name).child(found[1]).error(str(error)) from error
            index -= len(pairs)
        return call(build, item, table, given)  # type: ignore[no-any-return]


def _gathered(name: str, groups: _Groups, common: Any, table: Mapping[str, Item]) -> Any:
    """Return a property of all members, NaN where nothing says it; None where no group says it."""
    if not any(name in properties for _, properties in groups.values()):
        return common
    if isinstance(common, list):
        raise table[name].error(
            "is a list, and groups say it, too: give one number for the members of groups that do not"
        )
    fallback: Any = (
        {"rest_length": np.nan, "force_density": np.nan}.get(name, FROM_NODES.defaults.get(name))
        if common is None
        else common
    )
    values = [
        np.broadcast_to(properties.get(name, fallback), (len(pairs),))
        for pairs, properties in groups.values()
    ]
    return np.concatenate(values)


def _per_string(name: str, value: Any, count: int, table: Mapping[str, Item]) -> Array:
    if isinstance(value, list) and len(value) != count:
        raise table[name].error(
            f"has {len(value)} entries: give one number, or one for each of the {count} strings"
        )
    return np.array(np.broadcast_to(np.nan if value is None else value, (count,)), dtype=float)


def _place(
    structure: Structure, turn: Turn | None, move: Any, item: Item, table: Mapping[str, Item]
) -> Structure:
    """Return the structure turned, then moved."""
    nodes = structure.nodes
    if turn is not None:
        nodes = nodes @ call(turn.matrix, table["turn"], {}, {}).T
    if move is not None:
        nodes = nodes + np.asarray(move)
    return (
        structure
        if nodes is structure.nodes
        else call(structure.replace, item, table, {"nodes": nodes})
    )


def _count(names: Names, groups: Mapping[str, _Groups]) -> Names:
    counts, named = dict(names.counts), dict(names.named)
    for which, part in (("bar", "bars"), ("string", "strings")):
        first, found = 0, {}
        for name, (pairs, _) in groups[part].items():
            found[name] = list(range(first, first + len(pairs)))
            first += len(pairs)
        counts[which] = first  # type: ignore[index]
        named[which] = {name: indices for name, indices in found.items() if name}  # type: ignore[index]
    return replace(names, counts=counts, named=named)
