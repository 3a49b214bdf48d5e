"""Work in a thread that a search can abandon."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from ocp.solvers.monitor import Monitor, Progress
from ocp.solvers.worker import Abandoned, Worker


def never() -> bool:
    return False


def always() -> bool:
    return True


def test_result_is_that_of_the_work():
    assert Worker(lambda: 7).wait(never, lambda: 0) == 7


def test_errors_of_the_work_are_raised():
    def fail():
        raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        Worker(fail).wait(never, lambda: None)


def test_work_that_does_not_stop_is_abandoned():
    release = threading.Event()
    began = time.perf_counter()
    found = Worker(lambda: release.wait(30)).wait(always, lambda: "best")
    release.set()
    assert found == "best"
    assert time.perf_counter() - began < 5


def test_work_that_asks_often_is_abandoned():
    ended, monitor = threading.Event(), Monitor(0.01)

    def work():
        while not ended.is_set():
            monitor.ask(lambda: time.sleep(0.01))
        return "stopped"

    timer = threading.Timer(5.0, ended.set)
    timer.start()
    assert monitor.run(work, lambda: "best") == "best"
    timer.cancel()


def test_stop_is_soon_after_a_long_search():
    """The permitted delay does not grow with the elapsed time."""
    for time_limit in (None, 1e4):
        release, monitor = threading.Event(), Monitor(time_limit)
        monitor.began -= 1e3
        monitor.stop()
        timer = threading.Timer(5.0, release.set)
        timer.start()
        found = monitor.run(lambda event=release: event.wait(30), lambda: "best")
        release.set()
        timer.cancel()
        assert found == "best"


def test_work_that_stops_soon_gives_its_own_result():
    stop = threading.Event()
    found = Worker(lambda: stop.wait(30)).wait(lambda: bool(stop.set()), lambda: "best")
    assert found is True


def test_calls_of_the_user_run_in_the_waiting_thread():
    names = []

    def work():
        return worker.ask(lambda: names.append(threading.current_thread()) or "seen")

    worker = Worker(work)
    assert worker.wait(never, lambda: "") == "seen"
    assert names == [threading.current_thread()]


def test_errors_of_calls_are_raised_in_the_work():
    def fail():
        raise TimeoutError("of the user")

    worker = Worker(lambda: worker.ask(fail))
    with pytest.raises(TimeoutError, match="of the user"):
        worker.wait(never, lambda: None)


def test_abandoned_work_calls_nothing():
    release, ended, seen = threading.Event(), threading.Event(), []

    def work():
        release.wait(30)
        try:
            worker.ask(lambda: seen.append(1))
        except Abandoned:
            ended.set()

    worker = Worker(work)
    worker.wait(always, lambda: None)
    release.set()
    assert ended.wait(30)
    assert not seen


def test_abandoned_work_does_not_disturb_the_next():
    """It neither calls the user's function nor replaces the best iterate."""
    release, ended, seen = threading.Event(), threading.Event(), []
    monitor = Monitor(watch=lambda now: seen.append(now.iteration))

    def work(number, wait):
        if wait:
            release.wait(30)
        try:
            monitor.follow(Progress(number, 0.0, 0.0), np.full(number, 1.0))
        except Abandoned:
            ended.set()
        return monitor.iterate

    monitor.stop()
    assert monitor.run(lambda: work(1, True), lambda: None) is None
    monitor.interrupted, monitor.deadline = False, np.inf

    def again():
        release.set()
        assert ended.wait(30)
        return work(2, False)

    number, iterate = monitor.run(again, lambda: None)
    assert (number, len(iterate), seen) == (2, 2, [2])
