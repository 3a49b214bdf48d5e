"""One thread for BLAS: its threads wait for each other longer than they take for matrices of a few hundred rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any

_LOCK = Lock()
_within = 0  # how many calls, of all threads, want one thread now
_before: list[int] = []  # threads of each library, before the first of them


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the BLAS of NumPy and SciPy take one thread within, whatever the environment says.

    Most libraries have one number for the whole process: calls that overlap in several threads
    share it, and the last one to end puts it back.
    """
    global _within, _before
    libraries = _libraries()
    with _LOCK:
        own = [library.num_threads for library in libraries]
        if not _within:
            _before = own
        _within += 1
        _limit(libraries, [1] * len(own))
    try:
        yield
    finally:
        with _LOCK:
            _within -= 1
            shared = [1] * len(own) if _within else _before
            counts = zip(libraries, own, shared, strict=True)
            _limit(
                libraries,
                [
                    mine if _each_thread_has_its_own(library) else ours
                    for library, mine, ours in counts
                ],
            )


def _each_thread_has_its_own(library: Any) -> bool:
    return bool(library.internal_api == "openblas" and library.threading_layer == "openmp")


def _limit(libraries: list[Any], counts: list[int]) -> None:
    """Let libraries take as many threads. What is not one when it is to rise was changed by someone else, and stays."""
    for library, count in zip(libraries, counts, strict=True):
        if count == 1 or library.num_threads == 1:
            library.set_num_threads(count)
        if hasattr(library, "clear_controlling_thread"):
            # else only the thread that set it first may set it back
            library.clear_controlling_thread()


@cache
def _libraries() -> list[Any]:
    """Return the BLAS libraries that are loaded."""
    import scipy.linalg.blas  # noqa: F401  (loads its own)
    import threadpoolctl  # takes a while

    return list(threadpoolctl.ThreadpoolController().select(user_api="blas").lib_controllers)
