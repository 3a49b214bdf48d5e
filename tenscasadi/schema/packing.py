"""Values as JSON text and arrays, of registered kinds alone, never code."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, get_type_hints

import numpy as np

from tenscasadi.schema.field_types import InPython, names_file
from tenscasadi.schema.value import Value
from tenscasadi.util.archive import Fields

ENTRY = "packed"  # name of the text; its arrays are "packed.0", "packed.1", …
_DAMAGED = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


class NotStored(Exception):
    """A value that no file holds; the message tells which."""


class _Packer:
    """Converter of values; one that occurs twice is packed once."""

    def __init__(self, aliases: Mapping[int, Any]) -> None:
        self._aliases = aliases
        self._known: dict[int, int] = {}  # number of each packed value, by its id
        self.arrays: list[Any] = []

    def pack(self, value: Any, name: str) -> Any:
        """Convert a value to JSON. Raises NotStored, naming the field."""
        value = self._aliases.get(id(value), value)
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, np.ndarray) and value.dtype.kind in "bifU":
            self.arrays.append(value)
            return {"array": len(self.arrays) - 1}
        if isinstance(value, (list, tuple)):
            items = [self.pack(item, f"{name}[{k}]") for k, item in enumerate(value)]
            return {"tuple" if isinstance(value, tuple) else "list": items}
        if isinstance(value, Mapping):
            names = [f"{name}.{key}" if isinstance(key, str) else f"{name}[{key}]" for key in value]
            pairs = zip(value.items(), names, strict=True)
            return {"mapping": [[self.pack(k, name), self.pack(v, own)] for (k, v), own in pairs]}
        kind = find_kind(type(value))
        if kind and id(value) in self._known:
            return {"same": self._known[id(value)]}
        if kind:
            own, left = value.to_fields(), _find_python_fields(type(value))
            fields = {
                field: self.pack(content, f"{name}.{field}")
                for field, content in own.items()
                if field not in left
            }
            self._known[id(value)] = len(self._known)
            return {"class": kind, "fields": fields}
        function = callable(value) and not isinstance(value, type)
        state = "a function" if function else f"of an own class, {type(value).__name__}"
        raise NotStored(f"{name} is {state}, which no file holds")


def pack(values: Mapping[str, Any], aliases: Mapping[int, Any]) -> dict[str, Any]:
    """Convert values to entries of a file.

    Values that cannot be stored are replaced by the reason. `aliases` are values that take the
    place of others, by the ids of these.
    """
    packer = _Packer(aliases)
    trees: dict[str, Any] = {}
    for name, value in values.items():
        known = packer._known.copy()
        try:
            trees[name] = packer.pack(value, name.capitalize())
        except NotStored as error:
            trees[name], packer._known = {"unknown": str(error)}, known
    arrays = {f"{ENTRY}.{k}": array for k, array in enumerate(packer.arrays)}
    return {ENTRY: np.asarray(json.dumps(trees)), **arrays}


def unpack(content: Fields) -> dict[str, Any]:
    """Restore the values of `pack`.

    NotStored takes the place of a value that the file does not hold, ValueError of a damaged one.
    """
    try:
        trees = json.loads(str(content.array(ENTRY, "U", 0)))
        items = list(trees.items())
    except _DAMAGED as error:
        raise ValueError(f"field {ENTRY!r} holds no values ({error})") from None
    arrays, known = content.within(f"{ENTRY}."), list[Any]()
    found: dict[str, Any] = {}
    for name, tree in items:
        try:
            found[name] = _unpack(tree, arrays, known)
        except NotStored as error:
            found[name] = error
        except _DAMAGED as error:
            found[name] = ValueError(str(error))
    return found


def _unpack(tree: Any, arrays: Fields, known: list[Any]) -> Any:
    if not isinstance(tree, dict):
        return tree
    ((form, content), *more) = tree.items()
    if form == "unknown":
        raise NotStored(content)
    if form == "same":
        return known[content]
    if form == "array" and not more:
        return arrays[str(content)]
    if form == "array":  # of a plan of version 0.1
        types: dict[str, Any] = {"b": bool, "i": np.intp, "f": float}
        return np.array(content, dtype=types[tree["kind"]]).reshape(tree["shape"])
    if form == "mapping":
        pairs = [[_unpack(part, arrays, known) for part in pair] for pair in content]
        return dict(pairs)
    if form == "class":
        given = {name: _unpack(own, arrays, known) for name, own in tree["fields"].items()}
        for option in filter(names_file, given.get("options", ())):
            reason = "nothing is loaded or written because a file says so"
            raise ValueError(f"{content}.options has {option!r}, which names a file: {reason}")
        build = dict(_kinds())[content]
        known.append(getattr(build, "from_fields", build)(**given))
        return known[-1]
    items = [_unpack(item, arrays, known) for item in tree[form]]
    return {"list": items, "tuple": tuple(items)}[form]


def _find_python_fields(cls: type) -> set[str]:
    """Find the fields that only Python can give, such as callbacks: files leave them out."""
    hints = get_type_hints(cls, include_extras=True) if is_dataclass(cls) else {}
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {name for name, own in marks.items() if any(type(mark) is InPython for mark in own)}


def _kinds() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the names of all kinds; in files of version 0.1 they have no family."""
    for family in Value.__subclasses__():
        for kind, member in family.members.items():
            if isinstance(member, type):
                yield kind, member
                yield f"{family.__name__}.{kind}", member


def find_kind(own: Any) -> str:
    """Return the name of a kind in files of arrays, "" for other classes."""
    if not issubclass(own, Value) or own.members.get(own.kind) is not own:
        return ""
    family = next(base for base in own.__mro__ if Value in base.__bases__)
    return f"{family.__name__}.{own.kind}"


def find_differences(one: Any, other: Any, name: str) -> Iterator[str]:
    """Yield the names of fields in which two values differ by more than rounding."""
    matches = getattr(one, "matches", None) or getattr(other, "matches", None)
    if matches:
        if not matches(other if hasattr(one, "matches") else one):
            yield name
    elif isinstance(one, Value) and type(one) is type(other):
        fields, others = one.to_fields(), other.to_fields()
        for field in {**fields, **others}:
            label = f"{type(one).__name__}.{field}"
            yield from find_differences(fields.get(field), others.get(field), label)
    elif isinstance(one, Mapping) and isinstance(other, Mapping) and one.keys() == other.keys():
        for key in one:
            yield from find_differences(one[key], other[key], name)
    elif isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        if len(one) != len(other):
            yield name
        for pair in zip(one, other, strict=False):
            yield from find_differences(*pair, name)
    elif not _is_same(one, other):
        yield name


def _is_same(one: Any, other: Any) -> bool:
    a, b = np.asarray(one), np.asarray(other)
    if a.shape != b.shape or a.dtype.kind not in "iuf" or b.dtype.kind not in "iuf":
        return bool(np.array_equal(a, b))
    size = np.abs(b[np.isfinite(b)]).max(initial=0.0)
    return bool(np.allclose(a, b, rtol=1e-9, atol=1e-9 * size, equal_nan=True))
