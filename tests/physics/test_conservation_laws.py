"""Conservation laws: energy, linear and angular momentum, and motions that reverse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from flights import G, centre, fly

import tenscasadi as tc


def ball_on_the_ground(damping: float, friction: float | None = None) -> tc.Scene:
    ball = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0, damping=damping)
    ground = tc.Ground(2e3, damping, friction=friction)
    return tc.Scene(
        ball.replace(nodes=ball.nodes + (0, 0, 0.8)), gravity=tc.Gravity((0, 0, -G)), ground=ground
    )


@pytest.mark.parametrize("friction", [None, 0.4])
def test_energy_never_grows_where_there_is_damping(friction: float | None) -> None:
    scene = ball_on_the_ground(5.0, friction)
    spin = np.cross((0.0, 3.0, 1.0), scene.structure.nodes - (0, 0, 0.8)) + (1.0, 0.0, 0.0)
    _, run = fly(scene, 1.5, 1e-4, velocities=spin, save_every=20, compiled=None)
    assert run.nodes[:, :, 2].min() < -0.01  # it did hit the ground
    assert np.diff(run.energy).max() < 1e-9
    assert run.energy[0] - run.energy[-1] > 1.0
    assert np.abs(run.energy_error).max() < 5e-3 * (run.energy[0] - run.energy[-1])


def test_an_undamped_elastic_body_keeps_its_energy_and_its_motion_reverses() -> None:
    """Dropped, bounced, then with all velocities turned round: it goes back to where it was dropped, at rest."""
    scene = ball_on_the_ground(0.0)
    model, there = fly(scene, 0.6, 1e-4, compiled=None)
    assert there.nodes[:, :, 2].min() < -0.01
    assert there.velocities[-1, :, 2].mean() > 0  # on its way up again
    assert np.abs(there.energy - there.energy[0]).max() < 1e-3 * there.energy_parts[:, 0].max()
    back = tc.simulate(
        model,
        0.6,
        1e-4,
        state=model.state(there.nodes[-1], -there.velocities[-1]),
        correction=tc.Projection(),
    )
    np.testing.assert_allclose(back.nodes[-1], there.nodes[0], atol=1e-4)
    np.testing.assert_allclose(back.velocities[-1], 0, atol=2e-2)


def angular_momentum(model: tc.Model, nodes: Any, velocities: Any) -> Any:
    """Σ over M of nᵢ × v_j about the origin (…, 3)."""
    carried = np.einsum("ij,...jx->...ix", model.structure.mass_matrix().toarray(), velocities)
    return np.cross(nodes, carried).sum(axis=-2)


@pytest.mark.parametrize(
    "structure",
    [
        tc.shapes.six_bar_ball(
            prestress=50.0, stiffness=1000.0, damping=3.0, bar_radius=0.02, node_mass=0.1
        ),
        tc.shapes.d_bar(stiffness=100.0, rest_length=[1.0, 1.2], damping=1.0),
        tc.shapes.membrane(5, 4, stiffness=200.0, rest_length=0.3, damping=0.5),
    ],
    ids=["ball", "d_bar", "membrane"],
)
def test_a_free_structure_keeps_its_momentum(structure: tc.Structure) -> None:
    velocity = np.cross((0.2, 0.5, 1.0), structure.nodes) + (0.4, -0.3, 0.2)
    model, run = fly(tc.Scene(structure), 1.0, 1e-3, velocities=velocity)
    scale = model.structure.mass_matrix().sum() * np.abs(velocity).max()
    linear = centre(model, run.velocities)
    np.testing.assert_allclose(linear, np.broadcast_to(linear[0], linear.shape), atol=1e-12)
    np.testing.assert_allclose(
        centre(model, run.nodes),
        centre(model, run.nodes[0]) + linear[0] * run.time[:, None],
        atol=1e-12,
    )
    turning = angular_momentum(model, run.nodes, run.velocities)
    np.testing.assert_allclose(
        turning, np.broadcast_to(turning[0], turning.shape), atol=1e-7 * scale
    )
    assert (
        np.ptp(run.nodes - centre(model, run.nodes)[:, None], axis=0).max() > 0.05
    )  # it does move


def test_a_free_structure_falls_as_a_stone() -> None:
    ball = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0, string_mass=0.05)
    model, run = fly(tc.Scene(ball, segments=2, gravity=tc.Gravity((0, 0, -G))), 0.5, 1e-3)
    np.testing.assert_allclose(centre(model, run.nodes)[:, 2], -G * run.time**2 / 2, atol=1e-12)
    np.testing.assert_allclose(
        run.nodes - centre(model, run.nodes)[:, None],
        np.broadcast_to(run.nodes[0], run.nodes.shape),
        atol=1e-9,
    )
