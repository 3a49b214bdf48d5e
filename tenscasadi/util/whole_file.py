"""Atomic writes: a file is either complete or unchanged."""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tenscasadi.util.validate import FilePath, file_path

_UNFINISHED = ".tenscasadi-"  # prefix of temporary files


@contextmanager
def whole_file(path: FilePath) -> Iterator[BinaryIO]:
    """Open the file `path`, which is written atomically, see `whole_path`."""
    with whole_path(path) as part, open(part, "xb") as file:
        yield file


@contextmanager
def whole_path(path: FilePath) -> Iterator[Path]:
    """Provide a temporary name for an atomic write.

    The file becomes exactly `path` if the block succeeds. Until then, and after a failure, an
    existing file stays unchanged. The temporary name has the suffix of `path`. Raises OSError if
    the file cannot be written, or `path` is not a regular file, such as a device.
    """
    target = file_path("path", path)
    whole = Path(os.path.realpath(target))  # where a link leads to
    if (target.exists() or whole.is_symlink()) and not target.is_file():
        raise OSError(
            errno.EISDIR if target.is_dir() else errno.EINVAL,
            "Not a regular file: give another name",
            os.fspath(path),
        )
    _clean(whole.parent)
    part = whole.with_name(f"{_UNFINISHED}{os.urandom(16).hex()}{whole.suffix}")
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())  # its name must not be on disk before its content is
        if whole.exists():
            shutil.copymode(whole, part)
        os.replace(part, whole)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(
            error.errno, error.strerror, os.fspath(path)
        ) from None  # of the file, not of the one beside it
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: FilePath, content: str) -> None:
    """Write the text `content` to exactly `path` atomically."""
    with whole_file(path) as file:
        file.write(content.encode())


def write_files(folder: Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts by file name into a folder.

    The folder is created if necessary. Returns the paths.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in texts.items():
        write_whole(folder / name, content)
    return [folder / name for name in texts]


def _clean(folder: Path) -> None:
    """Remove temporary files of killed processes, after an hour."""
    with suppress(OSError):
        for entry in os.scandir(folder):
            if entry.name.startswith(_UNFINISHED):
                with suppress(OSError):  # another process has removed it, or it is another user's
                    if time.time() - entry.stat(follow_symlinks=False).st_mtime > 3600:
                        os.unlink(entry)
