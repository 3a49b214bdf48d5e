"""Load paths of cables with friction: slip step by step, and the end of friction."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.structure.cables import wrap_angles

GRAVITY = tc.Gravity((0, 0, -9.81))


def weights(friction: float) -> tc.Scene:
    """Two masses on vertical guides hang on a cable between two supports."""
    nodes = [(0, 0, 0), (1, 0, -0.8), (2, 0, -0.9), (3, 0, 0)]
    s = tc.Structure(
        nodes,
        strings=[(0, 1), (2, 1), (2, 3)],
        node_mass=[0, 2.0, 2.5, 0],
        pinned={0: "xyz", 1: "xy", 2: "xy", 3: "xyz"},
        stiffness=2e4,
        rest_length=np.linalg.norm(np.diff(nodes, axis=0), axis=1),
        cables=[(0, 1, 2)],
        cable_friction=friction,
    )
    return tc.Scene(s, gravity=GRAVITY)


def test_cable_slips_step_by_step_under_a_growing_load():
    scene, load = weights(0.05), np.zeros((4, 3))
    load[2, 2] = -30.0
    path = tc.load_path(scene, load, factors=(0, 1))
    assert path.success, path.message
    assert path.stable.all()
    s = scene.structure
    angles = np.array([wrap_angles(s.replace(nodes=nodes), (0, 1, 2)) for nodes in path.nodes])
    ratio = np.log(path.tension[:, :-1] / path.tension[:, 1:]) / angles
    assert np.abs(ratio).max() <= 0.05 * (1 + 1e-6)
    np.testing.assert_allclose(np.abs(ratio[-1]), 0.05, rtol=1e-5)  # both nodes slip at last
    assert np.ptp(ratio[:, 0]) > 0.05  # the load turns the slip of the first node back
    forces = tc.Scene(s, gravity=GRAVITY, forces=tc.NodalForce(load))
    at_once = tc.find_equilibrium(forces, path.nodes[-1])
    np.testing.assert_allclose(path.nodes[-1], at_once.nodes, atol=1e-7)


def atwood(friction: float) -> tc.Scene:
    """Masses of 3 and 2 kg hang on both sides of a fixed node."""
    s = tc.Structure(
        [(0, 0, -1), (0, 0, 0), (0, 0, -1.2)],
        strings=[(0, 1), (1, 2)],
        node_mass=[3.0, 0, 2.0],
        pinned={0: "xy", 1: "xyz", 2: "xy"},
        stiffness=1e4,
        cables=[[0, 1]],
        cable_friction=friction,
    )
    return tc.Scene(s, gravity=GRAVITY)


def test_path_ends_where_friction_does_not_hold_the_load():
    path = tc.load_path(atwood(0.2), [(0, 0, -29.43), (0, 0, 0), (0, 0, 0)])
    assert not path.success
    assert path.factor[-1] == pytest.approx(2 * np.exp(0.2 * np.pi) / 3 - 1, rel=1e-4)
    assert "the search for slips of cable 0 stalled" in path.message
    assert np.isfinite(path.nodes).all()


def test_path_without_first_equilibrium_has_no_rows():
    path = tc.load_path(atwood(0.1), np.ones((3, 3)))
    assert not path.success
    assert path.nodes.shape == (0, 3, 3)
    assert "no equilibrium at factor 0" in path.message


def test_path_takes_a_load_only():
    with pytest.raises(ValueError, match="take a load only"):
        tc.load_path(weights(0.05), control=[0.1])
    with pytest.raises(ValueError, match="load has shape"):
        tc.load_path(weights(0.05), np.zeros(3))
    with pytest.raises(ValueError, match="are None: give one that changes"):
        tc.load_path(weights(0.05))
