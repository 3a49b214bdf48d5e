"""Implicit schemes: collocation, CVODES and IDAS: orders, tolerances, stiffness, and what happens when they fail."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from references import certified

from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.redundancy import RedundantConstraints
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.scheme import stability_limit
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.integrators.sundials import Cvodes, Idas, Sundials
from tenscasadi.scene.loads import Gravity, Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError, find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")


def error(name: str, scheme: Any, step: float | None = None, coordinates: Any = "reduced") -> float:
    """The largest error of any node at any certified time."""
    case = certified(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(case.scene, coordinates)
    times = case.data["t"]
    every = 1 if step is None else round(times[1] / step)
    run = simulate(model, times[-1], times[1] / every, scheme, model.state(case.nodes[0], case.velocities), save_every=every, compiled=False)
    assert run.success, run.message
    return float(abs(run.nodes - case.nodes).max())


# --- collocation ---


@pytest.mark.parametrize(
    ("scheme", "step"),
    [(Collocation(1), 5e-3), (Collocation(), 0.01), (Collocation(3), 0.02), (Collocation(2, "radau"), 5e-3), (Collocation(3, "radau"), 0.01)],
)
def test_order_of_collocation(scheme: Collocation, step: float) -> None:
    for name in ("prism_n1", "spin_bar"):
        assert np.log2(error(name, scheme, step) / error(name, scheme, step / 2)) == pytest.approx(scheme.order, abs=0.25)


def test_coefficients_are_those_of_the_books() -> None:
    root = np.sqrt(3)
    A, b = Collocation().coefficients
    assert pytest.approx(np.array([[1 / 4, 1 / 4 - root / 6], [1 / 4 + root / 6, 1 / 4]])) == A
    assert pytest.approx([1 / 2, 1 / 2]) == b
    A, b = Collocation(2, "radau").coefficients
    assert pytest.approx(np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])) == A
    assert pytest.approx([3 / 4, 1 / 4]) == b


def test_no_step_is_too_large_for_stability() -> None:
    directions = np.exp(1j * np.linspace(np.pi / 2, np.pi, 5))
    model = Model(Scene(shapes.prism(stiffness=1e7, prestress=30.0)))
    for scheme in (Collocation(), Collocation(3, "radau"), Cvodes(), Idas()):
        assert np.isinf(stability_limit(scheme, directions)).all()
        assert stable_step(model, scheme=scheme) == np.inf
    z = np.array([-1e6, 1e6j])
    assert abs(Collocation().amplification(z)) == pytest.approx(np.ones(2), abs=1e-4)
    assert abs(Collocation(2, "radau").amplification(z)).max() < 1e-5
    assert Collocation().amplification(np.array([0.1j]))[0] == pytest.approx(np.exp(0.1j), abs=1e-7)


@needs_compiler
def test_compiled_collocation_gives_the_same_numbers() -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    machine, virtual = (simulate(model, 1.0, 0.02, Collocation(), compiled=compiled) for compiled in (True, False))
    assert (machine.compiled, virtual.compiled) == (True, False)
    assert abs(machine.states - virtual.states).max() < 1e-10


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_a_step_that_newton_cannot_solve_ends_the_run(compiled: bool) -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    run = simulate(model, 30.0, 3.0, Collocation(iterations=2), compiled=compiled)
    assert not run.success
    assert "not finite" in run.message
    assert np.isfinite(run.states).all()


# --- SUNDIALS ---


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("scheme", [Cvodes, Idas])
@pytest.mark.parametrize("name", ["double_pendulum", "cross_bar", "spin_bar", "net4"])
def test_sundials_follow_their_tolerance(name: str, scheme: type[Sundials], coordinates: Any) -> None:
    coarse, fine = (error(name, scheme(rtol), coordinates=coordinates) for rtol in (1e-6, 1e-10))
    assert fine < 5e-6
    assert fine < coarse / 50


def test_idas_meets_the_ground() -> None:
    assert error("lander_mass", Idas(1e-6)) < 1e-4


BALL = Scene(Structure([[0, 0, 0.5]], node_mass=1.0), gravity=Gravity(), ground=Ground(1e5, damping=5.0))
TETHERED = Scene(
    Structure([[0, 0, 0], [0.4, 0, 0]], strings=[(0, 1)], node_mass=1.0, pinned=[0], stiffness=1e4, rest_length=0.5), gravity=Gravity((-9.81, 1, 0))
)


@pytest.mark.parametrize("scheme", [Cvodes, Idas])
@pytest.mark.parametrize("scene", [BALL, TETHERED], ids=["contact", "slack"])
def test_sundials_follow_their_tolerance_across_slack_and_contact(scene: Scene, scheme: type[Sundials]) -> None:
    """Events are not located: control of the error finds the kinks of the forces, shortens the step and begins anew at low order."""
    model = Model(scene)
    exact = simulate(model, 1.0, None, DormandPrince853(1e-12), compiled=False)
    assert "events" in exact.message
    errors = [abs(simulate(model, 1.0, 0.02, scheme(rtol)).nodes[-1] - exact.nodes[-1]).max() for rtol in (1e-4, 1e-11)]
    assert errors[1] < 1e-8
    assert errors[1] < errors[0] / 1e3


@pytest.mark.parametrize("scheme", [Cvodes(1e-9), Idas(1e-9)])
def test_controls_work_and_corrections(scheme: Sundials) -> None:
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=1.0), control=RestLength()))
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


@pytest.mark.parametrize("scheme", [Cvodes(1e-10), Idas(1e-10), Collocation(4)])
def test_the_step_function_follows_the_model(scheme: Any) -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    reference = DormandPrince853().advance(model)(model.initial_state, [], 0.05)
    assert abs(scheme.advance(model)(model.initial_state, [], 0.05) - reference).full().max() < 1e-6


def test_failures_of_sundials_are_messages() -> None:
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0), gravity=Gravity()))
    start = model.state(model.structure.nodes, np.random.default_rng(0).normal(size=(6, 3)))
    for scheme in (Cvodes(1e-9, max_steps=3), Idas(1e-9, max_steps=3)):
        run = simulate(model, 1.0, 0.5, scheme, start)
        assert not run.success
        assert f"{type(scheme).__name__} gave up" in run.message
        assert "try a larger rtol" in run.message
    with pytest.raises(CompileError, match="Cvodes"):
        simulate(model, 1.0, scheme=Cvodes(), compiled=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        held = Model(Scene(Structure([[0, 0, 0], [1, 0, 0], [0, 0, 1]], bars=[(0, 1)], node_mass=[0, 0, 1.0], pinned=[0, 1])))
    with pytest.raises(ValueError, match="no free node"):
        simulate(Model(Scene(Structure([[0, 0, 0]], node_mass=1.0, pinned=[0]))), 0.1, scheme=Cvodes())
    with pytest.raises(ValueError, match="redundant"):
        simulate(held, 0.1, scheme=Idas())


def test_a_motion_that_a_loose_tolerance_breaks_asks_for_a_smaller_one() -> None:
    run = simulate(Model(Scene(shapes.pendulum(), gravity=Gravity())), 10.0, 0.2, Cvodes(0.1))
    assert not run.success
    assert "rtol is 0.1, try a smaller rtol" in run.message


def test_mistakes_are_named() -> None:
    for options in ({"degree": 0}, {"degree": 10}, {"points": "lobatto"}, {"tolerance": 0.0}, {"iterations": 0}):
        with pytest.raises(ValueError, match=rf"Collocation\.{next(iter(options))}"):
            Collocation(**options)  # type: ignore[arg-type]
    for scheme in (Cvodes, Idas):
        for wrong in ({"rtol": 0.0}, {"rtol": 1e-16}, {"rtol": 1.0}, {"atol": -1.0}, {"max_steps": 0}):
            with pytest.raises(ValueError, match=rf"{scheme.__name__}\.{next(iter(wrong))}"):
                scheme(**wrong)  # type: ignore[arg-type]
