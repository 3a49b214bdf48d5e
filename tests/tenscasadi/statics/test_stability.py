"""Stability against analytic results, finite differences, natural modes and a peer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from statics_cases import general_prism, general_prism_stress, polygon

import tenscasadi as tc

GRAVITY = tc.Gravity((0, 0, -10))
UNIT = np.eye(18).reshape(18, 6, 3)


def loaded() -> tc.Equilibrium:
    """A pinned prism under its weight and a load aside."""
    load = np.zeros((6, 3))
    load[3] = (4, 3, -5)
    s = tc.shapes.prism(
        prestress=30.0, stiffness=1e3, pinned=[0, 1], bar_stiffness=[5e4, np.inf, 1e4]
    )
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY, forces=tc.NodalForce(load)))
    assert eq.success
    return eq


@pytest.mark.parametrize("bars", [3, 4, 5, 6, 9])
@pytest.mark.parametrize("radius", [1.0, 0.4])
def test_twist_of_a_prism_with_stiff_members(bars, radius):
    """4 q sin(π/n)/(1 + (r/h)² cos²(π/n)) per unit-norm displacement, all members stiff."""
    height, q = 1.3, 2.5
    s = general_prism(bars, 1.0, height, stiffness=1e8)
    s = s.replace(nodes=s.nodes * (radius, radius, 1.0))
    stress = q * general_prism_stress(bars)
    found = tc.stability(s, stress)
    assert found.success
    assert found.stable
    assert found.super_stable
    assert found.prestress_stable
    assert len(found.self_stress) == 1
    assert len(found.mechanisms) == 2 * bars - 5
    angle = np.pi / bars
    expected = 4 * q * np.sin(angle) / (1 + (radius / height) ** 2 * np.cos(angle) ** 2)
    twist = np.zeros((2 * bars, 3))  # the symmetric motion: turn and rise of the upper triangle
    twist[bars:] = np.cross((0, 0, 1), s.nodes[bars:])
    twist[:bars] = -np.cross((0, 0, 1), s.nodes[:bars])
    along = np.abs(np.einsum("kni,ni->k", found.modes, twist))
    assert found.eigenvalues[np.argmax(along[: 2 * bars - 5])] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("count", [6, 8, 10])
def test_polygon_with_diameters_is_super_stable(count):
    s = polygon(count, stiffness=1e6)
    ratio = 1 - np.cos(2 * np.pi / count)
    found = tc.stability(s, np.repeat([3.0, 3.0 * ratio], [count, count // 2]))
    assert found.success
    assert found.super_stable
    assert found.stable
    assert len(found.mechanisms) == count // 2 - 2


def test_simplex_of_feron_et_al():
    """Struts 8551, horizontal 1765, vertical 1776 N/mm: 602, −237, −410 N per mm of strut elongation."""
    radius, angle = 2043.8 / 3**0.5, np.deg2rad(30)
    height = np.sqrt(2043.4**2 - (2 * radius * np.sin(angle / 2)) ** 2)
    s = general_prism(3, height=height, stiffness=np.repeat([1765.0, 1776.0], [6, 3]))
    s = s.replace(nodes=s.nodes * (radius, radius, 1), bar_stiffness=8551.0)
    s = s.replace(rest_length=s.string_lengths, bar_rest_length=s.bar_lengths)
    np.testing.assert_allclose(s.bar_lengths, 2999.8, atol=0.35)
    stress = tc.self_stress(s)[0] * np.sign(tc.self_stress(s)[0, 0])
    tension = stress * np.concatenate([s.string_lengths, s.bar_lengths])
    forces = (tension / tension[-1])[[0, 6, 9]]
    np.testing.assert_allclose(forces, [0.393, 0.681, 1.0], atol=5e-4)

    def response(structure: tc.Structure) -> tuple[np.ndarray, np.ndarray]:
        held = structure.prestressed(1e-3 * stress)
        longer = held.bar_rest_length + np.array([1e-3, 0, 0])
        before = tc.find_equilibrium(tc.Scene(held))
        after = tc.find_equilibrium(tc.Scene(held.replace(bar_rest_length=longer)))
        assert before.success
        assert after.success
        return (
            (after.bar_force - before.bar_force) / 1e-3,
            (after.tension - before.tension) / 1e-3,
        )

    bars, strings = response(s)
    np.testing.assert_allclose(bars, -602, atol=1.0)
    np.testing.assert_allclose(strings, np.repeat([237, 410], [6, 3]), atol=1.0)
    bars, _ = response(s.replace(bar_stiffness=1e9))
    np.testing.assert_allclose(bars, -764, atol=1.0)


def test_tangent_is_the_derivative_of_the_forces():
    eq = loaded()
    found = tc.stability(eq)
    assert sp.issparse(found.tangent)
    assert abs(found.tangent - found.material - found.geometric).max() < 1e-9
    s, h = eq.structure, 1e-6

    def forces(nodes: np.ndarray) -> np.ndarray:
        total = np.zeros_like(nodes)
        for pairs, law in (
            (
                s.strings,
                lambda length: s.stiffness * np.maximum(length - s.rest_length, 0) / length,
            ),
            (s.bars, lambda length: bar_density(length)),
        ):
            vectors = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
            density = law(np.linalg.norm(vectors, axis=1))
            np.add.at(total, pairs[:, 0], density[:, None] * vectors)
            np.add.at(total, pairs[:, 1], -density[:, None] * vectors)
        return total

    def bar_density(length: np.ndarray) -> np.ndarray:
        lam = -found.force_density[len(s.strings) :]  # constant multiplier of the rigid bar
        k = np.where(s.elastic, s.bar_stiffness, 0.0)
        return np.where(s.elastic, k * (1 - s.bar_rest_length / length), lam)

    numeric = [
        (forces(eq.nodes - h * e) - forces(eq.nodes + h * e)).ravel() / (2 * h) for e in UNIT
    ]
    np.testing.assert_allclose(found.tangent.toarray(), np.array(numeric).T, atol=1e-4)
    np.testing.assert_allclose(
        found.geometric.toarray(), np.kron(found.force_density_matrix.toarray(), np.eye(3))
    )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_natural_modes_follow_from_the_tangent(coordinates):
    eq = loaded()
    found = tc.stability(eq)
    model = tc.Model(eq.scene, coordinates=coordinates)
    s = eq.structure
    rigid = np.flatnonzero(~s.elastic)
    rows = np.zeros((len(rigid), 6, 3))
    for row, bar in zip(rows, s.bars[rigid], strict=True):
        row[bar[1]] = eq.nodes[bar[1]] - eq.nodes[bar[0]]
        row[bar[0]] = -row[bar[1]]
    held = np.concatenate([rows.reshape(-1, 18), np.eye(18)[s.fixed.ravel()]])
    T = scipy.linalg.null_space(held)
    M = np.kron(s.mass_matrix().toarray(), np.eye(3))
    squared = scipy.linalg.eigh(T.T @ (found.tangent @ T), T.T @ M @ T)[0]
    np.testing.assert_allclose(
        np.sqrt(squared) / (2 * np.pi), tc.modes(model, eq).frequency, rtol=1e-8
    )
    values = np.linalg.eigvalsh(T.T @ (found.tangent @ T))
    np.testing.assert_allclose(found.eigenvalues, values, rtol=1e-9)


def test_modes_are_orthonormal_and_keep_rigid_bars():
    found = tc.stability(tc.shapes.six_bar_ball(prestress=10.0))
    flat = found.modes.reshape(len(found.modes), -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-12)
    s = found.structure
    moved = found.modes[:, s.bars[:, 1]] - found.modes[:, s.bars[:, 0]]
    bars = s.nodes[s.bars[:, 1]] - s.nodes[s.bars[:, 0]]
    assert np.abs(np.einsum("kbi,bi->kb", moved, bars)).max() < 1e-12
    assert len(found.modes) == 36 - 6 - 6
    assert np.all(np.diff(found.eigenvalues) >= 0)


def test_displacement_is_that_of_small_loads():
    eq = loaded()
    found = tc.stability(eq)
    load = np.random.default_rng(0).normal(size=(6, 3))
    u = found.displacement(load)
    assert not u[[0, 1]].any()
    h = 1e-5
    moved = [
        tc.find_equilibrium(
            tc.Scene(
                eq.scene.structure,
                gravity=GRAVITY,
                forces=tc.NodalForce(eq.scene.forces.values + side * h * load),
            ),
            start=eq.nodes,
        ).nodes
        for side in (-1, 1)
    ]
    np.testing.assert_allclose(u, (moved[1] - moved[0]) / (2 * h), rtol=1e-4, atol=1e-9)
    assert found.stiffness(load) == pytest.approx((load**2).sum() / (load * u).sum(), rel=1e-12)
    assert found.stiffness(tc.NodalForce(load)) == found.stiffness(load)


def test_loads_of_named_nodes_move_segmented_strings():
    prism = tc.shapes.prism(pinned=[0, 1, 2], stiffness=500.0, prestress=20.0, string_mass=1.0)
    s = prism.replace(node_names=[f"n{k}" for k in range(6)])
    st = tc.stability(tc.Scene(s, segments=2))
    full = np.zeros((15, 3))
    full[3] = force = (0.0, 0.0, -1.0)
    for load in ({"n3": force}, tc.NodalForce({"n3": force}), tc.NodalForce({3: force})):
        np.testing.assert_array_equal(st.displacement(load), st.displacement(full))


def test_stiffness_of_held_and_free_loads():
    found = tc.stability(tc.shapes.prism(prestress=10.0, pinned=[0]))
    held, along, turning = np.zeros((3, 6, 3))
    held[0] = (1, 2, 3)
    assert found.stiffness(held) == np.inf
    np.testing.assert_array_equal(found.displacement(held), 0.0)
    bar = found.structure.bars[1]
    along[bar] = found.structure.nodes[bar] - found.structure.nodes[bar][::-1]
    assert found.stiffness(along) == np.inf  # a rigid bar takes it
    turning[3] = (0, 0, 1)
    assert found.stiffness(turning) == 0.0
    assert np.isfinite(found.displacement(turning)).all()
    free = tc.stability(tc.shapes.prism(prestress=10.0))
    assert free.stiffness(np.ones((6, 3))) == 0.0
    pull = np.zeros((6, 3))
    pull[:3, 2], pull[3:, 2] = -1, 1
    assert 0.0 < free.stiffness(pull) < np.inf
    with pytest.raises(ValueError, match="load is zero"):
        free.stiffness(np.zeros((6, 3)))
    with pytest.raises(ValueError, match="load"):
        free.displacement(np.zeros((5, 3)))


def test_displacement_does_not_depend_on_the_count():
    load = [(0, 0, 0), (0, 0, -1.0), (0, 0, 0)]
    shapes = tc.shapes.double_pendulum()
    few, all_ = (tc.stability(shapes, count=count).displacement(load) for count in (1, None))
    np.testing.assert_allclose(few, all_, atol=1e-12)


def test_stiffness_of_one_string():
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], pinned=[0], node_mass=1, stiffness=50.0
    )
    found = tc.stability(s, [5.0])
    assert found.stiffness([(0, 0, 0), (2, 0, 0)]) == pytest.approx(50.0)  # k as given
    np.testing.assert_allclose(found.displacement([(0, 0, 0), (2, 0, 0)])[1], [0.04, 0, 0])


def test_force_densities_above_the_stiffness_are_allowed():
    s = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0,
        stiffness=2.0,
    )  # fmt: skip
    found = tc.stability(s, force_density=7.0)
    np.testing.assert_allclose(found.eigenvalues, [4.0, 14.0, 14.0], rtol=1e-12)


def test_bars_balance_the_strings_that_are_given():
    s = tc.shapes.prism()
    stress = tc.self_stress(s)[0]
    stress = 10 * stress / stress[0]
    both, strings = tc.stability(s, stress), tc.stability(s, stress[:9])
    np.testing.assert_allclose(both.eigenvalues, strings.eigenvalues, rtol=1e-9)
    np.testing.assert_allclose(strings.force_density, stress, rtol=1e-9)
    np.testing.assert_allclose(
        tc.stability(s.prestressed(stress)).eigenvalues, both.eigenvalues, rtol=1e-9
    )


@pytest.mark.parametrize("stiffness", [1e2, 1e6, 1e10])
def test_prestress_stability_does_not_depend_on_the_level(stiffness):
    s = tc.shapes.prism(stiffness=stiffness)
    stress = tc.self_stress(s)[0]
    stress = stress / stress[0]
    assert tc.stability(s, stress).stable
    assert tc.stability(s, 1e-2 * stress).stable
    assert not tc.stability(s, -stress).stable
    unstressed = tc.stability(s, 0.0 * stress)
    assert not unstressed.stable
    assert not unstressed.prestress_stable
    assert not unstressed.super_stable


def test_elastic_and_rigid_bars_have_the_same_mechanisms():
    for k in (None, 1e4):
        s = tc.shapes.prism(5, prestress=10.0, bar_stiffness=k)
        assert len(tc.stability(s).mechanisms) == 5


def test_rigid_bars_are_the_limit_of_elastic_ones():
    s = tc.shapes.prism(prestress=10.0)
    rigid = tc.stability(s).eigenvalues
    stress = np.concatenate([[10.0] * 6, [300**0.5] * 3, [300**0.5] * 3])
    soft = tc.stability(s.replace(bar_stiffness=1e8), stress).eigenvalues
    np.testing.assert_allclose(soft[: len(rigid)], rigid, rtol=1e-5)
    assert len(soft) == len(rigid) + 3


def test_stability_is_lost_beyond_the_limit():
    """A column of two rigid bars with a lateral spring of 100 N/m buckles at 50 N."""
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0)],
        bars=[(0, 1), (1, 2)],
        strings=[(1, 3), (1, 4)],
        stiffness=50.0,
        rest_length=0.5,
        pinned={0: "xyz", 1: "z", 2: "yz", 3: "xyz", 4: "xyz"},
    )
    for force in (49.0, 51.0):
        load = tc.NodalForce([(0, 0, 0), (0, 0, 0), (-force, 0, 0), (0, 0, 0), (0, 0, 0)])
        found = tc.stability(tc.Scene(s, forces=load))
        assert found.success
        np.testing.assert_allclose(found.eigenvalues, 100 - 2 * force, rtol=1e-9)
        assert found.stable == (force < 50)


def test_sources_agree():
    s = tc.shapes.prism(prestress=10.0)
    scene = tc.Scene(s)
    values = [
        tc.stability(source).eigenvalues
        for source in (s, scene, tc.Model(scene), tc.find_equilibrium(scene))
    ]
    for other in values[1:]:
        np.testing.assert_allclose(other, values[0], rtol=1e-9)


def test_parameters_of_a_scene():
    s = tc.shapes.prism(prestress=10.0)
    scene = tc.Scene(s, parameters=tc.Parameters("stiffness", groups={"stiffness": "all"}))
    changed = tc.stability(
        scene, 10.0 * np.r_[[1] * 6, [3**0.5] * 3], parameters={"stiffness": 500.0}
    )
    other = tc.stability(s.replace(stiffness=500.0), 10.0 * np.r_[[1] * 6, [3**0.5] * 3])
    np.testing.assert_allclose(changed.eigenvalues, other.eigenvalues, rtol=1e-9)


def test_slack_strings_have_no_stiffness_and_corners_have():
    line = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0
    )
    np.testing.assert_allclose(tc.stability(line).eigenvalues, [0, 0, 200.0], atol=1e-9)
    slack = tc.stability(line.replace(rest_length=[1.5, 1.0]))
    np.testing.assert_allclose(slack.eigenvalues, [0, 0, 100.0], atol=1e-9)


def test_ground_and_gravity_hold_rigid_motions():
    s = tc.shapes.prism(prestress=50.0)
    standing = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY, ground=tc.Ground()))
    found = tc.stability(standing)
    assert found.stable
    assert len(found.eigenvalues) == 18 - 3 - 3  # two translations and a rotation are free
    hanging = tc.stability(tc.Scene(tc.shapes.pendulum(angle=0.0), gravity=GRAVITY))
    np.testing.assert_allclose(hanging.eigenvalues, 5.0, rtol=1e-12)
    upright = tc.stability(tc.Scene(tc.shapes.pendulum(angle=np.pi), gravity=GRAVITY))
    assert not upright.stable


def test_message_tells_forces_out_of_balance():
    s = tc.shapes.prism(prestress=10.0)
    uneven = tc.stability(s.replace(rest_length=np.linspace(0.3, 0.6, 9)))
    assert not uneven.success
    assert "not in equilibrium" in uneven.message
    assert np.isfinite(uneven.eigenvalues).all()


def test_large_structures_are_sparse():
    """Lanczos and inertia give what dense matrices do."""
    p, q = 16, 15
    s = tc.shapes.membrane(p, q, pinned=[*range(p), *range(p * (q - 1), p * q)], stiffness=1e3)
    scene = tc.Scene(s, pressure=tc.Pressure(tc.shapes.membrane_faces(p, q), 20.0))
    eq = tc.find_equilibrium(scene)
    assert eq.success
    found = tc.stability(eq, count=5)
    assert found.eigenvalues.shape == (5,)
    assert found.stable
    K = (found.tangent + found.tangent.T).toarray() / 2
    free = ~s.fixed.ravel()
    dense = np.linalg.eigvalsh(K[np.ix_(free, free)])
    np.testing.assert_allclose(found.eigenvalues, dense[:5], rtol=1e-8)
    assert len(tc.stability(eq).eigenvalues) == 20


def test_super_stability_of_supported_nets():
    """A net on pins in a plane or not: minimal, whatever its stiffness."""
    s = tc.Structure(
        [(-1, -1, 0), (1, -1, 0.3), (1, 1, 0), (-1, 1, 0.3), (0, 0, 0.1)],
        strings=[(0, 4), (1, 4), (2, 4), (3, 4)],
        pinned=[0, 1, 2, 3],
        node_mass=1.0,
    )
    assert tc.stability(s, np.ones(4)).super_stable
    assert not tc.stability(s, [1.0, -1.0, 1.0, -1.0]).super_stable


def test_affine_flexes_are_not_super_stable():
    """Strings and bars along two directions alone shear without a change of lengths."""
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)],
        bars=[(0, 2), (3, 5)],
        strings=[(0, 1), (1, 2), (3, 4), (4, 5)],
        pinned=dict.fromkeys(range(6), "z"),
        node_mass=1.0,
    )
    found = tc.stability(s, [2.0, 2.0, 2.0, 2.0, 1.0, 1.0])
    assert not found.super_stable
    assert not found.stable


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"source": 3}, TypeError, "source"),
        ({"force_density": np.ones(7)}, ValueError, "force_density"),
        ({"force_density": [np.nan] * 9}, ValueError, "force_density"),
        ({"count": 0}, ValueError, "count"),
        ({"parameters": {"mass": 1}}, ValueError, "parameters"),
    ],
)
def test_wrong_arguments_are_rejected_by_name(arguments, error, text):
    with pytest.raises(error, match=text):
        tc.stability(**{"source": tc.shapes.prism(), **arguments})


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    pins=st.integers(0, 3),
    level=st.sampled_from([0.0, 1e-3, 1.0, 1e3]),
    rollers=st.booleans(),
)
def test_any_structure_has_a_verdict(seed, pins, level, rollers):
    """Contradictory supports, disconnected parts, nodes in line: finite numbers or an error."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    pairs = [(i, j) for i in range(n) for j in range(i)]
    rng.shuffle(pairs)
    bars = int(rng.integers(0, 3))
    nodes = rng.normal(size=(n, 3)) * ([1, 1, 1], [1, 1, 0], [1, 0, 0])[seed % 3]
    s = tc.Structure(
        nodes,
        pairs[:bars],
        pairs[bars : bars + 8],
        node_mass=1.0,
        pinned=range(min(pins, n)),
        rollers={n - 1: rng.normal(size=3)} if rollers and pins < n else {},
    )
    gamma = level * rng.exponential(size=len(s.strings))
    found = tc.stability(s, gamma)
    for values in (found.eigenvalues, found.modes, found.self_stress, found.mechanisms):
        assert np.isfinite(values).all()
    assert found.stable in (True, False)
    assert found.super_stable in (True, False)
    assert np.isfinite(found.displacement(rng.normal(size=(n, 3)))).all()
    if found.stable and len(found.eigenvalues):
        assert found.eigenvalues[0] > 0


@pytest.mark.parametrize("strength", [tc.Breaking(4.0), tc.Yielding(4.0, viscosity=1.0)])
def test_overloaded_strings_are_rejected(strength):
    line = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        pinned=[0, 2],
        node_mass=1.0,
        stiffness=100.0,
        rest_length=0.95,
    )
    with pytest.raises(
        ValueError, match=r"source has an overload: string 0 (breaks|yields), .*5 N"
    ):
        tc.stability(tc.Scene(line, strength=strength))
    with pytest.raises(ValueError, match="force_density has an overload: string 1 "):
        tc.stability(tc.Scene(line, strength=strength), [1.0, 6.0])
    strong = replace(strength, force=6.0)
    found = tc.stability(tc.Scene(line, strength=strong))
    np.testing.assert_allclose(found.eigenvalues, tc.stability(line).eigenvalues)


def test_message_counts_motions_without_stiffness() -> None:
    flat = tc.stability(tc.shapes.prism())
    assert flat.message.startswith("1 motion has no stiffness: prestress")
    one = tc.stability(tc.shapes.hyperbolic_paraboloid(4), count=1)
    assert one.message.startswith("at least 1 motion has no stiffness")
    stiff = tc.stability(tc.shapes.prism(prestress=10.0))
    assert repr(stiff) == "Stability(softest motion 55.9 N/m)"
