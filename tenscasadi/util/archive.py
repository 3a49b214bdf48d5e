"""Arrays in .npz files: written whole or not at all, and read without running what is in them."""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from tenscasadi.util.validate import file_path
from tenscasadi.util.whole_file import whole_file

T = TypeVar("T")
_LIMIT = 1_000_000_000  # bytes that a file may unpack to, however small it is
_RATIO = (
    20  # bytes that each byte of a larger file may unpack to: numbers of real motions need less
)
# Anything that reading a damaged or foreign archive may raise.
_UNREADABLE = (
    *(
        OSError,
        ValueError,
        TypeError,
        EOFError,
        KeyError,
        IndexError,
        RuntimeError,
        MemoryError,
        AttributeError,
        SyntaxError,
        OverflowError,
    ),
    *(zipfile.BadZipFile, zlib.error),
)


class Fields(dict[str, Any]):
    """Arrays of a file by name; asking for one that the file lacks raises ValueError."""

    def __missing__(self, name: str) -> Any:
        raise ValueError(f"it has no field {name!r}")

    def array(self, name: str, kinds: str, dimensions: int | None = None) -> Any:
        """Return the array of this name, whose values are of one of these kinds, in NumPy's letters. Raises ValueError."""
        value = self[name]
        if value.dtype.kind not in kinds or (dimensions is not None and value.ndim != dimensions):
            raise ValueError(
                f"field {name!r} holds values of type {value.dtype}, shape {value.shape}"
            )
        return value

    def within(self, prefix: str) -> Fields:
        """Return the fields whose names begin with `prefix`, without it."""
        return Fields(
            {
                name.removeprefix(prefix): value
                for name, value in self.items()
                if name.startswith(prefix)
            }
        )


def save(path: str | os.PathLike[str], form: str, content: Mapping[str, Any]) -> Path:
    """Write arrays by name, and `form` as the field "format", to exactly `path`, compressed, and return it.

    A file that was there stays as it is until the new one is complete. Raises OSError when it
    cannot be written, see `whole_file`.
    """
    with whole_file(path) as file:
        write(file, form, content)
    return file_path("path", path)


def write(file: BinaryIO, form: str, content: Mapping[str, Any]) -> None:
    """Write what `save` does to a file that is open."""
    arrays = {name: np.asarray(value) for name, value in content.items()}
    savez = (
        np.savez_compressed
        if sum(value.nbytes for value in arrays.values()) <= _LIMIT
        else np.savez
    )  # else `load` could refuse it
    savez(file, allow_pickle=False, format=np.asarray(form), **arrays)


def unpacked_limit(path: Path) -> int:
    """Return how many bytes a file may unpack to: 1 GB, or 20 times its own size."""
    return max(_LIMIT, _RATIO * path.stat().st_size)


def load(
    path: str | os.PathLike[str],
    form: str,
    kind: str,
    build: Callable[[Fields], T],
    names: Container[str] | None = None,
) -> T:
    """Return `build` of the arrays, by name, of a file that `save` wrote in this form; `names`: only these are opened.

    No code in the file is ever run. Raises FileNotFoundError, and ValueError naming the file, the
    `kind` of thing that it is not, and why; `build` says so with a ValueError, and all else that it
    raises passes. A file may unpack to 1 GB, or to 20 times its own size.
    """
    refusal = f"{file_path('path', path)} is not a {kind}"
    try:
        content = _read(Path(path), names)
    except FileNotFoundError:
        raise
    except (OSError, MemoryError) as error:
        raise ValueError(f"{refusal}: it cannot be read ({error})") from None
    except _UNREADABLE:  # NumPy's words would advise to allow pickles
        raise ValueError(
            f"{refusal}: it cannot be read, as tenscasadi did not save it or it is damaged"
        ) from None
    if str(content.pop("format", "")) != form:
        raise ValueError(f"{refusal}: its field 'format' is not {form!r}")
    try:
        return build(content)
    except ValueError as error:
        raise ValueError(f"{refusal}: {error}") from error


def stored_format(path: str | os.PathLike[str]) -> str:
    """Return what a file that `save` wrote says it is, as `form` of `load`; empty for any other. Raises FileNotFoundError."""
    try:
        return str(_read(file_path("path", path), ()).get("format", ""))
    except FileNotFoundError:
        raise
    except _UNREADABLE:
        return ""


def _read(path: Path, names: Container[str] | None) -> Fields:
    """Read the arrays of a file, once the sizes that it tells are known to fit each other and the limit."""
    if path.exists() and not path.is_file():  # opening a FIFO would wait for another process
        raise OSError("it is no regular file")
    with zipfile.ZipFile(path) as packed:
        found = {info.filename.removesuffix(".npy"): info for info in packed.infolist()}
        wanted = {
            name: info
            for name, info in found.items()
            if names is None or name == "format" or name in names
        }
        size, most = sum(info.file_size for info in wanted.values()), unpacked_limit(path)
        if size > most:
            raise MemoryError(
                f"it unpacks to {size / 1e9:.3g} GB, above the limit of {most / 1e9:.3g} GB for a file of its size"
            )
        return Fields({name: _read_array(packed, name, info) for name, info in wanted.items()})


def _read_array(packed: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> Any:
    with packed.open(info) as member:
        version = np.lib.format.read_magic(member)
        header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = header(member)
        size = math.prod(shape) * dtype.itemsize
        if not dtype.hasobject and size != info.file_size - member.tell():
            raise OSError(
                f"its field {name!r} of shape {shape} would take {size:.3g} bytes, and the file tells of {info.file_size}"
            )
    with packed.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)
