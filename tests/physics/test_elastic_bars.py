"""Elastic bars: their vibrations, energy, and the limit of rigid bars."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc


def single(stiffness: float, mass: float = 2.0, radius: float = 0.0) -> tc.Structure:
    """A free elastic bar of 1.5 m along x."""
    return tc.Structure(
        [(0, 0, 0), (1.5, 0, 0)],
        bars=[(0, 1)],
        bar_mass=mass,
        bar_radius=radius,
        bar_stiffness=stiffness,
    )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("radius", [0.0, 0.3])
def test_axial_vibration_has_the_inertia_of_eq_19(coordinates, radius):
    """ω² = k/J: the ends move with the consistent mass m/6 [[2, 1], [1, 2]], J = m/12, if r = 0."""
    s = single(5e3, radius=radius)
    modes = tc.modes(tc.Model(tc.Scene(s), coordinates=coordinates))
    assert modes.rigid == 5
    np.testing.assert_allclose(
        modes.frequency, np.sqrt(5e3 / s.bar_inertia) / (2 * np.pi), rtol=1e-12
    )


def test_stretched_bar_pulls_and_shortened_bar_pushes():
    s = single(5e3)
    model = tc.Model(tc.Scene(s))
    for length in (1.6, 1.4):
        x = model.state([(0, 0, 0), (length, 0, 0)])
        rate = model.ode(x, []).full().ravel()
        force = 5e3 * (length - 1.5)
        np.testing.assert_allclose(rate[6], force / 1.0 * 0.5 * 6, rtol=1e-7)  # F (M⁻¹) = 6/m F
        lam = model.multipliers(x).bar_force_density
        np.testing.assert_allclose(lam, -force / length, rtol=1e-12)  # λ > 0 in compression
        assert model.energy(x).elastic == pytest.approx(0.5 * 5e3 * (length - 1.5) ** 2, rel=1e-12)
    assert model.bar_length_error(x) == 0.0  # only rigid bars have one


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_accelerations_are_gradients_of_the_energy(coordinates):
    s = tc.shapes.six_bar_ball(prestress=20.0, bar_stiffness=[1e3, np.inf, 2e3, 1e3, np.inf, 5e3])
    rng = np.random.default_rng(0)
    model = tc.Model(tc.Scene(s.replace(bar_stiffness=s.bar_stiffness[[0, 0, 2, 3, 3, 5]])))
    nodes = s.nodes + 0.02 * rng.normal(size=s.nodes.shape)
    x, h = model.state(nodes), 1e-6

    def energy(change: np.ndarray) -> float:
        return float(model.energy(model.state(nodes + change.reshape(nodes.shape))).total)

    gradient = [(energy(h * e) - energy(-h * e)) / (2 * h) for e in np.eye(nodes.size)]
    M = np.kron(s.mass_matrix().toarray(), np.eye(3))
    own = tc.Model(model.scene, coordinates=coordinates)
    velocity = own.ode(own.state(nodes), []).full().ravel()[own.nq : 2 * own.nq]
    shift = np.zeros(own.nx)
    shift[: own.nq] = velocity
    acceleration = own.nodes(shift) - own.nodes(np.zeros(own.nx))
    np.testing.assert_allclose(
        M @ acceleration.ravel(), -np.array(gradient), atol=1e-6 * np.abs(gradient).max()
    )
    assert len(x) == model.nx


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_energy_is_conserved_with_rigid_and_elastic_bars(coordinates):
    s = tc.shapes.prism(prestress=10.0, bar_stiffness=[1e4, np.inf, 2e4], pinned=[0])
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity()), coordinates=coordinates)
    run = tc.simulate(model, 0.5, 2e-4)
    assert run.success, run.message
    assert np.abs(run.energy_error).max() < 1e-8
    assert run.bar_length_error.max() < 1e-10
    parts = run.energy_parts[-1]
    assert parts.sum() == pytest.approx(run.energy[-1])
    bars = run.nodes[-1][s.bars[:, 1]] - run.nodes[-1][s.bars[:, 0]]
    strings = run.nodes[-1][s.strings[:, 1]] - run.nodes[-1][s.strings[:, 0]]
    stretch = np.linalg.norm(bars, axis=1) - s.bar_rest_length
    slack = np.maximum(np.linalg.norm(strings, axis=1) - s.rest_length, 0.0)
    stored = 0.5 * (1e4 * stretch[0] ** 2 + 2e4 * stretch[2] ** 2 + (s.stiffness * slack**2).sum())
    assert parts[1] == pytest.approx(stored, rel=1e-10)


def test_stiff_bars_move_like_rigid_ones():
    """The difference falls in proportion to 1/k."""
    rigid = tc.shapes.prism(prestress=10.0, pinned=[0])

    def end(structure: tc.Structure, step: float) -> np.ndarray:
        run = tc.simulate(tc.Model(tc.Scene(structure, gravity=tc.Gravity())), 0.2, step)
        assert run.success, run.message
        return run.nodes[-1]

    reference = end(rigid, 1e-3)
    off = []
    for k in (1e4, 1e5):
        stress = tc.equilibrium_force_density(rigid, minimum=10.0)
        soft = rigid.replace(bar_stiffness=k).prestressed(stress)
        off.append(np.abs(end(soft, 1e-4) - reference).max())
    assert 5.0 < off[0] / off[1] < 20.0
    assert off[1] < 2e-4


def test_class_two_joints_of_elastic_and_rigid_bars():
    s = tc.shapes.d_bar(prestress=5.0, bar_stiffness=[1e3, np.inf, 1e3, np.inf], pinned={0: "xyz"})
    runs = [
        tc.simulate(tc.Model(tc.Scene(s, gravity=tc.Gravity((1, -2, 0))), coordinates=c), 0.1, 1e-3)
        for c in ("reduced", "full")
    ]
    np.testing.assert_allclose(runs[0].nodes[-1], runs[1].nodes[-1], atol=1e-9)


def test_forces_on_the_ends_of_elastic_bars():
    """`NodalForce.bars` counts all bars, elastic ones, too."""
    s = tc.shapes.d_bar(bar_stiffness=[np.inf, 1e3, np.inf, 1e3], pinned=[0])
    load = tc.NodalForce([(0, 0, 0), (0, 0, 0), (0, 3.0, 0), (0, 0, 0)], bars={2: 1})
    models = [
        tc.Model(tc.Scene(s, forces=load), coordinates=coordinates)
        for coordinates in ("reduced", "full")
    ]
    rates = [model.ode(model.initial_state, []).full().ravel() for model in models]
    moved = []
    for model, rate in zip(models, rates, strict=True):
        shift = np.zeros(model.nx)
        shift[: model.nq] = rate[model.nq : 2 * model.nq]
        moved.append(model.nodes(shift) - model.nodes(np.zeros(model.nx)))
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-9)


def test_rigid_bars_alone_build_the_same_expressions():
    """A scene without elastic bars has no instruction more."""
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=10.0), gravity=tc.Gravity()))
    assert "elastic bars" not in model.describe()
    assert sum(v for k, v in model.describe().items() if k != "total") == model.describe()["total"]


def test_stiffness_and_rest_length_are_parameters():
    s = tc.shapes.prism(prestress=10.0, bar_stiffness=[1e4, np.inf, 1e4], pinned=[0])
    groups = {"bar_stiffness": [[0, 2]], "bar_rest_length": [[0], [2]]}
    names = tc.Parameters("bar_stiffness", "bar_rest_length", groups=groups)
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity(), parameters=names))
    assert model.parameters.names == (
        "bar_stiffness[0]",
        "bar_rest_length[0]",
        "bar_rest_length[1]",
    )
    p = [2e4, 1.3, 1.45]
    other = s.replace(bar_stiffness=[2e4, np.inf, 2e4], bar_rest_length=[1.3, 1, 1.45])
    plain = tc.Model(tc.Scene(other, gravity=tc.Gravity()))
    x = model.initial_state
    expected = plain.ode(x, []).full()
    np.testing.assert_allclose(model.ode(x, [], p).full(), expected, rtol=1e-12)
    np.testing.assert_allclose(model.with_parameters(p).ode(x, []).full(), expected, rtol=1e-12)
    eq = tc.find_equilibrium(model, parameters=p)
    np.testing.assert_allclose(eq.nodes, tc.find_equilibrium(plain).nodes, atol=1e-9)
    with pytest.raises(ValueError, match="bar 1 is rigid"):
        tc.Scene(s, parameters=tc.Parameters("bar_stiffness"))
