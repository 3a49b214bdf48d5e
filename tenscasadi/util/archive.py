"""Arrays in .npz files: written whole or not at all, and read without running what is in them."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
# Anything that reading a damaged or foreign archive may raise.
_UNREADABLE = (
    *(OSError, ValueError, TypeError, EOFError, KeyError, IndexError, RuntimeError, MemoryError, AttributeError, SyntaxError, OverflowError),
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
            raise ValueError(f"field {name!r} holds values of type {value.dtype}, shape {value.shape}")
        return value

    def within(self, prefix: str) -> Fields:
        """Return the fields whose names begin with `prefix`, without it."""
        return Fields({name.removeprefix(prefix): value for name, value in self.items() if name.startswith(prefix)})


def save(path: str | os.PathLike[str], form: str, content: Mapping[str, Any]) -> Path:
    """Write arrays by name, and `form` as the field "format", to exactly `path`, compressed, and return it.

    A file that was there stays as it is until the new one is complete. Raises OSError when it cannot be written.
    """
    target = Path(path)
    whole = Path(os.path.realpath(target))  # where a link leads to
    part = whole.with_name(f".{whole.name}.{os.getpid()}")
    try:
        with open(part, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, format=np.asarray(form), **content)
        os.replace(part, whole)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from None  # of the file, not of the one beside it
    finally:
        part.unlink(missing_ok=True)
    return target


def load(path: str | os.PathLike[str], form: str, kind: str, build: Callable[[Fields], T], names: Container[str] | None = None) -> T:
    """Return `build` of the arrays, by name, of a file that `save` wrote in this form; `names`: only these are opened.

    No code in the file is ever run. Raises FileNotFoundError, and ValueError naming the file, the `kind` of thing that it is not, and why;
    `build` says so with a ValueError, and all else that it raises passes.
    """
    refusal = f"{os.fspath(path)} is not a {kind}"
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            content = Fields({name: archive[name] for name in archive.files if names is None or name == "format" or name in names})
            if not all(isinstance(value, np.ndarray) for value in content.values()):
                raise ValueError("a file that holds no array")
    except FileNotFoundError:
        raise
    except (OSError, MemoryError) as error:
        raise ValueError(f"{refusal}: it cannot be read ({error})") from None
    except _UNREADABLE:  # NumPy's words would advise to allow pickles
        raise ValueError(f"{refusal}: it cannot be read, as tenscasadi did not save it or it is damaged") from None
    if str(content.pop("format", "")) != form:
        raise ValueError(f"{refusal}: its field 'format' is not {form!r}")
    try:
        return build(content)
    except ValueError as error:
        raise ValueError(f"{refusal}: {error}") from error
