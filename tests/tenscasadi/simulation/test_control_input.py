"""Controls over time: every form gives the steps and the values that it says."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.simulation.control_input import ControlProfile, sample_control
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes

MESH = np.array([0.0, 0.04, 0.1, 0.11, 0.3])


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=1.0), control=ForceDensity()))


def pulls(model: Model, rows: int) -> np.ndarray:
    return model.initial_control * (1 + 0.1 * np.random.default_rng(0).normal(size=(rows, model.nu)))


@pytest.mark.parametrize("scheme", [RungeKutta4(), Rattle(), DormandPrince54(), DormandPrince853(1e-10), Cvodes(1e-10), Idas(1e-10)], ids=repr)
def test_a_profile_is_what_its_intervals_are_one_after_the_other(model, scheme):
    values = pulls(model, 4)
    run = simulate(model, 0.3, 0.01, scheme, control=ControlProfile(MESH, values), save_every=1, compiled=False)
    assert run.success, run.message
    assert np.isin(MESH, run.time).all()
    state = model.initial_state
    for (begin, end), held in zip(pairwise(MESH), values, strict=True):
        part = simulate(model, end - begin, 0.01, scheme, state=state, control=held, compiled=False)
        state = part.states[-1]
        assert run.states[run.time == end] == pytest.approx(state[None], abs=1e-6 if getattr(scheme, "rtol", None) else 1e-11)
    assert np.abs(run.energy_error).max() < 1e-4 * np.ptp(run.energy)


def test_intervals_are_cut_into_equal_steps_no_longer_than_asked():
    values = np.arange(4.0)[:, None]
    held = sample_control(ControlProfile(MESH, values), np.zeros(1), 0.3, 15)  # of at most 0.02 s
    assert np.diff(held.ends) == pytest.approx([0.02] * 2 + [0.02] * 3 + [0.01] + [0.019] * 10)
    assert held.window(0, 16).ravel().tolist() == [0] * 2 + [1] * 3 + [2] + [3] * 10
    assert held.window(14, 4).ravel().tolist() == [3] * 4
    assert held.lengths(14, 4) == pytest.approx(np.full(4, 0.019))
    assert held.times(np.array([0, 2, 16])).tolist() == [0.0, 0.04, 0.3]
    assert held.longest == pytest.approx(0.02)
    assert sample_control(ControlProfile(MESH, values, steps=7), np.zeros(1), 0.3, 1).steps == 28


def test_linear_profiles_are_held_at_their_mean():
    linear = sample_control(ControlProfile(MESH, MESH[:, None] ** 2, steps=2), np.zeros(1), 0.3, 1)
    middle = (linear.ends[1:] + linear.ends[:-1]) / 2
    assert linear.window(0, 8).ravel() == pytest.approx(np.interp(middle, MESH, MESH**2))


def test_an_equal_mesh_is_a_table(model):
    values = pulls(model, 5)
    table, profile = (simulate(model, 0.2, 0.01, control=u, compiled=False) for u in (values, ControlProfile(np.linspace(0, 0.2, 6), values)))
    assert profile.states == pytest.approx(table.states, abs=1e-11)
    assert profile.energy_error == pytest.approx(table.energy_error, abs=1e-11)
    assert profile.control == pytest.approx(table.control)


@pytest.mark.parametrize(
    ("time", "shape", "named"),
    [
        ([0.0, 0.2], (1, 9), r"control\.time is .* from 0 to t_end = 0\.3"), ([0.1, 0.3], (1, 9), r"control\.time"),
        ([0.3], (0, 9), r"control\.time"), ([0.0, 0.2, 0.2, 0.3], (3, 9), r"control\.time"),
        (MESH, (4, 3), r"control\.values"), (MESH, (3, 9), r"control\.values"),
    ],
)  # fmt: skip
def test_profiles_that_do_not_fit_are_refused(model: Model, time: Any, shape: Any, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        simulate(model, 0.3, control=ControlProfile(np.array(time), np.zeros(shape)), compiled=False)
