"""Controls over time: every form gives the steps and the values that it says."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from runs import by_hand, moving, prism

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.simulation.control_input import (
    ControlProfile,
    append_constants,
    cut_steps,
    sample_control,
)
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes

MESH = np.array([0.0, 0.04, 0.1, 0.11, 0.3])


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(
        Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=1.0), control=ForceDensity())
    )


def pulls(model: Model, rows: int) -> np.ndarray:
    return model.initial_control * (
        1 + 0.1 * np.random.default_rng(0).normal(size=(rows, model.nu))
    )


@pytest.mark.parametrize(
    "scheme",
    [
        RungeKutta4(),
        Rattle(),
        DormandPrince54(),
        DormandPrince853(1e-10),
        Cvodes(1e-10),
        Idas(1e-10),
    ],
    ids=repr,
)
def test_a_profile_is_what_its_intervals_are_one_after_the_other(model, scheme):
    values = pulls(model, 4)
    run = simulate(
        model, 0.3, 0.01, scheme, control=ControlProfile(MESH, values), save_every=1, compiled=False
    )
    assert run.success, run.message
    assert np.isin(MESH, run.time).all()
    state = model.initial_state
    for (begin, end), held in zip(pairwise(MESH), values, strict=True):
        part = simulate(model, end - begin, 0.01, scheme, state=state, control=held, compiled=False)
        state = part.states[-1]
        assert run.states[run.time == end] == pytest.approx(
            state[None], abs=1e-6 if getattr(scheme, "rtol", None) else 1e-11
        )
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
    table, profile = (
        simulate(model, 0.2, 0.01, control=u, compiled=False)
        for u in (values, ControlProfile(np.linspace(0, 0.2, 6), values))
    )
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
def test_profiles_that_do_not_fit_are_refused(
    model: Model, time: Any, shape: Any, named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        simulate(
            model, 0.3, control=ControlProfile(np.array(time), np.zeros(shape)), compiled=False
        )


@pytest.mark.parametrize("kind", [ForceDensity(), RestLength()])
def test_every_form_of_control(kind: Any) -> None:
    model = prism(kind)
    u, x, steps, h = model.initial_control, moving(model), 1200, 1e-3
    table = u * np.array([1.0, 1.1, 0.9])[:, None]
    forms = [
        (None, [u] * steps),
        (1.1 * u, [1.1 * u] * steps),
        (table, np.repeat(table, 400, axis=0)),
        (table[1:2], [1.1 * u] * steps),
    ]
    for control, used in forms:
        run = simulate(model, steps * h, h, state=x, control=control, save_every=1, compiled=False)
        assert np.abs(run.states - by_hand(model, x, np.array(used), h)).max() < 1e-11
        assert run.control == pytest.approx(np.concatenate([used, used[-1:]]))
        assert run.force_density[5] == pytest.approx(model.force_density(run.states[5], used[5]))


def test_steps_fit_the_intervals_of_a_table() -> None:
    model = prism(ForceDensity())
    u = model.initial_control
    run = simulate(model, 1.0, 0.01, control=np.outer(np.linspace(1, 1.1, 7), u), compiled=False)
    assert len(run.time) == 7 * 15 + 1
    changes = np.flatnonzero(np.abs(np.diff(run.control, axis=0)).max(axis=1) > 0) + 1
    assert run.time[changes] == pytest.approx(np.arange(1, 7) / 7, abs=1e-15)


def test_a_scene_without_control_takes_an_empty_one() -> None:
    model = prism()
    reference = simulate(model, 0.1, 0.01, state=moving(model), compiled=False)
    assert reference.control.shape == (11, 0)
    for control in ([], np.zeros((3, 0)), lambda t: []):
        run = simulate(model, 0.1, 0.01, state=moving(model), control=control, compiled=False)
        assert np.array_equal(run.states, reference.states)


def test_rest_lengths_must_be_greater_than_0() -> None:
    model = prism(RestLength())
    u = model.initial_control
    forms = {
        r"control\[0\] is -": -u,
        r"control\[8\] is 0:": np.append(u[:8], 0.0),
        r"control\[2, 0\] is -": np.array([u, u, -u]),
        r"control\(0\.5\)\[0\] is 0:": lambda t: u * (0.5 - t),
        r"control\.values\[1, 0\] is -": ControlProfile(
            np.array([0.0, 0.2, 1.0]), np.array([u, -u])
        ),
    }
    for named, control in forms.items():
        with pytest.raises(
            ValueError, match=named + ".* rest lengths .RestLength. must be greater than 0"
        ):
            simulate(model, 1.0, 0.01, control=control, compiled=False)


def test_cut_steps_hold_the_control_of_their_step():
    values = np.arange(4.0)[:, None]
    equal = sample_control(values, np.zeros(1), 0.4, 4)
    assert cut_steps(equal, np.array([-1.0, 0.0, 0.1, 0.3 + 1e-12, 0.4, 2.0])) is equal
    cut = cut_steps(equal, np.array([0.15, 0.17, 0.35]))
    assert cut.times(np.arange(8)) == pytest.approx([0, 0.1, 0.15, 0.17, 0.2, 0.3, 0.35, 0.4])
    assert cut.window(0, 9).ravel().tolist() == [0, 1, 1, 1, 2, 3, 3, 3, 3]
    assert cut.window(3, 2).ravel().tolist() == [1, 2]
    assert cut.window(7, 2).ravel().tolist() == [3, 3]


def test_constants_stand_behind_the_control_of_each_step():
    inputs = append_constants(
        sample_control(np.array([[1.0], [2.0]]), np.zeros(1), 1.0, 4), np.array([7.0, 8.0])
    )
    assert inputs.window(1, 4).tolist() == [
        [1.0, 7.0, 8.0],
        [2.0, 7.0, 8.0],
        [2.0, 7.0, 8.0],
        [2.0, 7.0, 8.0],
    ]
