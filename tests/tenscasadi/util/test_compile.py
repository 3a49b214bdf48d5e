"""Compiled Functions: the same numbers, one compilation, and safety of the cache."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.util import compile as compiled
from tenscasadi.util import library_cache
from tenscasadi.util.compile import (
    CompileError,
    compile_function,
    compile_library,
    find_compiler,
    read_compiled,
)
from tenscasadi.util.library_cache import cache_folder

pytestmark = pytest.mark.usefixtures("users_compiler")
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX permissions")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "deep" / "cache"
    monkeypatch.setenv("TENSCASADI_CACHE", str(folder))
    return folder


@pytest.fixture
def count(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The commands that build a library, as they are run.

    Runs of earlier tests may still compile, in threads of their own.
    """
    commands: list[str] = []
    original, here = compiled.run_compiler, threading.current_thread()

    def run(command: list[str], *options: Any, **named: Any) -> str:
        if "-shared" in command and threading.current_thread() is here:
            commands.append(" ".join(command))
        return original(command, *options, **named)

    monkeypatch.setattr(compiled, "run_compiler", run)
    return commands


def function(name: str = "f", factor: float = 2.0) -> ca.Function:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 0)
    return ca.Function(
        name,
        [x, u],
        [factor * ca.sin(x) / ca.sqrt(x) + ca.fmax(x, 0.3) * x**3, ca.dot(x, x)],
        ["x", "u"],
        ["y", "z"],
    )


@needs_compiler
def test_same_numbers_and_names() -> None:
    f = function()
    g = compile_function(f)
    assert g.is_a("External")
    assert (g.name_in(), g.name_out(), g.name()) == (f.name_in(), f.name_out(), f.name())
    assert [g.size_in(i) for i in range(2)] == [(3, 1), (0, 1)]
    x = np.random.default_rng(0).uniform(0.1, 9, size=3)
    for ours, theirs in zip(g(x, []), f(x, []), strict=True):
        assert np.allclose(np.array(ours), np.array(theirs), rtol=4e-16, atol=0)
    assert np.isnan(float(g([np.nan, 1, 1], [])[1]))


@needs_compiler
@pytest.mark.parametrize("single", [False, True])
def test_products_with_sparse_matrices_are_exact(single: bool) -> None:
    """Columns with 1 to 10 entries; the products are whole numbers."""
    rng = np.random.default_rng(0)
    sparse = np.array([rng.permutation(12) < k for k in range(1, 11)]).T * rng.integers(
        1, 9, (12, 10)
    )
    x, y = ca.MX.sym("x", 7, 12), ca.MX.sym("y", ca.sparsify(ca.DM(sparse)).sparsity())
    function = ca.Function("product", [x, y], [x @ y])
    assert "x3[i] * y3" in compiled._generate_c(function, single)
    dense = rng.integers(-9, 9, (7, 12))
    product = compile_function(function, single=single)(dense, sparse)
    assert np.array_equal(product.full(), dense @ sparse)


@needs_compiler
def test_compiled_once(cache: Path, count: list[str]) -> None:
    compile_function(function())
    compile_function(function())
    assert len(count) == 1
    assert len(list(cache.iterdir())) == 1  # nothing but the library is left behind
    compile_function(function(factor=3.0))
    compile_function(function(), flags=("-O0",))
    compile_function(
        function(), flags=("-O0", "-fno-tree-vectorize")
    )  # a flag that no macro tells of
    assert len(count) == 4
    assert float(compile_function(function(factor=3.0))([1, 1, 1], [])[0][0]) == pytest.approx(
        3 * np.sin(1) + 1
    )


@needs_compiler
@posix
def test_cache_is_private(cache: Path) -> None:
    before = os.umask(0)
    try:
        compile_function(function())
    finally:
        os.umask(before)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert all(not stat.S_IMODE(path.stat().st_mode) & 0o022 for path in cache.iterdir())


@needs_compiler
@posix
def test_a_folder_that_others_can_write_is_not_used(cache: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    assert float(compile_function(function())([1, 1, 1], [])[1]) == 3
    assert list(cache.iterdir()) == []
    assert stat.S_IMODE(cache_folder().stat().st_mode) == 0o700


@posix
def test_a_folder_of_another_user_is_not_used(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.mkdir(parents=True, mode=0o700)
    assert cache_folder() == cache
    monkeypatch.setattr(os, "getuid", lambda: cache.stat().st_uid + 1)
    assert cache_folder() != cache


def test_a_folder_that_cannot_be_made_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path / "file" / "cache"))
    folder = cache_folder()
    assert folder.is_dir()
    assert tmp_path not in folder.parents


@posix
def test_temporary_folders_belong_to_one_process_and_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A forked process that ends must not take its parent's folder along, nor must who sweeps old files away."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path / "file" / "cache"))
    code = """
import os, sys
from tenscasadi.util.library_cache import cache_folder
own = cache_folder()
child = os.fork()
if not child:
    other = cache_folder()
    assert other != own and other.is_dir()
    sys.exit()
assert os.waitpid(child, 0)[1] == 0
assert own.is_dir() and cache_folder() == own
own.rmdir()
print(cache_folder().is_dir(), cache_folder())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    again, _, folder = done.stdout.strip().partition(" ")
    assert again == "True"
    assert not Path(folder).exists()


def test_the_users_cache_is_the_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TENSCASADI_CACHE")
    name = {"win32": "LOCALAPPDATA", "darwin": "HOME"}.get(sys.platform, "XDG_CACHE_HOME")
    monkeypatch.setenv(name, str(tmp_path))
    assert cache_folder().name == "tenscasadi"
    assert tmp_path in cache_folder().parents


@needs_compiler
@posix
def test_damaged_and_planted_libraries_are_replaced(cache: Path, count: list[str]) -> None:
    compile_function(function("g"))
    (library,) = cache.iterdir()
    library.unlink()  # loaded code stays: the new file is another one
    library.write_bytes(b"not a library")
    library.chmod(0o700)
    assert float(compile_function(function("g"))([1, 1, 1], [])[1]) == 3
    library.chmod(0o777)
    assert float(compile_function(function("g"))([1, 1, 1], [])[1]) == 3
    assert len(count) == 3
    assert stat.S_IMODE(library.stat().st_mode) == 0o700


def flipped(content: bytes, place: int) -> bytes:
    return content[:place] + bytes([content[place] ^ 0x40]) + content[place + 1 :]


@needs_compiler
def test_libraries_that_are_not_as_they_were_written_are_compiled_again(
    cache: Path, count: list[str]
) -> None:
    f = function("p")
    compile_function(f, ("-O0",))
    (library,) = cache.iterdir()
    whole = library.read_bytes()
    size = len(whole)
    compile_function(function("p", factor=5.0), ("-O0",))
    (other,) = set(cache.iterdir()) - {library}
    cut = [whole[:k] for k in (0, 1, 32, 100, 4096, size // 2, size - 33, size - 32, size - 1)]
    changed = [flipped(whole, k) for k in (0, 17, size // 3, size // 2, size - 40, size - 1)]
    poisoned = [
        *cut,
        *changed,
        bytes(size),
        whole + b"x",
        other.read_bytes(),
    ]  # loading some of these would end this process
    for k, content in enumerate(poisoned):
        library.unlink()
        library.write_bytes(content)
        library.chmod(0o700)
        assert float(compile_function(f, ("-O0",))([1, 1, 1], [])[0][0]) == pytest.approx(
            2 * np.sin(1) + 1
        )
        assert len(count) == k + 3
    assert library.read_bytes()[:4] == whole[:4]
    compile_function(f, ("-O0",))
    assert len(count) == len(poisoned) + 2
    assert len(list(cache.iterdir())) == 2


@needs_compiler
@posix
def test_a_fifo_under_the_name_of_a_library_is_replaced(cache: Path) -> None:
    compile_function(function("q"))
    (library,) = cache.iterdir()
    library.unlink()
    os.mkfifo(library, 0o700)
    assert float(compile_function(function("q"))([1, 1, 1], [])[1]) == 3
    assert library.is_file()


FULL = """
import resource
import tenscasadi as tc
model = tc.Model(tc.Scene(tc.shapes.pendulum()))
for size in (20_000, 1000):  # bytes that a file may have: less than the library, less than the source
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    run = tc.simulate(model, 0.01, 0.001)
    assert run.success and not run.compiled, run.message
    try:
        tc.simulate(model, 0.01, 0.001, compiled=True)
    except tc.CompileError as error:
        assert "cannot be written" in str(error) or "failed with code" in str(error), error
    else:
        raise AssertionError(size)
"""


@needs_compiler
@posix
def test_a_full_disk_leaves_nothing_and_the_run_goes_on(cache: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(compiled.__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", FULL],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    # the model's library fits and is complete; the engine's does not, and nothing else is left
    assert {path.name.partition("-")[0] for path in cache.iterdir()} <= {"model"}
    assert all(path.is_file() for path in cache.iterdir())


# --- its size ---


def library(cache: Path, name: str, age: float, size: int = 100) -> Path:
    """A file of the cache last used `age` s ago."""
    path = cache / name
    path.write_bytes(b"x" * size)
    os.utime(path, (time.time() - age,) * 2)
    return path


@needs_compiler
@pytest.mark.parametrize(
    ("limit", "kept"),
    [(10**6, "old older newer recent"), (450_000, "newer recent"), (100_000, "recent")],
)
def test_the_cache_has_a_limit(
    cache: Path, monkeypatch: pytest.MonkeyPatch, limit: int, kept: str
) -> None:
    monkeypatch.setattr(library_cache, "_LIMIT", limit)
    cache_folder()
    ages = {
        "newer": 20_000,
        "old": 40_000,
        "recent": 1,
        "older": 30_000,
    }  # what is recent, another process may be loading
    files = {
        name: library(cache, f"{name}-{'a' * 32}{library_cache.SUFFIX}", age, 200_000)
        for name, age in ages.items()
    }
    others = [
        library(cache, f"lib{name}", 90_000, 10**6)
        for name in ("-mine", f"-{'g' * 32}{library_cache.SUFFIX}", f"{library_cache.SUFFIX}")
    ]
    f = compile_function(function())
    assert float(f([1, 1, 1], [])[1]) == 3
    assert {name for name, path in files.items() if path.exists()} == set(kept.split())
    assert all(path.exists() for path in others)


@needs_compiler
def test_use_keeps_a_library_in_the_cache(
    cache: Path, monkeypatch: pytest.MonkeyPatch, count: list[str]
) -> None:
    cache_folder()
    compile_function(function("g"))
    (used,) = cache.iterdir()
    os.utime(used, (0, 0))
    unused = library(cache, f"f-{'0' * 32}{library_cache.SUFFIX}", 10_000)
    compile_function(function("g"))
    monkeypatch.setattr(library_cache, "_LIMIT", 50)
    compile_function(function("h"))
    assert used.exists()
    assert not unused.exists()
    assert len(count) == 2


@needs_compiler
@posix
def test_a_library_that_is_removed_still_serves_and_is_compiled_again(
    cache: Path, monkeypatch: pytest.MonkeyPatch, count: list[str]
) -> None:
    loaded = compile_function(function())
    (path,) = cache.iterdir()
    path.unlink()
    assert float(loaded([1, 1, 1], [])[1]) == 3
    monkeypatch.setattr(
        library_cache, "_trim", lambda folder: path.unlink()
    )  # as another process may
    assert float(compile_function(function())([1, 1, 1], [])[1]) == 3
    assert len(count) == 2
    assert not path.exists()


@needs_compiler
def test_what_killed_compilations_left_is_removed(cache: Path) -> None:
    cache_folder()
    left, busy = cache / "tenscasadi-build-1", cache / "tenscasadi-build-2"
    for folder, age in ((left, 2 * 86_400), (busy, 60)):
        folder.mkdir()
        library(folder, "code.c", age)
        os.utime(folder, (time.time() - age,) * 2)
    compile_function(function())
    assert not left.exists()
    assert busy.exists()


PROCESS = """
import sys, time, casadi as ca
from tenscasadi.util.compile import compile_function
x = ca.SX.sym("x", 40)
y = x
for k in range(15):
    y = ca.sin(y) + k * x
f = ca.Function("busy", [x], [y])
while time.time() < float(sys.argv[1]):
    time.sleep(0.001)
g = compile_function(f)
assert abs(float(ca.norm_inf(g(0.1) - f(0.1)))) < 1e-12
"""


@needs_compiler
def test_processes_may_compile_at_the_same_time(cache: Path) -> None:
    start = str(time.time() + 1.5)
    root = str(Path(compiled.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, start],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    for process in processes:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    assert len(list(cache.iterdir())) == 1


POISONERS = """
import os, random, sys, casadi as ca
from tenscasadi.util.compile import compile_function
from tenscasadi.util.library_cache import cache_folder
draw = random.Random(int(sys.argv[1]))
x = ca.SX.sym("x", 3)
for k in range(25):
    f = ca.Function(f"f{draw.randrange(3)}", [x], [ca.sin(x) * draw.randrange(1, 3)])
    g = compile_function(f, ("-O0",))
    for path in list(cache_folder().glob("f*")):
        try:
            content = path.read_bytes()
            damaged = draw.choice([content[: len(content) // 2], b"", content[:-1], content.replace(b"a", b"b"), bytes(len(content))])
            if draw.random() < 0.5:
                path.write_bytes(damaged)  # in place
            else:
                poison = path.with_name(f"poison{os.getpid()}")
                poison.write_bytes(damaged)
                poison.chmod(0o700)
                os.replace(poison, path)
        except OSError:
            pass
    assert abs(float(ca.norm_inf(g(0.1) - f(0.1)))) < 1e-12
"""


@needs_compiler
@posix
@pytest.mark.slow
def test_eight_processes_survive_that_their_libraries_are_poisoned(cache: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(compiled.__file__).parents[2])}
    commands = [[sys.executable, "-c", POISONERS, str(k)] for k in range(8)]
    processes = [
        subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        for command in commands
    ]
    for process in processes:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors


@needs_compiler
@posix
def test_a_library_that_is_replaced_once_it_was_looked_at_is_not_loaded(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    f = function("race")
    compile_function(f, ("-O0",))
    (library,) = cache.iterdir()
    compile_function(function("race", factor=5.0), ("-O0",))
    (other,) = set(cache.iterdir()) - {library}
    original = library_cache._read_library

    def then(path: Path, key: str) -> bytes:
        code = original(path, key)
        library.unlink()
        library.write_bytes(other.read_bytes())
        library.chmod(0o700)
        return code

    monkeypatch.setattr(library_cache, "_read_library", then)
    assert float(compile_function(f, ("-O0",))([1, 1, 1], [])[0][0]) == pytest.approx(
        2 * np.sin(1) + 1
    )


@needs_compiler
@posix
def test_a_loaded_library_outlives_its_file(cache: Path) -> None:
    loaded = compile_function(function("cut"), ("-O0",))
    (library,) = cache.iterdir()
    os.truncate(library, 0)  # what is mapped from it would be gone
    assert float(loaded([1, 1, 1], [])[1]) == 3


@posix
def test_cc_names_the_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert find_compiler() is None
    with pytest.raises(CompileError, match="no C compiler found"):
        compile_function(function())
    own = tmp_path / "owncc"
    own.write_text("#!/bin/sh\necho broken as it is >&2\nexit 3\n")
    own.chmod(0o700)
    monkeypatch.setenv("CC", "owncc -extra")
    assert find_compiler() == (str(own), "-extra")
    with pytest.raises(CompileError, match=r"owncc .*code 3:\nbroken as it is"):
        compile_function(function())
    for unusable in ("nowhere", 'unbalanced "', ""):
        monkeypatch.setenv("CC", unusable)
        assert find_compiler() is None
    (tmp_path / "gcc").write_text("#!/nowhere/at/all\n")
    (tmp_path / "gcc").chmod(0o700)
    with pytest.raises(CompileError, match="gcc cannot be run"):
        compile_function(function())


HANGING = """#!/bin/sh
case "$*" in *-dM*) exec cc "$@";; esac
sleep 300 &
echo $$ $! > "$WITNESS"
wait
"""


def wait_for(happened: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.02)


def gone(pid: int) -> bool:
    """Whether a process has ended; one that waits for its parent to hear of it has."""
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rsplit(")", 1)[1].split()[0] == "Z"


@pytest.fixture
def hanging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file into which a compiler that never ends writes its processes."""
    own, witness = tmp_path / "slowcc", tmp_path / "pids"
    own.write_text(HANGING)
    own.chmod(0o700)
    monkeypatch.setenv("CC", str(own))
    monkeypatch.setenv("WITNESS", str(witness))
    return witness


@needs_compiler
@linux
def test_a_compiler_that_hangs_is_ended_with_all_that_it_started(
    hanging: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TENSCASADI_COMPILE_SECONDS", "0.5")
    with pytest.raises(
        CompileError,
        match=r"slowcc did not end within 0\.5 s: set TENSCASADI_COMPILE_SECONDS .* or give compiled=False",
    ):
        compile_function(function())
    wait_for(lambda: all(gone(int(pid)) for pid in hanging.read_text().split()))
    assert list(cache.iterdir()) == []
    run = tc.simulate(tc.Model(tc.Scene(tc.shapes.pendulum())), 0.01, 0.001)
    assert run.success
    for wrong in ("soon", "0", "nan"):
        monkeypatch.setenv("TENSCASADI_COMPILE_SECONDS", wrong)
        with pytest.raises(
            CompileError,
            match=rf"TENSCASADI_COMPILE_SECONDS is '{wrong}': give a number of seconds",
        ):
            compile_function(function())


INTERRUPTED = """
import signal
import subprocess
import sys
import time
import casadi as ca
from tenscasadi.util.compile import compile_function
signal.signal(signal.SIGINT, signal.default_int_handler)
start = subprocess.Popen.__init__
def late(self, *given, **named):
    start(self, *given, **named)
    time.sleep(float(sys.argv[1]))
subprocess.Popen.__init__ = late
x = ca.SX.sym("x")
try:
    compile_function(ca.Function("f", [x], [2 * x]))
except KeyboardInterrupt:
    print("interrupted")
"""


@needs_compiler
@linux
@pytest.mark.parametrize("late", ["0", "2"], ids=["while it runs", "when it has just begun"])
def test_ctrl_c_during_a_compilation_leaves_nothing(late: str, hanging: Path, cache: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(compiled.__file__).parents[2])}
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, late],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    wait_for(lambda: hanging.exists() and len(hanging.read_text().split()) == 2)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=30)
    assert (told.strip(), process.returncode) == ("interrupted", 0)
    wait_for(lambda: all(gone(int(pid)) for pid in hanging.read_text().split()))
    assert list(cache.iterdir()) == []


@needs_compiler
def test_what_the_compiler_says_is_passed_on(cache: Path) -> None:
    with pytest.raises(CompileError, match="no-such-flag"):
        compile_function(function(), flags=("-fno-such-flag",))
    assert list(cache.iterdir()) == [] if cache.exists() else True


@needs_compiler
def test_what_has_no_c_code_is_refused() -> None:
    x = ca.MX.sym("x")
    finder = ca.rootfinder(
        "finder", "newton", {"x": x, "g": x * x - 2}, {"linear_solver": "lapacklu"}
    )
    with pytest.raises(CompileError, match="finder"):
        compile_function(finder)


@pytest.mark.parametrize(
    ("argument", "value"), [("function", 3), ("flags", "-O2"), ("flags", (2,))]
)
def test_wrong_types_are_refused(argument: str, value: object) -> None:
    arguments = {"function": function(), "flags": ("-O0",)} | {argument: value}
    with pytest.raises(TypeError, match=argument):
        compile_function(**arguments)  # type: ignore[arg-type]


def test_large_constants_do_not_cost_optimisation(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels: list[str] = []

    original = compiled.run_compiler

    def stop(command: list[str], *options: Any, **named: Any) -> str:
        if "-shared" not in command:
            return original(command, *options, **named)
        levels.extend(flag for flag in command if flag.startswith("-O"))
        raise CompileError("not built")

    monkeypatch.setattr(compiled, "run_compiler", stop)
    x, a = ca.MX.sym("x", 200_000), ca.SX.sym("a")
    long = a
    for k in range(20_000):
        long = ca.sin(long) * (a + k)
    order = np.random.default_rng(0).permutation(
        200_000
    )  # printed as a constant and, once more, in a comment
    constants = [x * np.linspace(0.1, 0.7, len(order)), x[order.tolist()]]
    for function in (ca.Function("constants", [x], constants), ca.Function("code", [a], [long])):
        with pytest.raises(CompileError, match="not built"):
            compile_function(function)
    assert levels == ["-O3", "-O1"]


@needs_compiler
def test_a_function_is_computed_in_float_and_called_in_double() -> None:
    x, k, m = ca.SX.sym("x", 3), ca.SX.sym("k"), ca.SX.sym("m", ca.Sparsity.upper(2))
    function = ca.Function(
        "f", [x, k, m], [x / k, ca.sum1(x) * m], ["x", "k", "m"], ["part", "more"]
    )
    single = compile_function(function, single=True)
    assert (single.name_in(), single.name_out(), single.sparsity_out(1)) == (
        function.name_in(),
        function.name_out(),
        function.sparsity_out(1),
    )
    values = np.array([1.0, 2.0, 1e-3])
    part, more = single(values, 3.0, ca.DM(ca.Sparsity.upper(2), [1.0, 0.1, -1.0]))
    narrow = values.astype(np.float32)
    assert np.array_equal(part.full().ravel(), (narrow / np.float32(3)).astype(float))
    assert more[0, 1] == float((narrow[0] + narrow[1] + narrow[2]) * np.float32(0.1))
    assert np.isinf(float(single(values, 1e-60, m.sparsity())[0][0]))  # no float is as small
    buffer, run = single.buffer()  # as the loop does, which leaves out what it does not need
    out = np.zeros(3)
    buffer.set_arg(0, values.data)
    buffer.set_arg(1, np.array([3.0]).data)
    buffer.set_res(0, out.data)
    run()
    assert np.array_equal(out, part.full().ravel())


@needs_compiler
def test_cpp_is_compiled_once_and_sealed(
    cache: Path, count: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = (
        "template <int n> int number() { return n; }\n"
        'extern "C" __attribute__((visibility("default"))) int answer(void) { return number<42>(); }'
    )
    assert [compile_library("answer", source).answer() for _ in range(2)] == [42, 42]
    assert len(count) == 1
    (library,) = cache.glob("answer-*")
    whole = library.read_bytes()
    library.unlink()
    library.write_bytes(whole[: len(whole) // 2])  # as a full disk leaves it
    library.chmod(0o700)
    assert compile_library("answer", source).answer() == 42
    assert len(count) == 2
    with pytest.raises(CompileError, match="failed with code 1"):
        compile_library("answer", "class {")
    monkeypatch.setattr(compiled, "find_compiler", lambda: None)
    with pytest.raises(CompileError, match="no C compiler found"):
        compile_library("answer", source)


def test_how_a_process_prints_numbers_does_not_change_its_code() -> None:
    x = ca.MX.sym("x", 3)
    function = ca.Function("third", [x], [ca.sin(x) * (1 / 3)])
    before = compiled._generate_c(function)
    try:
        ca.DM.set_precision(14)
        assert compiled._generate_c(function) == before
    finally:
        ca.DM.set_precision(6)


@pytest.mark.parametrize(
    ("platform", "named", "command"),
    [
        (
            "win32",
            r'"C:\Program Files\LLVM\bin\clang.exe" -m64',
            (r"C:\Program Files\LLVM\bin\clang.exe", "-m64"),
        ),
        ("win32", r"C:\mingw\bin\gcc.exe", (r"C:\mingw\bin\gcc.exe",)),
        ("darwin", "'/Applications/My Tools/clang' -arch arm64", None),
        ("linux", "'unbalanced", ("cc",)),
    ],
)
def test_the_compiler_that_cc_names_is_found_on_each_system(platform, named, command, monkeypatch):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setenv("CC", named)
    monkeypatch.setattr(compiled.shutil, "which", lambda program: program)
    expected = command or ("/Applications/My Tools/clang", "-arch", "arm64")
    assert find_compiler() == expected


@pytest.mark.parametrize(
    ("platform", "present", "absent"),
    [("win32", (), ("-fPIC", "-lm")), ("darwin", ("-fPIC", "-lm"), ())],
)
def test_options_of_the_compiler_fit_the_system(platform, present, absent, monkeypatch):
    commands: list[list[str]] = []

    def run(command: list[str], *_: Any, **__: Any) -> str:
        commands.append(command)
        if "-shared" in command:
            raise CompileError("there is no such compiler here")
        return ""

    monkeypatch.setattr(compiled, "find_compiler", lambda: (f"cc for {platform}",))
    monkeypatch.setattr(compiled, "run_compiler", run)
    monkeypatch.setattr(sys, "platform", platform)
    with pytest.raises(CompileError, match="no such compiler"):
        compile_function(function(f"for_{platform}"))
    (build,) = [command for command in commands if "-shared" in command]
    assert set(present) <= set(build)
    assert not set(absent) & set(build)


def test_the_cache_is_trusted_on_windows_if_it_can_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.delattr(os, "getuid", raising=False)  # as there
    assert library_cache._explain_distrust(tmp_path) == ""
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "cannot be written" in library_cache._explain_distrust(tmp_path)


def test_numpy_booleans_choose_as_pythons_do():
    assert [read_compiled("compiled", value) for value in (np.True_, np.False_, None)] == [
        True,
        False,
        None,
    ]
    assert read_compiled("compiled", np.False_) is False
    with pytest.raises(TypeError, match="compiled is 'yes': give True or False, None or Single"):
        read_compiled("compiled", "yes")
