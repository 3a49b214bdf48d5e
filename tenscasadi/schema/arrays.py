"""Values as text in files of arrays: numbers, lists and registered kinds alone, never code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tenscasadi.schema.value import Value


class NotStored(Exception):
    """Something has no form as text; says which."""


def pack(value: Any, name: str, kinds: Mapping[str, type]) -> Any:
    """Write a value as lists and tables of JSON that name its kind. Raises NotStored, naming the field."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.ndarray) and value.dtype.kind in "bif":
        return {
            "array": value.ravel().tolist(),
            "shape": list(value.shape),
            "kind": value.dtype.kind,
        }
    if isinstance(value, (list, tuple)):
        return {
            "tuple" if isinstance(value, tuple) else "list": [
                pack(item, f"{name}[{k}]", kinds) for k, item in enumerate(value)
            ]
        }
    if isinstance(value, Mapping):
        return {
            "mapping": [
                [
                    pack(key, name, kinds),
                    pack(
                        item, f"{name}.{key}" if isinstance(key, str) else f"{name}[{key}]", kinds
                    ),
                ]
                for key, item in value.items()
            ]
        }
    if isinstance(value, Value):
        told = {
            field: pack(own, f"{name}.{field}", kinds) for field, own in value.to_fields().items()
        }
        for kind, known in kinds.items():
            if known is type(value):
                return {"class": kind, "fields": told}
    own = (
        "a function"
        if callable(value) and not isinstance(value, type)
        else f"of an own class, {type(value).__name__}"
    )
    raise NotStored(f"{name} is {own}, which no file holds")


def unpack(told: Any, kinds: Mapping[str, type]) -> Any:
    """Build a value again from the kinds that are known. Raises what a damaged text leads to: KeyError, TypeError, ValueError, AttributeError."""
    if not isinstance(told, dict):
        return told
    if "unknown" in told:
        raise ValueError(told["unknown"])
    if "array" in told:
        return np.array(
            told["array"], dtype={"b": bool, "i": np.intp, "f": float}[told["kind"]]
        ).reshape(told["shape"])
    if "mapping" in told:
        return {unpack(key, kinds): unpack(value, kinds) for key, value in told["mapping"]}
    if "class" in told:
        given = {name: unpack(value, kinds) for name, value in told["fields"].items()}
        files = [name for name in given.get("options", ()) if "lib" in name or "file" in name]
        if files:
            raise ValueError(
                f"{told['class']}.options has {files[0]!r}, which names a file: nothing is loaded or written because a file says so"
            )
        return kinds[told["class"]](**given)
    items = [unpack(item, kinds) for item in told["tuple" if "tuple" in told else "list"]]
    return tuple(items) if "tuple" in told else items
