"""Motions between their rows, and of many copies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import tenscasadi as tc
from tenscasadi.viewer.motion import MOST_COPIES, Motion, of_rollouts, of_structure, of_trajectory


@pytest.fixture(scope="module")
def swing():
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    return tc.simulate(model, 1.0, 0.05, compiled=False)


def test_rows_are_shown_as_they_are(swing):
    motion = of_trajectory(swing, "swing")
    for k, time in enumerate(swing.time):
        np.testing.assert_array_equal(motion.nodes_at(float(time)), swing.nodes[k])
        assert motion.row_at(float(time)) == k
    np.testing.assert_array_equal(motion.nodes_at(-1.0), swing.nodes[0])
    np.testing.assert_array_equal(motion.nodes_at(9.0), swing.nodes[-1])


def test_between_rows_nodes_are_those_of_a_hermite_spline(swing):
    motion, spline = (
        of_trajectory(swing, "swing"),
        CubicHermiteSpline(swing.time, swing.nodes, swing.velocities),
    )
    for time in np.linspace(0, 1, 37):
        np.testing.assert_allclose(motion.nodes_at(float(time)), spline(time), atol=1e-12)


def test_without_velocities_they_are_linear():
    nodes = np.array([[(0.0, 0, 0)], [(1.0, 0, 0)]])
    motion = Motion(
        "line",
        np.array([0.0, 2.0]),
        nodes,
        np.zeros((0, 2), int),
        np.zeros((0, 2), int),
        np.zeros(0, int),
    )
    np.testing.assert_allclose(motion.nodes_at(0.5), [(0.25, 0, 0)])


def test_a_structure_shows_what_its_rest_lengths_pull():
    prism = tc.shapes.prism(stiffness=1000.0, prestress=50.0)
    motion, model = of_structure(prism, "prism"), tc.Model(tc.Scene(prism))
    np.testing.assert_allclose(
        motion.tension[0], np.ravel(model.tension(model.initial_state)), rtol=1e-12
    )
    np.testing.assert_allclose(
        motion.force_density[0], np.ravel(model.force_density(model.initial_state)), rtol=1e-12
    )


def test_rollouts_are_copies_side_by_side():
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    many = tc.rollouts(
        model, 0.1, 0.01, states=np.tile(model.initial_state, (MOST_COPIES + 40, 1)), save_every=5
    )
    motion = of_rollouts(many, "many")
    n = len(model.structure.nodes)
    assert motion.copies == MOST_COPIES
    assert motion.name == f"many: {MOST_COPIES} of {MOST_COPIES + 40} motions"
    np.testing.assert_array_equal(motion.bars[2:4] - n, model.structure.bars)
    np.testing.assert_array_equal(motion.nodes[:, n : 2 * n][:, 2], many.path(2)[1])
    saved = tc.Rollouts.load(many.save("many.npz"))
    np.testing.assert_array_equal(saved.bars, model.structure.bars)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
