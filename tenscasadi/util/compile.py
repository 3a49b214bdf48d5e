"""CasADi Functions as machine code, in double or single precision: C code from CasADi, the C compiler of the computer, a cache on disk."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import hashlib
import logging
import os
import platform
import re
import shlex
import shutil
import stat
import string
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np
import platformdirs

from tenscasadi.util.processes import run_program
from tenscasadi.util.validate import format_value, instance

T = TypeVar("T")
log = logging.getLogger(__name__)

# characters of C above which optimisation is cut short: compile time would grow with their square
_LONG = 1_000_000
_NO_CODE = re.compile(
    r"=\s*\{[^}]*\}|/\*.*?\*/", re.DOTALL
)  # constants, and comments that repeat them
# No fused multiply-add and no fast maths: compiled or not, the same formulas are rounded the same
# way.
# Hidden but for what CasADi marks as exported: else gcc may not inline a library's own helpers, and
# each square is a call.
_FLAGS = (
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-funroll-loops",
    "-fvisibility=hidden",
    "-DGCC_HASCLASSVISIBILITY",
)
_LIMIT = 500_000_000  # bytes of all libraries in the cache
# s since a library was used in which it is not removed: another process may be about to load it
_RECENT = 60.0
_ABANDONED = 86_400.0  # s after which what a compilation left behind is nobody's any more
_SECONDS = "TENSCASADI_COMPILE_SECONDS"
_QUICK = 20.0  # s for a compiler to say what it is
_NATIVE = "-march=native"  # 10 to 20 % faster
_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
_LIBRARY, _BUILD = re.compile(rf"-[0-9a-f]{{32}}{re.escape(_SUFFIX)}$"), "tenscasadi-build-"

# What CasADi reads of a library whose numbers' type shows; all else is the same for both.
_TYPED = ("", "_work", "_work_bytes", "_default_in", "_casadi_real_size")


@dataclass(frozen=True)
class Single:
    """Run as machine code that computes in single precision, as small processors do.

    Give it as `compiled` to `simulate`, or as `precision` to `export_c`. Numbers have some seven
    digits: each instruction rounds to ``float``, and so do states from step to step. Errors and
    energies of the result are computed from these states in double.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Single()
    Single()
    """


Compiled = (
    bool | Single | None
)  # how to run: True, as machine code; False, in CasADi's virtual machine; None, as there is a compiler


class CompileError(RuntimeError):
    """There is no C compiler, or it refused the code; the message holds what it said."""


class CompileTimeout(CompileError):
    """The compiler did not end in time."""


def find_compiler() -> tuple[str, ...] | None:
    """Return the C compiler as a command, None when there is none.

    It is what the environment variable CC names if that can be run, else cc, gcc or clang.
    """
    try:
        named = shlex.split(os.environ.get("CC", ""), posix=os.name != "nt")
    except ValueError:  # unbalanced quotes
        named = []
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        program = shutil.which(command[0]) if command else None
        if program:
            return (program, *command[1:])
    return None


def compile_function(
    function: ca.Function, flags: Sequence[str] | None = None, single: bool = False
) -> ca.Function:
    """Compile a CasADi Function to machine code.

    The library is kept in `cache_folder` under the hash of its source, the compiler, the flags,
    what these mean on this machine, and CasADi's version, so that it is compiled once. Any number
    of processes may do so at the same time. A library that is not as it was written, by the hash at
    its end, is not loaded but compiled again; what is loaded is a private copy of the bytes that
    were looked at. Libraries beyond 500 MB are removed, those first that have not been used for
    longest; what a process has loaded, it keeps.

    Parameters
    ----------
    function : casadi.Function
        What to compile; its derivatives are not included.
    flags : sequence of str, optional
        Flags for the compiler; by default optimised for this machine, and rounded as CasADi does.
    single : bool
        Whether to compute in float, see `Single`.

    Returns
    -------
    casadi.Function
        A Function with the same inputs, outputs and values.

    Raises
    ------
    TypeError
        For anything but a casadi.Function and strings.
    CompileError
        Where compilation fails, with the compiler's words, or takes more than
        $TENSCASADI_COMPILE_SECONDS, 600 unless set.
    """
    instance("function", function, ca.Function, "a casadi.Function")
    if flags is not None and (
        isinstance(flags, str) or not all(isinstance(flag, str) for flag in flags)
    ):
        raise TypeError(
            f'flags is {format_value(flags)}: give a sequence of strings, such as ("-O2",), or None'
        )
    compiler = find_compiler()
    if compiler is None:
        raise CompileError(
            "no C compiler found: install gcc or clang, or name one in the environment variable CC"
        )
    try:
        source = _c_code(function, single)
    except RuntimeError as error:
        raise CompileError(f"CasADi cannot write C code for {function}: {error}") from None
    return _load(
        compiler,
        flags,
        source,
        function.name(),
        ".c",
        lambda library: ca.external(function.name(), str(library)),
    )


def compile_library(
    name: str, source: str, suffix: str = ".cpp", *, build: bool = True
) -> ctypes.CDLL:
    """Compile C, or C++ that needs nothing of C++'s own library, by the C compiler, and load it; the cache keeps it as it does a Function's.

    suffix: ".c" or ".cpp". Without `build`, only the cache is looked at. Raises CompileError where
    there is no compiler, where it knows no C++ or refuses the code, or the cache has no library.
    """
    compiler = find_compiler()
    if compiler is None:
        raise CompileError(
            "no C compiler found: install gcc or clang, or name one in the environment variable CC"
        )
    return _load(
        compiler, None, source, name, suffix, lambda library: ctypes.CDLL(str(library)), build
    )


def _load(
    compiler: tuple[str, ...],
    flags: Sequence[str] | None,
    source: str,
    name: str,
    suffix: str,
    load: Callable[[Path], T],
    may_build: bool = True,
) -> T:
    """Return what `load` makes of the library of this source, compiled unless the cache holds it."""
    if flags is None:
        flags = (
            _default_flags(compiler)
            if len(_NO_CODE.sub("", source)) < _LONG
            else ("-O1", *_default_flags(compiler)[1:])
        )
    identity = (
        _identity(compiler, flags),
        platform.machine(),
        *flags,
        ca.CasadiMeta.version(),
        source,
    )
    key = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    library = cache_folder() / f"{name}-{key[:32]}{_SUFFIX}"
    reason: object = ""
    for build in (False, True) if may_build else (False,):
        try:
            code = (
                _build(compiler, flags, source, suffix, library, key)
                if build
                else _read_whole(library, key)
            )
            if build:
                _trim(library.parent)
            if code:
                return _load_copy(load, code, library)
        except (
            RuntimeError,
            OSError,
        ) as error:  # removed by another process, or damaged, for instance by a disk that was full
            if isinstance(error, CompileError):
                raise
            log.info("%s cannot be loaded: %s", library, error)
            reason = error
    if not may_build:
        raise CompileError(f"{library} is not in the cache")
    raise CompileError(f"{library} was compiled by {compiler[0]} but cannot be loaded: {reason}")


def cache_folder() -> Path:
    """Return the folder of compiled libraries, created if need be, which no other user can write to.

    It is $TENSCASADI_CACHE, else a folder `tenscasadi` in $XDG_CACHE_HOME or ~/.cache (Linux),
    ~/Library/Caches (macOS), %LOCALAPPDATA% (Windows). Libraries are code that will be run: where
    that folder belongs to another user, can be written by others, or cannot be made, this is a
    private temporary folder that lasts as long as the process.
    """
    try:
        folder = _preferred_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        reason = _distrust(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        reason = str(error)
    if not reason:
        return folder
    temporary = _temporary_folder(os.getpid())
    if not temporary.is_dir():  # swept away
        _temporary_folder.cache_clear()
        temporary = _temporary_folder(os.getpid())
    log.info("compiled code goes to %s for this process: %s", temporary, reason)
    return temporary


def _trim(folder: Path) -> None:
    """Remove libraries of this module, least recently used first, down to `_LIMIT`, and what compilations that were killed left behind."""
    now, found = time.time(), []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process has removed it
            status = path.stat()
            if _LIBRARY.search(
                path.name
            ):  # the folder is the user's choice: other files in it are not ours
                found.append((status.st_mtime, status.st_size, path))
            elif path.name.startswith(_BUILD) and now - status.st_mtime > _ABANDONED:
                shutil.rmtree(path, ignore_errors=True)
    excess = sum(size for _, size, _ in found) - _LIMIT
    for used, size, path in sorted(found):
        if excess <= 0 or now - used < _RECENT:
            return
        with contextlib.suppress(OSError):  # Windows: in use
            path.unlink(missing_ok=True)
            excess -= size


def _preferred_folder() -> Path:
    if named := os.environ.get("TENSCASADI_CACHE"):
        return Path(named).absolute()
    return platformdirs.user_cache_path("tenscasadi", appauthor=False, opinion=False).absolute()


def _distrust(path: Path) -> str:
    """Why a folder or library must not be used; empty when it may."""
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
    """Make a folder of this process alone: one that a fork shared would be removed by the first of both that ends."""
    folder = tempfile.mkdtemp(prefix="tenscasadi-")
    atexit.register(_remove_own, folder, process)
    return Path(folder)


def _remove_own(folder: str, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


@functools.cache
def _default_flags(compiler: tuple[str, ...]) -> tuple[str, ...]:
    try:
        _identity(compiler, (_NATIVE,))
    except CompileError:  # not every compiler knows its machine
        return _FLAGS
    return (*_FLAGS, _NATIVE)


@functools.cache
def _identity(compiler: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Tell this compiler from another by its path, arguments, and predefined macros, which hold its version and the processor's features."""
    macros = _run([*compiler, *flags, "-dM", "-E", "-x", "c", os.devnull], most=_QUICK)
    return "\n".join((os.path.realpath(compiler[0]), *compiler[1:], macros))


def _run(command: list[str], folder: Path | None = None, most: float = np.inf) -> str:
    """Return what a command prints; its temporary files go to `folder`. Raises CompileError, after `most` s at the latest."""
    seconds = min(most, _patience())
    own = {} if folder is None else dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    try:
        done = run_program(command, seconds, {**os.environ, "LC_ALL": "C", **own})
    except OSError as error:
        raise CompileError(f"{command[0]} cannot be run: {error}") from None
    except subprocess.TimeoutExpired:
        cure = f"set {_SECONDS} to wait longer, CC to another compiler, or give compiled=False"
        raise CompileTimeout(f"{command[0]} did not end within {seconds:g} s: {cure}") from None
    if done.returncode:
        raise CompileError(
            f"{shlex.join(command)} failed with code {done.returncode}:\n{done.stderr.strip()}"
        )
    return done.stdout


def _patience() -> float:
    """Return the time that a compilation may take, s."""
    told = os.environ.get(_SECONDS, "600")
    with contextlib.suppress(ValueError):
        if 0 < float(told) < np.inf:
            return float(told)
    raise CompileError(f"{_SECONDS} is {told!r}: give a number of seconds greater than 0")


def _seal(code: bytes, key: str) -> bytes:
    """Return the hash that ends a library: loading one that a full disk cut short, or that holds other code, would kill the process."""
    return hashlib.sha256(key.encode() + code).digest()


def _read_whole(library: Path, key: str) -> bytes:
    """Return what the cache holds, nothing where that is no library, or not as it was written."""
    if not library.is_file() or _distrust(library):
        return b""
    code = library.read_bytes()
    size = len(code) - len(_seal(b"", key))
    if size <= 0 or code[size:] != _seal(code[:size], key):
        return b""
    os.utime(library)  # used now
    return code


def _load_copy(load: Callable[[Path], T], code: bytes, library: Path) -> T:
    """Load a library from a copy of its bytes that nobody else knows of, and that is removed at once: a loaded library needs no name.

    Who alters or cuts the file in the cache, before or after it is loaded, would otherwise end this
    process.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(
                tempfile.TemporaryDirectory(
                    prefix=_BUILD, dir=library.parent, ignore_cleanup_errors=True
                )
            )
            copy = Path(folder) / library.name
            copy.write_bytes(code)
            copy.chmod(0o700)
        except OSError:  # no room for a copy
            copy = library
        return load(copy)


def _build(
    compiler: tuple[str, ...],
    flags: Sequence[str],
    source: str,
    suffix: str,
    library: Path,
    key: str,
) -> bytes:
    """Compile in a folder of its own, then move the library into place in one operation: no process ever sees half a file. Return it."""
    try:
        with tempfile.TemporaryDirectory(prefix=_BUILD, dir=library.parent) as folder:
            text, result = Path(folder) / f"code{suffix}", Path(folder) / library.name
            text.write_text(source, encoding="utf-8")
            position = [] if sys.platform == "win32" else ["-fPIC"]
            _run(
                [*compiler, *flags, *position, "-shared", "-o", str(result), str(text), "-lm"],
                Path(folder),
            )
            code = result.read_bytes()
            code += _seal(code, key)  # loaders do not mind what follows the code
            result.write_bytes(code)
            result.chmod(0o700)  # whatever the umask
            try:
                os.replace(result, library)
            except PermissionError:  # Windows: another process has just put it there and uses it
                if not library.exists():
                    raise
            return code
    except OSError as error:
        raise CompileError(f"{library} cannot be written: {error}") from error


def _c_code(function: ca.Function, single: bool = False) -> str:
    """Write `function` in C, for `casadi.external`; `single`: with float inside. Raises RuntimeError where CasADi cannot write C."""
    # Without comments: their numbers are printed as any part of the process has told CasADi to, and
    # the same code would be compiled again.
    generator = ca.CodeGenerator(
        function.name() + ".c", {"verbose": False} | ({"casadi_real": "float"} if single else {})
    )
    generator.add(function)
    return _behind_double(function, generator.dump()) if single else generator.dump()


def _behind_double(function: ca.Function, source: str) -> str:
    """Put the source under other names, then functions of the right names that round arguments to float and give results back as double."""
    name, inputs, outputs = function.name(), function.n_in(), function.n_out()
    renamed = [f"#define {name}{suffix} {name}_in_float{suffix}" for suffix in _TYPED]
    restored = [f"#undef {name}{suffix}" for suffix in _TYPED]
    shell = _SHELL.substitute(
        NAME=name,
        N_IN=inputs,
        N_OUT=outputs,
        SIZES_IN=", ".join(str(function.nnz_in(i)) for i in range(inputs)),
        SIZES_OUT=", ".join(str(function.nnz_out(i)) for i in range(outputs)),
        ROOM=function.nnz_in() + function.nnz_out(),
    )
    return "\n".join([*renamed, source, *restored, shell])


# A float takes no more room than a double, so that the work space of CasADi holds the copies too.
_SHELL = string.Template("""
CASADI_SYMBOL_EXPORT int ${NAME}_work(casadi_int *sz_arg, casadi_int *sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (${NAME}_in_float_work(sz_arg, sz_res, sz_iw, sz_w)) return 1;
  if (sz_arg) *sz_arg += ${N_IN};
  if (sz_res) *sz_res += ${N_OUT};
  if (sz_w) *sz_w += ${ROOM};
  return 0;
}

CASADI_SYMBOL_EXPORT int ${NAME}(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  static const casadi_int size_in[] = {${SIZES_IN}}, size_out[] = {${SIZES_OUT}};
  const float **given = (const float **)(arg + ${N_IN});
  float **found = (float **)(res + ${N_OUT}), *room = (float *)w;
  casadi_int i, k;
  for (i = 0; i < ${N_IN}; ++i) {
    given[i] = arg[i] ? room : 0;
    for (k = 0; arg[i] && k < size_in[i]; ++k) *room++ = (float)arg[i][k];
  }
  for (i = 0; i < ${N_OUT}; ++i) {
    found[i] = res[i] ? room : 0;
    if (res[i]) room += size_out[i];
  }
  if (${NAME}_in_float(given, found, iw, room, mem)) return 1;
  for (i = 0; i < ${N_OUT}; ++i) {
    for (k = 0; res[i] && k < size_out[i]; ++k) res[i][k] = (double)found[i][k];
  }
  return 0;
}
""")
