"""Cache of compiled libraries on disk, shared by processes."""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
log = logging.getLogger(__name__)

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
_LIBRARY = re.compile(rf"-[0-9a-f]{{32}}{re.escape(SUFFIX)}$")
_TEMPORARY = "tenscasadi-build-"
_LIMIT = 500_000_000  # bytes of all libraries in the cache
_IN_USE = 3600.0  # s in which another process may be building or about to load a library


class CompileError(RuntimeError):
    """Raised if a compilation fails, with the compiler's message."""


def load_library(
    library: Path, key: str, build: Callable[[Path], None], load: Callable[[Path], T]
) -> T:
    """Load a library from the cache, or build it.

    Parameters
    ----------
    library : Path
        File in `cache_folder`.
    key : str
        Hash of everything that the library depends on.
    build : callable
        Function of a path that compiles the library to it.
    load : callable
        Function of a path that loads the library from it.

    Returns
    -------
    object
        Result of `load`.

    Raises
    ------
    CompileError
        If the library cannot be compiled or written.
    RuntimeError, OSError
        If the new library cannot be loaded.
    """
    try:
        if code := _read_library(library, key):
            return _load_copy(load, code, library)
    except (RuntimeError, OSError) as error:  # another process removed it, or it is damaged
        log.info("%s cannot be loaded: %s", library, error)
    code = _build_library(library, key, build)
    _trim(library.parent)
    return _load_copy(load, code, library)


def cache_folder() -> Path:
    """Find or create the folder of compiled libraries.

    It is $TENSCASADI_CACHE, or a folder `tenscasadi` in $XDG_CACHE_HOME or ~/.cache (Linux),
    ~/Library/Caches (macOS) or %LOCALAPPDATA% (Windows). Libraries are code that will be executed,
    so other users must not be able to write to the folder. If they can, or if the folder cannot be
    created, a private temporary folder of this process takes its place.
    """
    try:
        folder = _choose_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        reason = _explain_distrust(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        reason = str(error)
    if not reason:
        return folder
    temporary = _temporary_folder(os.getpid())
    if not temporary.is_dir():  # removed by a cleaner of temporary files
        _temporary_folder.cache_clear()
        temporary = _temporary_folder(os.getpid())
    log.info("compiled code goes to %s for this process: %s", temporary, reason)
    return temporary


def _choose_folder() -> Path:
    if named := os.environ.get("TENSCASADI_CACHE"):
        return Path(named).absolute()
    import platformdirs  # needed once in a process

    return platformdirs.user_cache_path("tenscasadi", appauthor=False, opinion=False).absolute()


def _explain_distrust(path: Path) -> str:
    """Explain why a file is untrusted, "" if trusted.

    `path` is a file or folder. It is trusted if only this user can write to it.
    """
    if sys.platform == "win32":
        return "" if os.access(path, os.W_OK) else f"{path} cannot be written"
    status = path.stat()
    if status.st_uid != os.getuid():
        return f"{path} belongs to another user"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"{path} can be written by other users"
    return "" if os.access(path, os.W_OK | os.X_OK) else f"{path} cannot be written"


@functools.cache
def _temporary_folder(process: int) -> Path:
    """Create the temporary folder of a process, given by its id.

    Forked processes have folders of their own, because each process removes its folder at its end.
    """
    folder = tempfile.mkdtemp(prefix="tenscasadi-")
    atexit.register(_remove_own, folder, process)
    return Path(folder)


def _remove_own(folder: str, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


def _compute_seal(code: bytes, key: str) -> bytes:
    """Compute the checksum at the end of a library file.

    `code` is the content before, and `key` the hash in `load_library`. Loading a library that is
    truncated or has other code would kill the process.
    """
    return hashlib.sha256(key.encode() + code).digest()


def _read_library(library: Path, key: str) -> bytes:
    """Read the content of a library file in the cache.

    `key` is the hash in `load_library`. Returns b"" if the file is missing, untrusted or damaged.
    """
    if not library.is_file() or _explain_distrust(library):
        return b""
    code = library.read_bytes()
    size = len(code) - len(_compute_seal(b"", key))
    if size <= 0 or code[size:] != _compute_seal(code[:size], key):
        return b""
    os.utime(library)  # marks it as used now
    return code


def _build_library(library: Path, key: str, build: Callable[[Path], None]) -> bytes:
    """Build a library and move it into the cache.

    The arguments are those of `load_library`. The move is atomic. Returns the content of the file.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=_TEMPORARY, dir=library.parent) as folder:
            result = Path(folder) / library.name
            build(result)
            code = result.read_bytes()
            code += _compute_seal(code, key)  # loaders ignore bytes after the code
            result.write_bytes(code)
            result.chmod(0o700)  # whatever the umask
            try:
                os.replace(result, library)
            except PermissionError:  # Windows: another process has written and loaded it
                if not library.exists():
                    raise
            return code
    except OSError as error:
        raise CompileError(f"{library} cannot be written: {error}") from error


def _load_copy(load: Callable[[Path], T], code: bytes, library: Path) -> T:
    """Load a library from a private temporary copy.

    `code` is the content of the file `library`, and `load` loads a library from a path. If the file
    in the cache were loaded, a later change of it would kill the process.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(
                tempfile.TemporaryDirectory(
                    prefix=_TEMPORARY, dir=library.parent, ignore_cleanup_errors=True
                )
            )
            copy = Path(folder) / library.name
            copy.write_bytes(code)
            copy.chmod(0o700)
        except OSError:  # the disk is full
            copy = library
        return load(copy)


def _trim(folder: Path) -> None:
    """Remove the least recently used libraries until the cache is small.

    The limit is `_LIMIT`. Temporary folders of killed processes are removed, too. Other files in
    the folder belong to the user.
    """
    now, found = time.time(), []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process has removed it
            status = path.stat()
            if _LIBRARY.search(path.name):
                found.append((status.st_mtime, status.st_size, path))
            elif path.name.startswith(_TEMPORARY) and now - status.st_mtime > _IN_USE:
                shutil.rmtree(path, ignore_errors=True)
    excess = sum(size for _, size, _ in found) - _LIMIT
    for used, size, path in sorted(found):
        if excess <= 0 or now - used < _IN_USE:
            return
        with contextlib.suppress(OSError):  # Windows: in use
            path.unlink(missing_ok=True)
            excess -= size
