"""Contact of bars as capsules: conservation, equilibrium, order, derivatives, and MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mujoco_runs import mujoco_ends

import tenscasadi as tc

STIFFNESS, RADIUS = 1e4, 0.05
NODES = [(-1, 0, 0), (1, 0, 0.1), (0.3, -1, 0.2), (0.2, 1, 0.2)]
MASSES = [1.0, 2.0]
FALL = np.array([(0, 0, 1.0), (0, 0, 1.0), (0, 0, -0.5), (0, 0, -0.5)])


def crossed(damping: float = 0.0, **options) -> tc.Model:
    """Two bars that fly at each other."""
    s = tc.Structure(NODES, bars=[(0, 1), (2, 3)], bar_radius=RADIUS, bar_mass=MASSES)
    contact = tc.BarContact([(0, 1)], STIFFNESS, damping)
    return tc.Model(tc.Scene(s, bar_contact=contact, **options))


def run(model: tc.Model, step: float = 2e-4, t_end: float = 0.2, **options) -> tc.Trajectory:
    state = model.state(model.structure.nodes, FALL)
    options = {"correction": tc.Projection(), "compiled": False, **options}
    found = tc.simulate(model, t_end, step, state=state, **options)
    assert found.success, found.message
    return found


def angular_momentum(nodes, velocities):
    """Sum over both bars, thin rods with the transverse inertia of their radius."""
    total = np.zeros(3)
    for k, mass in enumerate(MASSES):
        (a, b), (va, vb) = nodes[2 * k : 2 * k + 2], velocities[2 * k : 2 * k + 2]
        length = np.linalg.norm(b - a)
        inertia = mass * (1 / 12 + RADIUS**2 / (4 * length**2))  # Eq. 19
        total += mass * np.cross((a + b) / 2, (va + vb) / 2) + inertia * np.cross(b - a, vb - va)
    return total


def test_impact_keeps_energy_and_momenta():
    found = run(crossed(), 1e-4)
    assert np.abs(np.diff(found.velocities, axis=0)).max() > 1e-3  # they have met
    np.testing.assert_allclose(found.energy, found.energy[0], atol=1e-5 * found.energy[0])
    weights = np.repeat(MASSES, 2) / 2
    momentum = np.einsum("i,tij->tj", weights, found.velocities)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), atol=1e-12)
    spins = [angular_momentum(found.nodes[k], found.velocities[k]) for k in (0, -1)]
    np.testing.assert_allclose(spins[1], spins[0], atol=1e-10)


def test_damping_takes_energy():
    found = run(crossed(20.0), 1e-4)
    assert found.energy[-1] < 0.6 * found.energy[0]
    assert np.diff(found.energy).max() < 1e-5


@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_schemes_find_the_events(damping):
    """With damping the force jumps at the events."""
    model = crossed(damping)
    ends = [
        run(model, 1e-3, scheme=scheme, correction=None).nodes[-1]
        for scheme in (
            tc.DormandPrince853(rtol=1e-10),
            tc.Cvodes(rtol=1e-9),
        )
    ]
    np.testing.assert_allclose(ends[1:], [ends[0]], atol=1e-6)
    tolerance = 1e-3 if damping else 1e-5  # of first order in the step, of order two without
    np.testing.assert_allclose(run(model, 2e-4).nodes[-1], ends[0], atol=tolerance)


def test_order_is_four_within_contact():
    """Strings press the bars together: they never part."""
    s = tc.Structure(
        [(-1, 0, 0), (1, 0, 0), (0.1, -1, 0.09), (0.1, 1, 0.09)],
        bars=[(0, 1), (2, 3)],
        strings=[(0, 2), (0, 3), (1, 2), (1, 3)],
        bar_radius=RADIUS,
        stiffness=50.0,
        rest_length=0.5,
    )
    model = tc.Model(tc.Scene(s, bar_contact=tc.BarContact(stiffness=2e3), slack=tc.Linear()))
    steps = (2e-3, 1e-3, 5e-4)
    exact = tc.simulate(model, 0.2, 1e-4, compiled=False).nodes[-1]
    errors = [
        np.abs(tc.simulate(model, 0.2, step, compiled=False, verify=False).nodes[-1] - exact).max()
        for step in steps
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


def test_bar_rests_on_a_bar():
    """Two of its ends stand on strings; the contact carries the rest of its weight."""
    s = tc.Structure(
        [(-1, 0, 0), (1, 0, 0), (0, -1, 0.0995), (0, 1, 0.0995)],
        bars=[(0, 1), (2, 3)],
        pinned=(0, 1),
        bar_radius=RADIUS,
    )
    held = s.replace(pinned={0: "xyz", 1: "xyz", 2: "xy", 3: "xy"})
    scene = tc.Scene(held, gravity=tc.Gravity(), bar_contact=tc.BarContact(stiffness=STIFFNESS))
    rest = tc.find_equilibrium(scene)
    assert rest.success, rest.message
    weight = 9.81 * s.bar_mass[1]
    np.testing.assert_allclose(0.1 - rest.nodes[2:, 2], weight / STIFFNESS, rtol=1e-6)
    np.testing.assert_allclose(rest.reactions[:2].sum(axis=0), [0, 0, 2 * weight], atol=1e-6)
    frequency = tc.modes(tc.Model(scene), rest).frequency
    bounce = np.sqrt(STIFFNESS / s.bar_mass[1]) / (2 * np.pi)
    assert frequency[-1] == pytest.approx(bounce, rel=1e-6)


def test_derivatives_match_differences():
    model = crossed()
    state = model.state(model.structure.nodes, FALL)
    options = {"t_end": 0.1, "step": 2e-3}
    found = tc.sensitivities(model, state, compiled=False, **options)
    size = 1e-6
    low, high = (
        tc.rollouts(model, states=state + sign * np.eye(model.nx), **options)
        for sign in (-size, size)
    )
    by_differences = (high.final - low.final).T / (2 * size)
    np.testing.assert_allclose(found.jacobian, by_differences, atol=2e-4)


@pytest.mark.parametrize("compiled", [False, True])
def test_stiffness_and_damping_are_parameters(compiled):
    names = "bar_contact_stiffness", "bar_contact_damping"
    model = crossed(1.0, parameters=tc.Parameters(*names))
    assert model.parameters.names == names
    given = {"bar_contact_stiffness": 2 * STIFFNESS, "bar_contact_damping": 20.0}
    one = run(model, parameters=given, compiled=compiled)
    law = tc.BarContact([(0, 1)], 2 * STIFFNESS, 20.0)
    other = run(tc.Model(tc.Scene(model.structure, bar_contact=law)), compiled=compiled)
    np.testing.assert_allclose(one.nodes, other.nodes, atol=1e-12)
    np.testing.assert_allclose(one.energy, other.energy, atol=1e-12)
    assert tc.stable_step(model, parameters=given) == pytest.approx(
        tc.stable_step(tc.Model(tc.Scene(model.structure, bar_contact=law)))
    )
    state = model.state(model.structure.nodes, FALL)
    found = tc.sensitivities(model, state, t_end=0.1, step=1e-3, by="parameters", compiled=False)
    assert np.abs(found.jacobian).max() > 0
    with pytest.raises(ValueError, match=r"bar_contact_stiffness.*Scene\.bar_contact is None"):
        tc.Scene(model.structure, parameters=tc.Parameters("bar_contact_stiffness"))
    with pytest.raises(ValueError, match="bar_contact_damping is -1"):
        run(model, parameters={**given, "bar_contact_damping": -1.0})


def test_absent_contact_adds_no_term():
    """Bars with a radius pass through each other, and build no expression."""
    model = crossed()
    bare = tc.Model(tc.Scene(model.structure))
    assert "bar contact" not in bare.describe()
    assert "bar contact" in model.describe()
    gone = tc.Model(tc.Scene(model.structure, bar_contact=None))
    assert gone.describe() == bare.describe()


@pytest.mark.parametrize("damping", [0.0, 5.0])
def test_mujoco_has_the_same_impact(damping, tmp_path: Path):
    model = crossed(damping)
    ours = run(model, 1e-3, scheme=tc.DormandPrince853(rtol=1e-10), correction=None).nodes
    assert np.abs(ours[-1] - (ours[0] + 0.2 * FALL)).max() > 0.02
    path = tc.export_mjcf(model.scene, tmp_path / "crossed.xml", FALL, step=5e-5)
    assert np.abs(mujoco_ends(path, 0.2) - ours[-1]).max() < 2e-5
    parted = tc.export_mjcf(tc.Scene(model.structure), tmp_path / "parted.xml")
    assert "capsule" not in parted.read_text(encoding="utf-8")
