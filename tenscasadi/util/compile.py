"""CasADi Functions as machine code, in double or single precision."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import re
import shlex
import shutil
import string
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from tenscasadi.util.casadi_tools import unroll_products
from tenscasadi.util.library_cache import SUFFIX, CompileError, cache_folder, load_library
from tenscasadi.util.processes import run_program
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import format_value, instance

__all__ = [
    "CompileError",
    "CompileTimeout",
    "Compiled",
    "Single",
    "compile_function",
    "compile_library",
    "find_compiler",
    "read_compiled",
]

T = TypeVar("T")

# characters of C above which -O1 is used: compile time at -O3 grows with their square
_LONG = 1_000_000
_NO_CODE = re.compile(r"=\s*\{[^}]*\}|/\*.*?\*/", re.DOTALL)  # tables of constants, and comments
# Without fused multiply-add and fast math, compiled and interpreted formulas are rounded alike.
# With hidden symbols gcc can inline the helper functions of a library, such as squares.
_FLAGS = (
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-funroll-loops",
    "-fvisibility=hidden",
    "-DGCC_HASCLASSVISIBILITY",
)
_NATIVE = "-march=native"  # 10 to 20 % faster
_TIME_LIMIT = "TENSCASADI_COMPILE_SECONDS"
_NO_COMPILER = (
    "no C compiler found: install gcc or clang, or name one in the environment variable CC"
)

# symbols of a library that depend on the type of its numbers
_TYPED = ("", "_work", "_work_bytes", "_default_in", "_casadi_real_size")


@dataclass(frozen=True)
class Single:
    """Machine code in single precision, as on small processors.

    Give it as `compiled` to `simulate`, or as `precision` to `export_c`. Each instruction and each
    step rounds to the C type ``float``, which has about seven digits. Errors and energies of the
    result are computed in double precision, from the states in single precision.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Single()
    Single()
    """


# True: machine code. False: CasADi's virtual machine. None: machine code if there is a compiler.
Compiled = bool | Single | None


class CompileTimeout(CompileError):
    """Raised if a compilation exceeds its time limit."""


def find_compiler() -> tuple[str, ...] | None:
    """Find the command of the C compiler, None without one.

    The environment variable CC comes first, then cc, gcc and clang.
    """
    windows = sys.platform == "win32"  # whose paths have backslashes
    try:
        words = shlex.split(os.environ.get("CC", ""), posix=not windows)
    except ValueError:  # unbalanced quotes
        words = []
    named = [word.strip('"') for word in words] if windows else words
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        program = shutil.which(command[0]) if command else None
        if program:
            return (program, *command[1:])
    return None


def read_compiled(field: str, value: Any) -> Compiled:
    """Check the choice whether to compile: True, False, None or `Single`.

    NumPy's booleans become Python's. Messages name `field`. Raises TypeError.
    """
    if value is None or isinstance(value, Single):
        return value
    instance(field, value, (bool, np.bool_), "True or False, None or Single()")
    return bool(value)


def compile_function(
    function: ca.Function, flags: Sequence[str] | None = None, single: bool = False
) -> ca.Function:
    """Compile a CasADi Function to machine code.

    The library is kept in `cache_folder` and compiled once. Its name has the hash of the source,
    the compiler, the flags with their meaning on this machine, and CasADi's version. Any number of
    processes can use the cache at the same time. A damaged library is compiled again. Above 500 MB
    the least recently used libraries are removed from disk.

    Parameters
    ----------
    function : casadi.Function
        Function to compile, without its derivatives.
    flags : sequence of str, optional
        Flags for the compiler. Default: optimized for this machine, with CasADi's rounding.
    single : bool
        Whether to compute in float, see `Single`.

    Returns
    -------
    casadi.Function
        Function with the same inputs, outputs and values.

    Raises
    ------
    TypeError
        If an argument is not a casadi.Function or not a sequence of strings.
    CompileError
        If the compilation fails, with the compiler's message, or takes longer than
        $TENSCASADI_COMPILE_SECONDS (default: 600).
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
        raise add_address(CompileError(_NO_COMPILER))
    try:
        source = _generate_c(function, single)
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
    """Compile and load C or C++ code, `source`.

    The library is cached as by `compile_function`, in a file that begins with `name`. The C
    compiler is used, so C++ code (suffix ".cpp") cannot use the C++ library. Without `build`, the
    library is only loaded from the cache. Raises CompileError if there is no compiler, it does not
    accept the code, or the cache does not have the library.
    """
    compiler = find_compiler()
    if compiler is None:
        raise add_address(CompileError(_NO_COMPILER))
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
    """Load the library of a source code from the cache, or compile it.

    `compiler` is the command, `flags` are its options (None: defaults), and `suffix` is the ending
    of the source file. The library file begins with `name`, and `load` loads it. Unless
    `may_build`, a missing library raises CompileError.
    """
    options = tuple(flags) if flags is not None else _choose_flags(compiler, source)
    identity = (
        _identify(compiler, options),
        platform.machine(),
        *options,
        ca.CasadiMeta.version(),
        source,
    )
    key = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    library = cache_folder() / f"{name}-{key[:32]}{SUFFIX}"

    def build(result: Path) -> None:
        if not may_build:
            raise CompileError(f"{library} is not in the cache")
        code = result.with_name(f"code{suffix}")
        code.write_text(source, encoding="utf-8")
        # on Windows all code is relocatable, and the C library has the mathematics
        position, libraries = ([], []) if sys.platform == "win32" else (["-fPIC"], ["-lm"])
        # the same code; GNU's headers of later standards take 0.1 s longer
        standard = ["-std=gnu++14"] if suffix == ".cpp" else []
        files = ["-shared", "-o", str(result), str(code), *libraries]
        run_compiler([*compiler, *options, *standard, *position, *files], result.parent)

    try:
        return load_library(library, key, build, load)
    except CompileError:
        raise
    except (RuntimeError, OSError) as error:
        raise CompileError(
            f"{library} was compiled by {compiler[0]} but cannot be loaded: {error}"
        ) from None


def _choose_flags(compiler: tuple[str, ...], source: str) -> tuple[str, ...]:
    flags = _default_flags(compiler)
    return flags if len(_NO_CODE.sub("", source)) < _LONG else ("-O1", *flags[1:])


@functools.cache
def _default_flags(compiler: tuple[str, ...]) -> tuple[str, ...]:
    try:
        _identify(compiler, (_NATIVE,))
    except CompileError:  # not every compiler knows its machine
        return _FLAGS
    return (*_FLAGS, _NATIVE)


@functools.cache
def _identify(compiler: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Identify a compiler by its path, arguments and predefined macros.

    The macros, for these `flags`, contain its version and the features of the processor.
    """
    command = [*compiler, *flags, "-dM", "-E", "-x", "c", os.devnull]
    macros = run_compiler(command)
    return "\n".join((os.path.realpath(compiler[0]), *compiler[1:], macros))


def run_compiler(command: list[str], folder: Path | None = None) -> str:
    """Run a command with its temporary files in `folder`.

    Returns its output. Raises CompileError, at the latest after the time limit of a compilation.
    """
    seconds = _read_time_limit()
    temporary = {} if folder is None else dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    try:
        done = run_program(command, seconds, {**os.environ, "LC_ALL": "C", **temporary})
    except OSError as error:
        raise CompileError(f"{command[0]} cannot be run: {error}") from None
    except subprocess.TimeoutExpired:
        cure = f"set {_TIME_LIMIT} to wait longer, CC to another compiler, or give compiled=False"
        raise add_address(
            CompileTimeout(f"{command[0]} did not end within {seconds:g} s: {cure}")
        ) from None
    if done.returncode:
        raise CompileError(
            f"{shlex.join(command)} failed with code {done.returncode}:\n{done.stderr.strip()}"
        )
    return done.stdout


def _read_time_limit() -> float:
    """Read the time limit of a compilation [s]."""
    given = os.environ.get(_TIME_LIMIT, "600")
    with contextlib.suppress(ValueError):
        if 0 < float(given) < np.inf:
            return float(given)
    raise CompileError(f"{_TIME_LIMIT} is {given!r}: give a number of seconds greater than 0")


def _generate_c(function: ca.Function, single: bool = False) -> str:
    """Generate C code of a CasADi Function for `casadi.external`.

    With `single`, it computes in single precision. Raises RuntimeError if CasADi cannot generate
    code.
    """
    # The comments have numbers in the process-wide format of CasADi, which would change the hash.
    options = {"verbose": False} | ({"casadi_real": "float"} if single else {})
    generator = ca.CodeGenerator(function.name() + ".c", options)
    generator.add(function)
    code = unroll_products(generator.dump())
    return _wrap_float(function, code) if single else code


def _wrap_float(function: ca.Function, source: str) -> str:
    """Wrap single-precision C code in a function with double arguments.

    `source` is the code of the CasADi Function. Returns code with both.
    """
    name, inputs, outputs = function.name(), function.n_in(), function.n_out()
    defines = [f"#define {name}{suffix} {name}_in_float{suffix}" for suffix in _TYPED]
    undefines = [f"#undef {name}{suffix}" for suffix in _TYPED]
    wrapper = _WRAPPER.substitute(
        NAME=name,
        N_IN=inputs,
        N_OUT=outputs,
        SIZES_IN=", ".join(str(function.nnz_in(i)) for i in range(inputs)),
        SIZES_OUT=", ".join(str(function.nnz_out(i)) for i in range(outputs)),
        ROOM=function.nnz_in() + function.nnz_out(),
    )
    return "\n".join([*defines, source, *undefines, wrapper])


# A float is not larger than a double, so the copies fit into CasADi's work space of doubles.
_WRAPPER = string.Template("""
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
