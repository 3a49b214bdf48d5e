"""Names of nodes, bars and strings."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, ParamSpec, TypeVar

from tenscasadi.schema.reading import Names
from tenscasadi.util.validate import as_tuple, format_value, text

P = ParamSpec("P")
R = TypeVar("R")
# members in a message, such as "bar 3" and "nodes 0, 2 and 5", without those named beside them
_INDEXED = re.compile(r"\b(node|bar|string)s? (\d+(?:(?:, | and )\d+)*)(?!\.?\w| \()")
_MEMBER = re.compile(r"(.*)\[\d+\]")  # name of a member of a group, such as "guys[2]"


def read_names(field: str, value: Any, count: int) -> tuple[str, ...]:
    """Read the names of `count` items, "" for unnamed items.

    `value` is a sequence of names for the field `field`. The result is empty if no item has a name.
    Raises TypeError or ValueError, also for duplicate names and names that are numbers.
    """
    names = tuple(text(field, name) for name in as_tuple(field, value, '["foot", "top"]'))
    if names and len(names) != count:
        raise ValueError(f"{field} has {len(names)} entries: give {count}, or none")
    first: dict[str, int] = {}
    for k, name in enumerate(names):
        if name.isascii() and name.isdigit():
            raise ValueError(f"{field}[{k}] is {format_value(name)}, an index, too: give letters")
        if name and first.setdefault(name, k) < k:
            raise ValueError(f"{field}[{k}] is {format_value(name)} again: give unique names")
    return names if any(names) else ()


def names_of(structure: Any, **counts: int) -> Names:
    """Collect the names of a structure's nodes, bars and strings.

    The structure can be incomplete. If it is None, the items have numbers only, as many as
    `counts`.
    """
    if structure is None:
        return Names(counts)  # type: ignore[arg-type]
    parts = ("node", "string", "bar")
    own = {which: len(getattr(structure, f"{which}s", ())) for which in parts}
    return find_names(own, {which: getattr(structure, f"{which}_names", ()) for which in parts})


def name_members(groups: Iterable[tuple[str, int]]) -> list[str]:
    """Name the members of groups, such as "guys[2]".

    Groups have a name and a size.
    """
    return [
        group if size == 1 or not group else f"{group}[{k}]"
        for group, size in groups
        for k in range(size)
    ]


def name_segments(names: Sequence[str], counts: Sequence[int]) -> list[str]:
    """Name the segments of strings, such as "guy[0]".

    `names` are those of the strings, and `counts` their numbers of segments. The result is empty
    without names.
    """
    return name_members(zip(names, counts, strict=True)) if names else []


def extend_names(names: Sequence[str], count: int) -> list[str]:
    """Append unnamed items ("") to names, up to a count.

    The result is empty if there are no names.
    """
    return [*names, *[""] * (count - len(names))] if names else []


def reset_item_fields(structure: Any, changes: dict[str, Any]) -> None:
    """Reset names of items, and cable friction, if the number changes.

    `changes` are new field values of the structure by name. Defaults are added to them in place.
    """
    for part, field, default in (
        ("nodes", "node_names", ()),
        ("strings", "string_names", ()),
        ("bars", "bar_names", ()),
        *([] if structure.cable_friction.any() else [("cables", "cable_friction", 0.0)]),
    ):
        own = getattr(structure, part)
        with suppress(TypeError):  # what is no list is rejected later
            if len(changes.get(part, own)) != len(own):
                changes.setdefault(field, default)


def label(names: Sequence[str], index: int) -> str:
    """Return the name of an item, or its index.

    `names` are those of all items, or empty.
    """
    return (names[index] if names else "") or str(index)


def find_named(text: str, structure: Any) -> dict[str, str]:
    """Find the names of members that a message mentions by index.

    `text` is the message. An example of the result is {"string 3": "guy"}.
    """
    found = {}
    for match in _INDEXED.finditer(text):
        names = getattr(structure, f"{match[1]}_names", ())  # of a structure in construction, too
        for index in map(int, re.findall(r"\d+", match[2])):
            if index < len(names) and names[index]:
                found[f"{match[1]} {index}"] = names[index]
    return found


def add_names(text: str, structure: Any) -> str:
    """Append the names of members to a message that has indices only.

    The `text` "string 3 is slack" becomes "string 3 is slack (string 3: guy)" if that string is
    called "guy".
    """
    named = [f"{member}: {name}" for member, name in find_named(text, structure).items()]
    missing = ", ".join(part for part in named if part not in text)
    return f"{text} ({missing})" if missing else text


def name_errors(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that its errors contain member names.

    They are those of the first argument that is a structure, or has one, such as a scene or model.
    Strings have their indices before they are divided into segments.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except (TypeError, ValueError) as error:
            found = (_find_structure(value) for value in (*args, *kwargs.values()))
            structure = next((one for one in found if one is not None), None)
            if error.args and isinstance(error.args[0], str):
                error.args = (add_names(error.args[0], structure), *error.args[1:])
            raise

    return call


def _find_structure(owner: Any, depth: int = 3) -> Any:
    """Find the structure of an object; None without one.

    It can be the `owner` itself, or an attribute such as its model, scene or structure, up to
    `depth` levels below.
    """
    own = getattr(owner, "__dict__", {})
    if "node_names" in own or not depth:
        return owner if "node_names" in own else None
    parts = (own[name] for name in ("scene", "structure", "model", "source") if name in own)
    found = (_find_structure(part, depth - 1) for part in parts)
    return next((one for one in found if one is not None), None)


def find_names(counts: Mapping[Any, int], names: Mapping[Any, Sequence[str]]) -> Names:
    """Find the indices of items by their names and group names.

    `counts` has the number of items of each kind, such as "node", and `names` their names. Names
    such as "guys[2]" belong to the group "guys". The segment "guys[2][0]" of a string belongs to
    the groups "guys[2]" and "guys".
    """
    found: dict[Any, dict[str, list[int]]] = {}
    for which, own in names.items():
        table = found.setdefault(which, {})
        for k, name in enumerate(own):
            if name:
                table[name] = [k]
            group = name
            while found_group := _MEMBER.fullmatch(group):
                group = found_group[1]
                table.setdefault(group, []).append(k)
    strings, bars = (counts.get(which, 0) for which in ("string", "bar"))
    members = {name: list(own) for name, own in found.get("string", {}).items()}
    for name, indices in found.get("bar", {}).items():
        members.setdefault(name, []).extend(strings + k for k in indices)
    return Names({**counts, "member": strings + bars}, {**found, "member": members})
