"""Forces between steps: steps end at the times of tables and at the jumps of functions of time, so that no pulse is missed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tenscasadi.analysis.certify import certify
from tenscasadi.analysis.recommend import recommend
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure

SPRING = Structure([(0, 0, 0), (1.5, 0, 0)], [], [(0, 1)], stiffness=10.0, node_mass=[1, 1], pinned=(0,), rest_length=1.5)
FREQUENCY = np.sqrt(10.0)  # 1/s
SHORT = 2e-4  # s
TABLE = NodalForce([[[0, 0, 0], [force, 0, 0]] for force in (0, 5000, 0)], times=[0.5 - SHORT / 2, 0.5, 0.5 + SHORT / 2])
SWITCH = NodalForce(lambda t: [[0, 0, 0], [2500 * (t > 0.5 - SHORT / 2) * (t <= 0.5 + SHORT / 2), 0, 0]])
BUMP = NodalForce(
    lambda t: [[0, 0, 0], [0.5 / (1e-5 * np.sqrt(np.pi)) * ca.exp(-(((t - 0.5) / 1e-5) ** 2)), 0, 0]],
    breaks=0.5 + 5e-6 * np.arange(-14, 15),
)
SCHEMES = [RungeKutta4(), Rattle(order=4), DormandPrince54(), DormandPrince853(1e-9), Collocation(3, "radau"), Cvodes(1e-9), Idas(1e-9)]


def after(time: float) -> float:
    """Where an impulse of 0.5 N·s at t = 0.5 s puts the mass, m."""
    return 1.5 + 0.5 / FREQUENCY * np.sin(FREQUENCY * (time - 0.5))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("pulse", [TABLE, SWITCH, BUMP], ids=["table", "switch", "breaks"])
def test_no_scheme_misses_a_pulse(pulse: NodalForce, scheme: Any) -> None:
    run = simulate(Model(Scene(SPRING, forces=pulse)), 1.0, 0.01, scheme, compiled=False)
    assert run.success, run.message
    assert run.nodes[-1, 1, 0] == pytest.approx(after(1.0), abs=2e-6)
    assert run.time[-1] == 1.0
    assert abs(run.energy_error).max() < 1e-2


@pytest.mark.parametrize("pulse", [TABLE, SWITCH, BUMP], ids=["table", "switch", "breaks"])
def test_certified_ends_know_of_pulses(pulse: NodalForce) -> None:
    found = certify(Model(Scene(SPRING, forces=pulse)), 1.0, compiled=False)
    assert found.error < 1e-7
    assert found.nodes[1, 0] == pytest.approx(after(1.0), abs=1e-8)


def test_recommended_ways_know_of_pulses() -> None:
    model = Model(Scene(SPRING, forces=TABLE))
    advice = recommend(model, 1.0, 1e-4, schemes=[RungeKutta4(), DormandPrince54()], compiled=False)
    assert simulate(model, 1.0, **advice.options, compiled=False).nodes[-1, 1, 0] == pytest.approx(after(1.0), abs=1e-4)


def test_times_of_tables_are_those_of_the_clock() -> None:
    model = Model(Scene(SPRING, forces=TABLE))
    late = model.initial_state
    late[-1] = 0.2
    run = simulate(model, 0.8, 0.01, state=late, compiled=False, save_every=1)
    assert run.nodes[-1, 1, 0] == pytest.approx(after(1.0), abs=1e-8)
    assert abs(run.time[:, None] - (TABLE.times - 0.2)).min(axis=0).max() < 1e-15


def test_tables_on_the_grid_leave_steps_equal() -> None:
    table = NodalForce([[[0, 0, 0], [force, 0, 0]] for force in (0, 1, 0, 2)], times=[0.0, 0.1, 0.2, 7.0])
    run = simulate(Model(Scene(SPRING, forces=table)), 0.5, 0.01, compiled=False)
    assert np.array_equal(run.time, np.append(np.arange(50) * (0.5 / 50), 0.5))


def test_breaks_belong_to_functions() -> None:
    with pytest.raises(ValueError, match=r"NodalForce\.breaks is .*function of time alone"):
        replace(TABLE, breaks=[0.5])
    with pytest.raises(TypeError, match=r"NodalForce\.breaks"):
        replace(SWITCH, breaks="soon")
