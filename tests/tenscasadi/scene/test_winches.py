"""Controls that wind up cables: motion, energy, limits, statics, files, derivatives."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tenscasadi as tc

G = 9.81


def hanging(**changes: Any) -> tc.Structure:
    fields = {
        "nodes": [(0, 0, 0), (0, 0, -1)],
        "strings": [(0, 1)],
        "pinned": [0],
        "node_mass": [0.0, 2.0],
        "stiffness": 500.0,
        "rest_length": 1.0 - 2.0 * G / 500.0,
    }
    return tc.Structure(**fields | changes)


def lifting(**changes: Any) -> tc.Model:
    return tc.Model(tc.Scene(hanging(**changes), control=tc.RestLengthRate(), gravity=tc.Gravity()))


def test_a_mass_on_a_winch_follows_its_analytic_motion() -> None:
    model = lifting()
    run = tc.simulate(model, 0.5, 1e-3, control=[-0.2], compiled=False)
    omega, t = np.sqrt(500.0 / 2.0), run.time
    # in equilibrium at first: z = −1 + 0.2 (t − sin(ω t)/ω)
    expected = -1.0 + 0.2 * (t - np.sin(omega * t) / omega)
    assert run.success
    assert np.allclose(run.nodes[:, 1, 2], expected, rtol=0, atol=1e-8)
    rest = run.internal_states["rest length"]
    assert np.allclose(rest[:, 0], model.structure.rest_length[0] - 0.2 * t, rtol=0, atol=1e-12)
    assert np.abs(run.energy_error).max() < 1e-8
    assert run.energy[-1] - run.energy[0] > 1.0


@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_the_work_of_winches_is_counted(damping: float) -> None:
    structure = tc.shapes.prism(prestress=10.0, damping=damping)
    model = tc.Model(tc.Scene(structure, control=tc.RestLengthRate()))
    run = tc.simulate(model, 0.5, 1e-3, control=np.linspace(-0.2, 0.1, 9), compiled=False)
    assert run.success
    assert np.ptp(run.energy) > 1e-2
    assert np.abs(run.energy_error).max() < 1e-5 * np.ptp(run.energy)


def test_constant_rates_equal_a_rest_length_that_changes_linearly() -> None:
    structure = tc.shapes.prism(prestress=10.0, damping=1.0)
    rates = np.linspace(-0.2, 0.1, 9)
    winches = tc.Model(tc.Scene(structure, control=tc.RestLengthRate()))
    lengths = tc.Model(tc.Scene(structure, control=tc.RestLength()))
    one = tc.simulate(winches, 0.3, 1e-3, control=rates, compiled=False)
    start = lengths.initial_control
    two = tc.simulate(lengths, 0.3, 1e-3, control=lambda t: start + rates * t, compiled=False)
    assert np.allclose(one.nodes, two.nodes, rtol=0, atol=1e-9)
    assert np.allclose(one.tension, two.tension, rtol=0, atol=1e-6)


def test_a_prism_with_three_cables_has_three_winches() -> None:
    prism = tc.shapes.prism(prestress=10.0, damping=1.0, stiffness=500.0)
    robot = prism.replace(cables=[[0, 1, 2], [3, 4, 5], [6], [7], [8]])
    model = tc.Model(tc.Scene(robot, control=tc.RestLengthRate()))
    assert model.nu == model.na == 5
    run = tc.simulate(model, 0.3, 1e-3, control=[-0.1, -0.1, 0.0, 0.0, 0.0], compiled=False)
    assert run.success
    assert np.allclose(run.tension[:, 0], run.tension[:, 1])
    rest = run.internal_states["rest length"][-1]
    assert rest[0] == pytest.approx(prism.rest_length[:3].sum() - 0.03, abs=1e-12)
    assert np.abs(run.energy_error).max() < 1e-5


def test_a_string_that_is_wound_up_fails_the_run() -> None:
    run = tc.simulate(lifting(damping=50.0), 2.0, 1e-3, control=[-0.6], compiled=False)
    assert not run.success
    assert "the rest length of string 0 reaches 0 at 1.6" in run.message
    assert "give inputs that wind up less" in run.message


def test_statics_locks_winches() -> None:
    model = lifting(rest_length=0.9)
    eq = tc.find_equilibrium(model)
    assert eq.success
    assert eq.control.tolist() == [0.9]
    assert eq.nodes[1, 2] == pytest.approx(-0.9 - 2.0 * G / 500.0)
    shorter = tc.find_equilibrium(model, control=[0.5])
    assert shorter.nodes[1, 2] == pytest.approx(-0.5 - 2.0 * G / 500.0)
    rest = tc.simulate(model, 0.2, 1e-3, state=shorter, compiled=False)
    assert rest.success
    assert np.allclose(rest.nodes, shorter.nodes, rtol=0, atol=1e-9)
    assert tc.modes(shorter).frequency[-1] == pytest.approx(np.sqrt(500.0 / 2.0) / (2 * np.pi))
    again = tc.find_equilibrium(model, start=rest.states[-1])
    assert np.allclose(again.control, 0.5)


def test_rest_lengths_may_be_parameters() -> None:
    scene = tc.Scene(
        hanging(),
        control=tc.RestLengthRate(),
        gravity=tc.Gravity(),
        parameters=tc.Parameters("rest_length"),
    )
    model = tc.Model(scene)
    runs = tc.rollouts(model, 0.2, 1e-3, parameters=[[0.8], [0.9]], controls=[-0.1])
    assert np.allclose(model.split(runs.states[:, 0]).internal[:, 0], [0.8, 0.9])
    assert np.allclose(model.split(runs.final).internal[:, 0], [0.78, 0.88], rtol=0, atol=1e-12)


def motor(stiffness: float = 1e6, **changes: Any) -> tc.Model:
    structure = hanging(stiffness=stiffness, rest_length=1.0 - 2.0 * G / stiffness)
    control = tc.Winch(**{"radius": 0.05, "inertia": 2e-3} | changes)
    return tc.Model(tc.Scene(structure, control=control, gravity=tc.Gravity()))


@pytest.mark.parametrize("torque", [0.0, 2.0])
def test_a_motor_lifts_a_mass_on_a_stiff_cable(torque: float) -> None:
    run = tc.simulate(motor(), 0.3, 1e-4, control=[torque], compiled=False)
    # the drum is a mass J/r² on the cable
    acceleration = (torque / 0.05 - 2.0 * G) / (2.0 + 2e-3 / 0.05**2)
    assert run.success
    assert run.nodes[-1, 1, 2] + 1.0 == pytest.approx(acceleration * 0.3**2 / 2, rel=1e-4)
    speed = run.internal_states["winding speed"][-1, 0]
    assert speed == pytest.approx(acceleration * 0.3 / 0.05, rel=1e-2)
    assert np.abs(run.energy_error).max() < 1e-6


def test_a_drum_on_a_cable_vibrates_at_its_frequency() -> None:
    model = motor(stiffness=500.0)
    x = np.array(model.initial_state)
    model.split(x).internal[0] -= 0.01
    run = tc.simulate(model, 0.4, 1e-3, state=x, compiled=False)
    # two masses on a spring: stretch 0.01 cos(ω t) with ω² = k (1/m + r²/J)
    omega = np.sqrt(500.0 * (1 / 2.0 + 0.05**2 / 2e-3))
    stretch = -run.nodes[:, 1, 2] - run.internal_states["rest length"][:, 0]
    expected = 2.0 * G / 500.0 + 0.01 * np.cos(omega * run.time)
    assert np.allclose(stretch, expected, rtol=0, atol=1e-7)
    assert np.abs(run.energy_error).max() < 1e-8


def test_friction_limits_the_speed_of_an_idle_motor() -> None:
    winch = tc.Winch(0.05, 1e-2, friction=0.5)
    structure = hanging(damping=30.0)
    model = tc.Model(tc.Scene(structure, control=winch, gravity=tc.Gravity()))
    run = tc.simulate(model, 1.0, 1e-3, control=[0.0], compiled=False)
    speed = run.internal_states["winding speed"][-1, 0]
    assert speed == pytest.approx(-0.05 * 2.0 * G / 0.5, rel=1e-3)  # falls at a constant speed
    assert np.abs(run.energy_error).max() < 1e-6


@pytest.mark.parametrize(
    "scheme",
    [tc.RungeKutta4(), tc.Rattle(), tc.Rattle(4), tc.Collocation(1), tc.Cvodes(), tc.Idas()],
    ids=str,
)
def test_all_schemes_take_motors(scheme: Any) -> None:
    structure = tc.shapes.prism(prestress=10.0, damping=1.0)
    winch = tc.Winch(np.linspace(0.02, 0.03, 9), 1e-3, friction=1e-3)
    model = tc.Model(tc.Scene(structure, control=winch))
    control = 1.3 * model.initial_control
    exact = tc.simulate(model, 0.1, 0.01, tc.DormandPrince853(1e-10), control=control)
    run = tc.simulate(model, 0.1, 1e-3, scheme, control=control, compiled=False)
    assert run.success
    assert np.allclose(run.nodes[-1], exact.nodes[-1], rtol=0, atol=1e-5)
    assert np.abs(run.energy_error).max() < 1e-4


def test_motors_hold_an_equilibrium() -> None:
    model = motor(stiffness=500.0)
    eq = tc.find_equilibrium(model, control=[0.5])
    run = tc.simulate(model, 0.2, 1e-3, state=eq, compiled=False)
    assert run.success
    assert np.allclose(run.nodes, eq.nodes, rtol=0, atol=1e-9)


def test_motor_derivatives_are_finite_differences() -> None:
    model = motor(stiffness=500.0, friction=1e-3)
    linear = tc.linearize(model)
    x, u, h = model.initial_state, model.initial_control, 1e-6
    for k in range(model.nx):
        change = h * np.eye(model.nx)[k]
        column = (model.ode(x + change, u) - model.ode(x - change, u)).full().ravel() / (2 * h)
        assert np.allclose(linear.A[:, k], column, rtol=1e-5, atol=1e-4)
    column = (model.ode(x, u + h) - model.ode(x, u - h)).full().ravel() / (2 * h)
    assert np.allclose(linear.B[:, 0], column, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"radius": 0.0}, "Winch.radius of input 0 is 0: it must be greater than 0"),
        ({"inertia": -1.0}, "Winch.inertia of input 0 is -1"),
        ({"friction": -1.0}, "Winch.friction of input 0 is -1: it must be at least 0"),
        ({"torque": 0.0}, "Winch.torque of input 0 is 0"),
        ({"speed": np.nan}, "Winch.speed is nan"),
        ({"radius": [0.1, 0.1]}, "Winch.radius has shape"),
        ({"torque": [1.0, 1.0]}, "Winch.torque has shape"),
    ],
)
def test_bad_winches_are_rejected_by_name(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        motor(**fields)


def test_files_hold_motors(tmp_path: Path) -> None:
    scene = motor(friction=[1e-3], torque=2.0).scene
    tc.save_scene(scene, tmp_path / "motor.toml")
    own = tc.load_scene(tmp_path / "motor.toml").control
    assert own.radius == 0.05
    assert np.array_equal(own.friction, [1e-3])
    assert (own.torque, own.speed) == (2.0, None)


def test_files_hold_the_control(tmp_path: Path) -> None:
    scene = tc.Scene(hanging(), control=tc.RestLengthRate(), gravity=tc.Gravity())
    tc.save_scene(scene, tmp_path / "winch.toml")
    assert tc.load_scene(tmp_path / "winch.toml").control == tc.RestLengthRate()
    run = tc.simulate(tc.Model(scene), 0.01, 1e-3, control=[-0.1], compiled=False)
    run.save(tmp_path / "run.npz")
    back = tc.Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(back.internal_states["rest length"], run.internal_states["rest length"])
    back.to_csv(tmp_path / "run.csv")
    assert "input 0 rest length" in (tmp_path / "run.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("call", "cure"),
    [
        (lambda m: tc.simulate(m, 0.1, control=[[0.1, 0.1]]), "control has shape"),
    ],
)
def test_unsupported_uses_name_the_cure(call: Any, cure: str) -> None:
    with pytest.raises(ValueError, match=cure.replace("(", r"\(").replace(")", r"\)")):
        call(lifting())


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (
            {"torque": 1.0},
            "the motor torque of string 0 is up to 1.5 N m, beyond the 1 N m of Winch",
        ),
        (
            {"speed": [2.0]},
            r"the winding speed of string 0 is up to \d.* rad/s, beyond the 2 rad/s",
        ),
        ({"torque": 1.5, "speed": 1e3}, None),
    ],
)
def test_message_names_motors_beyond_their_limits(limits, told):
    hanging = tc.Structure(
        [(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=[0, 2.0], stiffness=500.0
    )
    winch = tc.Winch(0.05, 2e-3, 1e-3, **limits)
    model = tc.Model(tc.Scene(hanging, control=winch, gravity=tc.Gravity()))
    for message in (
        tc.simulate(model, 0.2, 1e-3, control=[1.5]).message,
        tc.simulate(model, 0.2, 1e-3, control=lambda t: [1.5]).message,
    ):
        assert "beyond" not in message if told is None else re.search(told, message), message
