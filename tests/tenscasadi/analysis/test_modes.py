"""Linearization and natural modes against independent figures and analytic frequencies."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.special import jn_zeros

import tenscasadi.analysis.modes as modes_module
from tenscasadi import plots
from tenscasadi.analysis.mode_motion import mode_motion
from tenscasadi.analysis.modes import linearize, modes
from tenscasadi.animation import animate
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import stable_step
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])
HEIGHT = np.sqrt(2 - 0.5 * (1 - np.cos(5 * np.pi / 6)))  # bars of √2 m in a prism of radius 0.5 m


@BOTH
@pytest.mark.parametrize(
    ("prestress", "expected"),
    [
        (30.0, [3.0578, 7.8590, 7.8590, 9.2587, 9.2587, 13.3234, 14.7737, 14.7737, 18.1460]),
        (3.0, [0.96714]),
        (0.3, [0.30584]),
    ],
)
def test_frequencies_of_the_prism(
    prestress: float, expected: list[float], coordinates: str
) -> None:
    model = Model(
        Scene(shapes.prism(radius=0.5, height=HEIGHT, stiffness=1000.0, prestress=prestress)),
        coordinates,
    )  # type: ignore[arg-type]
    result = modes(model)
    assert result.rigid == 6
    assert len(result.frequency) == 9
    assert result.residual < 1e-10
    assert np.allclose(result.frequency[: len(expected)], expected, rtol=3e-5)


def test_a_pendulum_swings_at_its_frequency_and_upside_down_is_unstable() -> None:
    hanging = Structure([(0, 0, 0), (0, 0, -2)], [(0, 1)], pinned=(0,))
    result = modes(Model(Scene(hanging, gravity=Gravity())))
    assert np.allclose(result.frequency, np.sqrt(3 * 9.81 / (2 * 2)) / (2 * np.pi), rtol=1e-12)
    standing = modes(Model(Scene(hanging, gravity=Gravity((0, 0, 9.81)))))
    assert np.allclose(standing.frequency, -result.frequency)


def test_two_masses_on_a_string() -> None:
    pair = Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[1.0, 3.0],
        stiffness=50.0,
        rest_length=1.0 - 1e-9,
    )
    result = modes(Model(Scene(pair)))
    assert result.frequency[-1] == pytest.approx(np.sqrt(50 * (1 + 1 / 3)) / (2 * np.pi), rel=1e-6)


@BOTH
def test_a_small_motion_follows_its_mode(coordinates: str) -> None:
    structure = shapes.prism(radius=0.5, height=HEIGHT, stiffness=1000.0, prestress=30.0)
    model = Model(Scene(structure), coordinates)  # type: ignore[arg-type]
    result = modes(model)
    k, size = 5, 1e-6
    state = model.state(structure.nodes + size * result.shape[k])
    period = 1 / result.frequency[k]
    run = simulate(model, period, period / 400, state=state)
    assert abs(run.nodes[-1] - run.nodes[0]).max() < 1e-3 * size
    assert (
        abs(run.nodes[len(run.nodes) // 2] - structure.nodes + size * result.shape[k]).max()
        < 1e-2 * size
    )


def test_linearisation_predicts_a_disturbed_motion() -> None:
    structure = shapes.prism(prestress=20.0, damping=1.0)
    model = Model(Scene(structure, control=ForceDensity()))
    linear = linearize(model)
    assert linear.A.shape == (36, 36)
    assert linear.B.shape == (36, 9)
    assert linear.tangent.shape == (18, 15)
    dx = np.zeros(36)
    dx[:18] = 1e-6 * linear.tangent[:, 3]
    du = 1e-6 * np.arange(9)
    x, u = model.initial_state, model.initial_control
    predicted = linear.residual + linear.A @ dx + linear.B @ du
    assert np.allclose(model.ode(x + dx, u + du).full().ravel(), predicted, atol=1e-9)


def test_bad_input_is_refused_by_name() -> None:
    with pytest.raises(TypeError, match="model"):
        modes("prism")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="x has shape"):
        linearize(Model(Scene(shapes.prism())), np.zeros(3))


@BOTH
def test_symbols_are_refused_by_name(coordinates: str) -> None:
    model = Model(Scene(shapes.prism(), control=ForceDensity()), coordinates)  # type: ignore[arg-type]
    for compute in (linearize, modes):
        with pytest.raises(TypeError, match="x is not an array"):
            compute(model, ca.MX.sym("x", model.nx))
        with pytest.raises(TypeError, match="u is not an array"):
            compute(model, None, ca.SX.sym("u", model.nu))


@BOTH
@pytest.mark.parametrize("dense", [0, 600])
def test_a_state_without_derivative_is_refused_by_name(
    coordinates: str, dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modes_module, "DENSE", dense)
    model = Model(Scene(shapes.prism(prestress=30.0)), coordinates)  # type: ignore[arg-type]
    for compute in (linearize, modes):
        with pytest.raises(ValueError, match="bar 0 has no length, its nodes 0 and 4 coincide"):
            compute(model, np.zeros(model.nx))
    with pytest.warns(UserWarning, match="stable_step is NaN"):
        assert np.isnan(stable_step(model, np.zeros(model.nx)))


def test_a_structure_that_cannot_vibrate_has_no_modes() -> None:
    held = Structure([(0, 0, 0), (1, 0, 0)], [(0, 1)], pinned=(0, 1))
    triangle = Structure([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1), (1, 2), (0, 2)], pinned=(0,))
    for structure, rigid in ((held, 0), (triangle, 3)):
        result = modes(Model(Scene(structure)))
        assert result.shape.shape == (0, len(structure.nodes), 3)
        assert result.rigid == rigid


def chain(bars: int, gravity: float) -> Scene:
    """Joined bars of 1 m that hang from the first node, or stand on it."""
    nodes = [(0, 0, -k) for k in range(bars + 1)]
    return Scene(
        Structure(nodes, [(k, k + 1) for k in range(bars)], pinned=[0]),
        gravity=Gravity((0, 0, -gravity)),
    )


SCENES = {
    "prism": Scene(shapes.prism(prestress=30.0)),
    "ball": Scene(shapes.six_bar_ball(prestress=10.0)),
    "hanging": chain(12, 9.81),
    "standing": chain(12, -9.81),  # 24 unstable modes: more than are asked for
    # a rigid body of five nodes and ten bars, of which nine suffice, on three strings
    "redundant": Scene(
        Structure(
            [
                (0, 0, 0),
                (1, 0, 0),
                (0, 1, 0),
                (0, 0, 1),
                (0.7, 0.8, 0.9),
                (-1, 0, 2),
                (2, 0, 3),
                (0, 2, 2),
            ],
            list(combinations(range(5), 2)),
            [(0, 5), (1, 6), (2, 7)],
            stiffness=100.0,
            pinned=[5, 6, 7],
        )
    ),
}


@BOTH
@pytest.mark.filterwarnings("ignore::tenscasadi.dynamics.constraint_forces.RedundantConstraints")
@pytest.mark.parametrize("name", SCENES)
def test_sparse_modes_are_the_dense_ones(name: str, coordinates: str) -> None:
    model = Model(SCENES[name], coordinates)  # type: ignore[arg-type]
    every = modes(model)
    state, control = model.initial_state, model.initial_control
    count = min(5, len(every.frequency) - 1)
    values, shapes_, rigid, residual = modes_module._lowest_modes(model, state, control, count)
    assert rigid == every.rigid
    assert residual == pytest.approx(every.residual, rel=1e-6, abs=1e-8)
    squares = np.sign(every.frequency) * (2 * np.pi * every.frequency) ** 2
    assert np.allclose(values, squares[:count], rtol=1e-7, atol=1e-9 * abs(squares).max())
    assert np.allclose(shapes_.T @ (model.mechanism.free_mass @ shapes_), np.eye(count), atol=1e-8)


def test_count_gives_the_lowest() -> None:
    model = Model(SCENES["prism"])
    every, some = modes(model), modes(model, count=4)
    assert np.array_equal(some.frequency, every.frequency[:4])
    assert some.shape.shape == (4, 6, 3)
    with pytest.raises(ValueError, match="count is 0"):
        modes(model, count=0)


def test_a_large_string_vibrates_at_its_frequencies() -> None:
    """n equal masses on a string of tension T between fixed ends: ω = 2 √(T / m a) sin(p π / 2 (n + 1)), twice each."""
    n, tension, mass = 400, 20.0, 0.01
    nodes = [(k, 0, 0) for k in range(n + 2)]
    pairs = [(k, k + 1) for k in range(n + 1)]
    string = Structure(
        nodes,
        strings=pairs,
        node_mass=mass,
        stiffness=1e5,
        rest_length=1 - tension / 1e5,
        pinned=[0, n + 1],
    )
    model = Model(Scene(string))
    with pytest.warns(UserWarning, match="20 lowest modes"):
        result = modes(model)
    p = np.repeat(np.arange(1, 11), 2)
    assert np.allclose(
        result.frequency,
        2 * np.sqrt(tension / mass) * np.sin(p * np.pi / (2 * (n + 1))) / (2 * np.pi),
        rtol=1e-6,
    )
    assert result.rigid == 0
    assert len(modes(model, count=6).frequency) == 6


@BOTH
def test_a_long_chain_of_joined_bars_swings_at_its_frequencies(coordinates: str) -> None:
    """Of many short bars a chain hangs as a rope does: ω = jₖ √(g / L) / 2 with the zeros jₖ of the Bessel function J₀."""
    bars = 300
    result = modes(Model(chain(bars, 9.81), coordinates), count=6)  # type: ignore[arg-type]
    rope = jn_zeros(0, 3) / 2 * np.sqrt(9.81 / bars) / (2 * np.pi)
    assert np.allclose(result.frequency, np.repeat(rope, 2), rtol=1e-4)


def test_a_mode_is_drawn_and_animated(tmp_path: Path) -> None:
    model = Model(Scene(shapes.prism(prestress=30.0)))
    result = modes(model)
    motion = mode_motion(model, result, 0, amplitude=0.02)
    assert motion.time[-1] == pytest.approx(1 / result.frequency[0])
    assert np.linalg.norm(motion.nodes - model.structure.nodes, axis=2).max() == pytest.approx(
        0.02, rel=1e-3
    )
    assert motion.bar_length_error.max() < 1e-3
    assert np.allclose(motion.nodes[0], motion.nodes[-1])
    plots.time_lapse(motion, instants=3, path=tmp_path / "mode.png")
    animate(motion, tmp_path / "mode.gif", speed=0.2)
    assert (tmp_path / "mode.png").stat().st_size > 5000
    assert (tmp_path / "mode.gif").stat().st_size > 5000
    with pytest.raises(ValueError, match="index is 9"):
        mode_motion(model, result, 9)
    with pytest.raises(ValueError, match=r"modes\.shape"):
        mode_motion(Model(Scene(shapes.six_bar_ball())), result, 0)
