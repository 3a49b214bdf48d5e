"""Processes and executors that compute the cases of a sweep."""

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

from tenscasadi.sweeps.case_files import CaseOutcome, check_results
from tenscasadi.util.processes import count_processors
from tenscasadi.util.validate import format_value

Function = Callable[[Any], Any]
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
_DIED = "the worker process died while it computed this case: it was killed, ran out of memory or crashed"
_UNPICKLED = (pickle.PicklingError, AttributeError, TypeError, RecursionError)
_CURE = "which other processes cannot get: give numbers, text and arrays, and build other objects in the function"


def compute(function: Function, case: Any) -> CaseOutcome:
    """Compute a case in a worker by calling the function.

    An exception becomes the error of the case.
    """
    began = time.perf_counter()
    try:
        values, error = check_results(function(case)), ""
    except BaseException as fault:  # whatever it is, other cases go on
        if isinstance(fault, KeyboardInterrupt) and _has_keyboard():
            raise
        frames = fault.__traceback__.tb_next if fault.__traceback__ else None  # without this one
        values, error = {}, "".join(traceback.format_exception(type(fault), fault, frames))
    return CaseOutcome(values, error, time.perf_counter() - began)


def _has_keyboard() -> bool:
    """Return whether Ctrl-C may have been raised in this process."""
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
    )


def run_on_executor(
    function: Function, cases: Mapping[Any, Any], executor: Executor
) -> Generator[tuple[Any, CaseOutcome], None, None]:
    """Yield the results of cases as an executor finishes them.

    Each comes as a tuple with the key of its case. `function` is called with each case. Cases that
    have not begun are canceled when the caller stops early. Raises the exception of an executor
    that takes no jobs.
    """
    futures: dict[Future[CaseOutcome], Any] = {}
    try:
        for key, case in cases.items():
            try:
                futures[executor.submit(compute, function, case)] = key
            except Exception as fault:
                lost = _describe_loss(fault, case)
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
) -> Generator[tuple[Any, CaseOutcome], None, None]:
    """Yield the results of cases as new processes finish them.

    There are as many processes as cores, each with one thread. When a process dies, its pool is
    lost. The running cases are tried again one by one to find the cause. Raises ValueError if
    processes cannot import the function, RuntimeError if they cannot begin.
    """
    _check_function(function)
    workers = min(count_processors(), len(cases))
    waiting, suspects, checked = deque(cases), deque[Any](), False
    with _environment(_ONE_THREAD):
        while waiting or suspects:
            queue, width = (suspects, 1) if suspects else (waiting, workers)
            pool = ProcessPoolExecutor(
                width, multiprocessing.get_context("spawn"), initializer=_begin_worker
            )
            running: dict[Future[CaseOutcome], Any] = {}
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
                yield lost[0], CaseOutcome({}, _DIED, float("nan"))
            else:
                suspects.extend(lost)


def _outcome(future: Future[CaseOutcome], case: Any) -> CaseOutcome:
    try:
        return future.result()
    except Exception as fault:  # noqa: BLE001  executors raise many things for lost workers and pickling
        return _describe_loss(fault, case)


def _describe_loss(fault: Exception, case: Any) -> CaseOutcome:
    part = _find_unpicklable(case) if isinstance(fault, _UNPICKLED) else ""
    cure = f": {part}, {_CURE}" if part else ""
    return CaseOutcome(
        {}, f"no result came back: {type(fault).__name__}: {fault}{cure}", float("nan")
    )


def _find_unpicklable(value: Any, name: str = "case") -> str:
    """Find the part of a case that cannot be pickled.

    `value` is the case, and `name` its name in the result. Returns "" if there is none.
    """
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
        found = (_find_unpicklable(part, f"{name}[{key!r}]") for key, part in parts)
        return next(filter(None, found), f"{name} is {format_value(value)}")
    return ""


def _check_function(function: Function) -> None:
    try:
        pickle.dumps(function)
    except Exception as fault:  # pickle raises many things
        cure = "define it with def at the top level of a module, or give an executor of threads"
        raise ValueError(
            f"function is {format_value(function)}, which other processes cannot import ({fault}): {cure}"
        ) from fault


def _check_worker(pool: ProcessPoolExecutor, function: Function) -> bool:
    """Check that a worker process can import the function.

    `pool` starts the process. Raises RuntimeError if it cannot begin.
    """
    try:
        return pool.submit(callable, function).result()
    except BrokenProcessPool:
        cure = "a script needs `if __name__ == '__main__':` around its calls; move functions of a notebook into a module"
        raise RuntimeError(
            f"worker processes cannot begin, or cannot import {format_value(function)}: {cure}"
        ) from None


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for processes started in the block.

    `values` are their values by name. Libraries read them at import.
    """
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
    """Ignore Ctrl-C, and end with the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _terminate(pool: ProcessPoolExecutor) -> None:
    """Terminate the processes of a pool."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
    pool.shutdown(cancel_futures=True)
