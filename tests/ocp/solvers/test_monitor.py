"""Progress lines of a search."""

from __future__ import annotations

import time

from ocp.solvers.monitor import Monitor, Progress


def test_lines_appear_while_a_function_reports_nothing():
    lines = []
    monitor = Monitor(60.0, lines.append)
    monitor.phase = "guess"
    assert monitor.run(lambda: time.sleep(2.4), lambda: "late") is None
    assert lines
    assert lines[0].startswith("guess: 2 s, ")
    assert lines[0].endswith(" s left")


def test_lines_have_the_last_iteration():
    lines = []
    monitor = Monitor(show=lines.append)

    def work():
        monitor.follow(Progress(7, 2.5, 1e-3))
        time.sleep(2.4)

    monitor.run(work, lambda: None)
    assert "iteration 7, violation 1.0e-03, objective 2.5, 2 s" in lines[-1]


def test_short_searches_show_nothing():
    lines = []
    Monitor(show=lines.append).run(lambda: time.sleep(0.2), lambda: None)
    assert not lines


def test_lines_of_parts_have_phase_and_time_of_the_whole():
    lines = []
    monitor = Monitor(60.0, lines.append)
    monitor.phase = "1 of 2 starts finished"
    time.sleep(1.2)
    monitor.limit(5.0).run(lambda: time.sleep(1.2), lambda: None)
    assert lines[0].startswith("1 of 2 starts finished; final state: 2 s, 5")
