"""Motions against closed forms: oscillators, slack, impact, friction and spin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from flights import G, centre, fly

import tenscasadi as tc


def order(error: Callable[[float], float], end: float, steps: int, times: int = 8) -> float:
    """Order of convergence from about `steps` steps to `times` as many, by the root mean square over runs that meet events at any part of a step."""
    groups = [
        end / (factor * np.arange(steps, 1.8 * steps, steps / 25).astype(int))
        for factor in (1, times)
    ]
    coarse, fine = (np.sqrt(np.mean([error(float(h)) ** 2 for h in group])) for group in groups)
    return float(np.log(coarse / fine) / np.log(times))


# --- strings ---


@pytest.mark.parametrize("mass", [(1.0, 1.0), (0.5, 3.0)])
def test_two_masses_on_a_string_swing_at_the_frequency_of_their_reduced_mass(
    mass: tuple[float, float],
) -> None:
    k, rest, pull = 80.0, 1.0, 40.0
    start = (
        rest + 0.9 * pull / k
    )  # stretched by 10 % less than the forces ask for: it never goes slack
    s = tc.Structure(
        [(0, 0, 0), (start, 0, 0)], strings=[(0, 1)], node_mass=mass, stiffness=k, rest_length=rest
    )
    omega = np.sqrt(k * sum(mass) / (mass[0] * mass[1]))
    forces = tc.NodalForce([(-pull, 0, 0), (pull, 0, 0)])
    _, run = fly(tc.Scene(s, forces=forces), 3 * 2 * np.pi / omega, 2e-3)
    length = run.nodes[:, 1, 0] - run.nodes[:, 0, 0]
    np.testing.assert_allclose(
        length, rest + pull / k * (1 - 0.1 * np.cos(omega * run.time)), atol=1e-8
    )
    assert np.abs(run.nodes[-1] - run.nodes[0]).max() < 1e-8  # after three periods


def test_a_damped_string_decays_as_the_linear_oscillator() -> None:
    m, k, c = 2.0, 50.0, 4.0
    s = tc.Structure(
        [(0, 0, 0), (0, 0, -1.6)],
        strings=[(0, 1)],
        node_mass=m,
        pinned=[0],
        stiffness=k,
        damping=c,
        rest_length=1.0,
    )
    _, run = fly(tc.Scene(s, gravity=tc.Gravity((0, 0, -G))), 4.0, 2e-3)
    rest, beta = -1.0 - m * G / k, c / (2 * m)
    omega = np.sqrt(k / m - beta**2)
    start = -1.6 - rest
    motion = (
        np.exp(-beta * run.time)
        * start
        * (np.cos(omega * run.time) + beta / omega * np.sin(omega * run.time))
    )
    np.testing.assert_allclose(run.nodes[:, 1, 2], rest + motion, atol=1e-8)
    assert np.all(np.diff(run.energy) < 0)
    assert np.abs(run.energy_error).max() < 1e-8


def slack_line(time: Any, k: float, m: float, stretch: float, wall: float) -> Any:
    """x of a mass pulled by a string (fixed at 0, at rest `wall` long) from wall + stretch: a quarter of a swing, then free."""
    omega = np.sqrt(k / m)
    release = np.pi / (2 * omega)
    return np.where(
        time < release,
        wall + stretch * np.cos(omega * time),
        wall - stretch * omega * (time - release),
    )


def test_a_slack_string_carries_exactly_nothing() -> None:
    k, m, stretch, wall = 100.0, 1.0, 0.2, 1.0
    s = tc.Structure(
        [(0, 0, 0), (wall + stretch, 0, 0)],
        strings=[(0, 1)],
        node_mass=m,
        pinned=[0],
        stiffness=k,
        rest_length=wall,
        damping=0.0,
    )

    model = tc.Model(tc.Scene(s))  # of all runs

    def run(step: float) -> tc.Trajectory:
        found = tc.simulate(
            model, 0.4, step, correction=tc.Projection(), compiled=False, save_every=1
        )
        assert found.success, found.message
        return found

    fine = run(1e-3)
    free = fine.time > np.pi / (2 * np.sqrt(k / m)) + 1e-3
    assert np.all(fine.tension[free] == 0)
    assert np.all(fine.force_density[free] == 0)
    assert np.all(fine.tension[fine.time < 0.15] > 0)
    assert np.ptp(fine.velocities[free], axis=0).max() == 0  # to the last bit: no force at all
    np.testing.assert_allclose(
        fine.nodes[:, 1, 0], slack_line(fine.time, k, m, stretch, wall), atol=2e-6
    )
    assert np.all(np.diff(fine.energy_parts[free, 1]) == 0)
    # A force whose slope jumps inside a step leaves an error of order 2, whatever the scheme.
    end = slack_line(0.4, k, m, stretch, wall)
    assert 1.6 < order(lambda h: float(run(h).nodes[-1, 1, 0] - end), 0.4, 50) < 2.4


def test_a_string_catches_the_mass_again() -> None:
    """Thrown along a slack string, the mass stops at v √(m/k) beyond the rest length and comes back as fast as it went."""
    k, m, v = 400.0, 1.0, 2.0
    s = tc.Structure(
        [(0, 0, 0), (0.5, 0, 0)],
        strings=[(0, 1)],
        node_mass=m,
        pinned=[0],
        stiffness=k,
        rest_length=1.0,
    )
    _, run = fly(tc.Scene(s), 0.6, 2e-4, velocities=[(0, 0, 0), (v, 0, 0)], save_every=1)
    assert run.nodes[:, 1, 0].max() == pytest.approx(1 + v * np.sqrt(m / k), abs=1e-6)
    assert run.velocities[-1, 1, 0] == pytest.approx(-v, abs=1e-6)
    assert run.tension[run.time < 0.25].max() == 0


# --- impact ---


def bounce(
    t_end: float, step: float, damping: float = 0.0, k: float = 1e3, height: float = 0.5
) -> tc.Trajectory:
    s = tc.Structure([(0, 0, height)], node_mass=1.0)
    return fly(
        tc.Scene(s, gravity=tc.Gravity((0, 0, -G)), ground=tc.Ground(k, damping)),
        t_end,
        step,
        save_every=1,
    )[1]


def bounce_height(time: float, k: float = 1e3, height: float = 0.5) -> float:
    """Height of an undamped mass of 1 kg that falls on a linear spring; it returns exactly to where it started."""
    fall = np.sqrt(2 * height / G)
    speed, omega, sag = G * fall, np.sqrt(k), G / k
    contact = 2 * (np.pi - np.arctan2(speed, omega * sag)) / omega
    t = time % (2 * fall + contact)
    if t < fall:
        return float(height - G * t**2 / 2)
    if t > fall + contact:
        return float(height - G * (2 * fall + contact - t) ** 2 / 2)
    return float(
        -sag + sag * np.cos(omega * (t - fall)) - speed / omega * np.sin(omega * (t - fall))
    )


def test_an_undamped_mass_returns_to_its_height() -> None:
    period = 2 * np.sqrt(2 * 0.5 / G) + 2 * (
        np.pi - np.arctan2(np.sqrt(2 * G * 0.5), G / np.sqrt(1e3))
    ) / np.sqrt(1e3)
    run = bounce(3.5 * period, 1e-3)
    tops = [run.nodes[abs(run.time - n * period) < 5e-3, 0, 2].max() for n in (1, 2, 3)]
    np.testing.assert_allclose(tops, 0.5, atol=2e-4)
    np.testing.assert_allclose(run.nodes[:, 0, 2], [bounce_height(t) for t in run.time], atol=2e-3)
    assert np.abs(run.energy_error).max() < 2e-3


@pytest.mark.slow
def test_the_error_of_a_bounce_is_of_order_two_and_of_order_one_with_damping() -> None:
    end = 0.6  # between the first impact and the second
    damped = float(bounce(end, 6e-6, 20.0).nodes[-1, 0, 2])
    assert (
        1.6
        < order(lambda h: float(bounce(end, h).nodes[-1, 0, 2]) - bounce_height(end), end, 150)
        < 2.4
    )
    assert (
        0.7 < order(lambda h: float(bounce(end, h, 20.0).nodes[-1, 0, 2]) - damped, end, 150) < 1.3
    )  # the damper's force jumps at contact


@pytest.mark.parametrize(
    ("ratio", "friction"), [(0.05, None), (0.2, None), (0.5, None), (0.2, 0.5)]
)
def test_restitution_of_a_damped_contact_that_never_pulls(
    ratio: float, friction: float | None
) -> None:
    """Without gravity: e = exp(−β/ω (π − atan(2βω/(ω²−β²)))), where contact ends as the force, not the depth, becomes zero."""
    k, m, v = 1e4, 1.0, 3.0
    beta = ratio * np.sqrt(k / m)
    omega = np.sqrt(k / m - beta**2)
    e = np.exp(-beta / omega * (np.pi - np.arctan(2 * beta * omega / (omega**2 - beta**2))))
    s = tc.Structure([(0, 0, 0.01)], node_mass=m)
    _, run = fly(
        tc.Scene(s, ground=tc.Ground(k, 2 * m * beta, friction=friction)),
        0.1,
        1e-5,
        velocities=[(0, 0, -v)],
        save_every=10,
    )
    assert run.velocities[-1, 0, 2] / v == pytest.approx(e, abs=2e-3)
    assert np.all(np.diff(run.energy) <= 1e-12)


# --- friction ---

MU = 0.5
SLIP = 1e-3


def slope(
    angle: float,
    tilted: str,
    structure: tc.Structure,
    slip_speed: float = SLIP,
    damping: float = 50.0,
) -> tuple[tc.Scene, Any]:
    """A slope of `angle`, as a tilted ground or as tilted gravity, and its downhill direction; the structure stands on the ground z ≤ 0."""
    down = np.array([np.sin(angle), 0, -np.cos(angle)])
    if tilted == "gravity":
        ground = tc.Ground(1e5, damping, friction=MU, slip_speed=slip_speed)
        return tc.Scene(structure, gravity=tc.Gravity(G * down), ground=ground), np.array(
            [1.0, 0.0, 0.0]
        )
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    ground = tc.Ground(1e5, damping, friction=MU, slip_speed=slip_speed, normal=turn @ (0, 0, 1))
    return tc.Scene(
        structure.replace(nodes=structure.nodes @ turn.T),
        gravity=tc.Gravity((0, 0, -G)),
        ground=ground,
    ), turn @ (1.0, 0.0, 0.0)


def block(angle: float) -> tc.Structure:
    """A point of 2 kg, as deep in the ground as its weight asks for."""
    return tc.Structure([(0, 0, -2.0 * G * np.cos(angle) / 1e5)], node_mass=2.0)


@pytest.mark.parametrize("tilted", ["ground", "gravity"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_block_sticks_below_the_friction_angle(tilted: str, share: float) -> None:
    angle = np.arctan(share * MU)
    scene, downhill = slope(angle, tilted, block(angle))
    _, run = fly(scene, 0.5, 1e-4)
    creep = (
        SLIP * share / np.sqrt(1 - share**2)
    )  # where μ f v/√(v² + v_s²) carries the weight's part
    assert run.velocities[-1, 0] @ downhill == pytest.approx(creep, rel=1e-3)
    assert np.linalg.norm(run.nodes[-1] - run.nodes[0]) < 0.5 * creep


@pytest.mark.parametrize("tilted", ["ground", "gravity"])
@pytest.mark.parametrize("share", [1.05, 1.5, 3.0])
def test_a_block_slides_above_the_friction_angle(tilted: str, share: float) -> None:
    angle = np.arctan(share * MU)
    scene, downhill = slope(angle, tilted, block(angle), slip_speed=1e-4)
    _, run = fly(scene, 0.5, 1e-4)
    acceleration = G * (np.sin(angle) - MU * np.cos(angle))
    half = len(run.time) // 2
    gained = (
        (run.velocities[-1, 0] - run.velocities[half, 0])
        @ downhill
        / (run.time[-1] - run.time[half])
    )
    assert gained == pytest.approx(acceleration, rel=1e-3)
    assert np.diff(run.energy).max() < 1e-12


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_prism_on_its_triangle_sticks_and_slides_as_a_block_does(share: float) -> None:
    angle = np.arctan(share * MU)
    squat = tc.shapes.prism(radius=0.6, height=0.3, prestress=500.0, stiffness=2e3, damping=100.0)
    scene, downhill = slope(angle, "ground", squat)
    model, run = fly(scene, 1.0, 2e-4, compiled=None)
    speed = centre(model, run.velocities) @ downhill
    late = run.time > 0.5
    gained = np.polyfit(run.time[late], speed[late], 1)[0]
    if share < 1:
        assert abs(gained) < 1e-3
        assert 0 < speed[-1] < SLIP
    else:
        assert gained == pytest.approx(G * (np.sin(angle) - MU * np.cos(angle)), rel=1e-4)


def test_friction_stops_a_sliding_block_where_its_energy_is_spent() -> None:
    scene, downhill = slope(0.0, "gravity", block(0.0), slip_speed=1e-5)
    _, run = fly(scene, 0.5, 2e-5, velocities=[(1.0, 0, 0)])
    assert run.nodes[-1, 0] @ downhill == pytest.approx(1 / (2 * MU * G), rel=1e-3)  # v²/(2 μ g)


# --- bars ---


def test_a_spinning_bar_turns_uniformly_under_its_centripetal_force() -> None:
    length, mass, rate = 2.0, 3.0, 2.5
    s = tc.Structure([(-length / 2, 0, 0), (length / 2, 0, 0)], [(0, 1)], bar_mass=mass)
    axis = np.array([0.0, 0.6, 0.8])
    drift = np.array([0.3, -0.2, 0.1])
    spin = np.cross(rate * axis, s.nodes) + drift

    def error(step: float) -> float:
        _, run = fly(tc.Scene(s), 4.0, step, velocities=spin)
        turn = rate * run.time[:, None]
        across = np.cross(axis, s.nodes[1])
        exact = np.cos(turn) * s.nodes[1] + np.sin(turn) * across + run.time[:, None] * drift
        return float(np.abs(run.nodes[:, 1] - exact).max())

    coarse, fine = error(8e-3), error(4e-3)
    assert fine < 1e-7
    assert 3.7 < np.log2(coarse / fine) < 4.3
    model = tc.Model(tc.Scene(s))
    state = model.state(s.nodes, spin)
    assert model.multipliers(state).bar_force_density[0] == pytest.approx(
        -s.bar_inertia[0] * rate**2
    )  # Eq. 46: in tension
    assert model.energy(state).kinetic == pytest.approx(
        mass * length**2 / 12 * rate**2 / 2 + mass * drift @ drift / 2
    )
