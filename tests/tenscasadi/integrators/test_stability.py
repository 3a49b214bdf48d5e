"""The largest stable step: against frequencies known by hand, and against runs that break."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import (
    contact_rate,
    contact_step,
    fastest_rate,
    lightest_mass,
    stable_step,
)
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


def prism() -> Model:
    return Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0)))


def test_the_fastest_rate_of_a_spring_is_its_frequency() -> None:
    masses = Structure(
        [[0, 0, 0], [2.0, 0, 0]],
        strings=[(0, 1)],
        node_mass=3.0,
        pinned=[0],
        stiffness=50.0,
        rest_length=1.0,
    )
    model = Model(Scene(masses))
    assert fastest_rate(model) == pytest.approx(np.sqrt(50.0 / 3.0), rel=1e-6)
    assert stable_step(model) == pytest.approx(0.9 * 2 * np.sqrt(2) / np.sqrt(50.0 / 3.0), rel=1e-6)
    damped = Model(Scene(masses.replace(damping=1000.0)))  # the fast motion decays: the other limit
    assert stable_step(damped) == pytest.approx(0.9 * 2.785 / fastest_rate(damped), rel=1e-3)
    assert stable_step(Model(Scene(Structure([[0, 0, 0]], node_mass=1.0)))) == np.inf


def test_large_models_have_the_rate_of_their_parts() -> None:
    small = shapes.prism(stiffness=1000.0, prestress=30.0)
    copies = 14
    nodes = np.concatenate([small.nodes + np.array([3.0 * i, 0, 0]) for i in range(copies)])
    bars, strings = (
        np.concatenate([pairs + 6 * i for i in range(copies)])
        for pairs in (small.bars, small.strings)
    )
    large = Model(
        Scene(
            Structure(
                nodes,
                bars,
                strings,
                stiffness=1000.0,
                rest_length=np.tile(small.rest_length, copies),
            )
        )
    )
    assert large.nx > 400
    assert fastest_rate(large) == pytest.approx(fastest_rate(prism()), rel=1e-3)
    assert stable_step(large) == pytest.approx(stable_step(prism()), rel=1e-2)


def test_the_limit_is_where_runs_break() -> None:
    masses = Structure(
        [[0, 0, 0], [2.0, 0, 0]],
        strings=[(0, 1)],
        node_mass=3.0,
        pinned=[0],
        stiffness=50.0,
        rest_length=1.0,
    )
    model = Model(Scene(masses, gravity=Gravity((100.0, 0, 0))))  # taut all the time
    limit = stable_step(model, safety=1.0)
    start = model.state([[0, 0, 0], [1.0 + 300.0 / 50.0 + 1e-3, 0, 0]])
    runs = [
        simulate(model, 500 * limit, factor * limit, state=start, compiled=False)
        for factor in (0.99, 1.01)
    ]
    amplitudes = [np.abs(run.nodes[-20:, 1, 0] - 7).max() for run in runs]
    assert amplitudes[0] < 2e-3
    assert amplitudes[1] > 1e-2


@pytest.mark.parametrize(
    ("argument", "value"),
    [("x", np.zeros(2)), ("u", np.zeros(2)), ("safety", 0), ("model", None), ("scheme", None)],
)
def test_mistakes_about_the_step_are_named(argument: str, value: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=argument):
        stable_step(**({"model": prism()} | {argument: value}))


def test_steps_in_contact_follow_the_lightest_node() -> None:
    masses = Structure(
        [[0, 0, 1.0], [1.0, 0, 1.0]], strings=[(0, 1)], node_mass=[0.5, 2.0], stiffness=50.0
    )
    free = Model(Scene(masses))
    assert lightest_mass(free) == pytest.approx(0.5)
    assert lightest_mass(Model(Scene(shapes.prism(bar_mass=0.3)))) == pytest.approx(
        0.3 / 4
    )  # an end of a rod
    assert contact_rate(free) == 0.0
    assert contact_step(free) == np.inf
    hung = Structure(
        [(0, 0, 1), (0, 0, 0), (0, 1, 0)],
        strings=[(0, 1), (1, 2)],
        node_mass=[0, 0.5, 2.0],
        pinned=[0],
        stiffness=1.0,
    )
    for coordinates in (
        "reduced",
        "full",
    ):  # in full ones the pin, which has no mass, is free, and held by a force
        assert lightest_mass(Model(Scene(hung), coordinates)) == pytest.approx(0.5)
    soft, damped = (
        Model(Scene(masses, ground=Ground(stiffness=200.0, damping=damping)))
        for damping in (0.0, 30.0)
    )
    assert contact_rate(soft) == pytest.approx(20.0)
    assert contact_rate(damped) == pytest.approx(60.0)
    assert contact_step(soft) == pytest.approx(0.1 / 20.0)
    rough = [
        Model(
            Scene(
                masses,
                gravity=Gravity(),
                ground=Ground(stiffness=200.0, friction=0.5, slip_speed=slip),
            )
        )
        for slip in (0.1, 1e-9)
    ]
    assert contact_step(rough[0]) == pytest.approx(0.25 / (0.5 * 2.5 * 9.81 / 3 / (0.5 * 0.1)))
    assert contact_step(rough[1]) == pytest.approx(0.1 * contact_step(soft))


@pytest.mark.parametrize(
    ("contact", "limit"),
    [
        ({}, 2 * np.sqrt(2) / 20.0),
        ({"damping": 30.0}, 2.785 / 60.0),
        ({"friction": 0.5, "slip_speed": 0.1}, 2.785 / (0.5 * 9.81 / 3 / 0.1)),
    ],
)
def test_stable_step_includes_contact_that_is_to_come(
    contact: dict[str, float], limit: float
) -> None:
    mass = Structure([[0, 0, 1.0]], node_mass=0.5)
    ground = Ground(stiffness=200.0, **contact)
    model = Model(Scene(mass, gravity=Gravity(), ground=ground))
    assert stable_step(model, safety=1.0) == pytest.approx(min(limit, 0.1414), rel=1e-3)
