"""CVODES and IDAS: tolerances, slack and contact, controls, and what happens when they fail."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from references import solve_certified

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.stabilization import Projection, build_projection
from tenscasadi.integrators.sundials import Cvodes, Idas, Sundials
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("scheme", [Cvodes, Idas])
@pytest.mark.parametrize("name", ["double_pendulum", "cross_bar", "spin_bar", "net4"])
def test_sundials_follow_their_tolerance(
    name: str, scheme: type[Sundials], coordinates: Any
) -> None:
    coarse, fine = (solve_certified(name, scheme(rtol), coordinates)[0] for rtol in (1e-6, 1e-10))
    assert fine < 5e-6
    assert fine < coarse / 50


@pytest.mark.slow
def test_idas_meets_the_ground() -> None:
    assert solve_certified("lander_mass", Idas(1e-6))[0] < 1e-4


BALL = Scene(
    Structure([[0, 0, 0.5]], node_mass=1.0), gravity=Gravity(), ground=Ground(1e5, damping=5.0)
)
TETHERED = Scene(
    Structure(
        [[0, 0, 0], [0.4, 0, 0]],
        strings=[(0, 1)],
        node_mass=1.0,
        pinned=[0],
        stiffness=1e4,
        rest_length=0.5,
    ),
    gravity=Gravity((-9.81, 1, 0)),
)


@pytest.mark.parametrize("scheme", [Cvodes, Idas])
@pytest.mark.parametrize("scene", [BALL, TETHERED], ids=["contact", "slack"])
def test_sundials_follow_their_tolerance_across_slack_and_contact(
    scene: Scene, scheme: type[Sundials]
) -> None:
    """Events are not located: control of the error finds the kinks of the forces, shortens the step and begins anew at low order."""
    model = Model(scene)
    exact = simulate(model, 1.0, None, DormandPrince853(1e-12), compiled=False)
    assert "events" in exact.message
    errors = [
        abs(simulate(model, 1.0, 0.02, scheme(rtol)).nodes[-1] - exact.nodes[-1]).max()
        for rtol in (1e-4, 1e-11)
    ]
    assert errors[1] < 1e-8
    assert errors[1] < errors[0] / 1e3


@pytest.mark.parametrize("scheme", [Cvodes(1e-9), Idas(1e-9)])
def test_controls_work_and_corrections(scheme: Sundials) -> None:
    model = Model(
        Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=1.0), control=RestLength())
    )
    table = model.initial_control * np.array([[1.0], [1.02], [0.99]])
    fine = simulate(model, 0.3, 1e-4, control=table, compiled=False)
    for correction in (None, Projection(), Projection(every=7)):
        run = simulate(model, 0.3, 0.01, scheme, control=table, correction=correction)
        assert abs(run.nodes[-1] - fine.nodes[-1]).max() < 1e-6
        assert np.ptp(run.energy) > 1e-3
        assert abs(run.energy_error).max() < 1e-4
        if correction is not None:
            assert run.bar_length_error[:: correction.every].max() < 1e-14
    plain = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0), control=RestLength()))
    assert abs(simulate(plain, 0.3, 0.01, scheme, control=table).energy_error).max() < 1e-4


@pytest.mark.parametrize("scheme", [Cvodes(1e-6), Idas(1e-6)])
def test_corrections_do_not_restart_the_integrator_at_order_one(scheme: Sundials) -> None:
    model = Model(
        Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=5.0), gravity=Gravity())
    )
    velocities = np.random.default_rng(0).normal(size=model.structure.nodes.shape)
    start = build_projection(model)(model.state(model.structure.nodes, velocities)).full().ravel()
    exact = simulate(model, 0.5, None, DormandPrince853(1e-12), start, compiled=False)
    plain, *corrected = (
        simulate(model, 0.5, 1e-3, scheme, start, correction=c)
        for c in (None, Projection(), Projection(every=10))
    )
    for run in corrected:
        assert (
            abs(run.nodes[-1] - exact.nodes[-1]).max()
            < 2 * abs(plain.nodes[-1] - exact.nodes[-1]).max()
        )


@pytest.mark.parametrize("scheme", [Cvodes(1e-10), Idas(1e-10), Collocation(4)])
def test_the_step_function_follows_the_model(scheme: Any) -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    reference = DormandPrince853().advance(model)(model.initial_state, [], 0.05)
    assert abs(scheme.advance(model)(model.initial_state, [], 0.05) - reference).full().max() < 1e-6


@pytest.mark.parametrize("scheme", [Cvodes(1e-8), Idas(1e-8)])
@pytest.mark.parametrize("steps", [7, 60, 100])
def test_nothing_is_computed_past_the_end_of_a_run(steps: int, scheme: Sundials) -> None:
    """The force is not defined there: x(1) = ∫ (1 − t) √(1 − t) dt = 2/5."""
    ends = NodalForce(lambda t: [[np.sqrt(1.0 - t), 0.0, 0.0]])
    run = simulate(
        Model(Scene(Structure([[0, 0, 0]], node_mass=1.0), forces=ends)), 1.0, 1.0 / steps, scheme
    )
    assert run.success, run.message
    assert run.nodes[-1, 0, 0] == pytest.approx(0.4, abs=1e-6)


def test_failures_of_sundials_are_messages() -> None:
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0), gravity=Gravity()))
    start = model.state(model.structure.nodes, np.random.default_rng(0).normal(size=(6, 3)))
    for scheme in (Cvodes(1e-9, max_steps=3), Idas(1e-9, max_steps=3)):
        run = simulate(model, 1.0, 0.5, scheme, start)
        assert not run.success
        assert f"{type(scheme).__name__} failed" in run.message
        assert "try a larger rtol" in run.message
    with pytest.raises(CompileError, match="Cvodes"):
        simulate(model, 1.0, scheme=Cvodes(), compiled=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        held = Model(
            Scene(
                Structure(
                    [[0, 0, 0], [1, 0, 0], [0, 0, 1]],
                    bars=[(0, 1)],
                    node_mass=[0, 0, 1.0],
                    pinned=[0, 1],
                )
            )
        )
    with pytest.raises(ValueError, match="no free node"):
        simulate(
            Model(Scene(Structure([[0, 0, 0]], node_mass=1.0, pinned=[0]))), 0.1, scheme=Cvodes()
        )
    with pytest.raises(ValueError, match="redundant"):
        simulate(held, 0.1, scheme=Idas())


SQUARE = Structure(
    [(1, 1, 0), (0, 1, 0), (0, 0, 0), (1, 0, 0)], [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]
)
SHAKEN = Structure([(0, 0, 0), (1, 0, 0), (0.5, 0, -1)], [(0, 1), (0, 2), (1, 2)], pinned=(0, 1))
PUSH = SupportMotion({n: lambda t, n=n: (n + 0.1 * t**2, 0, 0) for n in (0, 1)})


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize(
    "scene",
    [Scene(SQUARE), Scene(SHAKEN), Scene(SHAKEN, supports=PUSH)],
    ids=["bars", "pins", "moved supports"],
)
def test_idas_refuses_redundant_constraints_by_name(scene: Scene, coordinates: Any) -> None:
    with pytest.warns(RedundantConstraints):
        model = Model(scene, coordinates)
    with pytest.raises(
        ValueError,
        match=r"Idas does not support redundant constraints: use .* Cvodes\(\): the constraints of (bars|joints) \d",
    ):
        simulate(model, 0.1, scheme=Idas())
    assert simulate(model, 0.1, scheme=Cvodes()).success


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_idas_follows_moved_supports(coordinates: Any) -> None:
    model = Model(
        Scene(
            Structure(SHAKEN.nodes, [(0, 2), (1, 2)], pinned=(0, 1)),
            gravity=Gravity(),
            supports=PUSH,
        ),
        coordinates,
    )
    exact, run = (
        simulate(model, 0.5, None, DormandPrince853(1e-11), compiled=False),
        simulate(model, 0.5, 0.01, Idas(1e-9)),
    )
    assert abs(run.nodes[-1] - exact.nodes[-1]).max() < 1e-7


def test_a_motion_that_a_loose_tolerance_breaks_asks_for_a_smaller_one() -> None:
    run = simulate(Model(Scene(shapes.pendulum(), gravity=Gravity())), 10.0, 0.2, Cvodes(0.1))
    assert not run.success
    assert "rtol is 0.1, try a smaller rtol" in run.message


def test_mistakes_are_named() -> None:
    for scheme in (Cvodes, Idas):
        for wrong in (
            {"rtol": 0.0},
            {"rtol": 1e-16},
            {"rtol": 1.0},
            {"atol": -1.0},
            {"max_steps": 0},
        ):
            with pytest.raises(ValueError, match=rf"{scheme.__name__}\.{next(iter(wrong))}"):
                scheme(**wrong)  # type: ignore[arg-type]
