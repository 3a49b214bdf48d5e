"""Results in .npz files: dataclasses of numbers, text and arrays."""

from __future__ import annotations

import io
from collections.abc import Hashable, Mapping
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from types import NoneType
from typing import (
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from tenscasadi.util import archive
from tenscasadi.util.archive import Fields
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import FilePath, format_value

Own = TypeVar("Own", bound="Stored")
_KINDS = {bool: "b", int: "i", float: "f", str: "U"}  # NumPy's letters


class Stored(ReadOnlyArrays):
    """Base class of results that can be stored in .npz files.

    Arrays are annotated by their sizes and NumPy's letter of their kind: ``Annotated[Array, "Tn3",
    "f"]`` is a float array (T, n, 3). Subclasses convert fields of other types by `_write_values`
    and `_read_values`.
    """

    _form: ClassVar[str] = ""  # the field "format" of files
    _title: ClassVar[str] = ""  # the name in messages

    def __init_subclass__(cls, *, form: str = "", title: str = "", **more: Any) -> None:
        super().__init_subclass__(**more)
        if form:
            cls._form, cls._title = form, title

    def __post_init__(self) -> None:
        _check_arrays({name: getattr(self, name) for name in array_fields(type(self))}, type(self))
        super().__post_init__()

    def save(self, path: FilePath) -> Path:
        """Write the result to a compressed .npz file.

        Python functions, such as time-varying loads, are sampled at the saved times or omitted.

        Parameters
        ----------
        path : str or PathLike
            File to write; no ending is added.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        return archive.save(path, self._form, self.to_arrays())

    def to_bytes(self) -> bytes:
        """Return the content of the .npz file.

        Returns
        -------
        bytes
            The content of the file.
        """
        file = io.BytesIO()
        archive.write(file, self._form, self.to_arrays())
        return file.getvalue()

    @classmethod
    def load(cls: type[Own], path: FilePath) -> Own:
        """Read a file that `save` has written.

        No code in the file is ever run.

        Parameters
        ----------
        path : str or PathLike
            File to read.

        Returns
        -------
        Stored
            The saved result.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        ValueError
            The file cannot be read, or holds no such result; the message names the file and the
            field.
        """
        return archive.load(path, cls._form, cls._title, cls.from_arrays)

    def to_arrays(self) -> dict[str, Any]:
        """Convert the result to arrays by name.

        Returns
        -------
        dict of str to ndarray
            The fields; values as text and arrays.
        """
        found = {name: np.asarray(value) for name, value in self._write_values().items()}
        for field in fields(self):  # type: ignore[arg-type]  # subclasses are dataclasses
            content = getattr(self, field.name)
            if isinstance(content, Stored):
                own = content.to_arrays().items()
                found |= {f"{field.name}.{name}": array for name, array in own}
            elif field.name in array_fields(type(self)) and content is not None:
                found[field.name] = _as_array(field.name, content)
        return found

    @classmethod
    def from_arrays(cls: type[Own], content: Mapping[str, Any]) -> Own:
        """Build the result from arrays by name.

        Parameters
        ----------
        content : mapping of str to ndarray
            The fields by name. Those with a default may be missing.

        Returns
        -------
        Stored
            The result with these fields.

        Raises
        ------
        ValueError
            A field is missing or has a wrong type, shape or value. The message names the field.
        """
        own: type = cls
        content, hints = Fields(content), _find_fields(own).hints
        given: dict[str, Any] = {}
        for name, hint in hints.items():
            if isinstance(hint, type) and issubclass(hint, Stored):
                if any(entry.startswith(f"{name}.") for entry in content):
                    given[name] = _restore_part(hint, name, content)
            elif name in array_fields(cls) and name in content:
                given[name] = _as_array(name, content[name])
        given |= cls._read_values(content, given)
        for field in fields(cls):  # type: ignore[arg-type]
            name = field.name
            if name in given:
                continue
            if field.default is field.default_factory is MISSING:
                raise ValueError(f"it has no field {name!r}")
            made = field.default_factory
            given[name] = field.default if made is MISSING else made()
        _check_arrays(given, cls)
        for name, (letters, _) in array_fields(cls).items():
            if letters == "":
                given[name] = np.asarray(given[name]).item()
            elif letters and get_origin(get_args(hints[name])[0]) is tuple and name in content:
                given[name] = tuple(given[name].tolist())
        cls._check_loaded(given)
        return cls(**given)

    def _write_values(self) -> dict[str, str]:
        """Convert fields that are no arrays, such as scenes, to text."""
        return {}

    @classmethod
    def _read_values(cls, content: Fields, given: Mapping[str, Any]) -> dict[str, Any]:
        """Restore the fields that `_write_values` converted, by name.

        `content` has all arrays of the file, and `given` the other fields. Raises ValueError.
        """
        return {}

    @classmethod
    def _check_loaded(cls, given: Mapping[str, Any]) -> None:
        """Check the values of loaded fields, `given` by name.

        Raises ValueError.
        """


def _restore_part(kind: type[Stored], name: str, content: Fields) -> Stored:
    try:
        return kind.from_arrays(content.within(f"{name}."))
    except ValueError as error:
        raise ValueError(str(error).replace("field '", f"field '{name}.", 1)) from error


class _FieldTypes(NamedTuple):
    """Types of the fields of a class, by name.

    `hints` are the annotations. Each of the `arrays` has its dimensions, as letters, and NumPy's
    letter of its kind. Fields in `optional` can be None.
    """

    hints: dict[str, Any]
    arrays: dict[str, tuple[str | None, str]]
    optional: set[str]


@cache
def _find_fields(cls: Hashable) -> _FieldTypes:
    found, known = _FieldTypes({}, {}, set()), get_type_hints(cls, include_extras=True)
    for name, given in ((field.name, known[field.name]) for field in fields(cls)):  # type: ignore[arg-type]
        own = [part for part in get_args(given) if part is not NoneType]
        optional = NoneType in get_args(given) and get_origin(given) is not Annotated
        hint = found.hints[name] = own[0] if optional and len(own) == 1 else given
        if get_origin(hint) is Annotated:
            values, letters, kind = get_args(hint)
            found.arrays[name] = letters, kind
            optional = optional or NoneType in get_args(values)
        elif hint in _KINDS:
            found.arrays[name] = "", _KINDS[hint]
        elif get_origin(hint) is np.ndarray:
            found.arrays[name] = None, np.dtype(get_args(get_args(hint)[1])[0]).kind
        if optional:
            found.optional.add(name)
    return found


def array_fields(cls: type) -> dict[str, tuple[str | None, str]]:
    """Return dimensions and kinds of the fields that are arrays or text.

    Dimensions are letters, such as "Tn3".
    """
    return _find_fields(cls).arrays


def _check_arrays(content: Mapping[str, Any], cls: type) -> None:
    """Check the kinds and shapes of fields.

    They must agree with the annotations of a class. `content` are the fields by name. Raises
    ValueError.
    """
    sizes: dict[str, int] = {"2": 2, "3": 3}
    for name, (letters, kind) in array_fields(cls).items():
        if content.get(name) is None:
            if name in content and name not in _find_fields(cls).optional:
                raise ValueError(f"field {name!r} is None: give its value")
            continue
        value = _as_array(name, content[name])
        if value.size and value.dtype.kind != kind:  # without entries there is no kind
            raise ValueError(f"field {name!r} holds values of type {value.dtype}")
        if letters is not None and (
            value.ndim != len(letters)
            or any(
                sizes.setdefault(letter, size) != size
                for letter, size in zip(letters, value.shape, strict=True)
            )
        ):
            raise ValueError(f"field {name!r} has shape {value.shape}, which does not fit others")


def check_indices(name: str, value: Any, count: int, least: int = 0) -> None:
    """Raise ValueError unless indices lie in [`least`, `count`).

    `value` has the indices, and `name` is that of the field in messages.
    """
    if np.size(value) and not least <= np.min(value) <= np.max(value) < count:
        raise ValueError(f"field {name!r} holds indices outside {least} … {count - 1}")


def _as_array(name: str, value: Any) -> Any:
    if np.ma.is_masked(value):
        raise ValueError(f"field {name!r} has masked entries")  # NumPy would use the masked values
    try:
        return np.asarray(value, dtype=str if isinstance(value, tuple) and not value else None)
    except Exception as error:  # an object's own __array__ may raise anything
        raise ValueError(f"field {name!r} is {format_value(value)}: it must be an array") from error
