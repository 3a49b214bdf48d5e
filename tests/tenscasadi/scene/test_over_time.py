"""Gravity and pressure over time: against closed forms, their work in the energy account, their pulses, refusals by name."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.integrators.scheme import Scheme

SCHEMES = [
    tc.RungeKutta4(),
    tc.Rattle(4),
    tc.Collocation(3),
    tc.DormandPrince853(rtol=1e-10),
    tc.Cvodes(rtol=1e-10),
    tc.Idas(rtol=1e-10),
]
FALLING = tc.Structure([(0, 0, 0)], node_mass=2.0)
SAIL = tc.Structure([(0, 0, 0), (1, 0, 0), (0, 2, 0)], node_mass=[1.0, 1.0, 1.0])  # 1 m²
TIMES = [0.1, 0.4, 0.7]
SHORT = 2e-4  # s


def up(function: Any) -> tc.Gravity:
    return tc.Gravity(lambda t: [0, 0, function(t)])


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_gravity_that_is_a_function_of_time(scheme: Scheme) -> None:
    scene = tc.Scene(FALLING, gravity=up(lambda t: 3 * np.sin(2 * t) - 9.81))
    assert scene.has_clock
    run = tc.simulate(tc.Model(scene), 1.0, 0.01, scheme, compiled=False)
    t = run.time
    np.testing.assert_allclose(
        run.nodes[:, 0, 2], 1.5 * t - 0.75 * np.sin(2 * t) - 9.81 / 2 * t**2, rtol=0, atol=1e-8
    )
    assert run.energy[-1] > 50  # kinetic alone: what gravity does is supplied
    np.testing.assert_array_equal(run.energy_parts[:, 2], 0)
    assert abs(run.energy_error).max() < 1e-6


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_pressure_that_is_a_function_of_time(scheme: Scheme) -> None:
    """A free triangle moves along its normal: p A on 3 kg."""
    run = tc.simulate(
        tc.Model(tc.Scene(SAIL, pressure=tc.Pressure([(0, 1, 2)], lambda t: 30 * ca.cos(3 * t)))),
        1.0,
        0.01,
        scheme,
        compiled=False,
    )
    np.testing.assert_allclose(
        run.nodes[:, :, 2],
        np.repeat((10 / 9 * (1 - np.cos(3 * run.time)))[:, None], 3, axis=1),
        rtol=0,
        atol=1e-8,
    )
    assert abs(run.energy_error).max() < 1e-6


def ramp(time: Any) -> Any:
    """Way of a free body whose acceleration is 0 until 0.1 s, rises to 6 m/s² at 0.4 s, falls to 3 at 0.7 s and stays."""
    pieces = [
        (0.1, 20.0),
        (0.4, -30.0),
        (0.7, 10.0),
    ]  # where the slope of the acceleration changes, and by how much
    return sum(change * np.maximum(time - at, 0) ** 3 / 6 for at, change in pieces)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_tables_over_time(scheme: Scheme) -> None:
    gravity = tc.Gravity([(0, 0, 0), (0, 0, 6.0), (0, 0, 3.0)], times=TIMES)
    pressure = tc.Pressure([(0, 1, 2)], [0.0, 18.0, 9.0], times=TIMES)
    for scene in (tc.Scene(FALLING, gravity=gravity), tc.Scene(SAIL, pressure=pressure)):
        run = tc.simulate(tc.Model(scene), 1.0, 0.07, scheme, compiled=False)
        np.testing.assert_allclose(run.nodes[:, 0, 2], ramp(run.time), rtol=0, atol=2e-8)
        assert abs(run.time[:, None] - TIMES).min(axis=0).max() < 1e-12  # steps end there
        assert abs(run.energy_error).max() < 1e-2


PULSE = tc.Scene(
    FALLING,
    gravity=tc.Gravity(
        [(0, 0, 0), (0, 0, 5000.0), (0, 0, 0)], times=[0.5 - SHORT / 2, 0.5, 0.5 + SHORT / 2]
    ),
)
PULSES = {
    "gravity, table": PULSE,
    "gravity, switch": tc.Scene(
        FALLING, gravity=up(lambda t: 2500 * (t > 0.5 - SHORT / 2) * (t <= 0.5 + SHORT / 2))
    ),
    "pressure, table": tc.Scene(
        SAIL,
        pressure=tc.Pressure(
            [(0, 1, 2)], [0.0, 15000.0, 0.0], times=[0.5 - SHORT / 2, 0.5, 0.5 + SHORT / 2]
        ),
    ),
    "pressure, switch": tc.Scene(
        SAIL,
        pressure=tc.Pressure(
            [(0, 1, 2)], lambda t: ca.if_else(ca.fabs(t - 0.5) < SHORT / 2, 7500.0, 0)
        ),
    ),
}


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("pulse", PULSES)
def test_no_scheme_misses_a_pulse(pulse: str, scheme: Scheme) -> None:
    run = tc.simulate(tc.Model(PULSES[pulse]), 1.0, 0.01, scheme, compiled=False)
    assert run.success, run.message
    assert run.nodes[-1, 0, 2] == pytest.approx(0.25, abs=1e-6)


def test_certified_ends_know_of_pulses() -> None:
    assert tc.reference_solution(tc.Model(PULSE), 1.0, compiled=False).nodes[0, 2] == pytest.approx(
        0.25, abs=1e-9
    )


def test_steps_end_where_the_acceleration_of_a_support_jumps() -> None:
    """A pin that starts to move at 0.355 s with 4 m/s² takes the weightless bar's inertia along; none of the steps' order is lost."""
    bar = tc.Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], pinned=[0])
    ends = []
    for step in (0.02, 0.01):
        moved = tc.SupportMotion({0: lambda t: (0, 0, 2 * ca.fmax(t - 0.3551, 0) ** 2)})
        run = tc.simulate(tc.Model(tc.Scene(bar, supports=moved)), 1.0, step, compiled=False)
        assert abs(run.time - 0.3551).min() < 1e-12
        ends.append(run.nodes[-1, 1])
    given = tc.SupportMotion(
        {0: lambda t: (0, 0, 2 * ca.fmax(t - 0.3551, 0) ** 2)}, breakpoints=[0.77]
    )
    run = tc.simulate(
        tc.Model(tc.Scene(bar, supports=given)),
        1.0,
        0.01,
        tc.DormandPrince853(rtol=1e-12),
        compiled=False,
    )
    assert abs(run.time - 0.77).min() < 1e-12
    errors = [abs(end - run.nodes[-1, 1]).max() for end in ends]
    assert errors[0] < 1e-6
    assert errors[1] < errors[0] / 10


def test_both_coordinates_and_constant_loads_agree() -> None:
    prism = tc.shapes.prism(stiffness=500.0, prestress=10.0, damping=1.0)
    still = {"gravity": tc.Gravity((0, 0, -3.0)), "pressure": tc.Pressure([(0, 1, 2)], 4.0)}
    flat = {
        "gravity": tc.Gravity(lambda t: [0, 0, -3.0 + 0 * t]),
        "pressure": tc.Pressure([(0, 1, 2)], [4.0, 4.0], times=[0.0, 1.0]),
    }
    runs = [
        tc.simulate(tc.Model(tc.Scene(prism, **loads), way), 0.2, 1e-3, compiled=False)
        for loads in (still, flat)
        for way in ("reduced", "full")
    ]  # type: ignore[arg-type]
    for run in runs[1:]:
        np.testing.assert_allclose(run.nodes, runs[0].nodes, rtol=0, atol=1e-12)
        assert abs(run.energy_error).max() < 1e-6


REFUSED: list[tuple[Any, str]] = [
    (lambda: tc.Gravity(lambda t: [0, t]), r"Gravity\.acceleration\(0\.0\)"),
    (lambda: tc.Gravity(lambda t: [[0, 0, t]]), r"Gravity\.acceleration\(0\.0\)"),
    (lambda: tc.Gravity(lambda t: 1 / 0), r"Gravity\.acceleration raised"),
    (lambda: up(lambda t: float("nan")), r"Gravity\.acceleration\(0\.0\)\[2\] is nan"),
    (lambda: tc.Gravity((0, 0, 1), times=[0, 1]), r"Gravity\.acceleration"),
    (lambda: tc.Gravity([(0, 0, 1)] * 2, times=[1, 0]), r"Gravity\.times"),
    (
        lambda: tc.Gravity((0, 0, 1), breakpoints=[0.1]),
        r"Gravity\.breakpoints is .*only with a function of time",
    ),
    (lambda: tc.Pressure([(0, 1, 2)], [1.0, 2.0]), r"Pressure\.difference"),
    (lambda: tc.Pressure([(0, 1, 2)], [1.0, 2.0], times=[0, 1, 2]), r"Pressure\.difference"),
    (lambda: tc.Pressure([(0, 1, 2)], lambda t: [t, t]), r"Pressure\.difference\(0\.0\)"),
    (lambda: tc.Pressure([(0, 1, 2)], lambda t: "high"), r"Pressure\.difference\(0\.0\)"),
    (
        lambda: tc.SupportMotion({0: lambda t: (0, 0, 0)}, breakpoints="soon"),
        r"SupportMotion\.breakpoints",
    ),
    (
        lambda: run(gravity=up(lambda t: 1 / (t - 0.5))),
        r"Gravity\.acceleration is not finite at t = 0\.5 s",
    ),
    (
        lambda: run(gravity=up(lambda t: 1.0 if isinstance(t, float) else 2.0)),
        r"Gravity\.acceleration is \[.* for the number t = 0 ",
    ),
    (
        lambda: run(pressure=tc.Pressure([(0, 1, 2)], lambda t: ca.sqrt(0.5 - t))),
        r"Pressure\.difference is not finite at t = 0\.5 s",
    ),
]


def run(**loads: Any) -> Any:
    return tc.simulate(tc.Model(tc.Scene(SAIL, **loads)), 1.0, 0.01, compiled=False)


@pytest.mark.parametrize(("make", "told"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_load_over_time_is_refused_by_name(make: Any, told: str) -> None:
    with pytest.raises((ValueError, TypeError), match=told):
        make()


def test_a_constant_function_is_one_too() -> None:
    assert tc.Scene(SAIL, pressure=tc.Pressure([(0, 1, 2)], lambda t: 5.0)).has_clock
    assert hash(tc.Gravity()) == hash(tc.Gravity((0, 0, -9.81)))
    assert tc.Gravity([(0, 0, 1)] * 2, times=[0, 1]) == tc.Gravity(
        np.array([(0, 0, 1)] * 2), times=(0.0, 1.0)
    )
