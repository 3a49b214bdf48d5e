"""What every test runs under: no screen, one thread per linear-algebra call, and a compiled-code cache of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from tempfile import TemporaryDirectory

import pytest

# before NumPy and matplotlib are imported: they read these once
os.environ["MPLBACKEND"] = "Agg"
os.environ["OMP_NUM_THREADS"] = "1"


@pytest.fixture(scope="session", autouse=True)
def compiled_code_cache() -> Iterator[None]:
    """Compiled models of the whole session share one cache, which starts empty: no test may pass thanks to an older build."""
    with TemporaryDirectory(prefix="tenscasadi-tests-", ignore_cleanup_errors=True) as folder:
        before = os.environ.get("TENSCASADI_CACHE")
        os.environ["TENSCASADI_CACHE"] = folder
        yield
        if before is None:
            del os.environ["TENSCASADI_CACHE"]
        else:
            os.environ["TENSCASADI_CACHE"] = before
