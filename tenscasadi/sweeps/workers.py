"""Workers of a sweep: jobs on an executor of any kind, or in processes of this machine that may die."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from tenscasadi.sweeps.case_files import Outcome, check_results
from tenscasadi.util.validate import shown

Function = Callable[[Any], Any]
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
_DIED = "the worker process died while it computed this case: it was killed, ran out of memory or crashed"
_UNPICKLED = (pickle.PicklingError, AttributeError, TypeError, RecursionError)  # what pickle raises
_CURE = "which other processes cannot get: give numbers, text and arrays, and build in the function what is else"


def compute(function: Function, case: Any) -> Outcome:
    """Run one case and catch what it raises, in a worker."""
    began = time.perf_counter()
    try:
        values, error = check_results(function(case)), ""
    except BaseException as fault:  # whatever it is, other cases go on
        if isinstance(fault, KeyboardInterrupt) and _has_keyboard():
            raise
        frames = fault.__traceback__.tb_next if fault.__traceback__ else None  # without this one
        values, error = {}, "".join(traceback.format_exception(type(fault), fault, frames))
    return Outcome(values, error, time.perf_counter() - began)


def _has_keyboard() -> bool:
    """Whether Ctrl-C may be what has been raised here, rather than in the process that workers work for."""
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
    )


def run_on_executor(
    function: Function, cases: Mapping[Any, Any], executor: Executor
) -> Generator[tuple[Any, Outcome], None, None]:
    """Yield each case's key and outcome as it finishes; what has not begun is cancelled when the caller stops early.

    Raises what the executor does where it takes no jobs.
    """
    futures: dict[Future[Outcome], Any] = {}
    try:
        for key, case in cases.items():
            try:
                futures[executor.submit(compute, function, case)] = key
            except Exception as fault:
                lost = _lost(fault, case)
                if (
                    not isinstance(fault, BrokenExecutor) and _CURE not in lost.error
                ):  # neither its workers have died, nor is it this case
                    _check_function(function)
                    raise
                yield key, lost
        for future in as_completed(futures):
            yield futures[future], _outcome(future, cases[futures[future]])
    finally:
        for future in futures:
            future.cancel()


def run_in_processes(
    function: Function, cases: Mapping[Any, Any]
) -> Generator[tuple[Any, Outcome], None, None]:
    """Yield each case's key and outcome as it finishes, in as many new processes as there are cores, each with one thread.

    Where a process dies its pool is lost. The cases that were running are tried again one by one,
    which tells whose fault it was. Raises ValueError where processes cannot import the function,
    RuntimeError where they cannot begin.
    """
    _check_function(function)
    workers = min(_cores(), len(cases))
    waiting, suspects, checked = deque(cases), deque[Any](), False
    with _environment(_ONE_THREAD):
        while waiting or suspects:
            queue, width = (suspects, 1) if suspects else (waiting, workers)
            pool = ProcessPoolExecutor(
                width, multiprocessing.get_context("spawn"), initializer=_begin_worker
            )
            running: dict[Future[Outcome], Any] = {}
            lost: list[Any] = []
            try:
                checked = checked or _check_worker(pool, function)
                while (queue or running) and not lost:
                    while queue and len(running) < width:
                        running[pool.submit(compute, function, cases[queue[0]])] = queue[0]
                        queue.popleft()
                    done = wait(running, return_when=FIRST_COMPLETED).done
                    for future in done:
                        key = running.pop(future)
                        if isinstance(future.exception(), BrokenProcessPool):
                            lost.append(key)
                        else:
                            yield key, _outcome(future, cases[key])
            except BrokenProcessPool:  # by submit, as the pool has just broken
                pass
            except BaseException:  # Ctrl-C, or nobody wants the rest: no case is waited for
                _terminate(pool)
                raise
            pool.shutdown()
            lost += running.values()
            if width == 1 and lost:
                yield lost[0], Outcome({}, _DIED, float("nan"))
            else:
                suspects.extend(lost)


def _outcome(future: Future[Outcome], case: Any) -> Outcome:
    try:
        return future.result()
    except Exception as fault:  # noqa: BLE001  what executors make of a lost worker, or of a case that does not pickle
        return _lost(fault, case)


def _lost(fault: Exception, case: Any) -> Outcome:
    part = _unsendable(case) if isinstance(fault, _UNPICKLED) else ""
    cure = f": {part}, {_CURE}" if part else ""
    return Outcome({}, f"no result came back: {type(fault).__name__}: {fault}{cure}", float("nan"))


def _unsendable(value: Any, name: str = "case") -> str:
    """Return which part of a case does not pickle, and what it is; "" for none."""
    try:
        pickle.dumps(value)
    except Exception:  # noqa: BLE001  pickle raises many things
        parts = (
            value.items()
            if isinstance(value, Mapping)
            else enumerate(value)
            if isinstance(value, (list, tuple))
            else ()
        )
        found = (_unsendable(part, f"{name}[{key!r}]") for key, part in parts)
        return next(filter(None, found), f"{name} is {shown(value)}")
    return ""


def _check_function(function: Function) -> None:
    try:
        pickle.dumps(function)
    except Exception as fault:  # pickle raises many things
        cure = "define it with def at the top level of a module, or give an executor of threads"
        raise ValueError(
            f"function is {shown(function)}, which other processes cannot import ({fault}): {cure}"
        ) from fault


def _check_worker(pool: ProcessPoolExecutor, function: Function) -> bool:
    """Return True once a process has imported the function."""
    try:
        return pool.submit(callable, function).result()
    except BrokenProcessPool:
        cure = "a script needs `if __name__ == '__main__':` around what it runs; a function of a notebook has to move into a module"
        raise RuntimeError(
            f"worker processes cannot begin, or cannot import {shown(function)}: {cure}"
        ) from None


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables that processes which are started meanwhile inherit: libraries read them when they are loaded."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin_worker() -> None:
    """Leave Ctrl-C to the process that this one works for, and end with it: killed, it tells nobody."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _terminate(pool: ProcessPoolExecutor) -> None:
    """End the processes in the middle of their cases."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
    pool.shutdown(cancel_futures=True)
