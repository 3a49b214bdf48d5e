"""Thread that draws frames, and executes functions between them."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

_Result = TypeVar("_Result")
# raised by orders with values that a page has sent
INVALID = (TypeError, ValueError, IndexError, KeyError, OverflowError)


class Runner:
    """Thread that alternates between frames and queued functions.

    Parameters
    ----------
    advance : callable
        Draws the next frame; returns the time until the following one [s], None to wait for an
        order.
    """

    def __init__(self, advance: Callable[[], float | None]) -> None:
        self._advance = advance
        self._orders: queue.SimpleQueue[Callable[[], Any]] = queue.SimpleQueue()
        self._wake, self._ended = threading.Event(), False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether functions are waiting in the queue."""
        return not self._orders.empty()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def do(self, order: Callable[[], Any]) -> None:
        """Queue a function (`order`) for execution before the next frame.

        Errors due to invalid values are ignored, as a browser may send any value.
        """
        self._orders.put(order)
        self._wake.set()

    def call(self, order: Callable[[], _Result]) -> _Result:
        """Execute a function (`order`) between frames and return its result.

        After the end of the thread it is executed at once.
        """
        answer: queue.SimpleQueue[_Result] = queue.SimpleQueue()
        self.do(lambda: answer.put(order()))
        while self.is_alive:
            with contextlib.suppress(queue.Empty):
                return answer.get(timeout=0.1)  # the thread may end before
        return order()

    def close(self) -> None:
        """End the thread."""
        self._ended = True
        self._wake.set()
        if self.is_alive:
            self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while not self._ended:
            self._wake.clear()
            with contextlib.suppress(queue.Empty):
                while not self._ended:
                    order = self._orders.get_nowait()
                    with contextlib.suppress(*INVALID):
                        order()
            if not self._ended:
                self._wake.wait(self._advance())
