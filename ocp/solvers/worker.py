"""Work in a thread that a search can abandon.

Compiled code, such as a factorization of IPOPT, cannot be interrupted. The calling thread waits for
the result only as long as the search may take.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from contextvars import copy_context
from queue import Empty, SimpleQueue
from threading import Thread, current_thread, stack_size
from typing import Any, TypeVar

from tenscasadi.util.processes import one_blas_thread

Result = TypeVar("Result")


class Abandoned(Exception):
    """Raised in an abandoned thread that calls a user's function."""


class Worker:
    """Thread that computes while the calling thread waits.

    Parameters
    ----------
    work : callable
        Function without arguments.

    Attributes
    ----------
    iterate : object
        Best intermediate result of the work, which the work itself stores.

    Examples
    --------
    >>> from ocp.solvers.worker import Worker
    >>> Worker(lambda: 6 * 7).wait(lambda: False, lambda: None)
    42
    """

    def __init__(self, work: Callable[[], Any]) -> None:
        self._calls: SimpleQueue[tuple[Callable[[], Any] | None, Future[Any]]] = SimpleQueue()
        self._result: Future[Any] = Future()
        self._abandoned = False
        self.iterate: Any = None
        context = copy_context()
        self._thread = Thread(target=lambda: context.run(self._run, work), name="plan")

    @property
    def is_here(self) -> bool:
        """Whether the current thread is that of the work."""
        return current_thread() is self._thread

    def _run(self, work: Callable[[], Any]) -> None:
        try:
            with one_blas_thread():
                self._result.set_result(work())
        except BaseException as error:  # noqa: BLE001  # raised again in the waiting thread
            self._result.set_exception(error)
        self._calls.put((None, self._result))

    def wait(self, is_late: Callable[[], bool], otherwise: Callable[[], Result]) -> Result:
        """Wait for the result of the thread.

        Parameters
        ----------
        is_late : callable
            Function that returns whether to abandon the work.
        otherwise : callable
            Function that builds the result of abandoned work.

        Returns
        -------
        object
            Result of the work, or of `otherwise`.
        """
        before = stack_size(64 * 2**20)  # some systems' default is too small for expressions
        self._thread.start()
        stack_size(before)
        try:
            while True:
                try:
                    call, reply = self._calls.get(timeout=0.05)
                except Empty:
                    call, reply = _do_nothing, Future()
                if call is None:
                    return self._result.result()  # type: ignore[no-any-return]
                if is_late():
                    break
                _answer(call, reply)
        finally:
            self._abandoned = True
        return otherwise()

    def ask(self, call: Callable[[], Result]) -> Result:
        """Call a function in the waiting thread, and return its result.

        Raises Abandoned if that thread no longer waits.
        """
        if not self.is_here:  # that of earlier work, which was abandoned
            raise Abandoned
        reply: Future[Result] = Future()
        self._calls.put((call, reply))
        while not self._abandoned:
            try:
                return reply.result(0.05)
            except NotYet:
                if reply.done():  # meanwhile, or the function raised this error
                    return reply.result()
        raise Abandoned


def _do_nothing() -> None:
    pass


def _answer(call: Callable[[], Any], reply: Future[Any]) -> None:
    try:
        reply.set_result(call())
    except BaseException as error:  # noqa: BLE001  # raised again in the thread that asked
        reply.set_exception(error)
