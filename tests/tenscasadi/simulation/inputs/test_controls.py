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
from tenscasadi.simulation.inputs.controls import ControlProfile
from tenscasadi.simulation.inputs.run_inputs import read_inputs
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


def read(values, times, step, model, fewest=1):
    profile = ControlProfile(times, values, fewest)
    return read_inputs(model, times[-1], step, RungeKutta4(), None, profile, None, many=False)


def test_intervals_have_equal_steps_no_longer_than_the_step(model):
    inputs = read(pulls(model, 4), MESH, 0.02, model)
    grid = inputs.grid
    assert grid.counts.tolist() == [2, 3, 1, 10]
    assert grid.lengths == pytest.approx([0.02, 0.02, 0.01, 0.019])
    assert grid.longest == pytest.approx(0.02)
    assert grid.times(np.array([0, 2, 16])).tolist() == [0.0, 0.04, 0.3]
    assert grid.rows[grid.locate(np.arange(18))].tolist() == [0] * 2 + [1] * 3 + [2] + [3] * 12
    assert np.array_equal(inputs.stack(0, np.array([5])), pulls(model, 4)[[2]])
    assert read(pulls(model, 4), MESH, 0.3, model, fewest=7).grid.steps == 28


def test_linear_profiles_are_constant_at_their_mean(model):
    values = np.outer(MESH**2, np.ones(model.nu))
    inputs = read(values, MESH, 0.3, model, fewest=2)
    middle = np.repeat(MESH[:-1], 2) + np.ravel(np.outer(np.diff(MESH), [0.25, 0.75]))
    held = inputs.stack(0, np.arange(8))[:, 0]
    assert held == pytest.approx(np.interp(middle, MESH, MESH**2))


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
