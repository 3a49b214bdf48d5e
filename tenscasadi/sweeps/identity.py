"""Keys that identify a sweep's cases and function by content.

The same content gives the same key in any process.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.schema.value import Value
from tenscasadi.util.validate import format_value

PLAIN = "biufcU"  # kinds of arrays, in NumPy's letters, that files hold
_CONSTANTS = (bool, int, float, complex, str, np.generic, np.ndarray, Value)  # of a closure


class FunctionIdentity(NamedTuple):
    """Name and hash that identify a function.

    Attributes
    ----------
    name : str
        Name for messages.
    key : str
        Name with a hash of its content: arguments of a partial, the object that it belongs to,
        constants of a closure.
    source : str
        Hash of its source text, "" if there is none.
    home : str
        Name of its module or script, "" if unknown.
    """

    name: str
    key: str
    source: str
    home: str


def identify(function: Callable[..., Any]) -> FunctionIdentity:
    """Compute the identity of a function.

    Raises TypeError if its content is unknown.
    """
    bare = function
    while isinstance(bare, partial):
        bare = bare.func
    name = str(getattr(bare, "__qualname__", type(bare).__qualname__))
    content, source = _find_content(function), ""
    with contextlib.suppress(OSError, TypeError):
        source = hashlib.sha256(inspect.getsource(bare).encode()).hexdigest()
    home = getattr(bare, "__module__", None) or ""
    if home == "__main__":
        home = Path(getattr(sys.modules[home], "__file__", None) or "").stem
    key = f"{name} {case_key(name, content, 'function')}" if content else name
    return FunctionIdentity(name, key, source, str(home).rpartition(".")[2])


def _find_content(function: Callable[..., Any]) -> Any:
    """Find the values that distinguish functions of equal name.

    They are the arguments of a partial, the object of a method, and constants of a closure.
    """
    if isinstance(function, partial):  # of a partial, Python makes one with all arguments
        inner, arguments = _find_content(function.func), function.args
        return {"of": inner, "arguments": arguments, "keywords": function.keywords}
    function = inspect.unwrap(function)
    routine = inspect.isroutine(function) or isinstance(function, type)
    if inspect.ismethod(function) or not routine:
        owner = getattr(function, "__self__", function)
        if isinstance(owner, type):
            return None
        own = getattr(owner, "__dict__", {})
        kept = {name: value for name, value in own.items() if name != "_kept"}
        return owner if is_dataclass(owner) else kept
    if not inspect.isfunction(function):
        return None
    values = dict(inspect.getclosurevars(function).nonlocals)
    values |= {f"default {k}": value for k, value in enumerate(function.__defaults__ or ())}
    values |= function.__kwdefaults__ or {}
    # mutable values may change as it runs
    return {name: value for name, value in values.items() if isinstance(value, _CONSTANTS)}


def case_key(name: str, case: Any, field: str) -> str:
    """Compute the key of a case from its content and function.

    `name` is that of the function. Raises TypeError naming `field`.
    """
    return hash_case(name, describe_case(case, field))


def hash_case(name: str, text: str) -> str:
    """Compute the hash of a case from its text and function name."""
    return hashlib.sha256(f"[{json.dumps(name)}, {text}]".encode()).hexdigest()[:32]


def describe_case(case: Any, field: str = "case") -> str:
    """Format the content of a case as text for its hash.

    It does not depend on the machine. Raises TypeError naming `field`.
    """
    return json.dumps(_describe(field, case))


def _describe(field: str, value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, complex):
        return ["complex", value.real, value.imag]
    if isinstance(value, np.ndarray) and value.dtype.kind in PLAIN:
        plain = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        digest = hashlib.sha256(plain.tobytes()).hexdigest()
        return ["array", plain.dtype.str, list(plain.shape), digest]
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        own = {name: value[name] for name in sorted(value)}
        return ["dict", [[n, _describe(f"{field}[{n!r}]", part)] for n, part in own.items()]]
    if isinstance(value, (list, tuple)):
        return ["list", [_describe(f"{field}[{k}]", item) for k, item in enumerate(value)]]
    if isinstance(value, Value) or (is_dataclass(value) and not isinstance(value, type)):
        own = (
            dict(value.to_fields())
            if isinstance(value, Value)
            else {item.name: getattr(value, item.name) for item in fields(value)}
        )
        kind = getattr(value, "kind", "") or f"{type(value).__module__}.{type(value).__qualname__}"
        return [kind, [[n, _describe(f"{field}.{n}", part)] for n, part in own.items()]]
    cure = (
        "give numbers, text, arrays, lists, dicts by text, structures, scenes or options; build"
        " other values in the function"
    )
    raise TypeError(
        f"{field} is {format_value(value)}, which cannot identify a case in a folder: {cure}"
    )
