"""Forces between steps: steps end at the times of tables and at the jumps of functions of time, so that no pulse is missed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from tenscasadi.analysis.recommend import recommend
from tenscasadi.analysis.reference_solution import reference_solution
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure

SPRING = Structure(
    [(0, 0, 0), (1.5, 0, 0)],
    [],
    [(0, 1)],
    stiffness=10.0,
    node_mass=[1, 1],
    pinned=(0,),
    rest_length=1.5,
)
FREQUENCY = np.sqrt(10.0)  # 1/s
SHORT = 2e-4  # s
TABLE = NodalForce(
    [[[0, 0, 0], [force, 0, 0]] for force in (0, 5000, 0)],
    times=[0.5 - SHORT / 2, 0.5, 0.5 + SHORT / 2],
)
SWITCH = NodalForce(
    lambda t: [[0, 0, 0], [2500 * (t > 0.5 - SHORT / 2) * (t <= 0.5 + SHORT / 2), 0, 0]]
)
BUMP = NodalForce(
    lambda t: [
        [0, 0, 0],
        [0.5 / (1e-5 * np.sqrt(np.pi)) * ca.exp(-(((t - 0.5) / 1e-5) ** 2)), 0, 0],
    ],
    breakpoints=0.5 + 5e-6 * np.arange(-14, 15),
)


def smooth(width: float) -> NodalForce:
    """A bell of 0.5 N·s about 0.5 s, nothing said about it."""
    return NodalForce(
        lambda t: [
            [0, 0, 0],
            [0.5 / (width * np.sqrt(np.pi)) * ca.exp(-(((t - 0.5) / width) ** 2)), 0, 0],
        ]
    )


SCHEMES = [
    RungeKutta4(),
    Rattle(order=4),
    DormandPrince54(),
    DormandPrince853(1e-9),
    Collocation(3, "radau"),
    Cvodes(1e-9),
    Idas(1e-9),
]


def after(time: float) -> float:
    """Where an impulse of 0.5 N·s at t = 0.5 s puts the mass, m."""
    return 1.5 + 0.5 / FREQUENCY * np.sin(FREQUENCY * (time - 0.5))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("pulse", [TABLE, SWITCH, BUMP], ids=["table", "switch", "breaks"])
def test_no_scheme_misses_a_pulse(pulse: NodalForce, scheme: Any) -> None:
    run = simulate(Model(Scene(SPRING, forces=pulse)), 1.0, 0.01, scheme, compiled=False)
    assert run.success, run.message
    assert run.nodes[-1, 1, 0] == pytest.approx(after(1.0), abs=2e-6)
    assert run.time[-1] == 1.0
    assert abs(run.energy_error).max() < 1e-2


@pytest.mark.parametrize("pulse", [TABLE, SWITCH, BUMP], ids=["table", "switch", "breaks"])
def test_certified_ends_know_of_pulses(pulse: NodalForce) -> None:
    found = reference_solution(Model(Scene(SPRING, forces=pulse)), 1.0, compiled=False)
    assert found.error < 1e-7
    assert found.nodes[1, 0] == pytest.approx(after(1.0), abs=1e-8)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("width", [1e-3, 1e-4])
def test_undeclared_pulse_is_followed_or_told(width: float, scheme: Any) -> None:
    run = simulate(Model(Scene(SPRING, forces=smooth(width))), 1.0, 0.01, scheme, compiled=False)
    followed = abs(run.nodes[-1, 1, 0] - after(1.0)) < 2e-3
    told = "try a smaller step" in run.message  # coincidence may make the impulse right
    assert followed or told, run.message
    assert followed or scheme.adaptive or not run.success


def test_pulse_as_long_as_steps_is_noticed_by_repetition() -> None:
    run = simulate(Model(Scene(SPRING, forces=smooth(0.01))), 1.0, 0.01, compiled=False)
    assert not run.success or "try" in run.message or abs(run.nodes[-1, 1, 0] - after(1.0)) < 1e-3


@pytest.mark.parametrize(
    ("background", "impulse"),
    [(0.0, 0.1), (0.0, 1e-3), (1e3, 1e-3)],
    ids=["", "small", "on a large force"],
)
def test_pulses_stand_next_to_pulses_and_on_large_forces(background: float, impulse: float) -> None:
    """Each a hundredth of the height of the next or less, yet long enough to move the mass."""
    first, widths = (
        0.3125,
        [1e-3, 1e-6, 1e-3],
    )  # s; halvings of steps would meet the first at its top
    places = [first, 0.5, 0.6871]

    def pulses(t: Any) -> Any:
        return sum(
            impulse / (w * np.sqrt(np.pi)) * ca.exp(-(((t - at) / w) ** 2))
            for at, w in zip(places, widths, strict=True)
        )

    model = Model(
        Scene(
            SPRING,
            forces=NodalForce(
                lambda t: [[0, 0, 0], [background + pulses(t), 0, 0]],
                breakpoints=np.ravel(
                    [at + w * np.arange(-6, 7) for at, w in zip(places, widths, strict=True)]
                ),
            ),
        )
    )
    wanted = (
        1.5
        + background / 10 * (1 - np.cos(FREQUENCY))
        + impulse / FREQUENCY * np.sin(FREQUENCY * (1 - np.array(places))).sum()
    )
    for scheme in (DormandPrince54(1e-11), DormandPrince853(1e-11), Cvodes(1e-11)):
        run = simulate(model, 1.0, 0.05, scheme, compiled=False)
        assert run.success, run.message
        assert run.nodes[-1, 1, 0] == pytest.approx(wanted, abs=3e-6 * impulse + 1e-9 * background)


def test_certificates_of_declared_pulses_hold() -> None:
    pulse = replace(smooth(1e-6), breakpoints=0.5 + 1e-6 * np.arange(-7, 8))
    found = reference_solution(
        Model(Scene(SPRING, forces=pulse)),
        1.0,
        max_difference=1e-6,
        target_difference=1e-9,
        compiled=False,
    )
    assert abs(found.nodes[1, 0] - after(1.0)) <= max(2 * found.error, 1e-11) < 1e-6


def test_small_pulses_on_a_large_force_are_certified() -> None:
    """A thousandth of the rest, for a fifth of a millisecond: a difference of 3e-8 m that two coarse solutions would agree to miss."""
    ends = []
    for size in (0.0, 1.0):
        force = NodalForce(
            lambda t, size=size: [
                [0, 0, 0],
                [1000 * ca.sin(t) + size * ca.exp(-(((t - 0.5) / 1e-4) ** 2)), 0, 0],
            ],
            breakpoints=0.5 + 1e-4 * np.arange(-7, 8),
        )
        ends.append(
            reference_solution(
                Model(Scene(SPRING.replace(node_mass=1000.0), forces=force)), 1.0, compiled=False
            )
        )
    wanted = 1e-4 * np.sqrt(np.pi) / 1000 * np.sin(0.1 * 0.5) / 0.1
    assert ends[1].nodes[1, 0] - ends[0].nodes[1, 0] == pytest.approx(
        wanted, abs=2 * (ends[0].error + ends[1].error) + 1e-13
    )
    assert ends[1].error < wanted / 10


def test_fast_change_is_told_and_not_trusted() -> None:
    buzz = NodalForce(lambda t: [[0, 0, 0], [ca.sin(2e4 * t), 0, 0]])
    run = simulate(Model(Scene(SPRING, forces=buzz)), 1.0, 0.01, compiled=False)
    assert not run.success
    assert "NodalForce.values changes within steps near t = " in run.message


@pytest.mark.parametrize("steps", [20, 1000])
def test_steps_that_see_a_function_stay_as_they_are(steps: int) -> None:
    wave = NodalForce(lambda t: [[0, 0, 0], [ca.sin(2 * np.pi * 4 * t) + ca.fabs(t - 0.25), 0, 0]])
    run = simulate(Model(Scene(SPRING, forces=wave)), 1.0, 1 / steps, compiled=False)
    assert np.array_equal(run.time, np.append(np.arange(steps) * (1 / steps), 1.0))


def test_pulses_of_supports_are_seen() -> None:
    """A pin that is moved to and fro within half a millisecond leaves a bar turning as a long look at it says."""
    bar = Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], pinned=[0])
    model = Model(
        Scene(
            bar,
            supports=SupportMotion(
                {0: lambda t: (0, 0, 5e-4 * (1 + ca.tanh((t - 0.5) / 1e-4)))},
                breakpoints=0.5 + 2e-4 * np.arange(-10, 11),
            ),
        )
    )
    run = simulate(model, 1.0, 0.05, DormandPrince853(1e-11), compiled=False)

    def turning(t: float, y: Any) -> list[float]:
        """θ̈ = −3 a cos θ/(2 l) of a thin bar on a pin that accelerates by a."""
        th = np.tanh((t - 0.5) / 1e-4)
        return [y[1], 1.5 * 5e-4 / 1e-8 * 2 * th * (1 - th**2) * np.cos(y[0])]

    fine = solve_ivp(
        turning, (0.49, 0.51), [0.0, 0.0], rtol=1e-12, atol=1e-13, max_step=1e-5, method="DOP853"
    ).y[:, -1]
    angle = fine[0] + 0.49 * fine[1]
    assert run.nodes[-1, 1] == pytest.approx([np.cos(angle), 0, np.sin(angle) + 1e-3], abs=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES[:4], ids=lambda scheme: type(scheme).__name__)
def test_undeclared_shift_of_a_support_is_told(scheme: Any) -> None:
    """Its acceleration has no impulse over the step that contains it."""
    shift = SupportMotion({0: lambda t: (4e-5 * (1 + ca.tanh((t - 0.5) / 1e-4)), 0, 0)})
    run = simulate(Model(Scene(SPRING, supports=shift)), 1.0, 0.011, scheme, compiled=False)
    assert "SupportMotion.positions changes within steps near t = 0.49" in run.message
    assert run.success == scheme.adaptive


@pytest.mark.slow
def test_recommended_ways_know_of_pulses() -> None:
    model = Model(Scene(SPRING, forces=TABLE))
    advice = recommend(model, 1.0, 1e-4, schemes=[RungeKutta4(), DormandPrince54()], compiled=False)
    assert simulate(model, 1.0, **advice.options, compiled=False).nodes[-1, 1, 0] == pytest.approx(
        after(1.0), abs=1e-4
    )


def test_times_of_tables_are_those_of_the_clock() -> None:
    model = Model(Scene(SPRING, forces=TABLE))
    late = model.initial_state.copy()
    late[-1] = 0.2
    run = simulate(model, 0.8, 0.01, state=late, compiled=False, save_every=1)
    assert run.nodes[-1, 1, 0] == pytest.approx(after(1.0), abs=1e-8)
    assert abs(run.time[:, None] - (TABLE.times - 0.2)).min(axis=0).max() < 1e-15


def test_tables_on_the_grid_leave_steps_equal() -> None:
    table = NodalForce(
        [[[0, 0, 0], [force, 0, 0]] for force in (0, 1, 0, 2)], times=[0.0, 0.1, 0.2, 7.0]
    )
    run = simulate(Model(Scene(SPRING, forces=table)), 0.5, 0.01, compiled=False)
    assert np.array_equal(run.time, np.append(np.arange(50) * (0.5 / 50), 0.5))


def test_breakpoints_belong_to_functions() -> None:
    with pytest.raises(
        ValueError, match=r"NodalForce\.breakpoints is .*only with a function of time"
    ):
        replace(TABLE, breakpoints=[0.5])
    with pytest.raises(TypeError, match=r"NodalForce\.breakpoints"):
        replace(SWITCH, breakpoints="soon")


def test_breaks_is_the_deprecated_name_of_breakpoints() -> None:
    with pytest.warns(DeprecationWarning, match="use breakpoints"):
        force = NodalForce(lambda t: [[0, 0, 0], [t, 0, 0]], breaks=[0.5])  # type: ignore[call-arg]
    with pytest.warns(DeprecationWarning, match="use breakpoints"):
        assert force.breaks.tolist() == [0.5]  # type: ignore[attr-defined]


def test_supports_may_move_along_splines() -> None:
    times = np.linspace(-1, 2, 31)
    spline = ca.interpolant("spline", "bspline", [times], times**3)
    runs = []
    for place in (spline, lambda t: t**3):
        motion = SupportMotion({0: lambda t, place=place: (place(t) - place(0), 0, 0)})
        runs.append(simulate(Model(Scene(SPRING, supports=motion)), 1.0, 0.01, compiled=False))
    assert runs[0].success
    assert runs[0].nodes[-1] == pytest.approx(runs[1].nodes[-1], abs=1e-6)


@pytest.mark.parametrize(
    "scheme",
    [
        RungeKutta4(),
        DormandPrince853(),
        pytest.param(DormandPrince853(1e-9), marks=pytest.mark.slow),
        Rattle(),
        Collocation(2, "radau"),
        Cvodes(1e-9),
    ],
)
def test_functions_that_are_finite_up_to_the_end_alone(scheme: Any) -> None:
    """Rounding takes the clock beyond it: arcsin and roots are not defined there."""
    weight = Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[0, 2.0],
        pinned=[0],
        stiffness=1e-9,
        rest_length=5.0,
    )
    for function in (lambda t: np.arcsin(t / 2), lambda t: np.sqrt(2 - t)):
        moved = quad(lambda t, function=function: (2 - t) * function(t), 0.0, 2.0)[0] / 2
        model = Model(
            Scene(
                weight,
                forces=NodalForce(lambda t, function=function: [[0, 0, 0], [0, function(t), 0]]),
            )
        )
        for step in (0.1, 0.03, 0.0007):
            run = simulate(model, 2.0, step, scheme, compiled=False)
            assert run.success, run.message
            assert run.time[-1] == 2.0
            assert run.nodes[-1, 1, 1] == pytest.approx(moved, rel=2e-2 if step == 0.1 else 3e-3)
