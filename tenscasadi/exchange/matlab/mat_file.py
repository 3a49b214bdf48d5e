"""Variables of .mat files.

A file of MATLAB's versions 5 to 7 consists of a header and elements. An element has a type, a
number of bytes, and the bytes, which may contain elements. Every size is checked against the
available bytes before it is used. SciPy writes the files but does not read them: SciPy 1.17 crashed
with a segmentation fault in each of three runs over 3000 damaged files. Nothing in a file is
executed.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from tenscasadi.exchange.source import DEEPEST, Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.archive import compute_size_limit
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import FilePath, file_path
from tenscasadi.util.whole_file import whole_file

_HEADER = struct.Struct("124s2s2s")  # text, version, order of bytes
_MATRIX, _COMPRESSED = 14, 15  # element types
# NumPy's types by the types of elements
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4"}
_NUMBERS |= {9: "f8", 12: "i8", 13: "u8"}
_CODECS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
# array classes, and the flag of complex numbers
_STRUCT, _CHAR, _SPARSE, _NUMERIC, _COMPLEX = 2, 4, 5, range(6, 16), 0x0800
_DAMAGED = (
    *(ValueError, LookupError, TypeError, ArithmeticError, MemoryError),
    *(zlib.error, struct.error),
)


def read_mat(source: Source) -> dict[str, Any]:
    """Read the variables of a .mat file, version 5 to 7.

    Values are float arrays, sparse arrays, texts, and structs as dictionaries of these; None for
    objects, function handles, cells, arrays of structs and complex numbers. Raises
    FileNotFoundError, SceneFileError.
    """
    limit = compute_size_limit(source.path)
    whole, name = source.read(most=limit), source.path.name
    _check_version(name, whole)
    try:
        variables = dict(_read_variables(whole, limit))
    except _DAMAGED as error:
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise SceneFileError(f"it is no .mat file that can be read: {why}", name) from None
    return {name: value for name, value in variables.items() if name}


def write_mat(path: FilePath, content: Mapping[str, Any]) -> Path:
    """Write variables to exactly `path` in MATLAB's format v7.

    `content` maps names to numbers, arrays, texts, or dictionaries for structs. Returns the path.
    Raises OSError.
    """
    from scipy.io import savemat  # slow import

    with whole_file(path) as file:
        savemat(file, dict(content), do_compression=True, oned_as="column", long_field_names=True)
    return file_path("path", path)


def _check_version(name: str, whole: bytes) -> None:
    """Raise SceneFileError if a .mat file has an unsupported version.

    `whole` contains the bytes of the file, and `name` is its name for the message.
    """
    cure = f"save it in MATLAB with save('{name}', ..., '-v7')"
    _, version, order = _HEADER.unpack(whole[: _HEADER.size].ljust(_HEADER.size))
    if whole[:8] == b"\x89HDF\r\n\x1a\n" or version in (b"\x00\x02", b"\x02\x00"):
        raise SceneFileError(f"it has MATLAB's format v7.3 (HDF5): {cure}", name)
    if order not in (b"IM", b"MI") or version not in (b"\x00\x01", b"\x01\x00"):
        cure = f"{cure}, in Octave with '-mat7-binary'"
        raise SceneFileError(f"it is no .mat file of version 5, 6 or 7: {cure}", name)


def _read_variables(whole: bytes, limit: int) -> Iterator[tuple[str, Any]]:
    """Yield names and values of all variables.

    `whole` contains the bytes of the file. `limit` is the largest number of decompressed bytes.
    Raises ValueError and others if the file is damaged.
    """
    left = limit
    order = "<" if _HEADER.unpack_from(whole)[-1] == b"IM" else ">"
    for kind, content in _read_elements(memoryview(whole)[_HEADER.size :], order):
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(content, 8)
            told = struct.unpack(order + "II", head)[1] + 8
            left -= told
            if left < 0:
                most = f"{limit / 1e9:.3g} GB, the limit for a file of its size"
                raise add_address(ValueError(f"it unpacks to more than {most}"))
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(content, told + 8)
            if not unpacking.eof:
                raise ValueError("a compressed variable is cut off, or longer than it says")
            for inner, inside in _read_elements(memoryview(unpacked), order):
                if inner == _MATRIX:
                    yield _read_matrix(inside, order, 0)
        elif kind == _MATRIX:
            yield _read_matrix(content, order, 0)


def _read_elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield types and contents of consecutive elements of a .mat file.

    Types are MATLAB's numeric codes. `order` is the byte order, "<" or ">". Raises ValueError if an
    element exceeds the data.
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


def _read_matrix(content: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Read the name and value of an array in a .mat file.

    `content` contains the array's bytes. `order` is the byte order as in `struct`, and `depth` the
    number of structs around the array. The value is None for other kinds of values. Raises
    ValueError and others if it is damaged.
    """
    if not len(content):
        return "", np.zeros((0, 0))
    if depth > DEEPEST:
        raise ValueError(f"structs are nested deeper than {DEEPEST} times")
    parts = list(_read_elements(content, order))
    flags = struct.unpack(order + "I", parts[0][1][:4])[0]
    form = flags & 0xFF
    if form not in (_STRUCT, _CHAR, _SPARSE, *_NUMERIC):
        has_name = len(parts) > 2 and form <= max(_NUMERIC)
        return bytes(parts[2][1]).decode("ascii", "replace") if has_name else "", None
    shape = tuple(np.frombuffer(parts[1][1], order + "i4").tolist())
    name = bytes(parts[2][1]).decode("ascii")
    if min(shape, default=-1) < 0:
        raise ValueError(f"{name} has shape {shape}")
    if form == _STRUCT:
        return name, _read_struct(parts[3:], order, depth) if shape == (1, 1) else None
    if form == _CHAR:
        is_text = math.prod(shape) in (0, *shape[1:]) and len(parts) > 3
        return name, _read_text(parts[3], order) if is_text else None
    if flags & _COMPLEX:
        return name, None
    if form == _SPARSE:
        return name, _read_sparse(parts[3:], order, shape)
    values = _read_numbers(parts[3], order)
    if math.prod(shape) != len(values):
        raise ValueError(f"{name} of shape {shape} holds {len(values)} numbers")
    return name, values.astype(float).reshape(shape, order="F")


def _read_numbers(part: tuple[int, memoryview], order: str) -> Any:
    kind, content = part
    if kind not in _NUMBERS:
        raise ValueError(f"numbers are of the unknown type {kind}")
    return np.frombuffer(content, order + _NUMBERS[kind])


def _read_text(part: tuple[int, memoryview], order: str) -> str:
    codec = _CODECS.get(part[0], "latin-1")
    if codec in ("utf-16", "utf-32"):
        codec += {"<": "-le", ">": "-be"}[order]
    return bytes(part[1]).decode(codec, "replace")


def _read_sparse(parts: list[tuple[int, memoryview]], order: str, shape: tuple[int, ...]) -> Any:
    rows, starts = (_read_numbers(part, order) for part in parts[:2])
    # Boolean values have one byte, whatever their type says
    is_boolean = len(parts[2][1]) == len(rows)
    values = np.frombuffer(parts[2][1], "u1") if is_boolean else _read_numbers(parts[2], order)
    count = int(starts[-1])
    if (
        len(shape) != 2
        or len(starts) != shape[1] + 1
        or not 0 <= count <= min(len(rows), len(values))
    ):
        raise ValueError(f"a sparse matrix of shape {shape} is inconsistent")
    data = values[:count].astype(float), rows[:count].astype(np.int64), starts.astype(np.int64)
    found = csc_array(data, shape=shape)
    found.check_format(full_check=True)  # wrong indices would make its methods read out of bounds
    return found


def _read_struct(parts: list[tuple[int, memoryview]], order: str, depth: int) -> dict[str, Any]:
    length = struct.unpack(order + "i", parts[0][1][:4])[0]
    names, values = bytes(parts[1][1]), parts[2:]
    if length < 1 or len(names) != length * len(values):
        sizes = f"{len(names)} characters of names, each {length} long, and {len(values)} values"
        raise ValueError(f"a struct has {sizes}")
    fields = {}
    for k, (kind, content) in enumerate(values):
        name = names[k * length : (k + 1) * length].split(b"\0")[0].decode("ascii")
        if kind != _MATRIX:
            raise ValueError(f"field {name} of a struct is of the unknown type {kind}")
        fields[name] = _read_matrix(content, order, depth + 1)[1]
    return fields
