"""Labels describe items with the quantities of the displayed frame."""

from __future__ import annotations

import numpy as np
import pytest
from moving import thrown

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content, describe_rollouts, describe_trajectory
from tenscasadi.viewer.labels import describe_item, find_places


def describe(motion, kind, index, time):
    return describe_item(motion, motion.frame_at(time), kind, index)


@pytest.fixture(scope="module")
def trajectory():
    return thrown(0.2)


def test_labels_tell_lengths_forces_and_units(trajectory):
    motion = describe_trajectory(trajectory, "thrown")
    row, string = 7, 4
    a, b = trajectory.strings[string]
    length = np.linalg.norm(trajectory.nodes[row, b] - trajectory.nodes[row, a])
    told = describe(motion, "strings", string, float(trajectory.time[row]))
    tension, density = trajectory.tension[row, string], trajectory.force_density[row, string]
    assert told.splitlines() == [
        "top[1], string 4, top[1] – top[2]",
        f"length {length:.4g} m",
        f"tension {tension:.4g} N, force density {density:.4g} N/m",
    ]
    assert (a, b) == (4, 5)
    assert describe(motion, "bars", 2, 0.0).startswith("bar 2, bottom[2] – top[0]\n")
    x, y, z = trajectory.nodes[-1, 3]
    speed = np.linalg.norm(trajectory.velocities[-1, 3])
    assert describe(motion, "nodes", 3, 9.0).splitlines() == [
        "top[0], node 3",
        f"({x:.4g}, {y:.4g}, {z:.4g}) m",
        f"speed {speed:.3g} m/s",
    ]


def test_slack_strings_say_so():
    prism = tc.shapes.prism(stiffness=10.0)
    loose = prism.replace(rest_length=2 * prism.string_lengths)
    motion = describe_trajectory(
        tc.simulate(tc.Model(tc.Scene(loose)), 0.02, 0.01, compiled=False), "loose"
    )
    assert describe(motion, "strings", 0, 0.0).endswith("\nslack")


def test_copies_count_their_own_nodes():
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    motion = describe_rollouts(
        tc.rollouts(model, 0.1, 0.01, states=np.tile(model.initial_state, (3, 1)), save_every=5),
        "many",
    )
    assert (motion.count("bars"), motion.copies) == (2, 3)
    assert describe(motion, "bars", 3, 0.0).startswith("bar 1 of motion 1, node 1 – 2\n")
    assert describe(motion, "nodes", 8, 0.0).startswith("node 2 of motion 2\n")


def test_labels_stand_in_the_middle_of_members(trajectory):
    motion = describe_trajectory(trajectory, "thrown")
    nodes = trajectory.nodes[5].copy()
    np.testing.assert_allclose(
        find_places(motion, "bars", nodes),
        (nodes[trajectory.bars[:, 0]] + nodes[trajectory.bars[:, 1]]) / 2,
    )
    nodes[0] = np.nan
    assert np.isfinite(find_places(motion, "nodes", nodes)).all()


def test_labels_have_the_names_of_nodes_and_members():
    named = tc.shapes.prism(node_names=["foot", "", "", "", "", "top"])
    motion = describe_content(named).motions[0]
    frame = motion.frame_at(0.0)
    assert describe_item(motion, frame, "nodes", 0).startswith("foot, node 0\n")
    a, b = named.bars[0]
    names = [motion.names["nodes"][k].removeprefix("node ") for k in (a, b)]
    text = describe_item(motion, frame, "bars", 0)
    assert text.splitlines()[0].endswith(" – ".join(names))
    assert "bottom[0], string 0" in describe_item(motion, frame, "strings", 0)
