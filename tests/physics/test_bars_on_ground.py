"""Capsules of bars on grounds and friction of bars: closed forms, energy, order, and MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mujoco_runs import mujoco_ends

import tenscasadi as tc
from tenscasadi.integrators.stability import contact_rate, find_limit

GRAVITY, RADIUS, MASS, STIFFNESS = 9.81, 0.05, 2.0, 1e4
TILTED = [(0, 0, 0.3), (0.6, 0, 1.1)]  # 1 m long


def stick(nodes=TILTED, **options) -> tc.Structure:
    return tc.Structure(nodes, bars=[(0, 1)], bar_radius=RADIUS, bar_mass=MASS, **options)


def fall(ground: tc.Ground | tc.Terrain, nodes=TILTED, **options) -> tc.Model:
    return tc.Model(tc.Scene(stick(nodes), gravity=tc.Gravity(), ground=ground, **options))


def run(model: tc.Model, t_end: float, step: float = 2e-4, **options) -> tc.Trajectory:
    options = {"correction": tc.Projection(), "compiled": False, **options}
    found = tc.simulate(model, t_end, step, **options)
    assert found.success, found.message
    return found


def test_bar_rests_at_its_radius():
    rest = tc.find_equilibrium(fall(tc.Ground(STIFFNESS, bars=[0]), [(0, 0, 0.05), (1, 0, 0.05)]))
    assert rest.success, rest.message
    depth = MASS * GRAVITY / 2 / STIFFNESS
    np.testing.assert_allclose(rest.nodes[:, 2], RADIUS - depth, atol=1e-9)


def test_bar_on_a_ridge_touches_between_its_ends():
    ridge = tc.Terrain([[0, 0], [0.5, 0.5], [0, 0]], (-1, -1), (1, 1), 1e5, bars="all")
    held = stick([(-0.5, 0, 0.56), (0.5, 0, 0.56)], pinned={0: "xy", 1: "xy"})
    eq = tc.find_equilibrium(tc.Scene(held, gravity=tc.Gravity(), ground=ridge))
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.nodes[:, 2], 0.5 + RADIUS - MASS * GRAVITY / 1e5, atol=1e-6)
    without = tc.Terrain([[0, 0], [0.5, 0.5], [0, 0]], (-1, -1), (1, 1), 1e5)
    low = tc.find_equilibrium(tc.Scene(held, gravity=tc.Gravity(), ground=without))
    assert low.nodes[:, 2].max() < 0.3  # only its ends touch


@pytest.mark.parametrize(
    ("size", "options"), [(3, {"bar_points": 2}), (3, {}), (11, {}), (101, {})]
)
def test_bar_on_flat_terrain_moves_as_on_a_plane(size: int, options: dict):
    law = {"stiffness": 2e4, "damping": 50.0, "friction": 0.5, "bars": "all"}
    flat = tc.Terrain(np.zeros((size, size)), (-2, -2), (2, 2), **law, **options)
    nodes = [(-0.6, 0, RADIUS - 1e-3), (0.6, 0.2, RADIUS - 1e-3)]
    model, plane = fall(flat, nodes), fall(tc.Ground(**law), nodes)
    assert contact_rate(model) == contact_rate(plane)
    assert find_limit(model, tc.RungeKutta4()) >= find_limit(plane, tc.RungeKutta4())
    ours, theirs = run(model, 0.2, 5e-4), run(plane, 0.2, 5e-4)
    np.testing.assert_allclose(ours.nodes, theirs.nodes, atol=1e-9)
    np.testing.assert_allclose(ours.energy, theirs.energy, atol=1e-9)


def test_bar_on_a_bowl_keeps_its_energy_over_many_points():
    x = np.linspace(-1, 1, 41)
    bowl = tc.Terrain(0.2 * (x[:, None] ** 2 + x**2), (-1, -1), (1, 1), STIFFNESS, bars="all")
    found = run(fall(bowl, [(-0.4, 0, 0.2), (0.5, 0.1, 0.35)]), 0.5, 1e-4, correction=None)
    assert found.nodes[:, :, 2].min() < 0.1  # it touched
    np.testing.assert_allclose(found.energy, found.energy[0], rtol=1e-3)


def test_frictionless_impact_keeps_energy():
    found = run(fall(tc.Ground(STIFFNESS, bars="all")), 0.6, 1e-4)
    assert found.nodes[:, 0, 2].min() < RADIUS  # it touched
    np.testing.assert_allclose(found.energy, found.energy[0], rtol=2e-5)


def test_friction_slows_a_sliding_bar_and_loads_its_front():
    """Friction acts a radius below the axis: its moment moves load to the leading end."""
    mu = 0.3
    ground = tc.Ground(STIFFNESS, 20.0, mu, slip_speed=1e-4, bars=[0])
    depth = MASS * GRAVITY / 2 / STIFFNESS
    lever = mu * MASS * GRAVITY * RADIUS / 1.0 / STIFFNESS  # of depth, from both ends
    height = RADIUS - depth
    model = fall(ground, [(0, 0, height), (1, 0, height)])
    state = model.state(model.structure.nodes, [(2.0, 0, 0)] * 2)
    found = run(model, 0.5, state=state)
    np.testing.assert_allclose(found.velocities[-1][:, 0], 2.0 - mu * GRAVITY * 0.5, atol=5e-3)
    last = found.nodes[-1][:, 2]
    assert last[0] - last[1] == pytest.approx(2 * lever, rel=5e-2)
    assert np.diff(found.energy).max() < 1e-6
    np.testing.assert_allclose(found.energy_error, 0, atol=1e-5)


@pytest.mark.parametrize("friction", [None, 0.4])
def test_order_is_four_within_contact(friction):
    model = fall(
        tc.Ground(2e3, 5.0, friction, slip_speed=0.5, bars=[0]), [(0, 0, 0.044), (0.96, 0.1, 0.046)]
    )
    state = model.state(model.structure.nodes, [(0.3, 0.2, 0), (0.3, 0.2, 0)])
    options = {"compiled": False, "verify": False, "state": state}
    exact = tc.simulate(model, 0.1, 5e-5, **options).nodes[-1]
    errors = [
        np.abs(tc.simulate(model, 0.1, step, **options).nodes[-1] - exact).max()
        for step in (2e-3, 1e-3, 5e-4)
    ]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4.0, atol=0.3)


def test_schemes_agree_on_a_falling_bar():
    model = fall(tc.Ground(STIFFNESS, 20.0, 0.4, slip_speed=0.1, bars="all"))
    exact = run(model, 0.5, 1e-3, scheme=tc.DormandPrince853(rtol=1e-10), correction=None)
    for scheme in (tc.Cvodes(rtol=1e-9), tc.Collocation(2), tc.Rattle()):
        other = run(model, 0.5, 2.5e-4, scheme=scheme, correction=None)
        np.testing.assert_allclose(other.nodes[-1], exact.nodes[-1], atol=2e-4)


def test_derivatives_match_differences():
    model = fall(tc.Ground(1e3, 5.0, 0.4, slip_speed=0.1, bars=[0]), [(0, 0, 0.1), (0.6, 0, 0.9)])
    options = {"t_end": 0.3, "step": 2e-3}
    found = tc.sensitivities(model, model.initial_state, compiled=False, **options)
    size = 1e-6
    low, high = (
        tc.rollouts(model, states=model.initial_state + sign * np.eye(model.nx), **options)
        for sign in (-size, size)
    )
    np.testing.assert_allclose(found.jacobian, (high.final - low.final).T / (2 * size), atol=1e-3)


def test_compiled_code_has_the_same_motion():
    ridge = tc.Terrain([[0, 0], [0.2, 0.2], [0, 0]], (-1, -1), (1, 1), 1e4, 10.0, 0.4, bars=[0])
    model = fall(ridge)
    one, other = (run(model, 0.3, compiled=compiled) for compiled in (False, True))
    np.testing.assert_allclose(one.nodes, other.nodes, atol=1e-10)


def test_mujoco_has_the_same_falling_capsule(tmp_path: Path):
    model = fall(tc.Ground(STIFFNESS, 20.0, bars=[0]))
    ours = run(model, 0.5, 1e-3, scheme=tc.DormandPrince853(rtol=1e-10), correction=None).nodes
    path = tc.export_mjcf(model.scene, tmp_path / "stick.xml", step=4e-5)
    assert np.abs(mujoco_ends(path, 0.5) - ours[-1]).max() < 1e-4


def test_mujoco_has_the_same_sliding_capsule(tmp_path: Path):
    """The bar slides along its axis, so the capsule does not roll."""
    ground = tc.Ground(STIFFNESS, 20.0, 0.3, slip_speed=1e-2, bars=[0])
    height = RADIUS - MASS * GRAVITY / 2 / STIFFNESS
    nodes, V = [(0, 0, height), (1, 0, height)], np.array([(1.5, 0, 0)] * 2)
    model = fall(ground, nodes)
    ours = run(model, 0.4, state=model.state(nodes, V)).nodes[-1]
    theirs = mujoco_ends(tc.export_mjcf(model.scene, tmp_path / "s.xml", V, step=1e-4), 0.4)
    np.testing.assert_allclose(theirs[:, 0], ours[:, 0], atol=1e-3)  # 0.36 m
    np.testing.assert_allclose(theirs[:, 2], ours[:, 2], atol=1e-3)  # slip lifts it in MuJoCo


def crossed(friction: float | None, damping: float = 0.0) -> tc.Model:
    """A bar that slides along its axis over two fixed ones."""
    nodes = [(-0.3, -1, 0), (-0.3, 1, 0), (0.3, -1, 0), (0.3, 1, 0), (-1, 0, 0), (1, 0, 0)]
    sunk = MASS * GRAVITY / 2 / STIFFNESS
    nodes[4:] = [(x, 0, 2 * RADIUS - sunk) for x in (-1, 1)]
    held = {0: "xyz", 1: "xz", 2: "xyz", 3: "xz"}
    s = tc.Structure(nodes, [(0, 1), (2, 3), (4, 5)], bar_radius=RADIUS, bar_mass=MASS, pinned=held)
    law = tc.BarContact([(0, 2), (1, 2)], STIFFNESS, damping, friction, slip_speed=1e-3)
    return tc.Model(tc.Scene(s, gravity=tc.Gravity(), bar_contact=law))


def test_friction_of_bars_slows_a_sliding_bar():
    model = crossed(0.2, damping=20.0)
    velocities = np.zeros((6, 3))
    velocities[4:, 0] = 0.6
    found = run(model, 0.2, state=model.state(model.structure.nodes, velocities))
    np.testing.assert_allclose(found.velocities[-1][4:, 0], 0.6 - 0.2 * GRAVITY * 0.2, atol=3e-3)
    assert np.diff(found.energy).max() < 1e-6
    np.testing.assert_allclose(found.energy_error, 0, atol=1e-5)
    free = run(crossed(None), 0.2, state=crossed(None).state(model.structure.nodes, velocities))
    np.testing.assert_allclose(free.velocities[-1][4:, 0], 0.6, atol=3e-3)


def test_friction_of_free_bars_keeps_momentum():
    s = tc.Structure(
        [(-1, 0, 0), (1, 0, 0.1), (0.3, -1, 0.2), (0.2, 1, 0.2)],
        bars=[(0, 1), (2, 3)],
        bar_radius=RADIUS,
        bar_mass=[1.0, 2.0],
    )
    law = tc.BarContact(stiffness=STIFFNESS, friction=0.5, slip_speed=0.05)
    model = tc.Model(tc.Scene(s, bar_contact=law))
    start = np.array([(1, 0, 1.0), (1, 0, 1.0), (0, 0, -0.5), (0, 0, -0.5)])
    found = run(model, 0.2, 1e-4, state=model.state(model.structure.nodes, start))
    assert found.energy[-1] < 0.98 * found.energy[0]
    momentum = np.einsum("i,tij->tj", [0.5, 0.5, 1.0, 1.0], found.velocities)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), atol=1e-11)


def test_friction_is_a_parameter():
    model = crossed(0.2, damping=20.0)
    names = "bar_contact_friction", "bar_contact_damping"
    free = tc.Model(tc.Scene(**{**vars_of(model.scene), "parameters": tc.Parameters(*names)}))
    velocities = np.zeros((6, 3))
    velocities[4:, 0] = 0.6
    for value in (0.3, 0.0):
        given = {"bar_contact_friction": value, "bar_contact_damping": 20.0}
        one = run(free, 0.1, state=free.state(free.structure.nodes, velocities), parameters=given)
        other = run(
            crossed(value or None, 20.0), 0.1, state=model.state(model.structure.nodes, velocities)
        )
        np.testing.assert_allclose(one.nodes, other.nodes, atol=1e-10)
    with pytest.raises(ValueError, match=r"bar_contact_friction.*BarContact\.friction is None"):
        tc.Scene(**{**vars_of(crossed(None).scene), "parameters": tc.Parameters(names[0])})


def vars_of(scene: tc.Scene) -> dict[str, object]:
    return {name: getattr(scene, name) for name in scene.__dataclass_fields__}
