"""CVODES and IDAS with events located: as many as there are, and errors that follow the tolerance in one mode after the other."""

from __future__ import annotations

import _thread
from typing import Any

import numpy as np
import pytest
from references import solve_certified

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.integrators.sundials import Cvodes, Idas, Sundials
from tenscasadi.integrators.sundials_events import EventSteps
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("scheme", [Cvodes, Idas])
def test_all_events_of_a_certified_net_are_located(
    scheme: type[Sundials], coordinates: Any
) -> None:
    coarse, fine = (
        solve_certified("net4", scheme(rtol, locate_events=True), coordinates)
        for rtol in (1e-7, 1e-11)
    )
    assert fine[0] < 1e-7
    assert fine[0] < coarse[0] / 50
    assert "to locate 11 events" in fine[1].message  # as many as the certified solution met


@pytest.mark.slow
def test_contacts_with_friction_of_a_certified_landing_are_located() -> None:
    error, run = solve_certified("lander_mass", Cvodes(1e-6, locate_events=True))
    assert error < 1e-4
    assert "to locate 20 events" in run.message


@pytest.mark.parametrize(
    "scheme", [Cvodes(1e-10, locate_events=True), Idas(1e-10, locate_events=True)]
)
@pytest.mark.parametrize("step", [3.5, 0.5, 0.03])
def test_bounces_far_shorter_than_the_grid_are_seen(step: float, scheme: Sundials) -> None:
    """A ball on a stiff ground: half a turn of an oscillator, then the flight of before."""
    k, height = 1e6, 0.5
    model = Model(
        Scene(
            Structure([[0, 0, height]], node_mass=1.0),
            gravity=Gravity((0, 0, -10.0)),
            ground=Ground(stiffness=k),
        )
    )
    fall = np.sqrt(2 * height / 10)
    run = simulate(model, 3.5 * fall, step * fall, scheme)
    assert run.success, run.message
    assert "to locate 4 events" in run.message
    speed, rate = np.sqrt(20 * height), np.sqrt(k)
    contact = (
        2 * (np.pi - np.arctan(speed * rate / 10)) / rate
    )  # until z = −(g/ω²)(1 − cos ωt) − (v/ω) sin ωt is 0 again
    late = 0.5 * fall - 2 * contact  # after the second contact
    assert late > 0
    assert run.nodes[-1, 0, 2] == pytest.approx(speed * late - 5 * late**2, abs=2e-7)
    assert abs(run.energy_error).max() < 2e-6


PRISM = shapes.prism(stiffness=500.0, damping=1.0)
FALLING = {
    "structure": PRISM.replace(
        rest_length=0.999 * PRISM.string_lengths, nodes=PRISM.nodes + [0, 0, 0.2]
    ),
    "gravity": Gravity(),
    "ground": Ground(1e4, damping=10.0, friction=0.4),
}
BUMP = NodalForce(
    np.array([np.zeros((6, 3)), np.ones((6, 3)), np.zeros((6, 3))]), times=[0.0, 0.101, 0.13]
)


@pytest.mark.parametrize(
    ("scheme", "scene", "options"),
    [
        (Cvodes, Scene(**FALLING), {"correction": Projection()}),
        (Cvodes, Scene(**FALLING, forces=BUMP), {}),
        pytest.param(
            Idas,
            Scene(**FALLING, control=RestLength()),
            {"control": np.linspace(1.0, 0.98, 60)[:, None] * PRISM.string_lengths},
            marks=pytest.mark.slow,
        ),
        (
            Cvodes,
            Scene(**FALLING, parameters=Parameters(scale=["stiffness"])),
            {"parameters": [1.1]},
        ),
    ],
    ids=["corrected", "table", "control, Idas", "parameter"],
)
def test_a_fall_with_friction_and_damping(
    scheme: type[Sundials], scene: Scene, options: dict[str, Any]
) -> None:
    model = Model(scene)
    exact = simulate(model, 0.3, 0.005, DormandPrince853(1e-12), compiled=False, **options)
    run = simulate(model, 0.3, 0.005, scheme(1e-10, locate_events=True), **options)
    assert run.success, run.message
    assert " trials to locate " in run.message
    assert abs(run.nodes - exact.nodes).max() < 1e-7
    assert abs(run.energy_error).max() < 1e-5 * abs(run.energy).max()


def test_idas_starts_where_nodes_are_about_to_sink_in() -> None:
    """Multipliers are consistent at once; IDACalcIC did not see it, for a start on the ground at 2.4 m/s."""
    fast = Structure(
        PRISM.nodes,
        PRISM.bars,
        PRISM.strings,
        stiffness=500.0,
        damping=0.01,
        rest_length=0.999 * PRISM.string_lengths,
    )
    model = Model(Scene(fast, gravity=Gravity(), ground=Ground(1e4, damping=0.1)))
    start = model.state(fast.nodes - [0, 0, 1e-11], np.tile([0.0, 0.0, -2.4], (6, 1)))
    run, exact = (
        simulate(model, 0.01, 0.002, scheme, start, compiled=False)
        for scheme in (Idas(1e-9), DormandPrince853(1e-11))
    )
    assert run.success, run.message
    assert abs(run.nodes - exact.nodes).max() < 1e-7


def test_scenes_without_events_run_as_they_do_without_the_option() -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    runs = [
        simulate(model, 0.3, 0.01, Cvodes(1e-8, locate_events=located)) for located in (False, True)
    ]
    assert np.array_equal(runs[0].states, runs[1].states)
    assert runs[0].message == runs[1].message


def test_events_end_where_pieces_or_seconds_are_over() -> None:
    model = Model(Scene(**FALLING))
    few = simulate(model, 0.3, 0.1, Cvodes(1e-3, max_steps=7, locate_events=True))
    assert not few.success
    assert "Cvodes failed" in few.message
    late = simulate(model, 30.0, 0.005, Cvodes(1e-11, locate_events=True), time_limit=0.3)
    assert not late.success
    assert "time limit of 0.3 s" in late.message


@pytest.mark.usefixtures("keyboard")
def test_ctrl_c_is_not_taken_for_a_mode_that_breaks_down(monkeypatch: pytest.MonkeyPatch) -> None:
    def pressed(steps: EventSteps, *arguments: Any) -> Any:
        if steps.events > 0 and not sent:
            sent.append(True)
            _thread.interrupt_main()
        return usual(steps, *arguments)

    sent: list[bool] = []
    usual = EventSteps._integrate
    monkeypatch.setattr(EventSteps, "_integrate", pressed)
    run = simulate(Model(Scene(**FALLING)), 100.0, 0.005, Cvodes(1e-6, locate_events=True))
    assert run.interrupted
    assert run.message.startswith("interrupted from the keyboard")
