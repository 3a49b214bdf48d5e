"""Contact of bars as capsules: conservation, equilibrium, order, derivatives, and MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.exchange.mjcf.contact import contact_numbers

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
            tc.DormandPrince54(rtol=1e-8),
            tc.Cvodes(rtol=1e-9),
        )
    ]
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=1e-6)
    tolerance = 1e-3 if damping else 1e-6  # of first order in the step, of order two without
    np.testing.assert_allclose(run(model, 5e-5).nodes[-1], ends[0], atol=tolerance)


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
    options = {"t_end": 0.12, "step": 1e-3}
    found = tc.sensitivities(model, state, compiled=False, **options)
    size = 1e-6
    low, high = (
        tc.rollouts(model, states=state + sign * np.eye(model.nx), **options)
        for sign in (-size, size)
    )
    by_differences = (high.final - low.final).T / (2 * size)
    np.testing.assert_allclose(found.jacobian, by_differences, atol=2e-4)


def test_absent_contact_adds_no_term():
    """Bars with a radius pass through each other, and build no expression."""
    model = crossed()
    bare = tc.Model(tc.Scene(model.structure))
    assert "bar contact" not in bare.describe()
    assert "bar contact" in model.describe()
    gone = tc.Model(tc.Scene(model.structure, bar_contact=None))
    assert gone.describe() == bare.describe()


def test_mujoco_has_the_same_impact(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco")
    law = contact_numbers(tc.Ground(STIFFNESS), 1 / MASSES[0] + 1 / MASSES[1], 1.0)
    numbers = {name: " ".join(map(repr, values)) for name, values in law.items()}
    bodies = ""
    for k, mass in enumerate(MASSES):
        a, b = np.array(NODES[2 * k : 2 * k + 2], dtype=float)
        length = np.linalg.norm(b - a)
        across = mass * (length**2 / 12 + RADIUS**2 / 4)
        axis, middle = (" ".join(map(repr, x.tolist())) for x in (b - a, (a + b) / 2))
        ends = [
            f'<site name="n{2 * k + i}" pos="0 0 {z * length / 2}"/>' for i, z in enumerate((-1, 1))
        ]
        bodies += f"""<body pos="{middle}" zaxis="{axis}"><freejoint/>
          <inertial pos="0 0 0" mass="{mass}" diaginertia="{across} {across} {across / 50}"/>
          <geom name="bar{k}" type="capsule" size="{RADIUS} {length / 2}" contype="0" conaffinity="0"
          mass="0"/>{"".join(ends)}</body>"""
    pair = " ".join(f'{name}="{value}"' for name, value in numbers.items() if name != "friction")
    path = tmp_path / "crossed.xml"
    path.write_text(
        f"""<mujoco><option timestep="2e-5" integrator="RK4" gravity="0 0 0" cone="elliptic"/>
        <worldbody>{bodies}</worldbody><contact><pair geom1="bar0" geom2="bar1" {pair}/></contact>
        </mujoco>"""
    )
    world = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(world)
    data.qvel[2], data.qvel[8] = FALL[0, 2], FALL[2, 2]
    mujoco.mj_step(world, data, round(0.2 / 2e-5))
    mujoco.mj_kinematics(world, data)
    ends = np.array([data.site(f"n{node}").xpos for node in range(4)])
    found = run(crossed(), 5e-5)
    assert np.abs(found.nodes[-1] - (found.nodes[0] + 0.2 * FALL)).max() > 0.02
    assert np.abs(ends - found.nodes[-1]).max() < 2e-5
