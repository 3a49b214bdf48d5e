"""Validation of arguments shared by problems and phases."""

from __future__ import annotations

from typing import Any

from tenscasadi.schema.definitions import resolve_names
from tenscasadi.schema.reading import Names
from tenscasadi.util.validate import (
    IndexOrName,
    as_tuple,
    finite_array,
    index_or_name,
    instance,
    nesting,
    positive_number,
)

Duration = float | tuple[float, float]


def read_items(
    field: str, values: Any, kinds: type, example: str, names: Names | None = None
) -> tuple[Any, ...]:
    """Read a tuple of objects of one class.

    ``values`` is the argument ``field``, ``kinds`` the class, and ``example`` the cure in error
    messages. Names of nodes, bars and strings are replaced by indices if `names` are given. Raises
    TypeError, ValueError.
    """
    found = as_tuple(field, values, example)
    for k, value in enumerate(found):
        instance(
            f"{field}[{k}]", value, kinds, f"a {kinds.__name__.lower()}, such as {example[1:-1]}"
        )
    return found if names is None else tuple(resolve_names(value, names) for value in found)


def read_duration(field: str, value: Any) -> Duration:
    """Read a fixed duration [s], or limits (shortest, longest).

    ``value`` is the argument ``field``. Raises TypeError, ValueError.
    """
    if nesting(value) == 0:
        return positive_number(field, value)
    pair = finite_array(field, value, (2,))
    shortest = positive_number(f"{field}[0]", pair[0])
    if pair[1] < shortest:
        raise ValueError(f"{field} is ({shortest:g}, {pair[1]:g}): give (shortest, longest)")
    return shortest if pair[1] == shortest else (shortest, float(pair[1]))


def read_groups(
    field: str, value: Any, strict: bool = False
) -> tuple[tuple[IndexOrName, ...], ...]:
    """Read groups of strings that share one control value.

    ``value`` is the argument ``field``. A string is in one group at most. Empty groups are removed,
    or rejected if `strict`, as are no groups. Raises TypeError, ValueError.
    """
    example = "((0, 1, 2), (3, 4, 5))"
    groups = tuple(
        as_tuple(f"{field}[{k}]", group, "(0, 1, 2)")
        for k, group in enumerate(as_tuple(field, value, example))
    )
    seen: set[int | str] = set()
    for k, group in enumerate(groups):
        for string in group:
            if index_or_name(f"{field}[{k}]", string) in seen:
                raise ValueError(f"{field} has string {string} twice: give each string once")
            seen.add(string)
    if strict and not (groups and all(groups)):
        raise ValueError(
            f"{field} is {groups}: give strings to each group, such as {example}, or None"
        )
    return tuple(group for group in groups if group)


def limits_of(duration: Duration) -> tuple[float, float]:
    """Return the shortest and the longest duration [s]."""
    return duration if isinstance(duration, tuple) else (duration, duration)
