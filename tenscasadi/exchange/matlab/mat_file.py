"""Variables of .mat files.

A file of MATLAB's versions 5 to 7 consists of a header and elements. An element has a type, a
number of bytes, and the bytes, which may contain elements. Every size is checked against the
available bytes before it is used. SciPy writes the files but does not read them, because a damaged
file can crash its process. Nothing in a file is executed.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from tenscasadi.util.archive import unpacked_limit
from tenscasadi.util.validate import file_path
from tenscasadi.util.whole_file import whole_file

_HEADER = 128  # bytes
_MATRIX, _COMPRESSED = 14, 15  # element types
_NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_CODECS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_STRUCT, _CHAR, _SPARSE, _NUMERIC = 2, 4, 5, range(6, 16)  # array classes
_COMPLEX = 0x0800
_DEEPEST = 30  # nesting depth of structs
_UNREADABLE = (
    OSError,
    ValueError,
    TypeError,
    IndexError,
    MemoryError,
    OverflowError,
    zlib.error,
    struct.error,
)


def read_mat(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the variables of a .mat file by name.

    The file has MATLAB's version 5, 6 or 7.

    Values are float arrays, sparse arrays, texts, and structs as dictionaries of these. Objects,
    function handles, cells, arrays of structs and complex numbers are omitted. Raises
    FileNotFoundError, and ValueError that names the file and the reason.
    """
    place = file_path("path", path)
    if place.exists() and not place.is_file():  # opening a FIFO would block
        raise ValueError(f"path is {place}, no regular file: give a .mat file")
    with open(place, "rb") as file:
        _check_version(place, file.read(_HEADER))
    try:
        variables = dict(_variables(place))
    except _UNREADABLE as error:
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{place} is no .mat file that can be read: {why}") from None
    return {name: value for name, value in variables.items() if name and value is not None}


def write_mat(path: str | os.PathLike[str], content: Mapping[str, Any]) -> Path:
    """Write variables to exactly `path` in MATLAB's format v7.

    Raises OSError.

    Values are numbers, arrays, texts, and dictionaries for structs. Returns the path.
    """
    from scipy.io import savemat  # slow import

    with whole_file(path) as file:
        savemat(file, dict(content), do_compression=True, oned_as="column", long_field_names=True)
    return file_path("path", path)


def _check_version(path: Path, header: bytes) -> None:
    if header[:8] == b"\x89HDF\r\n\x1a\n" or header[124:126] in (b"\x00\x02", b"\x02\x00"):
        raise ValueError(
            f"{path} has MATLAB's format v7.3 (HDF5): save it in MATLAB with save('{path.name}', ..., '-v7')"
        )
    if header[126:128] not in (b"IM", b"MI") or header[124:126] not in (b"\x00\x01", b"\x01\x00"):
        cure = (
            f"save it in MATLAB with save('{path.name}', ..., '-v7'), in Octave with '-mat7-binary'"
        )
        raise ValueError(f"{path} is no .mat file of version 5, 6 or 7: {cure}")


def _variables(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield names and values of all variables; None if omitted.

    Raises ValueError and others if the file is damaged.
    """
    limit = left = unpacked_limit(path)
    if path.stat().st_size > limit:
        raise ValueError(f"it has more than {limit / 1e9:.3g} GB")
    whole = path.read_bytes()
    order = "<" if whole[126:128] == b"IM" else ">"
    for kind, content in _elements(memoryview(whole)[_HEADER:], order):
        if kind == _COMPRESSED:
            told = (
                struct.unpack(order + "II", zlib.decompressobj().decompress(content, 8))[1] + 8
            )  # size that its own header states
            left -= told
            if left < 0:
                raise ValueError(
                    f"it unpacks to more than {limit / 1e9:.3g} GB, the limit for a file of its size"
                )
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(content, told + 8)
            if not unpacking.eof:
                raise ValueError("a compressed variable is cut off, or longer than it says")
            for inner, inside in _elements(memoryview(unpacked), order):
                if inner == _MATRIX:
                    yield _matrix(inside, order, 0)
        elif kind == _MATRIX:
            yield _matrix(content, order, 0)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield types and contents of consecutive elements.

    Raises ValueError if an element exceeds the data.
    """
    at = 0
    while at < len(data):
        kind, size = struct.unpack(order + "II", data[at : at + 8])
        start = at + 8
        if kind >> 16:  # small element: type and content share eight bytes
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
        else:
            at = start + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if start + size > min(at, len(data)):
            raise ValueError(f"an element of {size} bytes is cut off")
        yield kind, data[start : start + size]


def _matrix(content: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Read name and value of an array; None if omitted.

    Raises ValueError and others if it is damaged.
    """
    if not len(content):
        return "", np.zeros((0, 0))
    if depth > _DEEPEST:
        raise ValueError(f"structs are nested deeper than {_DEEPEST} times")
    parts = list(_elements(content, order))
    flags = struct.unpack(order + "I", parts[0][1][:4])[0]
    form = flags & 0xFF
    if form not in (_STRUCT, _CHAR, _SPARSE, *_NUMERIC):
        return bytes(parts[2][1]).decode("ascii", "replace") if len(parts) > 2 and form <= max(
            _NUMERIC
        ) else "", None
    shape = tuple(np.frombuffer(parts[1][1], order + "i4").tolist())
    name = bytes(parts[2][1]).decode("ascii")
    if min(shape, default=-1) < 0:
        raise ValueError(f"{name} has shape {shape}")
    if form == _STRUCT:
        return name, _struct(parts[3:], order, depth) if shape == (1, 1) else None
    if form == _CHAR:
        return name, _text(parts[3], order) if math.prod(shape) in (0, *shape[1:]) and len(
            parts
        ) > 3 else None
    if flags & _COMPLEX:
        return name, None
    if form == _SPARSE:
        return name, _sparse(parts[3:], order, shape)
    values = _numbers(parts[3], order)
    if math.prod(shape) != len(values):
        raise ValueError(f"{name} of shape {shape} holds {len(values)} numbers")
    return name, values.astype(float).reshape(shape, order="F")


def _numbers(part: tuple[int, memoryview], order: str) -> Any:
    kind, content = part
    if kind not in _NUMBERS:
        raise ValueError(f"numbers are of the unknown type {kind}")
    return np.frombuffer(content, order + _NUMBERS[kind])


def _text(part: tuple[int, memoryview], order: str) -> str:
    codec = _CODECS.get(part[0], "latin-1")
    return bytes(part[1]).decode(
        codec + ({"<": "-le", ">": "-be"}[order] if codec in ("utf-16", "utf-32") else ""),
        "replace",
    )


def _sparse(parts: list[tuple[int, memoryview]], order: str, shape: tuple[int, ...]) -> Any:
    rows, starts = (_numbers(part, order) for part in parts[:2])
    flat = len(parts[2][1]) == len(rows)  # Boolean values of one byte, whatever their type says
    values = np.frombuffer(parts[2][1], "u1") if flat else _numbers(parts[2], order)
    count = int(starts[-1])
    if (
        len(shape) != 2
        or len(starts) != shape[1] + 1
        or not 0 <= count <= min(len(rows), len(values))
    ):
        raise ValueError(f"a sparse matrix of shape {shape} does not hold what it says")
    found = csc_array(
        (values[:count].astype(float), rows[:count].astype(np.int64), starts.astype(np.int64)),
        shape=shape,
    )
    found.check_format(full_check=True)  # wrong indices would make its methods read out of bounds
    return found


def _struct(parts: list[tuple[int, memoryview]], order: str, depth: int) -> dict[str, Any]:
    length = struct.unpack(order + "i", parts[0][1][:4])[0]
    names, values = bytes(parts[1][1]), parts[2:]
    if length < 1 or len(names) != length * len(values):
        raise ValueError(
            f"a struct has {len(names)} characters of names, each {length} long, and {len(values)} values"
        )
    fields = {}
    for k, (kind, content) in enumerate(values):
        name = names[k * length : (k + 1) * length].split(b"\0")[0].decode("ascii")
        if kind != _MATRIX:
            raise ValueError(f"field {name} of a struct is of the unknown type {kind}")
        value = _matrix(content, order, depth + 1)[1]
        if value is not None:
            fields[name] = value
    return fields
