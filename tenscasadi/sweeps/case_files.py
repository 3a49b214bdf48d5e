"""Cases of a sweep: what identifies them, what they may return, and the file that each has in a folder."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.schema.packing import find_kind
from tenscasadi.schema.value import Value
from tenscasadi.util import archive
from tenscasadi.util.archive import Fields
from tenscasadi.util.validate import shown

_FORMAT = "tenscasadi case 1"
_VALUE = "value."  # before the names of results in files
_PLAIN = "biufcU"  # kinds of arrays, in NumPy's letters, that files hold
_CONSTANTS = (bool, int, float, complex, str, np.generic, np.ndarray, Value)  # of a closure


class Outcome(NamedTuple):
    """Results of a case by name, the traceback where it failed ("" else), and its wall time, s."""

    values: dict[str, Any]
    error: str
    seconds: float


# --- identity ---


def name_of(function: Callable[..., Any]) -> str:
    """Return the name that files tell of a function."""
    function = _bare(function)
    return str(getattr(function, "__qualname__", type(function).__qualname__))


def source_hash(function: Callable[..., Any]) -> str:
    """Return a hash of the function's own source text, "" where there is none."""
    with contextlib.suppress(OSError, TypeError):
        return hashlib.sha256(inspect.getsource(_bare(function)).encode()).hexdigest()
    return ""


def home_of(function: Callable[..., Any]) -> str:
    """Return the name of the module or script that a function is of, "" where that cannot be told."""
    module = getattr(_bare(function), "__module__", None) or ""
    if module == "__main__":
        module = Path(getattr(sys.modules[module], "__file__", None) or "").stem
    return str(module).rpartition(".")[2]


def identity_of(function: Callable[..., Any]) -> str:
    """Return the name of a function, and with it a hash of what it holds: arguments of a partial, the object it belongs to, constants of a closure.

    Raises TypeError where that cannot be told.
    """
    name, held = name_of(function), _held_by(function)
    return f"{name} {case_key(name, held, 'function')}" if held else name


def _bare(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function below `partial`."""
    while isinstance(function, partial):
        function = function.func
    return function


def _held_by(function: Callable[..., Any]) -> Any:
    if isinstance(function, partial):  # of a partial, Python makes one with all arguments
        return {
            "of": _held_by(function.func),
            "arguments": function.args,
            "keywords": function.keywords,
        }
    function = inspect.unwrap(function)
    if inspect.ismethod(function) or not (
        inspect.isroutine(function) or isinstance(function, type)
    ):
        owner = getattr(function, "__self__", function)
        return (
            None
            if isinstance(owner, type)
            else owner
            if is_dataclass(owner)
            else dict(getattr(owner, "__dict__", {}))
        )
    if not inspect.isfunction(function):
        return None
    values = dict(inspect.getclosurevars(function).nonlocals)
    values |= {f"default {k}": value for k, value in enumerate(function.__defaults__ or ())} | (
        function.__kwdefaults__ or {}
    )
    return {
        name: value for name, value in values.items() if isinstance(value, _CONSTANTS)
    }  # what may change as it runs tells nothing


def case_key(name: str, case: Any, field: str) -> str:
    """Return the hash of what a case holds, for the function of that name. Raises TypeError naming `field`."""
    return _key(name, json.dumps(_describe(field, case)))


def _key(name: str, case: str) -> str:
    return hashlib.sha256(f"[{json.dumps(name)}, {case}]".encode()).hexdigest()[:32]


def _describe(field: str, value: Any) -> Any:
    """Return lists of text and numbers that are the same for the same content, in any process and on any machine."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, complex):
        return ["complex", value.real, value.imag]
    if isinstance(value, np.ndarray) and value.dtype.kind in _PLAIN:
        plain = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        return [
            "array",
            plain.dtype.str,
            list(plain.shape),
            hashlib.sha256(plain.tobytes()).hexdigest(),
        ]
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return [
            "dict",
            [[name, _describe(f"{field}[{name!r}]", value[name])] for name in sorted(value)],
        ]
    if isinstance(value, (list, tuple)):
        return ["list", [_describe(f"{field}[{k}]", item) for k, item in enumerate(value)]]
    if isinstance(value, Value) or (is_dataclass(value) and not isinstance(value, type)):
        own = value.to_fields() if isinstance(value, Value) else _fields_of(value)
        content = [[name, _describe(f"{field}.{name}", part)] for name, part in own.items()]
        kind = find_kind(type(value)) or f"{type(value).__module__}.{type(value).__qualname__}"
        return [kind, content]
    cure = "give numbers, text, arrays, lists, dicts by text, structures, scenes or options; what is else, build in the function"
    raise TypeError(
        f"{field} is {shown(value)}, whose content a folder of results cannot tell: {cure}"
    )


def _fields_of(value: Any) -> dict[str, Any]:
    return {item.name: getattr(value, item.name) for item in fields(value)}


# --- results ---


def check_results(returned: Any) -> dict[str, Any]:
    """Return what a function returned as numbers, text and arrays by name. Raises TypeError naming the result."""
    if returned is None:
        return {}
    results = dict(returned) if isinstance(returned, Mapping) else {"result": returned}
    for name, value in results.items():
        if not isinstance(name, str):
            raise TypeError(f"the function returned a result named {name!r}: name results by text")
        results[name] = _plain(name, value)
    return results


def _plain(name: str, value: Any) -> Any:
    try:
        array = np.asarray(value)
        known = array.dtype.kind in _PLAIN
    except ValueError:  # lists of different lengths
        known = False
    if not known:
        raise TypeError(
            f"result {name!r} is of type {type(value).__name__}: return numbers, text, or arrays of them (NaN for None)"
        )
    return array.item() if array.ndim == 0 else array


# --- files ---


class CaseFiles:
    """Folder with one .npz file for each finished case of a function. Raises TypeError, ValueError, OSError."""

    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        self._identity = identity_of(function)
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.name, self._source, self._home = (
            folder,
            name_of(function),
            source_hash(function),
            home_of(function),
        )
        self.found = self.damaged = self.outdated = (
            0  # files read so far: of finished cases, of no case, of an older text of the function
        )

    def key(self, case: Any, field: str) -> str:
        """Return what identifies a case. Raises TypeError."""
        return case_key(self._identity, case, field)

    def write(self, key: str, case: Any, outcome: Outcome) -> None:
        """Write a case whole or not at all. Raises OSError."""
        told: dict[str, Any] = {
            "case": json.dumps(_describe("case", case)),
            "function": self.name,
            "source": self._source,
            "home": self._home,
        }
        told |= {"error": outcome.error, "seconds": outcome.seconds}
        archive.save(
            self.folder / f"{key}.npz",
            _FORMAT,
            told | {_VALUE + name: value for name, value in outcome.values.items()},
        )

    def read(self, keys: Sequence[str]) -> dict[str, Outcome]:
        """Return the cases of these keys that have finished without error. Raises ValueError where they are of another function."""
        found = {}
        for key in dict.fromkeys(keys):
            try:
                outcome, source, home = archive.load(
                    self.folder / f"{key}.npz", _FORMAT, "case", partial(_read, self._identity, key)
                )
            except FileNotFoundError:
                continue
            except ValueError:
                self.damaged += 1
                continue
            if home and self._home and home != self._home and source != self._source:
                raise ValueError(
                    f"folder {self.folder} holds results of {self.name} of {home}, not of {self._home}: give each its own folder"
                )
            if not outcome.error:
                found[key] = outcome
                self.found += 1
                self.outdated += source != self._source
        return found


def _read(identity: str, key: str, content: Fields) -> tuple[Outcome, str, str]:
    """Return an outcome with the hash and the home of its function. Raises ValueError."""
    if _key(identity, str(content.array("case", "U", 0))) != key:
        raise ValueError("it is of another case")
    values = {
        name: value.item() if value.ndim == 0 else value
        for name, value in content.within(_VALUE).items()
        if _VALUE + name in content
    }
    error, seconds = str(content.array("error", "U", 0)), float(content.array("seconds", "f", 0))
    home = str(content.array("home", "U", 0)) if "home" in content else ""
    return Outcome(values, error, seconds), str(content.array("source", "U", 0)), home
