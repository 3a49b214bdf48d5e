"""Statics of cables: sag, one stiffness for a cable, self-stress, load paths."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc

GRAVITY = tc.Gravity((0, 0, -9.81))


def sliding(**options: object) -> tc.Structure:
    """A mass of 2 kg that slides on a cable of 2.6 m between (±1, 0, 0)."""
    return tc.Structure(
        [(-1, 0, 0), (0.3, 0.1, -0.8), (1, 0, 0)],
        strings=[(0, 1), (2, 1)],
        node_mass=[0, 2, 0],
        pinned=[0, 2],
        **{"stiffness": 1e4, "rest_length": 1.3, "cables": [[0, 1]], **options},
    )


def laced(**options: object) -> tc.Structure:
    """A prism whose bottom triangle, top triangle and vertical strings are three cables."""
    prism = tc.shapes.prism(stiffness=2e3, prestress=30.0, **options)
    diagonal = [6, 7, 8]
    ends = prism.strings[diagonal]
    assert len(np.unique(ends)) == 6  # vertical strings do not meet: they stay alone
    return prism.replace(cables=[[0, 1, 2], [3, 4, 5]])


def test_mass_on_a_cable_finds_its_sag():
    scene = tc.Scene(sliding(), gravity=GRAVITY)
    eq = tc.find_equilibrium(scene)
    assert eq.success, eq.message
    assert eq.stable
    np.testing.assert_allclose(eq.nodes[1], [0, 0, -0.833059], atol=1e-6)
    np.testing.assert_allclose(eq.tension, 15.326688, atol=1e-6)
    assert tc.modes(tc.Model(scene), eq).frequency[0] == pytest.approx(0.349573, rel=1e-5)


def test_equilibrium_keeps_the_rest_length_of_the_control():
    scene = tc.Scene(sliding(rest_length=[1.2, 1.4]), control=tc.RestLength(), gravity=GRAVITY)
    eq = tc.find_equilibrium(scene, control=[2.8])
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.structure.rest_length, np.array([1.2, 1.4]) * 2.8 / 2.6)
    again = tc.find_equilibrium(tc.Scene(eq.structure, gravity=GRAVITY))
    assert again.iterations <= 1
    np.testing.assert_allclose(again.nodes, eq.nodes, atol=1e-9)


def test_tension_control_holds_a_mass_at_any_place_of_its_sag():
    """T is given: 2 T cos α = m g, and the mass slides to the middle."""
    scene = tc.Scene(sliding(), control=tc.Tension(), gravity=GRAVITY)
    eq = tc.find_equilibrium(scene, control=[15.326688])
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.nodes[1], [0, 0, -0.833059], atol=1e-5)


def energy_hessian(scene: tc.Scene, nodes: np.ndarray) -> np.ndarray:
    model = tc.Model(scene)
    h = 1e-4

    def energy(change: np.ndarray) -> float:
        return float(model.energy(model.state(nodes + change.reshape(nodes.shape))).elastic)

    unit = h * np.eye(nodes.size)
    return np.array(
        [
            [energy(a + b) - energy(a - b) - energy(b - a) + energy(-a - b) for b in unit]
            for a in unit
        ]
    ) / (4 * h * h)


def test_tangent_is_the_hessian_of_the_energy():
    s = laced(bar_stiffness=1e4)
    scene = tc.Scene(s.replace(nodes=s.nodes + 0.01 * np.random.default_rng(0).normal(size=(6, 3))))
    st = tc.stability(scene)
    H = energy_hessian(scene, scene.structure.nodes)
    np.testing.assert_allclose(st.tangent.toarray(), H, atol=1e-3 * 2e3)
    own = tc.stability(scene, st.force_density)
    np.testing.assert_allclose(own.tangent.toarray(), st.tangent.toarray(), atol=1e-8 * 2e3)


def test_cable_adds_one_stiffness():
    """A straight cable of three strings is one spring along the line, and slides freely inside."""
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2.5, 0, 0), (3, 0, 0)],
        strings=[(0, 1), (1, 2), (2, 3)],
        node_mass=1.0,
        pinned={0: "xyz", 1: "yz", 2: "yz", 3: "yz"},
        stiffness=[100.0, 200.0, 400.0],
        cables=[[0, 1, 2]],
    )
    st = tc.stability(s, force_density=[10.0, 10.0 / 1.5, 20.0])
    assert st.success is False  # the tension of the cable pulls node 3
    np.testing.assert_allclose(st.eigenvalues, [0, 0, 1 / (1 / 100 + 1 / 200 + 1 / 400)], atol=1e-9)
    assert len(st.mechanisms) == 2
    lone = tc.stability(s.replace(cables=()), force_density=[10.0, 10.0 / 1.5, 20.0])
    assert len(lone.mechanisms) == 0
    assert lone.eigenvalues[0] > 10.0


def test_self_stress_of_a_cable_has_one_tension():
    s = laced()
    stress = tc.self_stress(s)
    assert stress.shape == (1, 12)
    np.testing.assert_allclose(np.linalg.norm(stress), 1.0)
    tension = stress[0, :9] * s.string_lengths
    np.testing.assert_allclose(tension[:3], tension[0], rtol=1e-9)
    np.testing.assert_allclose(tension[3:6], tension[3], rtol=1e-9)
    skewed = s.replace(nodes=s.nodes + 0.05 * np.random.default_rng(1).normal(size=(6, 3)))
    assert len(tc.self_stress(skewed)) == 0
    assert len(tc.mechanisms(s) if hasattr(tc, "mechanisms") else tc.stability(s).mechanisms) > len(
        tc.stability(s.replace(cables=())).mechanisms
    )


def test_force_densities_in_equilibrium_have_one_tension():
    s = sliding().replace(nodes=[(-1, 0, 0), (0, 0, -0.8), (1, 0, 0)])
    load = np.zeros((3, 3))
    load[1, 2] = -20.0
    gamma = tc.equilibrium_force_density(s, loads=load)
    np.testing.assert_allclose(gamma, 10.0 / 0.8)
    aside = s.replace(nodes=[(-1, 0, 0), (0.4, 0, -0.8), (1, 0, 0)])
    with pytest.raises(tc.EquilibriumError):
        tc.equilibrium_force_density(aside, loads=load)
    assert tc.equilibrium_force_density(aside.replace(cables=()), loads=load).shape == (2,)


def test_prestress_of_a_cable_needs_equal_tensions():
    s = sliding()
    lengths = s.string_lengths
    held = s.prestressed(30.0 / lengths)
    np.testing.assert_allclose(
        tc.Model(tc.Scene(held)).tension(held.nodes.ravel()[3:6].tolist() + [0, 0, 0]), 30.0
    )
    with pytest.raises(ValueError, match="make them equal"):
        s.prestressed([10.0, 20.0])
    with pytest.raises(ValueError, match="make them equal"):
        tc.stability(s, force_density=[10.0, 20.0])
    rough = s.replace(cable_friction=0.5)
    assert rough.prestressed(np.array([30.0, 32.0]) / lengths).rest_length.shape == (2,)
    with pytest.raises(ValueError, match="at most in the ratio"):
        rough.prestressed(np.array([30.0, 300.0]) / lengths)


def test_load_path_of_a_cable_follows_equilibria():
    scene = tc.Scene(sliding(), gravity=GRAVITY)
    load = np.zeros((3, 3))
    load[1] = (5.0, 1.0, -3.0)
    path = tc.load_path(scene, load, factors=(0, 2))
    assert path.success, path.message
    np.testing.assert_allclose(path.tension[:, 0], path.tension[:, 1], rtol=1e-9)
    last = tc.find_equilibrium(
        tc.Scene(sliding(), gravity=GRAVITY, forces=tc.NodalForce(path.factor[-1] * load)),
        start=path.nodes[-1],
    )
    np.testing.assert_allclose(last.nodes, path.nodes[-1], atol=1e-8)


def test_displacement_under_a_small_load_is_that_of_the_tangent():
    scene = tc.Scene(sliding(), gravity=GRAVITY)
    eq = tc.find_equilibrium(scene)
    load = np.zeros((3, 3))
    load[1] = (1e-3, 0, 2e-3)
    st = tc.stability(eq)
    other = tc.find_equilibrium(
        tc.Scene(sliding(), gravity=GRAVITY, forces=tc.NodalForce(load)), start=eq
    )
    np.testing.assert_allclose(other.nodes - eq.nodes, st.displacement(load), atol=1e-7)
    factor = tc.buckling_factor(scene, load)
    assert factor.success


def crooked_net() -> tc.Structure:
    """A net with irregular supports."""
    net = tc.shapes.hyperbolic_paraboloid(cells=4, stiffness=1e4)
    shift = 0.1 * np.random.default_rng(1).normal(size=net.nodes.shape)
    return net.replace(nodes=net.nodes + shift * net.fixed)


def test_form_finding_gives_each_cable_one_tension():
    alone = tc.form_find(crooked_net())
    assert np.ptp((alone.force_density * alone.structure.string_lengths)[:4]) > 0.03
    form = tc.form_find(crooked_net().replace(cables=[[0, 1, 2, 3]]))
    assert form.success, form.message
    tension = form.force_density * form.structure.string_lengths
    np.testing.assert_allclose(tension[:4], tension[0], rtol=1e-9)
    eq = tc.find_equilibrium(tc.Scene(form.structure))
    np.testing.assert_allclose(eq.nodes, form.structure.nodes, atol=1e-8)
    np.testing.assert_allclose(eq.tension, tension, rtol=1e-6)


def test_form_finding_refuses_friction_and_unequal_tensions_of_cables():
    with pytest.raises(ValueError, match=r"cable_friction of cable 0 is 0\.1"):
        tc.form_find(laced().replace(cable_friction=0.1))
    form = tc.form_find(crooked_net().replace(cables=[[0, 1, 2, 3]]), force_density=2.0)
    assert not form.success
    assert "cannot be as prescribed" in form.message


def test_stability_needs_the_equilibrium_of_cables_with_friction():
    scene = tc.Scene(sliding(cable_friction=0.1), gravity=GRAVITY)
    with pytest.raises(ValueError, match="not 0: give the result of find_equilibrium"):
        tc.stability(scene)
