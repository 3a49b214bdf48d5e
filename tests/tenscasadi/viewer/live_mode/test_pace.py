"""The pace of a live motion by a clock that the test moves."""

from __future__ import annotations

import math

import pytest

from tenscasadi.viewer.live_mode.pace import Pace


def run(pace, cost, until, frame=0.002):
    """Ticks done by `until` s where each takes `cost` s of a clock that jumps `frame` s a look."""
    now, total = 0.0, 0
    while now < until:
        for _ in range(pace.due(now)):
            now += cost
            total += 1
            pace.done(1, now)
        now += frame
    return total


def test_a_fast_machine_keeps_real_time():
    pace = Pace(1 / 60)
    assert run(pace, 0.001, 5.0) == pytest.approx(300, abs=2)
    assert pace.measured == pytest.approx(1.0, rel=0.03)
    assert pace.message == ""


def test_slow_motion_and_fast_motion():
    for speed in (0.1, 3.0):
        pace = Pace(1 / 60, speed)
        assert run(pace, 0.0005, 4.0) == pytest.approx(240 * speed, abs=2)
        assert pace.message == ""


def test_a_slow_machine_says_how_slow_and_does_not_pile_up_what_is_due():
    pace = Pace(1 / 60)
    total = run(pace, 0.05, 6.0)
    assert total == pytest.approx(6.0 / 0.05, rel=0.06)
    assert pace.measured == pytest.approx((1 / 60) / 0.05, rel=0.06)
    assert pace.message.startswith("0.3")
    assert "real time" in pace.message
    assert pace.due(6.05) <= 6  # and not the 240 ticks that were never computed
    assert pace.due(1e6) <= 6


def test_rest_forgets_the_time_that_passed():
    pace = Pace(0.01)
    pace.due(0.0)
    pace.rest()
    assert pace.due(100.0) == 0
    assert pace.due(100.01) == 1
    assert math.isnan(pace.measured)


def test_wait_ends_when_a_tick_is_due():
    pace = Pace(0.25)
    pace.due(0.0)
    assert pace.wait(0.0) == pytest.approx(0.25)
    assert pace.wait(0.2) == pytest.approx(0.05)
    assert pace.wait(1.0) == 0.0
