"""Rattle: constraints to rounding, energy for ever, its orders, and what it refuses."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from references import certified

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.scheme import stability_limit
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.stabilization import Projection, build_projection
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])


def moving(model: Model, speed: float = 0.1) -> np.ndarray:
    velocities = (
        speed
        * np.random.default_rng(3).normal(size=model.structure.nodes.shape)
        * ~model.structure.fixed
    )
    return build_projection(model)(model.state(model.structure.nodes, velocities)).full().ravel()


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize(
    ("name", "step", "coordinates"),
    [
        ("double_pendulum", 0.02, "reduced"),
        ("double_pendulum", 0.02, "full"),  # the others have no joints
        ("prism_n1", 0.01, "reduced"),
        ("cross_bar", 0.02, "reduced"),
        ("spin_bar", 0.02, "reduced"),
    ],
)
def test_orders_and_constraints_on_certified_scenes(
    name: str, step: float, order: int, coordinates: Any
) -> None:
    case = certified(name)
    model, times = Model(case.scene, coordinates), case.data["t"]
    errors = []
    for h in (step, step / 2):
        per_row = round((times[1] - times[0]) / h)
        run = simulate(
            model,
            times[-1],
            h,
            Rattle(order),
            model.state(case.nodes[0], case.velocities),
            save_every=per_row,
            compiled=False,
        )
        assert run.success
        assert run.bar_length_error.max() < 1e-14
        assert run.joint_error.max() < 1e-14
        errors.append(abs(run.nodes - case.nodes).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


@pytest.mark.slow
@needs_compiler
def test_a_million_steps_of_the_prism_without_a_trend() -> None:
    case = certified("prism_n1")
    model = Model(case.scene)
    run = simulate(
        model, 1000.0, 1e-3, Rattle(), model.state(case.nodes[0], case.velocities), save_every=97
    )
    error = run.energy_error / run.energy[0]
    assert run.bar_length_error.max() <= 1e-13
    tenths = np.array([part.mean() for part in np.array_split(error, 10)])
    assert abs(error).max() < 5e-5
    assert np.ptp(tenths) < 0.02 * tenths.mean()  # a band, and the band stays where it is
    assert abs(np.polyfit(run.time / run.time[-1], error, 1)[0]) < 1e-6


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize(
    "shape",
    [shapes.prism(stiffness=1000.0, prestress=30.0), shapes.d_bar(pinned=(0,), prestress=10.0)],
)
def test_reversible_and_momenta_kept(shape: Structure, order: int) -> None:
    model = Model(Scene(shape))
    step, start = Rattle(order).advance(model), moving(model)
    there = step(start, [], 0.01)
    assert abs(there - start).full().max() > 1e-4
    assert abs(step(there, [], -0.01).full().ravel() - start).max() < 1e-12
    if not shape.pinned:
        masses = shape.mass_matrix().toarray()

        def momenta(x: Any) -> Any:
            N, V = model.nodes(np.array(x).ravel()), model.velocities(np.array(x).ravel())
            return np.concatenate([(masses @ V).sum(axis=0), np.cross(N, masses @ V).sum(axis=0)])

        assert momenta(there) == pytest.approx(momenta(start), abs=1e-14)


@pytest.mark.parametrize("order", [2, 4])
def test_damping_and_its_work_keep_the_order(order: int) -> None:
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=20.0)))
    start = moving(model)
    reference = simulate(model, 0.5, 2e-4, DormandPrince853(), start, compiled=False)
    errors, losses = [], []
    for step in (4e-3, 2e-3):
        run = simulate(model, 0.5, step, Rattle(order), start, compiled=False)
        assert run.tension.min() > 1
        assert run.energy[-1] < run.energy[0] - 1e-3
        errors.append(abs(run.nodes[-1] - reference.nodes[-1]).max())
        losses.append(abs(run.energy_error).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.3
    assert np.log2(losses[0] / losses[1]) > order - 0.3
    assert errors[-1] < {2: 2e-6, 4: 5e-10}[order]


@pytest.mark.parametrize("control", [ForceDensity(), RestLength()])
def test_the_work_of_a_control_is_no_error(control: Any) -> None:
    model = Model(
        Scene(shapes.prism(stiffness=1000.0, prestress=30.0), control=control, gravity=Gravity())
    )
    u = model.initial_control * np.array([[1.0], [1.02], [0.99]])
    losses = [
        abs(simulate(model, 0.3, h, Rattle(4), moving(model), u, compiled=False).energy_error).max()
        for h in (4e-3, 2e-3)
    ]
    assert losses[1] < 1e-5
    assert losses[1] < 1e-12 or losses[0] / losses[1] > 12


@needs_compiler
def test_compiled_and_not_give_the_same_numbers() -> None:
    ground = Ground(stiffness=1e3, damping=10.0, friction=0.3, height=-1.2, normal=(0, 1, 0))
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0)), ground=ground))
    machine, virtual = (
        simulate(model, 1.0, 1e-3, Rattle(4), compiled=compiled) for compiled in (True, False)
    )
    assert (machine.compiled, virtual.compiled) == (True, False)
    assert abs(machine.states - virtual.states).max() < 1e-11
    assert machine.bar_length_error.max() < 1e-14


def test_large_structures_step_alike() -> None:
    small = shapes.prism(stiffness=1000.0, prestress=30.0)
    copies = 30
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
    assert large.mechanism.large
    model = Model(Scene(small))
    start = moving(model)
    together = large.state(nodes, np.tile(model.velocities(start), (copies, 1)))
    after = Rattle().advance(large)(together, [], 1e-2).full().ravel()
    expected = Rattle().advance(model)(start, [], 1e-2).full().ravel()
    assert large.velocities(after)[:6] == pytest.approx(model.velocities(expected), abs=1e-12)
    assert large.nodes(after)[:6] == pytest.approx(model.nodes(expected), abs=1e-12)


def test_stability() -> None:
    assert stability_limit(Rattle(), np.array([1j, -1.0 + 0j])) == pytest.approx([2, 2], abs=1e-6)
    spring = Structure(
        [[0, 0, 0], [2.0, 0, 0]],
        strings=[(0, 1)],
        node_mass=3.0,
        pinned=[0],
        stiffness=50.0,
        rest_length=1.0,
    )
    model = Model(Scene(spring, gravity=Gravity((100.0, 0, 0))))
    start = model.state([[0, 0, 0], [7.0 + 1e-3, 0, 0]])
    for order in (2, 4):
        limit = stable_step(model, start, scheme=Rattle(order), safety=1.0)
        runs = [
            simulate(model, 500 * limit, factor * limit, Rattle(order), start, compiled=False)
            for factor in (0.97, 1.03)
        ]
        amplitudes = [abs(run.nodes[-50:, 1, 0] - 7).max() for run in runs]
        assert amplitudes[0] < 1e-2
        assert amplitudes[1] > 1e-2


def test_amplification_is_that_of_the_step() -> None:
    damped = Structure(
        [[0, 0, 0], [2.0, 0, 0]],
        strings=[(0, 1)],
        node_mass=1.0,
        pinned={0: "xyz", 1: "yz"},
        stiffness=50.0,
        rest_length=1.0,
        damping=3.0,
    )
    model = Model(Scene(damped, gravity=Gravity((500.0, 0, 0))))
    x, h = np.array([11.0, 0.0]), 0.2
    X = ca.MX.sym("x", 2)
    for order in (2, 4):
        jacobian = ca.Function("j", [X], [ca.jacobian(Rattle(order).advance(model)(X, [], h), X)])(
            x
        ).full()
        root = np.roots([1.0, 3.0, 50.0])[0]
        assert Rattle(order).amplification(np.array([h * root]))[0].real == pytest.approx(
            abs(np.linalg.eigvals(jacobian)).max(), rel=1e-9
        )


def test_mistakes_are_named() -> None:
    for wrong in (3, 0, True, "four", None):
        with pytest.raises(ValueError, match=r"Rattle\.order"):
            Rattle(wrong)  # type: ignore[arg-type]
    with pytest.raises((TypeError, ValueError), match=r"Rattle\.iterations"):
        Rattle(iterations=0)
    with pytest.raises(TypeError, match=r"advance\(model\)"):
        Rattle().step(Model(Scene(shapes.prism())).ode)


def test_a_bar_that_turns_too_far_in_a_step_fails_with_a_reason() -> None:
    model = Model(Scene(Structure([[-0.5, 0, 0], [0.5, 0, 0]], bars=[(0, 1)])))
    run = simulate(
        model,
        1.0,
        0.1,
        Rattle(),
        model.state(model.structure.nodes, [[0, -15.0, 0], [0, 15.0, 0]]),
        compiled=False,
    )
    assert not run.success
    assert "not finite" in run.message


@cache
def shake_pendulum(coordinates: Any) -> tuple[Model, Trajectory]:
    """A pendulum on a moving support, and its motion in fine steps."""
    shaken = SupportMotion(
        {0: lambda t: (0.1 * np.sin(3 * t), 0.05 * np.cos(5 * t) - 0.05, 0.03 * t**2)}
    )
    model = Model(
        Scene(shapes.double_pendulum(), supports=shaken, gravity=Gravity((0, -9.81, 0))),
        coordinates,
    )
    return model, simulate(model, 1.0, 1e-3, DormandPrince853(), compiled=False)


@BOTH
@pytest.mark.parametrize("order", [2, 4])
def test_moved_supports_keep_the_order(order: int, coordinates: Any) -> None:
    model, reference = shake_pendulum(coordinates)
    errors, losses = [], []
    for step in (8e-3, 4e-3):
        run = simulate(model, 1.0, step, Rattle(order), compiled=False)
        assert max(run.bar_length_error.max(), run.joint_error.max()) < 1e-14
        assert run.nodes[-1, 0] == pytest.approx(
            [0.1 * np.sin(3), 0.05 * np.cos(5) - 0.05, 0.03], abs=1e-14
        )
        errors.append(abs(run.nodes[-1] - reference.nodes[-1]).max())
        losses.append(abs(run.energy_error).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)
    assert np.log2(losses[0] / losses[1]) > order - 0.3


@cache
def fold_d_bar(coordinates: Any) -> tuple[Model, Trajectory]:
    """A D-bar, and its motion through its fold in fine steps."""
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]) - 0.5
    bars, pinned = [(0, 1), (1, 2), (2, 3), (3, 0)], {0: "xyz", 1: "z", 2: "z", 3: "z"}
    model = Model(
        Scene(Structure(square, bars, [(0, 2), (1, 3)], rest_length=(1.0, 0.5), pinned=pinned)),
        coordinates,
    )
    return model, simulate(model, 0.6, 2e-4, correction=Projection(), compiled=False)


@pytest.mark.parametrize(
    ("order", "iterations", "coordinates"),
    [
        *((2, 6, coordinates) for coordinates in ("reduced", "full")),
        *((order, iterations, "reduced") for order, iterations in ((2, 30), (4, 6))),
        *(
            pytest.param(order, iterations, "full", marks=pytest.mark.slow)
            for order, iterations in ((2, 30), (4, 6))
        ),
    ],
)
def test_through_the_fold_of_a_d_bar(order: int, iterations: int, coordinates: Any) -> None:
    """At 0.42 s all bars lie in one line and no longer tell apart what holds which."""
    model, fine = fold_d_bar(coordinates)
    run = simulate(model, 0.6, 4e-3, Rattle(order, iterations), compiled=False)
    assert run.success, run.message
    assert max(run.bar_length_error.max(), run.joint_error.max()) < 1e-14
    assert abs(run.energy_error).max() < 1e-3 * run.energy[0]
    assert abs(run.nodes[-1] - fine.nodes[-1]).max() < {2: 5e-3, 4: 5e-4}[order]
