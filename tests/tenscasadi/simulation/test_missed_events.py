"""Events within fixed steps: strings that let go and catch, nodes that bounce."""

from __future__ import annotations

import re

import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.sundials import Cvodes
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Linear
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure

WORD = re.compile("put it off by some (.*) m: try .*step=(.*)")


def two_masses(stiffness: float = 2.1e4, damping: float = 100.0) -> Model:
    """Two masses that a string, underdamped, pulls together, lets go and catches."""
    return Model(Scene(Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=stiffness, damping=damping, rest_length=0.9)))


def off(model: Model, run: Trajectory) -> float:
    truth = simulate(model, run.time[-1], scheme=Cvodes(1e-11), state=run.states[0])
    return float(abs(run.nodes[-1] - truth.nodes[-1]).max())


@pytest.mark.parametrize("share", [0.76, 0.4, 0.2])
@pytest.mark.parametrize("scheme", [RungeKutta4(), Rattle(), DormandPrince853()])
def test_stable_steps_that_miss_events_are_told_with_the_error(scheme: Scheme, share: float) -> None:
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
    assert run.success
    assert off(model, run) > 0.02
    for cured in (simulate(model, 1.0, float(told[2]) / 4, compiled=False), simulate(model, 1.0, scheme=DormandPrince853(1e-6), compiled=False)):
        assert off(model, cured) < 0.005
        assert "put it off" not in cured.message


def test_bounces_within_steps_are_told() -> None:
    structure = Structure([(0, 0, 0), (0, 0, 1)], strings=[(0, 1)], node_mass=1.0, rest_length=0.5, stiffness=100.0)
    model = Model(Scene(structure, gravity=Gravity(), ground=Ground(1e4, 1.0, height=-0.2)))
    coarse, fine = (simulate(model, 2.0, step, compiled=False) for step in (0.01, 2e-4))
    assert "slack or taut and contacts within its steps put it off by some" in coarse.message
    assert off(model, coarse) > 0.01
    assert ";" not in fine.message


def test_smooth_motions_and_many_kept_steps_need_no_word() -> None:
    taut = two_masses(100.0, 0.0)
    pulled = taut.state([(0, 0, 0), (2.0, 0, 0)], [(0, 3.0, 0), (0, -3.0, 0)])
    assert ";" not in simulate(taut, 5.0, 0.02, state=pulled, compiled=False).message
    for every in (None, 7, 400):
        assert ";" not in simulate(two_masses(), 1.0, 2e-4, save_every=every, compiled=False).message
        assert "put it off" in simulate(two_masses(), 1.0, 0.005, save_every=1 if every is None else min(every, 9), compiled=False).message


def test_steps_too_long_for_a_vibration_are_told_without_events() -> None:
    """At half of the stability limit a string that pushes, too, swings as it should not: damped by the steps, and too slowly."""
    structure = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=1e3, rest_length=0.9)
    model = Model(Scene(structure, slack=Linear()))
    for share, told in ((0.4, True), (0.02, False)):
        run = simulate(model, 0.5, share * stable_step(model, safety=1.0), compiled=False)
        assert run.success
        assert ("its steps, too long for the fastest that moves, put it off by some" in run.message or "energy is off" in run.message) == told
        assert (off(model, run) > 1e-3) == told
