"""Ctrl-C: noted once, raised when it is asked for and the second time, and never left changed."""

from __future__ import annotations

import signal
import threading

import pytest

from tenscasadi.util.interrupts import on_interrupt


def test_the_first_is_noted_and_the_second_raises(keyboard: object) -> None:
    noted: list[str] = []
    with on_interrupt(lambda: noted.append("once"), then_raise=False):
        signal.raise_signal(signal.SIGINT)
        assert noted == ["once"]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert noted == ["once"]
    assert signal.getsignal(signal.SIGINT) is keyboard


def test_it_raises_once_it_is_noted(keyboard: object) -> None:
    noted: list[str] = []
    with (
        pytest.raises(KeyboardInterrupt),
        on_interrupt(lambda: noted.append("once"), then_raise=True),
    ):
        signal.raise_signal(signal.SIGINT)
    assert noted == ["once"]
    assert signal.getsignal(signal.SIGINT) is keyboard


@pytest.mark.parametrize("handler", [signal.SIG_IGN, signal.SIG_DFL])
def test_where_python_does_not_handle_it_nothing_changes(
    keyboard: object, handler: signal.Handlers
) -> None:
    signal.signal(signal.SIGINT, handler)
    with on_interrupt(lambda: None, then_raise=True):
        assert signal.getsignal(signal.SIGINT) == handler


def test_other_threads_may_use_it(keyboard: object) -> None:
    seen: list[object] = []

    def work() -> None:
        with on_interrupt(lambda: None, then_raise=True):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [keyboard]
