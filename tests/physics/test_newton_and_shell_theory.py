"""Class 0: structures of strings alone, small (unrolled) and large (mapped), against plain NumPy and shell theory."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.structure.shapes import membrane_faces
from tenscasadi.util.compile import compile_function, find_compiler

SIZES = pytest.mark.parametrize(("p", "q", "graph"), [(8, 5, "SXFunction"), (16, 9, "MXFunction")])
PRESSURE = 300.0


def inflated(p: int, q: int) -> tc.Scene:
    s = tc.shapes.membrane(
        p, q, node_mass=np.linspace(0.1, 0.3, p * q), stiffness=900.0, damping=2.0
    )
    s = s.replace(
        rest_length=s.string_lengths * np.linspace(0.8, 1.02, len(s.strings))
    )  # a few are slack
    return tc.Scene(
        s, gravity=tc.Gravity(), pressure=tc.Pressure(membrane_faces(p, q).tolist(), PRESSURE)
    )


def accelerations(scene: tc.Scene, nodes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Newton's second law, node by node, string by string and face by face."""
    s = scene.structure
    force = np.outer(s.node_mass, (0.0, 0.0, -9.81))
    for (a, b), k, c, rest in zip(s.strings, s.stiffness, s.damping, s.rest_length, strict=True):
        along = nodes[b] - nodes[a]
        length = np.linalg.norm(along)
        tension = k * (length - rest) + c * (velocities[b] - velocities[a]) @ along / length
        pull = along / length * tension * (length > rest and tension > 0)
        force[a] += pull
        force[b] -= pull
    assert scene.pressure is not None
    for face in scene.pressure.faces:
        a, b, c = nodes[list(face)]
        force[list(face)] += (
            PRESSURE * np.cross(b - a, c - a) / 2 / 3
        )  # a third of pressure times area
    return force / s.node_mass[:, None]


def moving(model: tc.Model) -> np.ndarray:
    random = np.random.default_rng(3)
    shape = model.structure.nodes.shape
    return model.state(
        model.structure.nodes + 0.03 * random.normal(size=shape), random.normal(size=shape)
    )


@SIZES
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_accelerations_are_newtons(p: int, q: int, graph: str, coordinates: str) -> None:
    scene = inflated(p, q)
    model = tc.Model(scene, coordinates=coordinates)
    assert model.ode.class_name() == graph
    x = moving(model)
    slack = model.tension(x) == 0
    assert 0 < slack.sum() < len(slack)
    found = model.ode(x, []).full().ravel()[model.nq :].reshape(-1, 3)
    expected = accelerations(scene, model.nodes(x), model.velocities(x))
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


@SIZES
def test_multipliers_vanish(p: int, q: int, graph: str) -> None:
    for coordinates in ("reduced", "full"):
        model = tc.Model(inflated(p, q), coordinates=coordinates)
        lam, omega = model.multipliers(moving(model))
        assert lam.shape == (0,)
        assert omega.shape == (3, 0)
        assert not any("bars" in term or "joints" in term for term in model.describe())
        assert model.bar_length_error(model.initial_state) == 0
        assert tc.Projection().step(model) is None


@SIZES
def test_derivatives_and_machine_code(p: int, q: int, graph: str) -> None:
    model = tc.Model(inflated(p, q))
    x, direction = moving(model), np.random.default_rng(5).normal(size=model.nx)
    symbol = ca.MX.sym("x", model.nx)
    along = (
        ca.Function(
            "along", [symbol], [ca.jtimes(model.ode(symbol, ca.DM(0, 1)), symbol, ca.DM(direction))]
        )(x)
        .full()
        .ravel()
    )
    h = 1e-6
    difference = (
        model.ode(x + h * direction, []) - model.ode(x - h * direction, [])
    ).full().ravel() / (2 * h)
    np.testing.assert_allclose(along, difference, atol=1e-6 * np.abs(along).max())
    if find_compiler():
        np.testing.assert_allclose(
            compile_function(model.ode)(x, []).full(),
            model.ode(x, []).full(),
            rtol=1e-12,
            atol=1e-9,
        )


def test_tensions_are_those_of_a_thin_shell() -> None:
    """Closed by caps: p R along the hoop and p R/2 along the axis, shared by rings and helices."""
    p, q, radius, length, pressure = 20, 11, 2.0, 4.0, 1e4
    s = tc.shapes.membrane(p, q, radius, length)
    faces = membrane_faces(p, q)
    load = np.asarray(
        tc.Pressure(faces.tolist(), pressure).forces(ca.DM(s.nodes.T)).full()
    ).T.copy()
    share = pressure * radius**2 / 2 * np.sin(2 * np.pi / p)
    load[:p, 2] -= share
    load[-p:, 2] += share
    gamma = tc.equilibrium_force_density(s, load, minimum=0.0)
    rings, helices = gamma[: p * q].reshape(q, p), gamma[p * q :].reshape(q - 1, -1)
    np.testing.assert_allclose(rings, rings[:, :1] * np.ones(p), rtol=1e-6)
    rise = length / (q - 1)
    axial = helices.sum(axis=1) * rise / (2 * np.pi * radius)
    np.testing.assert_allclose(axial, pressure * radius / 2, rtol=2e-2)
    chord = 2 * radius * np.sin(np.pi / p)
    # per unit of axial length: a ring each `rise`, and each helix string's circumferential part
    # over half a chord
    hoop = (rings[q // 2].mean() * chord + helices[q // 2].mean() * chord / 2) / rise
    assert hoop == pytest.approx(pressure * radius, rel=2e-2)
