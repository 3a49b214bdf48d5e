"""Motions on slopes, between walls and over height fields: against closed forms, energy, and MuJoCo."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flights import G, fly
from scipy.integrate import solve_ivp

import tenscasadi as tc

WIDTH = 40.0  # of height fields, m


def mass(*place: float) -> tc.Structure:
    """One point mass of 2 kg."""
    return tc.Structure([place], node_mass=2.0)


def slope(degrees: float, field: bool = False, **law: Any) -> tc.Ground | tc.Terrain:
    """A slope through the origin that rises with x; as a plane, or as a height field."""
    angle = np.radians(degrees)
    if not field:
        return tc.Ground(normal=(-np.sin(angle), 0, np.cos(angle)), **law)
    x = np.linspace(-WIDTH, WIDTH, 17)
    return tc.Terrain(
        np.tan(angle) * x[:, None] + np.zeros(5), (-WIDTH, -WIDTH), (WIDTH, WIDTH), **law
    )


def resting(degrees: float, stiffness: float) -> tc.Structure:
    """The mass as deep in the slope as its weight presses it."""
    angle = np.radians(degrees)
    depth = 2.0 * G * np.cos(angle) / stiffness
    return mass(depth * np.sin(angle), 0.0, -depth * np.cos(angle))


def down(run: tc.Trajectory, degrees: float) -> Any:
    """Distance that the mass has gone down the slope, m."""
    angle = np.radians(degrees)
    return -(run.nodes[:, 0] - run.nodes[0, 0]) @ [np.cos(angle), 0, np.sin(angle)]


@pytest.mark.parametrize("field", [False, True])
@pytest.mark.parametrize(("degrees", "friction"), [(10.0, None), (25.0, 0.3), (40.0, 0.8)])
def test_what_slides_down_a_slope_accelerates_as_coulomb_says(
    degrees: float, friction: float | None, field: bool
) -> None:
    k, v_s, end, fine = (
        1e4,
        1e-3,
        1.0,
        {"scheme": tc.DormandPrince853(rtol=1e-10), "correction": None},
    )
    ground = slope(degrees, field, stiffness=k, friction=friction, slip_speed=v_s)
    _, run = fly(
        tc.Scene(resting(degrees, k), gravity=tc.Gravity((0, 0, -G)), ground=ground),
        end,
        5e-3,
        **fine,
    )
    angle, mu = np.radians(degrees), friction or 0.0
    rate = G * (np.sin(angle) - mu * np.cos(angle))
    assert rate > 0
    assert run.velocities[-1, 0, 2] - run.velocities[len(run.time) // 2, 0, 2] == pytest.approx(
        -rate * np.sin(angle) * end / 2, rel=1e-3
    )
    law = solve_ivp(  # the regularized law along the slope, where the push does not change
        lambda t, y: [y[1], G * (np.sin(angle) - mu * np.cos(angle) * y[1] / np.hypot(y[1], v_s))],
        (0, end),
        (0.0, 0.0),
        "LSODA",
        rtol=1e-11,
        atol=1e-12,
    )
    assert down(run, degrees)[-1] == pytest.approx(law.y[0, -1], abs=1e-6)
    assert np.abs(run.energy_error).max() < 1e-6 * abs(run.energy_parts[:, 2]).max()


@pytest.mark.parametrize("field", [False, True])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_within_the_cone_of_friction_it_sticks_but_for_the_creep_that_is_told(
    share: float, field: bool
) -> None:
    degrees, k, v_s = 20.0, 1e4, 1e-3
    ground = slope(
        degrees, field, stiffness=k, friction=np.tan(np.radians(degrees)) / share, slip_speed=v_s
    )
    _, run = fly(
        tc.Scene(resting(degrees, k), gravity=tc.Gravity((0, 0, -G)), ground=ground), 0.5, 2e-4
    )
    creep = v_s * share / np.sqrt(1 - share**2)
    assert np.linalg.norm(run.velocities[-1, 0]) == pytest.approx(creep, rel=1e-6)
    assert down(run, degrees)[-1] < 1.01 * creep * 0.5


@pytest.mark.parametrize("field", [False, True])
def test_a_ball_bounces_off_a_slope_like_light_off_a_mirror(field: bool) -> None:
    degrees, k, start = 30.0, 1e6, (0.4, 0.0, 3.0)
    ground = slope(degrees, field, stiffness=k)
    scheme = tc.DormandPrince853(rtol=1e-10)
    model, run = fly(
        tc.Scene(mass(*start), gravity=tc.Gravity((0, 0, -G)), ground=ground),
        1.2,
        1e-2,
        scheme=scheme,
        correction=None,
    )
    angle = np.radians(degrees)
    normal, along = (
        np.array([-np.sin(angle), 0, np.cos(angle)]),
        np.array([np.cos(angle), 0, np.sin(angle)]),
    )
    assert run.nodes[-1, 0] @ along == pytest.approx(
        np.array(start) @ along - G * np.sin(angle) * 1.2**2 / 2, abs=1e-8
    )
    g, omega = G * np.cos(angle), np.sqrt(k / 2.0)
    hit = np.sqrt(2 * (np.array(start) @ normal) / g)
    touch = (
        2 / omega * (np.pi - np.arctan(g * hit * omega / g))
    )  # half a swing about where the weight would rest, and a little
    later = 1.2 - hit - touch
    assert later > 0.2
    assert run.nodes[-1, 0] @ normal == pytest.approx(g * hit * later - g * later**2 / 2, abs=1e-7)
    energies = [model.energy(x).total for x in run.states]
    assert np.ptp(energies) < 1e-7 * abs(energies[0])
    assert "2 events" in run.message


@pytest.mark.parametrize("scheme", [tc.DormandPrince54(rtol=1e-9), tc.DormandPrince853(rtol=1e-9)])
def test_between_two_walls_it_comes_back_after_a_period(scheme: Any) -> None:
    k, speed, gap = 500.0, 3.0, 2.0
    walls = [
        tc.Ground(stiffness=k, normal=(1, 0, 0), height=-gap / 2),
        tc.Ground(stiffness=4 * k, normal=(-1, 0, 0), height=-gap / 2),
    ]
    # flight there and back, and half a swing in each wall
    period = 2 * gap / speed + np.pi * np.sqrt(2.0 / k) * (1 + 1 / 2)
    _, run = fly(
        tc.Scene(mass(0, 0, 0), ground=walls),
        3 * period,
        0.05,
        velocities=[(speed, 0, 0)],
        scheme=scheme,
        correction=None,
    )
    assert np.abs(run.nodes[-1, 0]).max() < 1e-6
    assert run.velocities[-1, 0] == pytest.approx([speed, 0, 0], abs=1e-6)
    assert "12 events" in run.message


def test_a_wall_for_one_node_lets_the_others_pass() -> None:
    pair = tc.Structure([(0, 0, 0), (0, 1, 0)], node_mass=1.0)
    wall = tc.Ground(stiffness=1e3, normal=(-1, 0, 0), height=-0.5, nodes=[1])
    _, run = fly(
        tc.Scene(pair, ground=wall),
        1.0,
        1e-2,
        velocities=[(1, 0, 0)] * 2,
        scheme=tc.DormandPrince54(rtol=1e-9),
        correction=None,
    )
    assert run.nodes[-1, 0] == pytest.approx([1, 0, 0], abs=1e-9)
    back = 1.0 - 0.5 - np.pi / np.sqrt(1e3)
    assert run.nodes[-1, 1] == pytest.approx([0.5 - back, 1, 0], abs=1e-6)


@cache
def slide(field: bool, scheme: Any) -> tc.Trajectory:
    """A bar that slides down a slope onto a floor."""
    grounds = [
        slope(25.0, field, damping=200.0, friction=0.3, slip_speed=0.05),
        tc.Ground(damping=200.0, friction=0.5, slip_speed=0.05),
    ]
    bar = tc.Structure([(0.3, 0, 0.3), (0.5, 0.3, 0.35)], bars=[(0, 1)])
    scene = tc.Scene(bar, gravity=tc.Gravity(), ground=grounds)
    return fly(scene, 0.8, 5e-4, [(-1, 0, -1)] * 2, scheme=scheme, correction=None)[1]


@pytest.mark.parametrize(
    "scheme",
    [
        tc.Rattle(),
        tc.Collocation(2),
        tc.DormandPrince54(rtol=1e-7),
        tc.Cvodes(rtol=1e-9, atol=1e-9),
    ],
)
@pytest.mark.parametrize("field", [False, True])
def test_all_schemes_slide_alike_over_slope_and_floor(scheme: Any, field: bool) -> None:
    near, exact = (slide(field, own) for own in (scheme, tc.DormandPrince853(rtol=1e-10)))
    located = isinstance(
        scheme, (tc.DormandPrince54, tc.Cvodes)
    )  # fixed steps pass the moments of contact
    assert np.abs(near.nodes[-1] - exact.nodes[-1]).max() < (1e-6 if located else 1e-3)
    pressed, x = exact.energy_parts[:, 1] > 0, exact.nodes[:, 0, 0]
    assert np.any(pressed & (x > 0.02)), "it meets the slope"
    assert np.any(pressed & (x < -0.02)), "and the floor"


def bowl(points: int, **law: Any) -> tc.Terrain:
    """z = (x² + y²)/2 m⁻¹ for |x|, |y| ≤ 1 m."""
    x = np.linspace(-1, 1, points)
    return tc.Terrain((x[:, None] ** 2 + x**2) / 2, (-1, -1), (1, 1), **law)


@pytest.mark.parametrize("scheme", [tc.Rattle(), tc.Rattle(order=4)])
def test_energy_is_kept_over_the_edges_of_cells(scheme: Any) -> None:
    _, run = fly(
        tc.Scene(mass(0.5, 0.1, 0.3), gravity=tc.Gravity(), ground=bowl(9)),
        3.0,
        2e-4,
        velocities=[(0, 0.7, 0)],
        scheme=scheme,
    )
    assert run.energy_parts[:, 1].max() > 1.0
    assert np.abs(run.energy_error).max() < 2e-3 * np.ptp(run.energy_parts[:, 0])


def test_a_bowl_that_is_finer_swings_as_the_smooth_one() -> None:
    """A frictionless mass that circles in the bowl z = r²/2: ω² r = g r, so a turn takes 2π/√g, whatever the radius."""
    radius, k, turn = 0.5, 1e5, 2 * np.pi / np.sqrt(G)
    speed = radius * np.sqrt(G)
    push = 2.0 * G * np.sqrt(1 + radius**2)
    deep = push / k * np.sqrt(1 + radius**2)  # below the surface, along z
    errors = []
    for points in (21, 161):
        start = mass(radius, 0.0, radius**2 / 2 - deep)
        _, run = fly(
            tc.Scene(
                start,
                gravity=tc.Gravity((0, 0, -G)),
                ground=bowl(points, stiffness=k, damping=50.0),
            ),
            turn,
            5e-4,
            [(0, speed, 0)],
        )
        errors.append(np.abs(run.nodes[-1, 0] - run.nodes[0, 0]).max())
    assert errors[1] < 3e-3
    assert errors[1] < errors[0] / 10


@pytest.mark.parametrize(("degrees", "friction"), [(25.0, 0.3), (15.0, 0.6)])
def test_mujoco_slides_and_sticks_alike(degrees: float, friction: float) -> None:
    mujoco = pytest.importorskip("mujoco")
    angle, k, end = np.radians(degrees), 1e4, 1.0
    scene = tc.Scene(
        resting(degrees, k),
        gravity=tc.Gravity((0, 0, -G)),
        ground=slope(degrees, stiffness=k, damping=100.0, friction=friction),
    )
    _, run = fly(scene, end, 5e-4)
    radius = 0.05
    world = mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="0.0005" gravity="0 0 {-G}" cone="elliptic" impratio="100" integrator="implicitfast"/>
    <worldbody><geom type="plane" size="50 50 1" euler="0 {-degrees} 0" friction="{friction}"/>
    <body pos="{-radius * np.sin(angle)} 0 {radius * np.cos(angle)}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
    <joint type="slide" axis="0 0 1"/><geom type="sphere" size="{radius}" mass="2" friction="{friction}"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(world)
    for _ in range(round(end / 0.0005)):
        mujoco.mj_step(world, data)
    theirs = -data.qpos @ [np.cos(angle), 0, np.sin(angle)]
    assert down(run, degrees)[-1] == pytest.approx(theirs, rel=0.01, abs=5e-3)


def test_height_fields_have_open_parameters_and_copies() -> None:
    field = bowl(9, damping=20.0, friction=0.4)
    scene = tc.Scene(
        mass(0.5, 0.1, 0.1),
        gravity=tc.Gravity(),
        ground=[field, tc.Ground(height=-1.0, friction=0.4)],
    )
    model = tc.Model(scene)
    x = model.state([(0.5, 0.1, 0.05)], [(0.3, -0.2, 0.1)])
    told = model.ode(x, []).full()
    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):  # noqa: S301
        assert np.array_equal(tc.Model(again).ode(x, []).full(), told)
        assert not again.ground[0].heights.flags.writeable
    rougher = replace(
        scene,
        ground=[replace(field, friction=0.7), scene.grounds[1]],
        parameters=tc.Parameters("ground_friction"),
    )
    opened = tc.Model(rougher)
    assert opened.ode(x, [], [0.4]).full() == pytest.approx(told, abs=1e-12)
    assert np.abs(opened.ode(x, [], [0.7]).full() - told).max() > 0.1
    assert model.compile()(x, []).full() == pytest.approx(told, abs=1e-12)


def test_a_fine_height_field_costs_no_more_than_a_coarse_one() -> None:
    counts = [
        tc.Model(tc.Scene(mass(0.5, 0.1, 0.3), ground=bowl(points))).describe()["ground"]
        for points in (5, 200)
    ]
    assert abs(counts[0] - counts[1]) <= 1  # a spacing of a half is a shift of the exponent
