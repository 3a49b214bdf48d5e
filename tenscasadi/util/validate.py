"""Checks of arguments that return a converted value or raise.

All functions raise TypeError or ValueError. The message has the field, the value and the cure. In
the functions, `field` is the name of the argument that has the value, `item` the kind of an entry,
such as "bar", and `example` a valid value.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from numbers import Real
from pathlib import Path
from typing import Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Booleans = NDArray[np.bool_]
FilePath = str | os.PathLike[str]
IndexOrName = Any  # int or str in fields, which hold indices in a scene, and in invariant keys

LARGEST = 1e100  # largest input in size: its square does not overflow
SMALLEST = 1 / LARGEST  # smallest positive input: a division by it does not overflow
MAX_REPETITIONS = 1000  # of a part of a computation, such as starts, updates or hoops
MAX_ITERATIONS = 200  # of a method that settles in far fewer
MAX_COUNT = 100_000  # nodes, members, intervals or elements of a file; more would need hours
MAX_ENTRIES = 1_000_000  # samples, runs or values of a file; more would exhaust the memory
MAX_BYTES = 1_000_000_000  # of one array or unpacked file; more would exhaust the memory
ROUNDING = 1e-12  # relative rounding error of a few operations
TOLERANCE = 1e-6  # relative: accepted errors of given values, and of solutions of programs
FILE_ROUNDING = 1e-5  # relative: smaller differences come from rounding numbers in files
NEGLIGIBLE = 1e-9  # relative: smaller values and differences of computed results count as zero


def finite_array(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Convert a value to a finite read-only array of given shape.

    None in `shape` stands for any size. A CasADi column is also a vector. Messages name `field`.
    """
    array = real_array(
        field,
        value,
        _describe_shape(shape),
        "an array of real numbers" if shape else "a real number",
    )
    if isinstance(value, ca.DM) and value.is_column() and len(shape) == 1:
        array = array.ravel()
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"{field} has shape {array.shape}: give {_describe_shape(shape)}")
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
    """Convert a value to a new array of any shape.

    It may contain NaN and inf. Messages name `field`; they say that the value is not of this
    `kind`, and that `wanted` should be given.
    """
    try:
        source = np.asarray(value)
        if source.dtype.kind not in "iufO" or (
            source.dtype.kind == "O" and not all(isinstance(item, Real) for item in source.flat)
        ):  # NumPy would convert "1", True and None
            raise TypeError(f"got {type(value).__name__} of {source.dtype}")
        array = np.array(source, dtype=float)
    except Exception as error:  # an object's own __array__ may raise anything
        raise TypeError(f"{field} is not {kind} ({error}): give {wanted}") from error
    if np.ma.is_masked(value):  # NumPy would take the numbers under the mask
        raise ValueError(f"{field} has masked entries: fill or remove them")
    return array


def rows_of_size(field: str, value: Any, size: int, item: str) -> Array:
    """Convert a value to an array of shape (..., size).

    It may contain NaN and inf. Messages name `field` and the kind of `item` that is wanted, such as
    "states".
    """
    wanted = f"{item} of shape (..., {size})"
    array = real_array(field, value, wanted)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f"{field} has shape {array.shape}: give {wanted}")
    return array


def nesting(value: Any) -> int:
    """Return the number of array dimensions of a value.

    It is 1 for objects that are no arrays.
    """
    with suppress(Exception):  # an object's own __array__ may raise anything
        return np.ndim(value)
    return 1


def as_tuple(field: str, value: Any, example: str) -> tuple[Any, ...]:
    """Convert an iterable other than text to a tuple.

    Messages name `field`, and show `example`, a valid value.
    """
    if not isinstance(value, (str, bytes)):
        with suppress(Exception):  # each kind of matrix raises its own error
            return tuple(value)
    raise TypeError(f"{field} is {format_value(value)}: give a list, such as {example}")


def choice(field: str, value: Any, *options: str) -> Any:
    """Check that a value is one of the given words.

    They are `options`. Returns the value. Messages name `field`.
    """
    if not isinstance(value, str) or value not in options:
        raise ValueError(
            f"{field} is {format_value(value)}: give {' or '.join(repr(option) for option in options)}"
        )
    return value


def flag(field: str, value: Any) -> bool:
    """Check that a value is True or False, and return it.

    Messages name `field`.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{field} is {format_value(value)}: give True or False")
    return bool(value)


def text(field: str, value: Any) -> str:
    """Check that a value is text, and return it.

    Messages name `field`.
    """
    instance(field, value, str, "text")
    return str(value)


def file_path(field: str, value: Any) -> Path:
    """Convert a value to a path.

    Messages name `field`.
    """
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise TypeError(
            f"{field} is {format_value(value)}: give a file or folder as text or pathlib.Path"
        )
    if "\0" in os.fspath(value):
        raise ValueError(f"{field} is {format_value(value)}: give a name without null characters")
    return Path(value)


def number(field: str, value: Any) -> float:
    """Convert a value to a finite float.

    Messages name `field`.
    """
    return float(finite_array(field, value, ()))


def number_or_vector(field: str, value: Any) -> Array:
    """Convert a value to a finite number or vector.

    The result is an array. Messages name `field`.
    """
    if nesting(value):
        return finite_array(field, value, (None,))
    try:
        return finite_array(field, value, ())
    except TypeError as error:  # such as a mapping by name
        raise TypeError(f"{error}, or a list of numbers") from None


def coordinates(
    field: str, place: Any, none: str, some: bool = False, read: Callable[[str, Any], Any] = number
) -> tuple[Any, ...]:
    """Convert `place` to (x, y, z), where entries may be None.

    `read` converts the other entries. If `some`, at least one entry must be given. Messages name
    `field`, and explain None by `none`.
    """
    try:
        entries = tuple(place.full().ravel() if isinstance(place, ca.DM) else place)
    except Exception as error:  # each kind of matrix raises its own error
        raise TypeError(
            f"{field} is {format_value(place)}: give (x, y, z), None for {none}"
        ) from error
    if len(entries) != 3 or (some and all(entry is None for entry in entries)):
        raise ValueError(
            f"{field} is {format_value(entries)}: give three coordinates, None for {none}"
        )
    return tuple(None if entry is None else read(field, entry) for entry in entries)


def per_item(field: str, value: Any, count: int) -> Array:
    """Broadcast a value to an array (count,).

    It is one number, or such an array. Messages name `field`.
    """
    if not isinstance(value, Real) and not (isinstance(value, np.ndarray) and value.ndim == 0):
        return finite_array(field, value, (count,))
    array = np.full(count, number(field, value))
    array.flags.writeable = False
    return array


def nonnegative(field: str, array: Array, item: str, strict: bool = False) -> Array:
    """Check that entries are nonnegative, or positive if `strict`.

    Returns the array. Messages name `field` and the `item` that an entry belongs to.
    """
    bad = np.flatnonzero(array < (SMALLEST if strict else 0.0))
    if bad.size:
        relation = "greater than" if strict else "at least"
        raise ValueError(
            f"{field} of {item} {bad[0]} is {array.flat[bad[0]]:g}: it must be {relation} 0"
        )
    return array


def replace_inf(value: Any) -> Any:
    """Replace inf by 1 in limits, to check the others.

    `value` is a number or an array; other values are returned unchanged.
    """
    with suppress(Exception):  # values that are not arrays are rejected later, by field
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and not np.ma.is_masked(value):
            return np.where(np.isposinf(array), 1.0, array)
    return value


def positive_number(field: str, value: Any, zero: bool = False) -> float:
    """Convert a value to a positive float.

    It can be 0 if `zero`. Messages name `field`.
    """
    found = number(field, value)
    if found < SMALLEST and not (zero and found >= 0.0):
        raise ValueError(
            f"{field} is {found:g}: it must be {'at least' if zero else 'greater than'} 0"
        )
    return found


def whole_number(field: str, value: Any, minimum: int, maximum: int = 2**31 - 1) -> int:
    """Convert a value to an int from `minimum` to `maximum`.

    Booleans and fractions are rejected. Messages name `field`.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{field} is {format_value(value)}: give a whole number")
    if value < minimum:
        raise ValueError(f"{field} is {format_value(value)}: it must be at least {minimum}")
    if value > maximum:
        raise ValueError(f"{field} is {float(min(value, 10**300)):g}: it must be at most {maximum}")
    return int(value)


def node_index(field: str, value: Any, count: int, item: str = "node") -> int:
    """Convert a value to an index of `count` items.

    Messages name `field` and the kind of `item`.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{field} is {format_value(value)}: give a {item} index, a whole number")
    if not 0 <= value < count:
        cure = f"{item} indices run from 0 to {count - 1}" if count else f"there are no {item}s"
        raise ValueError(f"{field} is {format_value(value)}: {cure}")
    return int(value)


def check_indices(field: str, values: Iterable[Any], count: int, item: str = "node") -> None:
    """Check that the entries of a list are indices of `count` items.

    The list is `values`. Messages name `field` and the kind of `item`.
    """
    for k, value in enumerate(values):
        node_index(f"{field}[{k}]", value, count, item)


def index_or_name(field: str, value: Any) -> Any:
    """Check that a value is an index or a name.

    An index is at least 0. Returns the value. A structure replaces the name by its index later.
    Messages name `field`.
    """
    return str(value) if isinstance(value, str) else whole_number(field, value, 0)


def node_pairs(
    field: str, value: Iterable[Sequence[int]], count: int, item: str, parallel: bool = False
) -> Indices:
    """Convert bars or strings to an array (items, 2) of node indices.

    `value` are pairs of indices of `count` nodes. The ends differ. Two members join the same nodes
    only if `parallel`. Messages name `field` and the kind of `item`, "bar" or "string".
    """
    if _are_node_pairs(value, count, parallel):
        pairs = np.array(value, dtype=np.intp)
        pairs.flags.writeable = False
        return pairs
    try:
        rows = [tuple(row) for row in value]
    except Exception as error:  # each kind of matrix raises its own error
        raise TypeError(
            f"{field} is {format_value(value)}: give node pairs, such as [(0, 1), (1, 2)]"
        ) from error
    seen: dict[tuple[int, int], int] = {}
    pairs = np.empty((len(rows), 2), dtype=np.intp)
    for k, row in enumerate(rows):
        if len(row) != 2:
            raise ValueError(
                f"{field}[{k}] is {format_value(row)}: give the two nodes of {item} {k}"
            )
        a, b = (node_index(f"{field}[{k}]", end, count) for end in row)
        if a == b:
            raise ValueError(
                f"{field}: {item} {k} joins node {a} to itself: give two different nodes"
            )
        key = (min(a, b), max(a, b))
        if key in seen and not parallel:
            raise ValueError(
                f"{field}: {item}s {seen[key]} and {k} join the same nodes {a} and {b}: remove one"
            )
        seen[key] = k
        pairs[k] = a, b
    pairs.flags.writeable = False
    return pairs


def _are_node_pairs(value: Any, count: int, parallel: bool) -> bool:
    """Return whether an array of integers contains valid node pairs.

    For the arguments see `node_pairs`. Otherwise a slower loop over the items finds the error.
    """
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iu":
        return False
    if value.ndim != 2 or value.shape[1] != 2 or np.any((value < 0) | (value >= count)):
        return False
    ends = np.sort(value, axis=1).astype(np.intp)
    keys = ends[:, 0] * count + ends[:, 1]
    return not np.any(ends[:, 0] == ends[:, 1]) and (parallel or len(np.unique(keys)) == len(keys))


def instance(field: str, value: Any, kinds: type | tuple[type, ...], example: str) -> Any:
    """Check that a value is of one of given types.

    They are `kinds`. Returns the value. Messages name `field`, and show the example.
    """
    if not isinstance(value, kinds):
        raise TypeError(f"{field} is {format_value(value)}: give {example}")
    return value


def call_user_function(field: str, function: Callable[[Any], Any], argument: Any, hint: str) -> Any:
    """Call a user's function of one argument, and convert its exceptions.

    Any exception becomes a ValueError that names `field` and ends with the hint.
    """
    try:
        return function(argument)
    except Exception as error:
        last = (str(error).strip().splitlines() or [""])[-1]
        fault = re.sub(r"^\S+:\d+: ", "", last)  # without CasADi's own file and line
        cure = hint
        if "truth value" in fault:
            cure = "replace Python's if, max, and, or by casadi.if_else(condition, a, b)"
        raise ValueError(
            f"{field} fails with {type(error).__name__}: {fault.rstrip('.')}: {cure}"
        ) from error


def format_value(value: Any) -> str:
    """Format a value for a message.

    This is its repr, cut after 300 characters, or its type if the repr fails.
    """
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001  an object's own repr may raise anything
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= 300 else f"{text[:300]} …"


def _describe_shape(shape: tuple[int | None, ...]) -> str:
    if not shape:
        return "one number"
    sizes = ", ".join("any" if size is None else str(size) for size in shape)
    return f"an array of shape ({sizes}{',' if len(shape) == 1 else ''})"


@dataclass(frozen=True)
class Check:
    """Check of a field, given in its annotation.

    `check` takes name and value of the field, and returns a converted value or raises.
    """

    check: Callable[[str, Any], Any]


Positive = Annotated[float, Check(positive_number)]
NonNegative = Annotated[float, Check(partial(positive_number, zero=True))]


def whole(minimum: int, maximum: int = 2**31 - 1) -> Check:
    """Build the check that a field is a whole number in a range.

    The range is from `minimum` to `maximum`.
    """
    return Check(partial(whole_number, minimum=minimum, maximum=maximum))


def of_type(kinds: Any, example: str) -> Check:
    """Build the check that a field has a given type.

    It must be one of `kinds`. For `example` see `instance`.
    """
    return Check(partial(instance, kinds=kinds, example=example))


def one_of(*options: str) -> Check:
    """Build the check that a field is one of the given words."""
    return Check(lambda field, value: choice(field, value, *options))


Count = Annotated[int, whole(1)]
Number = Annotated[float, Check(number)]
Boolean = Annotated[bool, Check(flag)]


def positive_each(item: str, zero: bool = False, infinite: bool = False) -> Check:
    """Build the check that a field is positive.

    It is one number or one for each item. Numbers can be 0 if `zero`, and infinite if `infinite`.
    The value is not converted.
    """

    def check(field: str, value: Any) -> Any:
        finite = number_or_vector(field, replace_inf(value) if infinite else value)
        nonnegative(field, finite, item, strict=not zero)
        return value

    return Check(check)
