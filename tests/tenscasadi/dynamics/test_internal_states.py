"""States besides positions and velocities: layout, rates, energy, derivatives, steps."""

from __future__ import annotations

from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest
from comparison import BOTH

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince853, RungeKutta4
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.control import Control
from tenscasadi.scene.internal_states import InternalStates
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Linear
from tenscasadi.simulation.rollouts import rollouts
from tenscasadi.simulation.sensitivities import sensitivities
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.util.validate import Array


class Creep(Control):
    """Rest lengths that creep under tension and move by inputs; a flywheel turns with them."""

    name: ClassVar[str] = "pull"
    quantity: ClassVar[str] = "pulls"
    unit: ClassVar[str] = "m/s"
    sets_rest_lengths: ClassVar[bool] = True

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        return np.zeros(len(rest))

    def internal_states(self, rest: Array) -> tuple[InternalStates, ...]:
        return (
            InternalStates("rest length", "m", rest, rest),
            InternalStates("angle rate", "rad/s", np.ones(len(rest)), np.zeros(len(rest))),
        )

    def command(self, u: Any, internal: Any) -> Any:
        return internal[: u.shape[0]]

    def internal_rates(self, u: Any, internal: Any, tension: Any) -> Any:
        turn = internal[u.shape[0] :]
        return ca.vertcat(u + 0.01 * tension, 0.3 * tension - turn)

    def kinetic_energy(self, internal: Any) -> Any:
        turn = internal[internal.shape[0] // 2 :]
        return ca.sumsqr(turn) / 2


def scene(**changes: Any) -> Scene:
    fields = {"control": Creep(), "slack": Linear(), "gravity": Gravity()} | changes
    return Scene(shapes.prism(prestress=20.0, damping=1.0), **fields)


@BOTH
@pytest.mark.parametrize("clock", [False, True])
def test_parts_of_a_state_are_in_declared_order(
    clock: bool, coordinates: mechanism.Coordinates
) -> None:
    loads = {"forces": NodalForce(lambda t: np.zeros((6, 3)))} if clock else {}
    model = Model(scene(**loads), coordinates)
    assert model.na == 18
    assert model.nx == 2 * model.nq + 18 + clock
    parts = model.split(np.arange(float(model.nx)))
    assert [len(part) for part in parts] == [model.nq, model.nq, 18, int(clock)]
    assert np.array_equal(np.concatenate(parts), np.arange(float(model.nx)))
    initial = model.split(model.initial_state).internal
    assert np.array_equal(initial[:9], model.structure.rest_length)
    assert not initial[9:].any()
    given = model.state(model.structure.nodes, internal=np.arange(18.0))
    assert np.array_equal(model.split(given).internal, np.arange(18.0))
    with pytest.raises(ValueError, match="internal has shape"):
        model.state(model.structure.nodes, internal=np.zeros(17))


@BOTH
def test_rates_follow_the_declared_expressions(coordinates: mechanism.Coordinates) -> None:
    model = Model(scene(), coordinates)
    x, u = np.array(model.initial_state), np.linspace(-0.1, 0.1, 9)
    model.split(x).internal[:] += np.linspace(0.01, 0.2, 18)
    rates = model.split(model.ode(x, u).full().ravel())
    tension = model.tension(x, u)
    expected = [u + 0.01 * tension, 0.3 * tension - model.split(x).internal[9:]]
    assert np.allclose(rates.internal, np.concatenate(expected), rtol=0, atol=1e-8)
    shorter = model.structure.string_lengths - model.split(x).internal[:9]
    assert np.allclose(tension, model.structure.stiffness * shorter, rtol=0, atol=1e-6)


@BOTH
def test_linearization_has_finite_differences_of_the_rates(
    coordinates: mechanism.Coordinates,
) -> None:
    model = Model(scene(), coordinates)
    x, u = np.array(model.initial_state), np.linspace(-0.1, 0.1, 9)
    x += 1e-3 * np.random.default_rng(0).normal(size=model.nx)
    J = EquationDerivatives.of(model).at(x[None], u[None]).jacobian(0)
    z = np.concatenate([x, u])
    for k in range(len(z)):
        change = 1e-6 * np.eye(len(z))[k]
        ends = [model.ode(*np.split(z + sign * change, [model.nx])).full() for sign in (1, -1)]
        column = (ends[0] - ends[1]).ravel() / 2e-6
        assert np.allclose(J[:, k], column, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "scheme",
    [RungeKutta4(), Rattle(4), Collocation(1), Cvodes(), Idas()],
    ids=lambda scheme: type(scheme).__name__,
)
def test_schemes_agree_and_account_for_the_energy(scheme: Any) -> None:
    model = Model(scene())
    control = np.linspace(-0.1, 0.1, 9)
    reference = simulate(model, 0.2, 1e-3, DormandPrince853(1e-10), control=control, compiled=False)
    run = simulate(model, 0.2, 2e-3, scheme, control=control, compiled=False)
    assert run.success
    assert np.allclose(run.states[-1], reference.states[-1], rtol=0, atol=3e-4)
    assert np.abs(run.energy_error).max() < 1e-4
    assert np.ptp(run.energy) > 0.1


@pytest.mark.parametrize("order", [2, 4])
def test_rattle_keeps_its_order(order: int) -> None:
    model, control = Model(scene()), np.linspace(-0.1, 0.1, 9)
    exact = simulate(model, 0.2, 0.01, DormandPrince853(1e-12), control=control, compiled=False)
    errors = [
        np.abs(
            simulate(model, 0.2, h, Rattle(order), control=control, compiled=False).states[-1]
            - exact.states[-1]
        ).max()
        for h in (0.004, 0.002)
    ]
    assert order - 0.4 < np.log2(errors[0] / errors[1]) < order + 0.8


def test_projection_keeps_internal_states() -> None:
    from tenscasadi.integrators.stabilization import build_projection

    model = Model(scene())
    x = model.initial_state + 1e-3 * np.random.default_rng(1).normal(size=model.nx)
    found = build_projection(model)(x).full().ravel()
    assert np.array_equal(model.split(found).internal, model.split(x).internal)


def test_rollouts_equal_single_runs() -> None:
    model = Model(scene())
    controls = np.random.default_rng(2).uniform(-0.1, 0.1, (3, 9))
    many = rollouts(model, 0.05, 1e-3, controls=controls)
    for k, control in enumerate(controls):
        one = simulate(model, 0.05, 1e-3, control=control)
        assert np.allclose(many.final[k], one.states[-1], rtol=0, atol=1e-13)


def test_work_of_a_scheduled_control_is_counted() -> None:
    model = Model(scene())
    run = simulate(model, 0.2, 1e-3, control=lambda t: 0.1 * np.cos(t) * np.ones(9), compiled=False)
    assert run.success
    assert np.abs(run.energy_error).max() < 1e-6


def test_sensitivities_have_finite_differences_of_runs() -> None:
    model = Model(scene())
    control = np.linspace(-0.1, 0.1, 9)
    found = sensitivities(model, None, 0.05, 1e-3, by="control", control=control, compiled=False)
    ends = [
        simulate(model, 0.05, 1e-3, control=control + sign * 1e-5 * np.eye(9)[4], compiled=False)
        for sign in (1, -1)
    ]
    column = (ends[0].states[-1] - ends[1].states[-1]) / 2e-5
    assert np.allclose(found.jacobian[:, 0, 4], column, rtol=1e-5, atol=1e-7)
