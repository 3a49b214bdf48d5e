"""Linearisation and natural modes against independent figures and analytic frequencies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tenscasadi import plots
from tenscasadi.analysis.modes import linearize, mode_motion, modes
from tenscasadi.animation import animate
from tenscasadi.dynamics.model import Model
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
    [(30.0, [3.0578, 7.8590, 7.8590, 9.2587, 9.2587, 13.3234, 14.7737, 14.7737, 18.1460]), (3.0, [0.96714]), (0.3, [0.30584])],
)
def test_frequencies_of_the_prism(prestress: float, expected: list[float], coordinates: str) -> None:
    model = Model(Scene(shapes.prism(radius=0.5, height=HEIGHT, stiffness=1000.0, prestress=prestress)), coordinates)  # type: ignore[arg-type]
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
    pair = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[1.0, 3.0], stiffness=50.0, rest_length=1.0 - 1e-9)
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
    assert abs(run.nodes[len(run.nodes) // 2] - structure.nodes + size * result.shape[k]).max() < 1e-2 * size


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


def test_a_mode_is_drawn_and_animated(tmp_path: Path) -> None:
    model = Model(Scene(shapes.prism(prestress=30.0)))
    result = modes(model)
    motion = mode_motion(model, result, 0, amplitude=0.02)
    assert motion.time[-1] == pytest.approx(1 / result.frequency[0])
    assert np.linalg.norm(motion.nodes - model.structure.nodes, axis=2).max() == pytest.approx(0.02, rel=1e-3)
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
