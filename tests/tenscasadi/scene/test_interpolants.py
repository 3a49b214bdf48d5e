"""Functions of time that CasADi cannot trace: the same motions as traced ones, and errors by name."""

from __future__ import annotations

import gc
import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.scene import interpolants

PENDULUM = tc.shapes.pendulum()
SCHEMES = [
    tc.RungeKutta4(),
    tc.Rattle(4),
    tc.Collocation(3),
    tc.DormandPrince853(rtol=1e-10),
    tc.Cvodes(rtol=1e-10),
    tc.Idas(rtol=1e-10),
]
LOADS = {
    "gravity": lambda sin: {"gravity": tc.Gravity(lambda t: (sin(7 * t), 0, -9.81))},
    "pressure": lambda sin: {"pressure": tc.Pressure([(0, 1, 2)], lambda t: 3 * sin(7 * t))},
    "forces": lambda sin: {"forces": tc.NodalForce(lambda t: [[0, 0, 0], [sin(7 * t), 0, 1]] * 2)},
    "supports": lambda sin: {"supports": tc.SupportMotion({0: lambda t: (0.1 * sin(7 * t), 0, t)})},
}
SAIL = tc.Structure(
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    bars=[(0, 1)],
    strings=[(1, 2), (2, 3), (1, 3)],
    node_mass=1.0,
    pinned=[0],
)


def push(function: Any) -> tc.NodalForce:
    return tc.NodalForce(lambda t: [(0, 0, 0), (function(t), 0, 0)])


def run(t_end: float = 1.0, step: float = 0.01, **loads: Any) -> tc.Trajectory:
    return tc.simulate(tc.Model(tc.Scene(PENDULUM, **loads)), t_end, step, compiled=False)


@pytest.mark.parametrize("name", LOADS)
def test_every_load_moves_as_if_it_were_traced(name: str) -> None:
    models = [tc.Model(tc.Scene(SAIL, **LOADS[name](sin))) for sin in (math.sin, ca.sin)]
    runs = [tc.simulate(model, 1.0, 0.01, compiled=False) for model in models]
    assert runs[0].success, runs[0].message
    assert abs(runs[0].states - runs[1].states).max() < 1e-8
    assert abs(runs[0].energy_error - runs[1].energy_error).max() < 1e-8
    assert runs[0].scene is models[0].scene  # with the function itself
    rates = [
        np.asarray(model.ode(run.states[7], [])) for model, run in zip(models, runs, strict=True)
    ]
    assert abs(rates[0] - rates[1]).max() < 1e-4  # accelerations of supports: finite differences


@pytest.mark.parametrize(
    ("scheme", "compiled"),
    [*((scheme, False) for scheme in SCHEMES), (tc.RungeKutta4(), True)],
    ids=repr,
)
def test_all_schemes_take_a_lookup_in_a_table(scheme: Any, compiled: bool) -> None:
    times, values = np.linspace(0, 1, 6), np.array([0.0, 1, -1, 2, 0, 1])
    looked_up = push(lambda t: np.interp(float(t), times, values))
    table = tc.NodalForce(np.array([[(0, 0, 0), (value, 0, 0)] for value in values]), times=times)
    runs = [
        tc.simulate(tc.Model(tc.Scene(PENDULUM, forces=load)), 1.0, 0.02, scheme, compiled=compiled)
        for load in (looked_up, table)
    ]
    assert runs[0].success, runs[0].message
    assert abs(runs[0].nodes[-1] - runs[1].nodes[-1]).max() < 1e-8


def test_order_of_the_scheme_holds_with_a_jump() -> None:
    jump = push(lambda t: 2.0 if t > 0.3551 else 0.0)
    exact = run(step=1e-3, forces=push(lambda t: ca.if_else(t > 0.3551, 2.0, 0.0))).nodes[-1]
    errors = [abs(run(step=h, forces=jump).nodes[-1] - exact).max() for h in (0.1, 0.05)]
    assert errors[1] < errors[0] / 10
    assert run(step=1e-3, forces=jump).nodes[-1] == pytest.approx(exact, abs=1e-8)


def test_rollouts_and_sensitivities_use_the_interpolant() -> None:
    models = [tc.Model(tc.Scene(PENDULUM, forces=push(sin))) for sin in (math.sin, ca.sin)]
    ends = [
        tc.rollouts(model, 1.0, 0.01, states=[model.initial_state] * 3).final for model in models
    ]
    assert abs(ends[0] - ends[1]).max() < 1e-8
    slopes = [tc.sensitivities(model, t_end=1.0, step=0.01).jacobian for model in models]
    assert abs(slopes[0] - slopes[1]).max() < 1e-6


def test_functions_outlive_their_model_and_take_parameters() -> None:
    jump = push(lambda t: 1.0 if t > 0.3 else 0.0)
    scene = tc.Scene(PENDULUM, forces=jump, parameters=tc.Parameters(scale=["forces"]))
    ode = tc.Model(scene).ode
    gc.collect()
    x = np.append(tc.Model(scene).initial_state[:-1], 0.5)
    rates = [np.asarray(ode(x, [], [scale]))[3, 0] for scale in (1.0, 2.0)]
    assert rates[1] == pytest.approx(2 * rates[0])
    runs = [
        tc.simulate(tc.Model(scene), 1.0, 0.01, parameters=[2.0], compiled=False),
        tc.simulate(tc.Model(scene).with_parameters([2.0]), 1.0, 0.01, compiled=False),
    ]
    assert abs(runs[0].nodes - runs[1].nodes).max() < 1e-9


def test_moved_supports_start_with_their_velocity() -> None:
    moved = tc.SupportMotion({0: lambda t: (0.1 * math.sin(5 * t), 0, 0)})
    found = run(supports=moved)
    assert found.velocities[:, 0, 0] == pytest.approx(0.5 * np.cos(5 * found.time), abs=1e-8)
    assert run(supports=moved).bar_length_error.max() < 1e-6


@pytest.mark.parametrize(
    ("place", "told"),
    [
        (lambda t: 0.1 * float(t > 0.5), r" is not smooth near t = 0\.5 s"),
        (lambda t: max(t - 0.5, 0.0), r" is not smooth near t = 0\.5 s"),
        (lambda t: np.interp(float(t), [0, 0.3, 1], [0, 1, 1]), r" is not smooth near t = 0\.3"),
        (lambda t: 1.0 / 0 if t > 0.5 else 0.0, r"\(0\.75\) fails with ZeroDivisionError"),
        (lambda t: math.nan if t > 0.5 else 0.0, r"\(0\.75\)\[0\] is nan"),
    ],
)
def test_supports_that_jump_or_raise_are_rejected_by_name(place: Any, told: str) -> None:
    with pytest.raises(ValueError, match=r"SupportMotion\.positions\[0\]" + told):
        run(supports=tc.SupportMotion({0: lambda t: (place(t), 0, 0)}))


def test_a_declared_breakpoint_may_end_an_acceleration() -> None:
    def place(t: Any) -> Any:
        return (0, 0, 2 * max(t - 0.3551, 0.0) ** 2)

    found = run(supports=tc.SupportMotion({0: place}, breakpoints=[0.3551]))
    assert found.nodes[-1, 0, 2] == pytest.approx(2 * 0.6449**2, abs=1e-12)
    assert abs(found.time - 0.3551).min() < 1e-12


def test_pulses_of_a_two_thousandth_of_the_run_are_found() -> None:
    for start in np.random.default_rng(0).uniform(0, 9.9, 20):
        pulse = interpolants.interpolate_function(
            "pulse",
            lambda t, start=start: np.array([float(start < t < start + 0.005)]),
            0.0,
            10.0,
            np.empty(0),
        )[0]
        assert float(pulse(start + 0.0025)) == pytest.approx(1.0)


def test_functions_that_change_too_fast_are_rejected_with_a_cure(monkeypatch: Any) -> None:
    monkeypatch.setattr(interpolants, "MAX_COUNT", 100)
    fast = "changes too fast near t = .* s to be sampled: "
    with pytest.raises(
        ValueError, match=rf"NodalForce\.values {fast}declare breakpoints=\(…\), or"
    ):
        run(forces=push(lambda t: math.sin(1e6 * t)))
    model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.RestLength()))
    with pytest.raises(
        ValueError, match=rf"control {fast}give ControlFunction\(.*resolution=…\), or"
    ):
        tc.simulate(
            model, 1.0, 0.01, control=lambda t: model.initial_control * (2 + math.sin(1e6 * t))
        )


def test_a_function_that_changes_its_answer_is_rejected() -> None:
    calls = iter(range(10**9))
    with pytest.raises(ValueError, match=r"NodalForce\.values\(0\) is .* and then .* at each call"):
        run(forces=push(lambda t: math.sin(t) + next(calls)))


def test_an_interpolant_ends_with_its_span() -> None:
    model = tc.Model(tc.Scene(PENDULUM, forces=push(math.sin)))
    other = model.interpolate_functions(0.0, 1.0)
    assert other.interpolate_functions(0.0, 1.0) is other
    assert tc.simulate(other, 1.0, 0.01, compiled=False).success
    with pytest.raises(ValueError, match=r"NodalForce\.values is interpolated from 0 to 1 s"):
        tc.simulate(other, 2.0, 0.01, compiled=False)
    with pytest.raises(ValueError, match=r"last is 0: give a time after first = 1 s"):
        model.interpolate_functions(1.0, 0.0)


def test_machine_code_needs_an_interpolant(tmp_path: Any) -> None:
    model = tc.Model(tc.Scene(PENDULUM, forces=push(math.sin)))
    for user, call in {
        r"Model\.compile": model.compile,
        "export_c": lambda: tc.export_c(model, tmp_path / "c"),
    }.items():
        cure = r" cannot use NodalForce\.values, .* give model\.interpolate_functions"
        with pytest.raises(ValueError, match=user + cure):
            call()
    assert tc.export_c(model.interpolate_functions(0.0, 1.0), tmp_path / "c")
    assert tc.export_c(model, tmp_path / "c", t_end=1.0)
