"""Motions between their rows, and the space that pictures give them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content, describe_trajectory
from tenscasadi.drawing.view_content import Motion, choose_frame_times


@pytest.fixture(scope="module")
def swing():
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    return tc.simulate(model, 1.0, 0.05, compiled=False)


def test_rows_are_shown_exactly(swing):
    motion = describe_trajectory(swing, "swing")
    for k, time in enumerate(swing.time):
        np.testing.assert_array_equal(motion.nodes_at(float(time)), swing.nodes[k])
        assert motion.row_at(float(time)) == k
    np.testing.assert_array_equal(motion.nodes_at(-1.0), swing.nodes[0])
    np.testing.assert_array_equal(motion.nodes_at(9.0), swing.nodes[-1])


def test_nodes_between_rows_follow_a_hermite_spline(swing):
    motion = describe_trajectory(swing, "swing")
    spline = CubicHermiteSpline(swing.time, swing.nodes, swing.velocities)
    for time in np.linspace(0, 1, 37):
        np.testing.assert_allclose(motion.nodes_at(float(time)), spline(time), atol=1e-12)


def test_nodes_without_velocities_move_linearly():
    nodes = np.array([[(0.0, 0, 0)], [(1.0, 0, 0)]])
    none = np.zeros((0, 2), int)
    motion = Motion("line", np.array([0.0, 2.0]), nodes, none, none, np.zeros(0, int))
    np.testing.assert_allclose(motion.nodes_at(0.5), [(0.25, 0, 0)])


def test_a_single_node_has_the_space_of_its_motion():
    node = tc.Structure([[0.0, 0.0, 1.0]], [], [], node_mass=1.0)
    fall = tc.simulate(tc.Model(tc.Scene(node, gravity=tc.Gravity())), 1.0, 0.01, compiled=False)
    low, high = describe_content(fall).corners
    assert low[2] == fall.nodes[-1, 0, 2]
    assert high[2] == 1.0


def test_outliers_do_not_shrink_the_rest(swing):
    nodes = swing.nodes.copy()
    nodes[-1, 0] = 1e9
    nodes[-2, 0] = np.nan
    failed = dataclasses.replace(swing, nodes=nodes, success=False, message="it diverged")
    content = describe_content(failed)
    assert content.size < 5.0
    assert content.notes == ("trajectory: it diverged",)


def test_frames_are_evenly_spaced_and_limited(swing):
    content = describe_content(swing)
    np.testing.assert_allclose(choose_frame_times(content, 2.0, 30), np.linspace(0, 1, 16))
    assert len(choose_frame_times(content, 1e9, 30)) == 2
    message = "speed is 1: 1 s would take 30001 frames, give a speed of at least 10"
    with pytest.raises(ValueError, match=message):
        choose_frame_times(content, 1.0, 30_000)
