"""Ctrl-C while code runs that turns a KeyboardInterrupt into a failure, or loses it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def on_interrupt(react: Callable[[], object], then_raise: bool) -> Iterator[None]:
    """Call `react` at the first Ctrl-C of the block; from the second on it raises KeyboardInterrupt, as usual.

    Parameters
    ----------
    react : callable
        What to do at the first Ctrl-C.
    then_raise : bool
        Whether the first one raises, too.

    Notes
    -----
    Python lets the main thread alone handle signals: in other threads, and where nobody handles
    Ctrl-C, nothing is changed.
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
