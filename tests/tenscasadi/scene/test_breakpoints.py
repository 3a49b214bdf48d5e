"""Breakpoints: conditions in functions of time are found to the last digit, and tables keep steps short beside steep pieces."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tenscasadi.scene.breakpoints import add_guard_times, find_breakpoints


def test_switches_are_found_to_the_last_digit() -> None:
    t = ca.SX.sym("t")
    values = [
        t > 0.3,
        ca.fmin(t, 0.7),
        ca.fabs(ca.sin(t - 1)),
        ca.sign(t**2 - 2),
        ca.floor(t),
        ca.exp(t),
        (t > 1.9) * (t < 1.90001),
    ]
    found = find_breakpoints(ca.Function("f", [t], [ca.vertcat(*values)]), 0.1, 2.5)
    wanted = np.array([0.3, 0.7, 1.0, np.sqrt(2), 1.9, 1.90001, 2.0])
    assert max(abs(found - time).min() for time in wanted) < 1e-14
    assert max(abs(wanted - time).min() for time in found) < 1e-14
    assert not len(find_breakpoints(ca.Function("f", [t], [ca.sin(t)]), 0.0, 9.0))


def test_jumps_of_remainders_and_at_the_end_are_found() -> None:
    t = ca.SX.sym("t")
    for jumping, wanted in (
        (ca.fmod(t, 0.3), [0.3, 0.6, 0.9]),
        (ca.remainder(t, 0.4), [0.2, 0.6, 1.0]),
        (ca.floor(2 * t), [0.5, 1.0]),
    ):
        found = find_breakpoints(ca.Function("f", [t], [jumping]), 0.1, 1.0)
        assert max(abs(found - time).min() for time in wanted) < 1e-15
        assert max(abs(np.array(wanted) - time).min() for time in found) < 1e-15
        assert found[-1] <= 1.0


def test_steps_are_short_beside_short_pieces_of_a_table():
    times = np.array([0.0, 0.5, 0.501, 0.503, 1.0])
    assert add_guard_times(times) == pytest.approx([0.0, 0.499, 0.5, 0.501, 0.503, 0.505, 1.0])
    assert add_guard_times(times[[0, 1, 4]]).tolist() == [0.0, 0.5, 1.0]
