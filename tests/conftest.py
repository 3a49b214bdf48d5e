"""What every test runs under: no screen, one thread per linear-algebra call, and a cache of compiled code that no older build has filled."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from tempfile import TemporaryDirectory
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


def pytest_configure(config: pytest.Config) -> None:
    """One cache for all workers of a run: the first process makes it, those that it starts inherit it."""
    if hasattr(config, "workerinput"):
        return
    if SHARED in os.environ:
        os.environ["TENSCASADI_CACHE"] = os.environ[SHARED]
        return
    folder = TemporaryDirectory(prefix="tenscasadi-tests-", ignore_cleanup_errors=True)
    config.add_cleanup(folder.cleanup)
    os.environ["TENSCASADI_CACHE"] = folder.name


@pytest.fixture(scope="session", autouse=True)
def quick_compiler() -> Iterator[Any]:
    """Compile at level -O1, which changes no rounding; yields the function of the users' flags."""
    from tenscasadi.util import compile as compiled

    usual = compiled._default_flags
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "_default_flags", lambda compiler: ("-O1", *usual(compiler)[1:]))
        yield usual


@pytest.fixture
def users_compiler(quick_compiler: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile with the flags of users, where a test compares the numbers of machine code."""
    monkeypatch.setattr("tenscasadi.util.compile._default_flags", quick_compiler)


@pytest.fixture
def keyboard() -> Iterator[Any]:
    """Python's own handler of Ctrl-C, which a process that a shell has put into the background does not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield signal.default_int_handler
    signal.signal(signal.SIGINT, before)
