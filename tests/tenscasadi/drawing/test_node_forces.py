"""Forces on nodes in pictures, compared with the balance of the whole structure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content

G = 9.81


def find(thing, kind, row=-1):
    """Compute the forces of a kind in a row of a motion."""
    motion = describe_content(thing).motions[0]
    forces = {forces.name: forces for forces in motion.forces}
    return forces[kind].at(motion.frame_at(motion.time[row]))


def external_force(run, row):
    """Compute the sum of all forces (3,) but the weight from the rate of the momentum."""
    mass = run.scene.structure.mass_matrix()
    momentum = np.einsum("i,tij->tj", mass.sum(axis=0), run.velocities)
    weight = [0.0, 0.0, -G * mass.sum()]
    return np.gradient(momentum, run.time, axis=0)[row] - weight


@pytest.fixture(scope="module")
def held():
    """A pinned prism under gravity and a load."""
    prism = tc.shapes.prism(pinned=[0, 1, 2], stiffness=500.0, damping=50.0, prestress=50.0)
    loads = np.zeros((6, 3))
    loads[3] = 1.0, 2.0, 3.0
    scene = tc.Scene(prism, gravity=tc.Gravity(), forces=tc.NodalForce(loads))
    return tc.simulate(tc.Model(scene), 0.1, 1e-3, compiled=False)


def test_reactions_balance_the_momentum(held):
    reactions = find(held, "reaction", 50)
    found = external_force(held, 50) - find(held, "load", 50).sum(axis=0)
    assert reactions.sum(axis=0) == pytest.approx(found, rel=1e-3, abs=1e-3)
    assert not reactions[3:].any()


def test_reactions_are_those_of_a_loaded_file(held, tmp_path):
    loaded = tc.Trajectory.load(held.save(tmp_path / "held.npz"))
    assert find(loaded, "reaction") == pytest.approx(find(held, "reaction"), abs=1e-9)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_reactions_of_a_swinging_pendulum(coordinates):
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), coordinates)
    run = tc.simulate(model, 0.1, 1e-3, compiled=False)
    found = find(run, "reaction", 60).sum(axis=0)
    assert found == pytest.approx(external_force(run, 60), rel=1e-3, abs=1e-3)


def test_loads_follow_the_clock():
    sway = tc.NodalForce(lambda t: [[0, 0, 0], [10 * t, 0, 0]])
    run = tc.simulate(tc.Model(tc.Scene(tc.shapes.pendulum(), forces=sway)), 0.2, 0.01)
    assert find(run, "load")[1] == pytest.approx([2.0, 0.0, 0.0])
    assert not find(run, "load")[0].any()


def test_pressure_is_a_load():
    net = tc.shapes.membrane(4, 3)
    pressure = tc.Pressure(tc.shapes.membrane_faces(4, 3), 20.0)
    assert find(tc.Scene(net, pressure=pressure), "load").sum(axis=0)[2] != 0


def test_contact_forces_balance_the_momentum():
    ball = tc.shapes.six_bar_ball(stiffness=1000.0, damping=20.0, prestress=50.0)
    ground = tc.Ground(height=ball.nodes[:, 2].min(), stiffness=5e3, damping=100.0)
    run = tc.simulate(tc.Model(tc.Scene(ball, gravity=tc.Gravity(), ground=ground)), 0.1, 1e-3)
    forces = find(run, "contact", 60)
    assert forces[:, 2].max() > 1
    assert forces.sum(axis=0) == pytest.approx(external_force(run, 60), rel=0.02, abs=0.1)


def test_unknown_scenes_have_no_forces(held):
    assert describe_content(replace(held, scene=None)).motions[0].forces == ()


def test_parameters_of_the_run_count():
    scene = tc.Scene(
        tc.shapes.pendulum(), gravity=tc.Gravity(), parameters=tc.Parameters("bar_mass")
    )
    run = tc.simulate(tc.Model(scene), 0.01, 1e-3, parameters=[5.0], compiled=False)
    light = tc.simulate(tc.Model(scene), 0.01, 1e-3, parameters=[1.0], compiled=False)
    assert find(run, "reaction") == pytest.approx(5 * find(light, "reaction"), rel=1e-6)
