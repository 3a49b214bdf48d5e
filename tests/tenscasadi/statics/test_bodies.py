"""Statics of structures with rigid bodies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscasadi as tc

ANGLE = np.deg2rad([90, 210, 330])
PLATE = 0.4 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE), np.zeros(3)])
FRAME = 0.8 * np.column_stack(
    [np.cos(ANGLE + np.pi / 3), np.sin(ANGLE + np.pi / 3), np.ones(3) / 0.8]
)
STRINGS = [(0, 3), (1, 4), (2, 5), (0, 5), (1, 3), (2, 4)]
INERTIA = (0.1, 0.1, 0.18)
BASES = {
    "three nodes": np.zeros((0, 3)),
    "four in a plane": np.zeros((1, 3)),
    "four": np.array([[0, 0, -0.3]]),
    "five": np.array([[0, 0, -0.3], [0.2, 0.1, -0.1]]),
}


def platform(more: np.ndarray, center=(0, 0, 0), **options: object) -> tc.Scene:
    """A plate of 3 kg on six strings."""
    nodes = np.vstack([PLATE, FRAME, more])
    plate = tc.RigidBody((0, 1, 2, *range(6, len(nodes))), 3.0, center, INERTIA)
    s = tc.Structure(
        nodes, strings=STRINGS, pinned=(3, 4, 5), bodies=[plate], stiffness=500.0, rest_length=1.0
    )
    return tc.Scene(s, gravity=tc.Gravity(), **options)


@pytest.mark.parametrize("more", BASES.values(), ids=BASES)
def test_plate_hangs_in_equilibrium(more):
    center = (0.05, 0.02, 0.0) if len(more) < 1 or more[0, 2] == 0 else (0.05, 0.02, -0.1)
    scene = platform(more, center)
    eq = tc.find_equilibrium(scene)
    assert eq.success, eq.message
    assert eq.stable
    np.testing.assert_allclose(eq.reactions.sum(axis=0), (0, 0, 3.0 * 9.81), atol=1e-6)
    np.testing.assert_allclose(eq.reactions[[0, 1, 2, *range(6, len(eq.nodes))]], 0, atol=1e-9)
    moment = np.cross(eq.nodes, eq.reactions).sum(axis=0)
    place = np.array(eq.structure.bodies[0].center)
    np.testing.assert_allclose(moment, np.cross(place, (0, 0, 3.0 * 9.81)), atol=1e-6)
    model = tc.Model(scene)
    assert np.abs(np.array(model.ode(eq.state, []))).max() < 1e-6  # at rest in the dynamics
    rest = [np.linalg.norm(nodes[0] - nodes[2:3]) for nodes in (eq.nodes, scene.structure.nodes)]
    assert rest[0] == pytest.approx(rest[1], abs=1e-12)


@pytest.mark.parametrize("more", BASES.values(), ids=BASES)
def test_stiffness_agrees_with_modes(more):
    scene = platform(more)
    eq = tc.find_equilibrium(scene)
    st = tc.stability(eq)
    assert st.stable
    assert len(st.eigenvalues) == 6
    # the compliance against a force is that of small differences of equilibria
    load = np.zeros_like(eq.nodes)
    load[0] = (0.01, 0.02, -0.01)
    pushed = tc.find_equilibrium(
        tc.Scene(scene.structure, gravity=scene.gravity, forces=tc.NodalForce(load)), start=eq.nodes
    )
    np.testing.assert_allclose(st.displacement(load), pushed.nodes - eq.nodes, atol=2e-7)
    assert tc.modes(tc.Model(scene), eq.state).frequency.min() > 0.1


def test_equilibrium_force_densities_carry_the_weight():
    s = platform(BASES["four"]).structure
    weight = np.zeros_like(s.nodes)
    weight[6] = (0, 0, -30.0)
    gamma = tc.equilibrium_force_density(s, weight, minimum=1.0)
    pulled = s.prestressed(gamma)
    eq = tc.find_equilibrium(tc.Scene(pulled, forces=tc.NodalForce(weight)))
    assert eq.success
    np.testing.assert_allclose(eq.nodes, s.nodes, atol=1e-6)
    st = tc.stability(s, gamma)
    assert st.force_density.shape == (6,)


def test_bodies_have_no_mechanisms_and_self_stress():
    """Twelve strings hold a free box within a frame: six more than its motions."""
    cube = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    nodes = np.vstack([cube, 3 * Rotation.from_rotvec((0, 0, 0.3)).apply(cube)])
    strings = [(k, 8 + k) for k in range(8)] + [(k, 8 + (k ^ 1)) for k in range(4)]
    box = tc.RigidBody(range(8), 1.0)
    s = tc.Structure(nodes, strings=strings, pinned=range(8, 16), bodies=[box])
    assert len(tc.self_stress(s)) == 12 - 6
    st = tc.stability(s)
    assert len(st.mechanisms) == 0
    loose = tc.Structure(nodes, pinned=range(8, 16), bodies=[box])
    assert len(tc.stability(loose).mechanisms) == 6


def test_load_path_of_a_hanging_plate():
    scene = platform(BASES["four"])
    load = np.zeros_like(scene.structure.nodes)
    load[6] = (0, 0, -10.0)
    path = tc.load_path(scene, load, factors=(0, 2))
    assert path.success, path.message
    assert path.nodes[-1, 6, 2] < path.nodes[0, 6, 2]


def test_center_off_the_plane_of_the_nodes_is_rejected():
    with pytest.raises(ValueError, match="add a node off this plane"):
        tc.find_equilibrium(platform(BASES["three nodes"], (0, 0, -0.1)))
