"""Atomic writes: a file is complete, or as it was."""

from __future__ import annotations

import errno
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tenscasadi.util.validate import file_path

_UNFINISHED = ".tenscasadi-"  # beginning of names of files that are being written


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a file that becomes exactly `path` if the block succeeds, see `whole_path`."""
    with whole_path(path) as part, open(part, "xb") as file:
        yield file


@contextmanager
def whole_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide the name of a file that becomes exactly `path` if the block succeeds.

    An existing file stays as it is until then, and after a failure. The name has the ending of
    `path`. Raises OSError if the file cannot be written, or `path` is no regular file, such as a
    device.
    """
    target = file_path("path", path)
    whole = Path(os.path.realpath(target))  # where a link leads to
    if (target.exists() or whole.is_symlink()) and not target.is_file():
        raise OSError(
            errno.EISDIR if target.is_dir() else errno.EINVAL,
            "Not a regular file, give another name",
            os.fspath(path),
        )
    _clean(whole.parent)
    part = whole.with_name(f"{_UNFINISHED}{uuid.uuid4().hex}{whole.suffix}")
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


def write_whole(path: str | os.PathLike[str], content: str) -> None:
    """Write a text to exactly `path`, see `whole_path`."""
    with whole_file(path) as file:
        file.write(content.encode())


def write_files(folder: Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts by file name into a folder, which is created, and return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in texts.items():
        write_whole(folder / name, content)
    return [folder / name for name in texts]


def _clean(folder: Path) -> None:
    """Remove the unfinished files of killed processes, an hour after their last write."""
    with suppress(OSError):
        for entry in os.scandir(folder):
            if entry.name.startswith(_UNFINISHED):
                with suppress(OSError):  # another process has removed it, or it is another user's
                    if time.time() - entry.stat(follow_symlinks=False).st_mtime > 3600:
                        os.unlink(entry)
