"""Events within fixed steps: strings that let go and catch, nodes that bounce."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.sundials import Cvodes
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Linear, RestLength
from tenscasadi.scene.terrain import Terrain
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.shapes import double_pendulum
from tenscasadi.structure.structure import Structure

WORD = re.compile(r"position error about (.*) m\): try .*step=(.*)")


def two_masses(stiffness: float = 2.1e4, damping: float = 100.0) -> Model:
    """Two masses that a string, underdamped, pulls together, lets go and catches."""
    return Model(
        Scene(
            Structure(
                [(0, 0, 0), (1, 0, 0)],
                strings=[(0, 1)],
                node_mass=1.0,
                stiffness=stiffness,
                damping=damping,
                rest_length=0.9,
            )
        )
    )


def off(model: Model, run: Trajectory) -> float:
    truth = simulate(model, run.time[-1], scheme=Cvodes(1e-11), state=run.states[0])
    return float(abs(run.nodes[-1] - truth.nodes[-1]).max())


@pytest.mark.parametrize("share", [0.76, 0.4, 0.2])
@pytest.mark.parametrize("scheme", [RungeKutta4(), Rattle(), DormandPrince853()])
def test_stable_steps_that_miss_events_are_told_with_the_error(
    scheme: Scheme, share: float
) -> None:
    model = two_masses()
    step = share * stable_step(model, scheme=scheme, safety=1.0)
    run = simulate(model, 1.0, step, scheme, compiled=False)
    told = WORD.search(run.message)
    wrong = off(model, run)
    assert told or "try" in run.message or wrong < 0.02
    if told:
        assert wrong / 30 < float(told[1]) < 30 * wrong


def test_a_run_is_as_good_as_its_word_by_either_cure() -> None:
    model = two_masses()
    run = simulate(model, 1.0, 0.005, compiled=False)
    told = WORD.search(run.message)
    assert told
    assert off(model, run) > 0.02
    for cured in (
        simulate(model, 1.0, float(told[2]) / 4, compiled=False),
        simulate(model, 1.0, scheme=DormandPrince853(1e-6), compiled=False),
    ):
        assert off(model, cured) < 0.005
        still = WORD.search(cured.message)
        assert still is None or float(still[1]) < float(told[1]) / 3


def test_default_steps_are_refined_until_events_are_accurate() -> None:
    coarse = simulate(two_masses(), 1.0, 1e-3, compiled=False)
    default = simulate(two_masses(), 1.0, compiled=False)
    assert WORD.search(coarse.message)
    assert ";" not in default.message
    assert default.step < 1e-3
    assert off(two_masses(), default) < off(two_masses(), coarse) / 4
    np.testing.assert_allclose(default.time, coarse.time, atol=1e-12)


def test_bounces_within_steps_are_told() -> None:
    structure = Structure(
        [(0, 0, 0), (0, 0, 1)], strings=[(0, 1)], node_mass=1.0, rest_length=0.5, stiffness=100.0
    )
    model = Model(Scene(structure, gravity=Gravity(), ground=Ground(1e4, 1.0, height=-0.2)))
    coarse, fine = (simulate(model, 2.0, step, compiled=False) for step in (0.01, 2e-4))
    assert "strings go slack or taut, or contacts change, within steps" in coarse.message
    assert off(model, coarse) > 0.01
    assert ";" not in fine.message


def test_smooth_motions_and_many_kept_steps_need_no_word() -> None:
    taut = two_masses(100.0, 0.0)
    pulled = taut.state([(0, 0, 0), (2.0, 0, 0)], [(0, 3.0, 0), (0, -3.0, 0)])
    assert ";" not in simulate(taut, 5.0, 0.02, state=pulled, compiled=False).message
    for every in (None, 7, 400):
        assert (
            ";" not in simulate(two_masses(), 1.0, 2e-4, save_every=every, compiled=False).message
        )
        assert (
            "position error"
            in simulate(
                two_masses(),
                1.0,
                0.005,
                save_every=1 if every is None else min(every, 9),
                compiled=False,
            ).message
        )


def test_steps_too_long_for_a_vibration_are_told_without_events() -> None:
    """At half of the stability limit a string that pushes, too, swings as it should not: damped by the steps, and too slowly."""
    structure = Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=1e3, rest_length=0.9
    )
    model = Model(Scene(structure, slack=Linear()))
    for share, told in ((0.4, True), (0.02, False)):
        run = simulate(model, 0.5, share * stable_step(model, safety=1.0), compiled=False)
        assert run.success != told
        assert ("is too large (position error about" in run.message) == told
        assert (off(model, run) > 1e-3) == told


def hanging_chain() -> Model:
    """Undamped strings that let go and catch under three masses, along whose motion errors grow."""
    x = np.arange(4.0)
    nodes = np.column_stack([x, 0.3 * np.sin(x), 0 * x])
    strings = [(0, 1), (1, 2), (2, 3)]
    structure = Structure(
        nodes,
        strings=strings,
        node_mass=[0, 2.2, 0.9, 0.4],
        pinned=[0],
        stiffness=2.6e4,
        rest_length=0.91,
    )
    return Model(Scene(structure, gravity=Gravity()))


@pytest.mark.parametrize("steps", [600, 1620, 3240])
@pytest.mark.parametrize("scheme", [RungeKutta4(), Rattle(order=4)])
def test_errors_that_grow_after_the_first_events_are_told(scheme: Scheme, steps: int) -> None:
    model = hanging_chain()
    run = simulate(model, 0.9, 0.9 / steps, scheme, compiled=False)
    told = WORD.search(run.message)
    assert told, run.message
    wrong = off(model, run)
    assert wrong > 0.02
    assert wrong / 5 < float(told[1]) < 30 * wrong


def test_rattle_on_a_terrain_tells_its_error() -> None:
    terrain = Terrain(
        0.1 * np.sin(np.arange(30.0)).reshape(5, 6),
        (-2, -2),
        (1, 1),
        stiffness=1e4,
        damping=5.0,
        friction=0.3,
    )
    nodes, strings = [(0, 0, 0.5), (1, 0.25, 0.5), (2, 0.27, 0.5)], [(0, 1), (1, 2)]
    structure = Structure(
        nodes,
        strings=strings,
        node_mass=[0, 1.27, 2.77],
        pinned=[0],
        stiffness=2.3e4,
        damping=1.4,
        rest_length=0.945,
    )
    model = Model(Scene(structure, gravity=Gravity(), ground=terrain))
    run = simulate(model, 1.1, 1.1 / 400, Rattle(), compiled=False)
    told = WORD.search(run.message)
    assert told, run.message
    truth = simulate(model, 1.1, scheme=DormandPrince853(1e-11), compiled=False)
    assert float(told[1]) == pytest.approx(abs(run.nodes[-1] - truth.nodes[-1]).max(), rel=0.9)


def test_energy_that_is_kept_hides_no_error() -> None:
    """Gauss's points keep the energy of a mass between two strings, but not where it is."""
    structure = Structure(
        [(0, 0, 0), (1, 0.25, 0), (2, 0.27, 0)],
        strings=[(0, 1), (1, 2)],
        node_mass=[0, 0.12, 0],
        pinned=[0, 2],
        stiffness=1400.0,
        rest_length=0.83,
    )
    model = Model(Scene(structure, gravity=Gravity((-4.0, -12.0, 6.0))))
    for steps, told in ((120, True), (480, False)):
        run = simulate(model, 1.3, 1.3 / steps, Collocation(2), compiled=False)
        assert ("(position error about" in run.message) == told
        assert (off(model, run) > 0.01) == told


def test_steps_that_bear_no_longer_ones_need_no_word() -> None:
    """Twice as long, they are above the stability limit of a vibration that nothing excites."""
    structure = Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=1e4, rest_length=1.0
    )
    model = Model(Scene(structure, slack=Linear(), gravity=Gravity((0.0, 0.0, -1.0))))
    start = model.state(structure.nodes, [(0.0, 0.0, 1.0), (1e-9, 0.0, 1.0)])
    for steps in (200, 3000):
        step = 0.9 * stable_step(model, safety=1.0)
        run = simulate(model, steps * step, step, state=start, compiled=False)
        assert run.message == f"finished {steps} steps of {run.step:g} s"


def test_longer_steps_end_where_controls_jump() -> None:
    structure = Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=50.0, rest_length=1.0
    )
    model = Model(Scene(structure, slack=Linear(), control=RestLength()))
    run = simulate(model, 1.0, 1.0 / 44, control=[[0.9], [1.1], [0.9], [1.1]], compiled=False)
    assert 0 < run.error_estimate < 1e-3 * np.ptp(run.nodes, axis=0).max()


@pytest.mark.parametrize("save_every", [1, 3])
def test_functions_that_control_are_asked_once_for_each_step(save_every: int) -> None:
    structure = Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=1.0,
        stiffness=1e4,
        damping=0.1,
        rest_length=1.0,
    )
    model = Model(Scene(structure, control=RestLength()))

    def control(time: float) -> list[float]:
        return [0.8]

    run = simulate(model, 1.0, 1.0 / 300, control=control, save_every=save_every, compiled=False)
    told = WORD.search(run.message)
    assert told, run.message
    assert 0.05 < float(told[1]) < 1.0


def test_the_estimate_is_about_the_error() -> None:
    model = two_masses(100.0, 0.0)
    pulled = model.state([(0, 0, 0), (2.0, 0, 0)], [(0, 3.0, 0), (0, -3.0, 0)])
    for scheme in (RungeKutta4(), Rattle(), DormandPrince853(1e-5), Cvodes(1e-5)):
        run = simulate(model, 1.0, 0.02, scheme, state=pulled, compiled=False)
        assert off(model, run) / 30 < run.error_estimate < 30 * off(model, run) + 1e-12
    assert np.isnan(simulate(model, 1.0, 0.02, verify=False, compiled=False).error_estimate)


def test_error_is_estimated_if_the_grid_sets_adaptive_steps() -> None:
    model = Model(Scene(double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    run = simulate(model, 1.0, 0.02, DormandPrince54(1e-4), compiled=False)
    assert run.message.startswith("finished 50 steps of 0.02 s")
    assert off(model, run) / 3 < run.error_estimate < 30 * off(model, run)
