"""Process-wide settings: child processes, processors, BLAS threads, Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from types import FrameType
from typing import Any

from tenscasadi.util.renamed import lazy_module

threadpoolctl = lazy_module("threadpoolctl")
linalg = lazy_module("scipy.linalg")

_lock = threading.Lock()
_users = 0  # calls, of all threads, that limit BLAS to one thread now
_before: list[int] = []  # threads of each library, before the first of them


def count_processors() -> int:
    """Count the processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def run_program(
    command: Sequence[str], seconds: float, environment: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    """Run another program to its end.

    Parameters
    ----------
    command : sequence of str
        Program and arguments.
    seconds : float
        Time limit [s].
    environment : mapping of str to str
        Environment variables.

    Returns
    -------
    subprocess.CompletedProcess
        Exit status, and text on standard output and standard error.

    Raises
    ------
    OSError
        If the program cannot be run.
    subprocess.TimeoutExpired
        After the time limit. Then, and after Ctrl-C, the program and all its processes are killed.
    """
    own_group = os.name == "posix"
    silent, pipe = subprocess.DEVNULL, subprocess.PIPE
    started: list[subprocess.Popen[str]] = []

    def start() -> None:
        started.append(
            subprocess.Popen(
                command,
                stdin=silent,
                stdout=pipe,
                stderr=pipe,
                text=True,
                errors="replace",
                env=environment,
                start_new_session=own_group,
            )
        )

    # Ctrl-C interrupts only the main thread, so a thread that starts the program keeps its handle.
    with ThreadPoolExecutor(1) as starter:
        try:
            starter.submit(start).result()
            out, errors = started[0].communicate(timeout=seconds)
        except BaseException:
            starter.shutdown()
            for process in started:
                with contextlib.suppress(OSError):  # it has just ended
                    os.killpg(process.pid, signal.SIGKILL) if own_group else process.kill()
                with process:  # closes its pipes and waits for its end
                    pass
            raise
    return subprocess.CompletedProcess(command, started[0].returncode, out, errors)


@contextmanager
def on_interrupt(react: Callable[[], object], then_raise: bool) -> Iterator[None]:
    """Call a function at the first Ctrl-C within a block.

    Some code turns KeyboardInterrupt into a failure or loses it. The second Ctrl-C raises it as
    usual. Only the main thread can handle signals: in other threads nothing changes.

    Parameters
    ----------
    react : callable
        Function to call.
    then_raise : bool
        Whether the first Ctrl-C raises KeyboardInterrupt, too.
    """
    usual = signal.getsignal(signal.SIGINT)
    if not callable(usual) or threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, usual)
        react()
        if then_raise:
            usual(number, frame)

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread within a block.

    BLAS threads wait for each other longer than they compute at matrices of a few hundred rows.
    Most libraries have one thread count for the whole process. Overlapping calls in several threads
    share it, and the last one restores it.
    """
    global _users, _before
    libraries = _find_blas()
    with _lock:
        own = [library.num_threads for library in libraries]
        if not _users:
            _before = own
        _users += 1
        _limit(libraries, [1] * len(own))
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            shared = [1] * len(own) if _users else _before
            counts = zip(libraries, own, shared, strict=True)
            _limit(
                libraries,
                [
                    mine if _has_count_per_thread(library) else ours
                    for library, mine, ours in counts
                ],
            )


def _has_count_per_thread(library: Any) -> bool:
    return bool(library.internal_api == "openblas" and library.threading_layer == "openmp")


def _limit(libraries: list[Any], counts: list[int]) -> None:
    """Set thread counts of BLAS libraries.

    Counts that other code has changed meanwhile remain. The numbers of threads are `counts`, one
    for each of the `libraries`.
    """
    for library, count in zip(libraries, counts, strict=True):
        if count == 1 or library.num_threads == 1:
            library.set_num_threads(count)
        if hasattr(library, "clear_controlling_thread"):
            # otherwise only the first thread could restore the count
            library.clear_controlling_thread()


@cache
def _find_blas() -> list[Any]:
    """Find all loaded BLAS libraries, including that of SciPy."""
    _ = linalg.blas  # loads that of SciPy
    return list(threadpoolctl.ThreadpoolController().select(user_api="blas").lib_controllers)
