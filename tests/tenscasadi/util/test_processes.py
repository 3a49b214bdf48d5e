"""Programs, Ctrl-C and BLAS threads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from threading import Event, Thread

import pytest
from threadpoolctl import ThreadpoolController

import ocp
import tenscasadi as tc
from tenscasadi.util.processes import (
    count_processors,
    on_interrupt,
    one_blas_thread,
    run_program,
)


def test_what_it_says_and_how_it_ends() -> None:
    text = "import sys; print(sys.stdin.read() + 'out'); print('err', file=sys.stderr); sys.exit(3)"
    done = run_program([sys.executable, "-c", text], 30.0, os.environ)
    assert (done.stdout, done.stderr, done.returncode) == ("out\n", "err\n", 3)
    with pytest.raises(OSError, match="nowhere"):
        run_program(["/nowhere/at/all"], 30.0, os.environ)


@pytest.mark.skipif(os.name != "posix", reason="process groups")
def test_what_takes_too_long_is_ended_with_what_it_started(tmp_path: Path) -> None:
    witness = tmp_path / "witness"
    began = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired):
        run_program(
            ["/bin/sh", "-c", f"(while :; do date >> {witness}; sleep 0.05; done) & sleep 100"],
            0.3,
            os.environ,
        )
    assert time.monotonic() - began < 20
    time.sleep(0.2)
    size = witness.stat().st_size
    assert size > 0
    time.sleep(0.3)
    assert witness.stat().st_size == size


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


BLAS = ThreadpoolController().select(user_api="blas")


def threads() -> list[int]:
    return [library["num_threads"] for library in BLAS.info()]


@pytest.fixture(autouse=True)
def several():
    with BLAS.limit(limits=2):
        yield


def test_one_thread_within_and_as_many_as_before_afterwards():
    before = threads()
    assert before
    with one_blas_thread():
        assert set(threads()) == {1}
        with one_blas_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert threads() == before
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert threads() == before


def test_calls_that_overlap_in_threads_keep_one_until_the_last_ends():
    BLAS.lib_controllers[0].clear_controlling_thread(
        force=True
    )  # the fixture's thread would keep others from setting it
    entered, leave = [Event(), Event()], [Event(), Event()]

    def work(k):
        with one_blas_thread():
            entered[k].set()
            leave[k].wait(10)

    workers = [Thread(target=work, args=(k,)) for k in range(2)]
    for k in range(2):
        workers[k].start()
        assert entered[k].wait(10)
    leave[0].set()
    workers[0].join()
    assert set(threads()) == {1}
    leave[1].set()
    workers[1].join()
    assert set(threads()) == {2}


def test_a_limit_that_another_thread_sets_meanwhile_stays():
    with one_blas_thread():
        BLAS.limit(limits=2)
    assert set(threads()) == {2}


def test_planning_takes_one():
    seen = []
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    assert ocp.solve(
        ocp.Problem(model, goals=goals, costs=[ocp.Effort()]),
        ocp.Variational(10),
        ocp.Ipopt(callback=lambda progress: seen.append(threads())),
    ).success
    assert set(seen[0]) == {1}
    assert set(threads()) == {2}


def test_processors_are_counted_without_affinity(monkeypatch: pytest.MonkeyPatch) -> None:
    """macOS and Windows do not know `os.sched_getaffinity`."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert count_processors() == os.cpu_count()
