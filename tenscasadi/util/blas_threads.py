"""One thread for BLAS: its threads wait for each other longer than they take for matrices of a few hundred rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the BLAS of NumPy and SciPy take one thread within, whatever the environment says."""
    with _libraries().limit(limits=1):
        yield


@cache
def _libraries() -> Any:
    """Return the BLAS libraries that are loaded."""
    import scipy.linalg.blas  # noqa: F401  (loads its own)
    import threadpoolctl  # takes a while

    return threadpoolctl.ThreadpoolController().select(user_api="blas")
