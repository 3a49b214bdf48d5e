"""What every test runs under: no screen, one thread per linear-algebra call, and a cache of compiled code that no older build has filled."""

from __future__ import annotations

import gc
import os
import shlex
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import Any

import pytest
from hypothesis import settings

# before NumPy and matplotlib are imported: they read these once
os.environ["MPLBACKEND"] = "Agg"
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# before tests are imported, which inherit it: the same examples each time, unless somebody explores
settings.register_profile(
    "tenscasadi", derandomize="TENSCASADI_FUZZ" not in os.environ, database=None
)
settings.load_profile("tenscasadi")

# a folder that several runs of the tests share; it has to be as new as the code
SHARED = "TENSCASADI_TEST_CACHE"
USERS_COMPILER = "TENSCASADI_TEST_CC"  # what CC was before the tests


def pytest_configure(config: pytest.Config) -> None:
    """One cache and compiler for all workers of a run: the first process makes them, those that it starts inherit them."""
    if hasattr(config, "workerinput"):
        return
    if SHARED not in os.environ:
        folder = TemporaryDirectory(prefix="tenscasadi-tests-", ignore_cleanup_errors=True)
        config.add_cleanup(folder.cleanup)
        os.environ[SHARED] = folder.name
    os.environ["TENSCASADI_CACHE"] = os.environ[SHARED]
    use_quick_compiler(Path(os.environ[SHARED]))


def pytest_collection_finish() -> None:
    """Look for cyclic garbage rarely, and never among modules and tests: 5 % of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


def use_quick_compiler(folder: Path) -> None:
    """Compile at level -Og, which changes no rounding, here and in the processes that tests start."""
    given = os.environ[USERS_COMPILER] = os.environ.get("CC", "")
    if os.name != "posix" or not shutil.which((given or "cc").partition(" ")[0]):
        return
    folder.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile("w", dir=folder, delete=False) as file:
        # the last option counts
        file.write(f'#!/bin/sh\nexec {given or "cc"} "$@" -Og -fno-unroll-loops\n')
    os.chmod(file.name, 0o700)
    os.environ["CC"] = shlex.quote(str(Path(file.name).replace(folder / "quick-cc")))


@pytest.fixture
def users_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile as for users, where a test compares the numbers of machine code."""
    monkeypatch.setenv("CC", os.environ[USERS_COMPILER])


@pytest.fixture
def keyboard() -> Iterator[Any]:
    """Python's own handler of Ctrl-C, which a process that a shell has put into the background does not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield signal.default_int_handler
    signal.signal(signal.SIGINT, before)
