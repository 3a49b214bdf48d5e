"""Whole trajectories against solutions that were computed elsewhere in extended precision, with located events."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from references import certified, trajectory_error

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.mechanism import Coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.simulation.simulate import simulate

SMOOTH = {
    "cross_bar": 4e-3,
    "double_pendulum": 1e-2,
    "prism_n1": 4e-3,
    "spin_bar": 2e-3,
}  # a step in the asymptotic range, s
FINE = {
    "cross_bar": 5e-4,
    "double_pendulum": 5e-4,
    "prism_n1": 2e-4,
    "spin_bar": 2e-4,
    "dbar_regular": 2e-5,
    "net4": 5e-6,
}
BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])


@BOTH
@pytest.mark.parametrize("name", SMOOTH)
def test_fourth_order_convergence_to_the_certified_solution(
    name: str, coordinates: Coordinates
) -> None:
    case = certified(name)
    coarse, fine = (
        trajectory_error(case, case.data["t"], step, coordinates).max()
        for step in (SMOOTH[name], SMOOTH[name] / 2)
    )
    assert 3.6 < np.log2(coarse / fine) < 4.6


@BOTH
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name == "dbar_regular")) for name in FINE],
)
def test_certified_solution_to_a_nanometre(name: str, coordinates: Coordinates) -> None:
    case = certified(name)
    assert trajectory_error(case, case.data["t"], FINE[name], coordinates).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "step", "tolerance", "coordinates"),
    [
        ("dbar_regular", 1e-3, 2e-6, "reduced"),
        ("dbar_regular", 1e-3, 2e-6, "full"),
        ("net4", 1e-4, 2e-7, "reduced"),
        ("net4", 1e-4, 2e-7, "full"),
        ("lander_mass", 1e-4, 4e-5, "reduced"),
        pytest.param("lander_mass", 1e-4, 4e-5, "full", marks=pytest.mark.slow),
        ("redundant_triangle", 1e-4, 2e-5, "reduced"),
        pytest.param("redundant_triangle", 1e-4, 2e-5, "full", marks=pytest.mark.slow),
    ],
)
def test_certified_solution_across_slack_and_contact(
    name: str, step: float, tolerance: float, coordinates: Coordinates
) -> None:
    case = certified(name)
    assert trajectory_error(case, case.data["t"], step, coordinates).max() < tolerance


@BOTH
@pytest.mark.parametrize("name", ["dbar_regular", "net4", "lander_mass", "redundant_triangle"])
def test_certified_solution_across_located_events(name: str, coordinates: Coordinates) -> None:
    case = certified(name)
    times, nodes = case.data["t"], case.nodes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(case.scene, coordinates)
    run = simulate(
        model,
        times[-1],
        times[1],
        DormandPrince853(rtol=1e-12),
        model.state(nodes[0], case.velocities),
        correction=Projection(),
        save_every=1,
    )
    assert run.success, run.message
    assert abs(run.nodes - nodes).max() < 1e-9
