"""Checks of input: each returns a clean value or raises an error that names the field, the value and the cure."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from numbers import Real
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# squares and products of input must not overflow; no SI quantity of a structure comes near
LARGEST = 1e100
MOST_SHOWN = 300  # characters of a value in a message
SMALLEST = 1e-100  # what must be greater than 0 is at least this: divisions by it must not overflow


def finite_array(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a read-only float array of `shape` (None: any size); columns of CasADi's are vectors. Raises TypeError, ValueError."""
    array = real_array(
        field, value, _wanted(shape), "an array of real numbers" if shape else "a real number"
    )
    if isinstance(value, ca.DM) and value.is_column() and len(shape) == 1:
        array = array.ravel()
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"{field} has shape {array.shape}: give {_wanted(shape)}")
    bad = np.argwhere(~(np.abs(array) <= LARGEST))
    if len(bad):
        place = tuple(int(i) for i in bad[0])
        where = f"[{', '.join(map(str, place))}]" if place else ""
        raise ValueError(
            f"{field}{where} is {array[place]}: give finite numbers, at most {LARGEST:g} in size"
        )
    array.flags.writeable = False
    return array


def real_array(
    field: str, value: Any, wanted: str, kind: str = "an array of real numbers"
) -> Array:
    """Return `value` as a new float array of any shape, not checked for NaN and inf; `wanted` is the cure. Raises TypeError, ValueError."""
    try:
        source = np.asarray(value)
        if source.dtype.kind not in "iufO" or (
            source.dtype.kind == "O" and not all(isinstance(item, Real) for item in source.flat)
        ):
            raise TypeError(
                f"got {type(value).__name__} of {source.dtype}"
            )  # NumPy would read "1", True and None as numbers
        array = np.array(source, dtype=float)
    except Exception as error:  # an object's own __array__ may raise anything
        raise TypeError(f"{field} is not {kind} ({error}): give {wanted}") from error
    if np.ma.is_masked(value):
        raise ValueError(
            f"{field} has masked entries: fill them or leave them out"
        )  # NumPy would take what is under the mask
    return array


def rows_of_size(field: str, value: Any, size: int, item: str) -> Array:
    """Return `value` as a new float array of shape (..., size), not checked for NaN and inf. Raises TypeError, ValueError."""
    wanted = f"{item} of shape (..., {size})"
    array = real_array(field, value, wanted)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f"{field} has shape {array.shape}: give {wanted}")
    return array


def nesting(value: Any) -> int:
    """Tell how deep `value` is nested: 0 for a number, 1 for a list; 1 also for what is no array, which array checks then refuse by name."""
    with suppress(Exception):  # an object's own __array__ may raise anything
        return np.ndim(value)
    return 1


def as_tuple(field: str, value: Any, example: str) -> tuple[Any, ...]:
    """Return the items of `value` as a tuple; TypeError where it is no list of any kind, as text is none. `example` shows a right one."""
    if not isinstance(value, (str, bytes)):
        with suppress(
            Exception
        ):  # CasADi's and SciPy's matrices, arrays of no dimension: each refuses in its own way
            return tuple(value)
    raise TypeError(f"{field} is {format_value(value)}: give a list, such as {example}")


def choice(field: str, value: Any, *options: str) -> None:
    """Raise ValueError unless `value` is one of these words."""
    if not isinstance(value, str) or value not in options:
        raise ValueError(
            f"{field} is {format_value(value)}: give {' or '.join(repr(option) for option in options)}"
        )


def flag(field: str, value: Any) -> None:
    """Raise TypeError unless `value` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{field} is {format_value(value)}: give True or False")


def text(field: str, value: Any) -> str:
    """Return `value` where it is text. Raises TypeError."""
    instance(field, value, str, "text")
    return str(value)


def file_path(field: str, value: Any) -> Path:
    """Return `value` as a path. Raises TypeError, ValueError."""
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise TypeError(
            f"{field} is {format_value(value)}: give the name of a file or folder, as text or a pathlib.Path"
        )
    if "\0" in os.fspath(value):
        raise ValueError(f"{field} is {format_value(value)}: give a name without null characters")
    return Path(value)


def number(field: str, value: Any) -> float:
    """Return `value` as a finite float. Raises TypeError, ValueError."""
    return float(finite_array(field, value, ()))


def number_or_vector(field: str, value: Any) -> Array:
    """Return `value` as a finite array of shape (), for one number, or (any,). Raises TypeError, ValueError."""
    return finite_array(field, value, (None,) if nesting(value) else ())


def coordinates(
    field: str, place: Any, none: str, some: bool = False, read: Callable[[str, Any], Any] = number
) -> tuple[Any, ...]:
    """Return `place` (x, y, z) as three of what `read` makes of an entry, or None, which says `none`; `some`: all three None are refused.

    Raises TypeError, ValueError.
    """
    try:
        entries = tuple(place.full().ravel() if isinstance(place, ca.DM) else place)
    except Exception as error:  # each kind of matrix refuses in its own way
        raise TypeError(
            f"{field} is {format_value(place)}: give (x, y, z), None for {none}"
        ) from error
    if len(entries) != 3 or (some and all(entry is None for entry in entries)):
        raise ValueError(
            f"{field} is {format_value(entries)}: give three coordinates, None for {none}"
        )
    return tuple(None if entry is None else read(field, entry) for entry in entries)


def per_item(field: str, value: Any, count: int) -> Array:
    """Return `value` broadcast to one number for each of `count` items. Raises TypeError, ValueError."""
    if not isinstance(value, Real) and not (isinstance(value, np.ndarray) and value.ndim == 0):
        return finite_array(field, value, (count,))
    array = np.full(count, number(field, value))
    array.flags.writeable = False
    return array


def nonnegative(field: str, array: Array, item: str, strict: bool = False) -> Array:
    """Return `array` unchanged when every entry is ≥ 0 (> 0 when strict); ValueError names the first item that is not."""
    bad = np.flatnonzero(array < (SMALLEST if strict else 0.0))
    if bad.size:
        relation = "greater than" if strict else "at least"
        raise ValueError(
            f"{field} of {item} {bad[0]} is {array.flat[bad[0]]:g}: it must be {relation} 0"
        )
    return array


def positive_number(field: str, value: Any, zero: bool = False) -> float:
    """Return `value` as a finite float > 0 (≥ 0 when `zero`). Raises TypeError, ValueError."""
    found = number(field, value)
    if found < SMALLEST and not (zero and found >= 0.0):
        raise ValueError(
            f"{field} is {found:g}: it must be {'at least' if zero else 'greater than'} 0"
        )
    return found


def whole_number(field: str, value: Any, minimum: int, maximum: int = 2**31 - 1) -> int:
    """Return `value` as an int from `minimum` to `maximum`; booleans and fractions are refused. Raises TypeError, ValueError."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{field} is {format_value(value)}: give a whole number")
    if value < minimum:
        raise ValueError(f"{field} is {format_value(value)}: it must be at least {minimum}")
    if value > maximum:
        raise ValueError(f"{field} is {float(min(value, 10**300)):g}: it must be at most {maximum}")
    return int(value)


def node_index(field: str, value: Any, count: int, item: str = "node") -> int:
    """Return `value` as an index of one of `count` nodes, or other items, zero-based. Raises TypeError, ValueError."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{field} is {format_value(value)}: give a {item} index, a whole number")
    if not 0 <= value < count:
        raise ValueError(
            f"{field} is {format_value(value)}: {item} indices run from 0 to {count - 1}"
        )
    return int(value)


def node_pairs(
    field: str, value: Iterable[Sequence[int]], count: int, item: str, parallel: bool = False
) -> Indices:
    """Return members as an (items, 2) index array: in range, no member from a node to itself, none `parallel` to another unless they may be."""
    try:
        rows = [tuple(row) for row in value]
    except Exception as error:  # each kind of matrix refuses in its own way
        raise TypeError(
            f"{field} is {format_value(value)}: give a sequence of node pairs, such as [(0, 1), (1, 2)]"
        ) from error
    seen: dict[tuple[int, int], int] = {}
    pairs = np.empty((len(rows), 2), dtype=np.intp)
    for k, row in enumerate(rows):
        if len(row) != 2:
            raise ValueError(
                f"{field}[{k}] is {format_value(row)}: {item} {k} joins two nodes, give a pair"
            )
        a, b = (node_index(f"{field}[{k}]", end, count) for end in row)
        if a == b:
            raise ValueError(
                f"{field}: {item} {k} joins node {a} to itself: give two different nodes"
            )
        key = (min(a, b), max(a, b))
        if key in seen and not parallel:
            raise ValueError(
                f"{field}: {item} {k} joins nodes {a} and {b} as {item} {seen[key]} does: leave one out"
            )
        seen[key] = k
        pairs[k] = a, b
    pairs.flags.writeable = False
    return pairs


def format_value(value: Any) -> str:
    """Return `value` as messages show it: its repr, cut where it is long; its type where it has none, such as a number of 5000 digits."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001  an object's own repr may raise anything
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]} …"


def item_mask(field: str, value: Any, count: int, item: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which of `count` items a list of indices names. Raises TypeError, ValueError."""
    found = np.zeros(count, dtype=bool)
    for k, index in enumerate(as_tuple(field, value, f"[0, 3] of {item} indices")):
        found[node_index(f"{field}[{k}]", index, count, item)] = True
    return found


def instance(field: str, value: Any, kinds: type | tuple[type, ...], example: str) -> None:
    """Raise TypeError unless `value` is one of `kinds`; `example` shows a right one."""
    if not isinstance(value, kinds):
        raise TypeError(f"{field} is {format_value(value)}: give {example}")


def call_user_function(field: str, function: Callable[[Any], Any], argument: Any, hint: str) -> Any:
    """Return function(argument) of a user's function; whatever it raises becomes a ValueError that names the field and ends with a hint."""
    try:
        return function(argument)
    except Exception as error:
        fault = re.sub(
            r"^\S+:\d+: ", "", (str(error).strip().splitlines() or [""])[-1]
        )  # CasADi begins with its own files and lines
        cure = (
            "give casadi.if_else(condition, a, b) in place of Python's if, max, and, or"
            if "truth value" in fault
            else hint
        )
        raise ValueError(
            f"{field} fails with {type(error).__name__}: {fault.rstrip('.')}: {cure}"
        ) from error


def _wanted(shape: tuple[int | None, ...]) -> str:
    if not shape:
        return "one number"
    return (
        "an array of shape ("
        + ", ".join("any" if size is None else str(size) for size in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
