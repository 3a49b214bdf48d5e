"""Collocation: orders, coefficients, steps by Newton's method and by sweeps, slack and contact, and failure."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from references import certified, solve_certified

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import stability_limit
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, Linear, Smooth
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
PRISM = shapes.prism(stiffness=1000.0, prestress=30.0, damping=5.0)
SQUARE = Structure(
    [(0.5, 0.5, 0), (-0.5, 0.5, 0), (-0.5, -0.5, 0), (0.5, -0.5, 0)],
    [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)],
)
SUPPORTS = SupportMotion({0: lambda t: (0.1 * t**2, 0.05 * t, 0.0)})

SCENES = {
    "damped strings": Scene(PRISM, gravity=Gravity()),
    "slack strings": Scene(PRISM.replace(rest_length=1.05 * PRISM.rest_length)),
    "smooth slack": Scene(PRISM, slack=Smooth(1e-3)),
    "contact": Scene(
        PRISM,
        gravity=Gravity(),
        ground=Ground(1e4, 50.0, friction=0.5, height=float(PRISM.nodes[:, 2].min()) + 1e-3),
    ),
    "joints": Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))),
    "force densities": Scene(shapes.d_bar(pinned=(0,), prestress=10.0), control=ForceDensity()),
    "moved support": Scene(shapes.pendulum(), gravity=Gravity((0, -9.81, 0)), supports=SUPPORTS),
    "redundant bars": Scene(SQUARE),
}


@pytest.mark.parametrize(
    ("scheme", "step"),
    [
        pytest.param(Collocation(1), 5e-3, marks=pytest.mark.slow),
        (Collocation(), 0.02),
        (Collocation(3), 0.02),
        (Collocation(2, "radau"), 0.01),
        pytest.param(Collocation(3, "radau"), 0.02, marks=pytest.mark.slow),
    ],
)
def test_order_of_collocation(scheme: Collocation, step: float) -> None:
    for name in ("prism_n1", "spin_bar"):
        every = round(certified(name).data["t"][1] / step)
        errors = [solve_certified(name, scheme, every=k * every)[0] for k in (1, 2)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(scheme.order, abs=0.25)


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
    machine, virtual = (
        simulate(model, 1.0, 0.02, Collocation(), compiled=compiled) for compiled in (True, False)
    )
    assert (machine.compiled, virtual.compiled) == (True, False)
    assert abs(machine.states - virtual.states).max() < 1e-10


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_a_step_that_newton_cannot_solve_ends_the_run(compiled: bool) -> None:
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    run = simulate(model, 30.0, 3.0, Collocation(iterations=2), compiled=compiled)
    assert not run.success
    assert "not finite" in run.message
    assert np.isfinite(run.states).all()


def test_mistakes_are_named() -> None:
    for options in (
        {"degree": 0},
        {"degree": 10},
        {"points": "lobatto"},
        {"tolerance": 0.0},
        {"iterations": 0},
    ):
        with pytest.raises(ValueError, match=rf"Collocation\.{next(iter(options))}"):
            Collocation(**options)  # type: ignore[arg-type]


# --- triangular iteration ---


def moving(model: Model, speed: float = 0.3) -> Any:
    velocities = (
        speed
        * np.random.default_rng(0).normal(size=model.structure.nodes.shape)
        * ~model.structure.fixed
    )
    return build_projection(model)(model.state(model.structure.nodes, velocities)).full().ravel()


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("name", SCENES)
def test_the_same_step_as_by_newton(name: str, coordinates: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(SCENES[name], coordinates)
    nodes = model.structure.nodes
    start = (
        model.state(nodes, np.cross([0, 0, 1.0], nodes))
        if name == "redundant bars"
        else moving(model)
    )
    u = model.initial_control
    for scheme in (Collocation(2, tolerance=1e-12), Collocation(3, "radau", tolerance=1e-12)):
        expected = scheme.step(model.ode)(start, u, 4e-3).full().ravel()
        assert abs(expected - start).max() > 1e-4
        assert abs(scheme.advance(model)(start, u, 4e-3).full().ravel() - expected).max() < 1e-9


ROUGH = Ground(1e4, 50.0, friction=0.5, height=float(PRISM.nodes[:, 2].min()) + 1e-3)
BALL = Structure([[0, 0, 0]], node_mass=1.0)


@pytest.mark.parametrize("scheme", [Collocation(), Collocation(3, "radau")])
@pytest.mark.parametrize(
    ("scene", "velocity"),
    [
        (Scene(BALL, gravity=Gravity(), ground=Ground(1e5, 100.0, friction=0.5)), (0.3, 0.1, 0)),
        (Scene(BALL, gravity=Gravity(), ground=Ground(1e5, 100.0, friction=1.0)), (0.3, 0.1, 0)),
        (Scene(PRISM, gravity=Gravity(), ground=ROUGH), (0, 0, 0)),
        (Scene(PRISM, gravity=Gravity(), ground=ROUGH, slack=Smooth(1e-3)), (0, 0, 0)),
    ],
    ids=["stops", "stops at once", "slides", "slides, smooth strings"],
)
def test_what_slides_comes_to_rest_within_a_step(
    scene: Scene, velocity: tuple[float, ...], scheme: Collocation
) -> None:
    """Friction is all but constant while a node slides: a tangent to it leads past rest and back for ever."""
    model = Model(scene)
    nodes = scene.structure.nodes
    start = model.state(nodes, np.tile(velocity, (len(nodes), 1)))
    exact = simulate(model, 0.1, None, DormandPrince853(1e-8), start, compiled=False).nodes[-1]
    run = simulate(model, 0.1, 0.01, scheme, start, compiled=False)
    assert run.success, run.message
    assert abs(run.nodes[-1] - exact).max() < 5e-5


@pytest.mark.parametrize(
    ("structure", "scheme"),
    [
        pytest.param(PRISM, Collocation(2, "radau"), marks=pytest.mark.slow),
        (Structure([(0, 0, 0), (0.5, 0, 0.3)], [(0, 1)]), Collocation()),
    ],
)
def test_impacts_with_friction(structure: Structure, scheme: Collocation) -> None:
    """In a step through an impact, sliding, sticking and bouncing change in turns from iteration to iteration: it is taken in halves."""
    low = float(structure.nodes[:, 2].min())
    model = Model(
        Scene(
            structure, gravity=Gravity(), ground=Ground(1e5, 100.0, friction=0.5, height=low - 0.05)
        )
    )
    arms = structure.nodes - structure.nodes.mean(axis=0)
    start = build_projection(model)(
        model.state(structure.nodes, (1.0, 0.5, -1.0) + np.cross((0, 2.0, 1.0), arms))
    )
    exact = simulate(model, 0.4, None, DormandPrince853(1e-8), start).nodes[-1]
    coarse, fine = (simulate(model, 0.4, step, scheme, start) for step in (0.01, 5e-4))
    assert coarse.time[-1] == pytest.approx(0.4)
    assert abs(coarse.nodes[-1] - exact).max() < 2 * coarse.error_estimate
    assert abs(fine.nodes[-1] - exact).max() < 2e-3


def test_a_step_that_is_not_found_is_taken_in_halves_where_modes_may_change() -> None:
    """Smooth motions give no finite state there, as documented."""
    bar = Structure([(-0.5, 0, 0), (0.5, 0, 0)], [(0, 1)])
    free, above = (Model(Scene(bar, ground=ground)) for ground in (None, Ground(height=-10.0)))
    start, step = (
        free.state(bar.nodes, [(0, -10.0, 0), (0, 10.0, 0)]),
        Collocation(2).advance(above),
    )
    assert np.isnan(Collocation(2).advance(free)(start, [], 0.5).full()).all()
    whole = step(start, [], 0.5).full()
    assert np.isfinite(whole).all()
    assert (whole == step(step(start, [], 0.25), [], 0.25).full()).all()


@needs_compiler
def test_one_compiled_loop_serves_all_tolerances(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path))
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=31.0), gravity=Gravity()))
    start = moving(model)
    runs = [
        simulate(model, 0.1, 0.01, Collocation(2, tolerance=tolerance), start, compiled=True)
        for tolerance in (1e-3, 1e-6, 1e-10)
    ]
    assert len(list(tmp_path.glob("model-*"))) == 1
    coarse, fine, _ = (abs(run.states[-1] - runs[-1].states[-1]).max() for run in runs)
    assert 0 < fine < coarse < 1e-3


def test_work_is_collocated_too() -> None:
    model = Model(SCENES["damped strings"])
    start = moving(model)
    losses = [
        abs(simulate(model, 0.2, h, Collocation(2), start, compiled=False).energy_error).max()
        for h in (4e-3, 2e-3)
    ]
    assert losses[0] / losses[1] > 12


def stiff_prism(damping: float) -> tuple[Model, Any]:
    structure = shapes.prism(stiffness=1e7, prestress=30.0, damping=damping, string_mass=0.1)
    model = Model(Scene(structure, segments=5, gravity=Gravity()))
    nodes = model.structure.nodes
    return model, model.state(nodes, np.cross([0.5, 0.3, 1.0], nodes - nodes.mean(axis=0)))


@needs_compiler
@pytest.mark.parametrize("damping", [0.0, pytest.param(1e3, marks=pytest.mark.slow)])
def test_stiff_strings_at_the_pace_of_the_visible_motion(damping: float) -> None:
    """k = 1e7 N/m, five segments: to 1e-6 m in ten steps of 16 sweeps, where explicit schemes need thousands; damped or not."""
    model, start = stiff_prism(damping)
    exact = simulate(
        model, 0.1, stable_step(model, start), state=start, energy_balance=False
    ).nodes[-1]
    run = simulate(
        model,
        0.1,
        0.01,
        Collocation(2, tolerance=1e-8, iterations=16),
        start,
        compiled=False,
        energy_balance=False,
    )
    assert run.success, run.message
    assert abs(run.nodes[-1] - exact).max() < 1e-6
    evaluations = 10 * 16 * 2
    assert evaluations < 0.03 * 4 * 0.1 / stable_step(
        model, start, scheme=RungeKutta4(), safety=1.0
    )


def test_strings_that_let_go_and_catch_at_large_steps() -> None:
    ball = shapes.six_bar_ball(stiffness=1e6, damping=10.0, prestress=50.0)
    model = Model(Scene(ball, gravity=Gravity()))
    start = moving(model)
    after = Collocation(2, "radau").advance(model)(start, [], 0.02).full().ravel()
    assert np.isfinite(after).all()
    residual = (
        after
        - Collocation(2, "radau", tolerance=1e-12, iterations=200)
        .advance(model)(start, [], 0.02)
        .full()
        .ravel()
    )
    assert abs(residual).max() < 1e-6


def test_grounds_where_no_string_can_go_slack() -> None:
    structure = Structure(
        [(0, 0, 0.1), (0, 0, 1)], strings=[(0, 1)], node_mass=1.0, stiffness=100.0, rest_length=0.8
    )
    model = Model(Scene(structure, gravity=Gravity(), ground=Ground(1e3, 5.0), slack=Linear()))
    run = simulate(model, 0.5, 2e-4, Collocation(2, "radau"), compiled=False)
    assert run.success
    truth = simulate(model, 0.5, scheme=DormandPrince853(1e-10), compiled=False)
    assert abs(run.nodes[-1] - truth.nodes[-1]).max() < 1e-4
