"""Files of arrays (.npz) that never execute code."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, TypeVar

import numpy as np

from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import MAX_BYTES, FilePath, file_path
from tenscasadi.util.whole_file import whole_file

T = TypeVar("T")
_UNREADABLE = (
    *(LookupError, ArithmeticError, RuntimeError, MemoryError, AttributeError, SyntaxError),
    *(OSError, ValueError, TypeError, EOFError, TokenError, zipfile.BadZipFile, zlib.error),
)  # errors that reading a damaged or foreign archive may raise


class Fields(dict[str, Any]):
    """Arrays of a file by name."""

    def __missing__(self, name: str) -> Any:
        raise ValueError(f"it has no field {name!r}")  # `load` names the file

    def array(self, name: str, kinds: str, dimensions: int | None = None) -> Any:
        """Select the array of a field and check its type.

        Its data type must be of one of NumPy's kinds. `name` is that of the field, `kinds` are
        letters such as "fi", and `dimensions` is the number of dimensions; None: any. Raises
        ValueError.
        """
        value = self[name]
        if value.dtype.kind not in kinds or dimensions not in (None, value.ndim):
            found = f"type {value.dtype}, shape {value.shape}"
            raise ValueError(f"field {name!r} holds values of {found}")
        return value

    def within(self, prefix: str) -> Fields:
        """Select the fields whose names begin with `prefix`.

        The prefix is removed from the names.
        """
        own = {name: value for name, value in self.items() if name.startswith(prefix)}
        return Fields({name.removeprefix(prefix): value for name, value in own.items()})


def save(path: FilePath, form: str, content: Mapping[str, Any]) -> Path:
    """Write arrays by name to exactly `path`, atomically.

    `content` are the arrays. The field "format" is `form`. Raises OSError.
    """
    with whole_file(path) as file:
        write(file, form, content)
    return file_path("path", path)


def write(file: BinaryIO, form: str, content: Mapping[str, Any]) -> None:
    """Write arrays by name to an open file.

    `content` are the arrays. The field "format" is `form`.
    """
    arrays = {name: np.asarray(value) for name, value in content.items()}
    # a well compressed large file could exceed the size limit of `load`
    large = sum(value.nbytes for value in arrays.values()) > MAX_BYTES
    savez = np.savez if large else np.savez_compressed
    savez(file, allow_pickle=False, format=np.asarray(form), **arrays)


def compute_size_limit(path: Path) -> int:
    """Compute the largest unpacked size of the file `path` [bytes].

    It is 1 GB, or 20 times the size of the file. Trajectories compress by less than that.
    """
    return max(MAX_BYTES, 20 * path.stat().st_size)


def load(path: FilePath, form: str, kind: str, build: Callable[[Fields], T]) -> T:
    """Build an object from the arrays of the file `path`.

    `build` converts the arrays to the object. Raises FileNotFoundError. Raises ValueError if the
    file is damaged, its field "format" is not `form`, or `build` raises ValueError. The message has
    the file, the expected `kind` of content and the reason.
    """
    rejection = f"{file_path('path', path)} is not a {kind}"
    try:
        content = _read(Path(path))
    except FileNotFoundError:
        raise
    except (OSError, MemoryError) as error:
        raise add_address(ValueError(f"{rejection}: it cannot be read ({error})")) from None
    except _UNREADABLE:  # NumPy's message would advise to allow pickles
        reason = "it is damaged, or tenscasadi did not save it"
        raise add_address(ValueError(f"{rejection}: it cannot be read, {reason}")) from None
    if str(content.pop("format", "")) != form:
        raise ValueError(f"{rejection}: its field 'format' is not {form!r}")
    try:
        return build(content)
    except ValueError as error:
        raise ValueError(f"{rejection}: {error}") from error


def read_format(path: FilePath) -> str:
    """Read the field "format" of a file, "" for others.

    Raises FileNotFoundError.
    """
    try:
        return str(_read(file_path("path", path), "format").get("format", ""))
    except FileNotFoundError:
        raise
    except _UNREADABLE:
        return ""


def _read(path: Path, only: str = "") -> Fields:
    """Read arrays of a file after a check of their sizes.

    `only` is the name of the array to read; "": all.
    """
    if path.exists() and not path.is_file():  # opening a FIFO would wait for another process
        raise OSError("it is not a regular file")
    with zipfile.ZipFile(path) as packed:
        found = {info.filename.removesuffix(".npy"): info for info in packed.infolist()}
        wanted = {name: info for name, info in found.items() if only in ("", name)}
        size, most = sum(info.file_size for info in wanted.values()), compute_size_limit(path)
        if size > most:
            limit = f"the limit of {most / 1e9:.3g} GB for a file of its size"
            raise add_address(MemoryError(f"it unpacks to {size / 1e9:.3g} GB, above {limit}"))
        return Fields({name: _read_array(packed, name, info) for name, info in wanted.items()})


def _read_array(packed: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> Any:
    with packed.open(info) as member:
        old = np.lib.format.read_magic(member) == (1, 0)
        header = "read_array_header_1_0" if old else "read_array_header_2_0"
        shape, _, dtype = getattr(np.lib.format, header)(member)
        size = math.prod(shape) * dtype.itemsize
        if not dtype.hasobject and size != info.file_size - member.tell():
            sizes = f"{size:.3g} bytes, but the file has {info.file_size}"
            raise OSError(f"its field {name!r} of shape {shape} requires {sizes}")
    with packed.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)
