"""Recordings without a known end."""

from __future__ import annotations

import numpy as np

from tenscasadi.viewer.live_mode.recording import Recording


def test_all_rows_are_kept_while_they_fit():
    recording = Recording(2)
    for tick in range(50):
        recording.keep(tick, np.array([tick, -tick]))
    recording.keep(49, np.array([7.0, 8.0]))  # the same tick again: the newer row
    ticks, rows = recording.rows()
    assert ticks.tolist() == list(range(50))
    assert rows[:, 0].tolist() == [*range(49), 7]


def test_memory_is_bounded_and_the_whole_motion_is_covered():
    recording = Recording(1, bytes_=100 * 16)
    for tick in range(10_000):
        recording.keep(tick, np.array([float(tick)]))
        assert len(recording.rows()[0]) <= 101
    ticks, rows = recording.rows()
    assert ticks[0] == 0
    assert ticks[-1] == 9999
    assert len(ticks) > 40
    assert (np.diff(ticks[:-1]) == recording.every).all()
    assert (rows[:, 0] == ticks).all()
