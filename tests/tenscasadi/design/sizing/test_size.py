"""Sizing: published least masses, limits, prestress, stability, and clear failures."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import tenscasadi as tc

ALUMINUM = tc.Material(modulus=60e9, density=2700.0, strength=110e6)
UNIT = tc.Material(modulus=1e30, density=1.0, strength=1.0)  # mass is Σ |force| · length
DIAMOND = [(-1, 0, 0), (0, -1, 0), (1, 0, 0), (0, 1, 0)]
D_BAR = tc.Structure(DIAMOND, [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3)])
T_BAR = tc.Structure(DIAMOND, [(0, 2), (1, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)])


def squeeze(nodes: int, force: float = 1e4) -> np.ndarray:
    load = np.zeros((nodes, 3))
    load[[0, 2], 0] = force, -force
    return load


def balance(s: tc.Structure) -> np.ndarray:
    """Forces on nodes (3n, α + β) that members of unit tension exert."""
    pairs = np.concatenate([s.strings, s.bars])
    B = np.zeros((len(s.nodes), 3, len(pairs)))
    for k, (a, b) in enumerate(pairs):
        u = (s.nodes[b] - s.nodes[a]) / np.linalg.norm(s.nodes[b] - s.nodes[a])
        B[a, :, k], B[b, :, k] = u, -u
    return B.reshape(-1, len(pairs))


def check(s: tc.Structure, sized: tc.Sized, cases, string, bar, tube: float = 0.0) -> None:
    """Check equilibrium and limits of a result from its own numbers."""
    strings, lengths = len(s.strings), np.concatenate([s.string_lengths, s.bar_lengths])
    B, free = balance(s), ~s.fixed.ravel()
    scale = np.abs(sized.force).max(initial=1e-9)
    for force, load in zip(sized.force, cases, strict=True):
        np.testing.assert_allclose((B @ force + load.ravel())[free], 0.0, atol=1e-6 * scale)
    np.testing.assert_allclose((B @ sized.prestress)[free], 0.0, atol=1e-6 * scale)
    for force in (*sized.force, sized.prestress):
        assert force[:strings].min(initial=0.0) >= -1e-6 * scale
        assert np.all(force[:strings] <= string.strength * sized.area[:strings] + 1e-6 * scale)
        area = sized.area[strings:]
        inertia = area**2 / (4 * np.pi) * (1 + tube**2) / (1 - tube**2)
        euler = np.pi**2 * bar.modulus * inertia / s.bar_lengths**2
        assert np.all(np.abs(force[strings:]) <= bar.strength * area + 1e-6 * scale)
        assert np.all(-force[strings:] <= euler + 1e-6 * scale)
    density = np.repeat([string.density, bar.density], [strings, len(s.bars)])
    np.testing.assert_allclose(sized.member_mass, density * lengths * sized.area)
    assert sized.mass == pytest.approx(sized.member_mass.sum())


def test_d_bar_of_motes() -> None:
    load = squeeze(4)
    sized = tc.size(D_BAR, [load], ALUMINUM, ALUMINUM)
    assert sized.success, sized.message
    assert sized.mass == pytest.approx(8.858023, abs=5e-7)
    assert sized.governs == ("none", "yield", *["buckling"] * 4)
    np.testing.assert_allclose(sized.force[0], [0, 1e4, *[-(5e7**0.5)] * 4], atol=1e-6)
    np.testing.assert_allclose(sized.radius, np.sqrt(sized.area / np.pi))
    check(D_BAR, sized, [load], ALUMINUM, ALUMINUM)


def test_t_bar_of_motes_is_the_single_bar() -> None:
    load = squeeze(4)
    sized = tc.size(T_BAR, [load], ALUMINUM, ALUMINUM)
    assert sized.mass == pytest.approx(4.975116, abs=5e-7)
    assert sized.governs == (*["none"] * 4, "buckling", "none")
    check(T_BAR, sized, [load], ALUMINUM, ALUMINUM)


@pytest.mark.parametrize("degrees", [10.0, 29.4773, 40.0])
def test_planar_d_bar_against_the_single_bar(degrees: float) -> None:
    angle = np.radians(degrees)
    s = tc.shapes.d_bar(0.5 / np.cos(angle), angle)
    weightless = tc.Material(modulus=1.0, density=1e-20, strength=1.0)
    bar = tc.Material(modulus=1e9, density=1.0, strength=1e9)
    sized = tc.size(s, [squeeze(4, 1.0)], weightless, bar)
    single = np.sqrt(4.0 / (np.pi * 1e9))
    assert sized.mass / single == pytest.approx((2 * np.cos(angle) ** 5) ** -0.5, rel=1e-9)
    if degrees == 29.4773:
        assert sized.mass / single == pytest.approx(1.0, abs=1e-6)


def test_michell_cantilevers_converge_to_the_least_volume() -> None:
    limit = 2 * np.log(5.0)
    misses = []
    for order in (1, 2, 4, 8):
        s = tc.shapes.michell_cantilever(order, 1.0, 0.2)
        load = np.zeros((len(s.nodes), 3))
        load[0, 1] = -1.0
        sized = tc.size(s, [load], UNIT, UNIT)
        a = 0.2 ** (1 / order)
        assert sized.mass == pytest.approx(order * (1 / a - a), rel=1e-9)
        assert set(sized.governs) == {"yield"}
        misses.append(sized.mass - limit)
    np.testing.assert_allclose(np.divide(misses[1:-1], misses[2:]), 4.0, rtol=0.03)


def grid(columns: int = 3, rows: int = 3) -> tc.Structure:
    """Plane grid of bars with crossed strings, pinned below."""
    index = np.arange(columns * rows).reshape(columns, rows)
    nodes = np.array([(i, j, 0) for i in range(columns) for j in range(rows)], dtype=float)
    bars = [*zip(index[:-1].ravel(), index[1:].ravel(), strict=True)]
    bars += [*zip(index[:, :-1].ravel(), index[:, 1:].ravel(), strict=True)]
    strings = [*zip(index[:-1, :-1].ravel(), index[1:, 1:].ravel(), strict=True)]
    strings += [*zip(index[1:, :-1].ravel(), index[:-1, 1:].ravel(), strict=True)]
    pinned = {int(k): "xyz" if k in index[:, 0] else "z" for k in index.ravel()}
    return tc.Structure(nodes, bars, strings, pinned=pinned)


def least_volume(s: tc.Structure, cases) -> float:
    """Σ area · length by a linear program of its own, at unit strength."""
    strings, members = len(s.strings), len(s.strings) + len(s.bars)
    lengths = np.concatenate([s.string_lengths, s.bar_lengths])
    B, free = balance(s), ~s.fixed.ravel()
    count = len(cases)
    equal = np.kron(np.eye(count), B[free])
    equal = np.hstack([np.zeros((len(equal), members)), equal])
    right = -np.concatenate([load.ravel()[free] for load in cases])
    eye = np.eye(members)
    below = [
        np.hstack([-eye, *(sign * eye if k == case else 0 * eye for k in range(count))])
        for case, sign in product(range(count), (1, -1))
    ]
    bounds = [(0, None)] * members + ([(0, None)] * strings + [(None, None)] * len(s.bars)) * count
    cost = np.concatenate([lengths, np.zeros(count * members)])
    found = linprog(cost, np.vstack(below), np.zeros(2 * count * members), equal, right, bounds)
    return float(found.fun)


@pytest.mark.parametrize("count", [1, 3])
def test_least_volume_is_that_of_a_linear_program(count: int) -> None:
    s = grid()
    rng = np.random.default_rng(count)
    cases = [rng.normal(size=(9, 3)) * [1, 1, 0] for _ in range(count)]
    sized = tc.size(s, cases, UNIT, UNIT)
    assert sized.success, sized.message
    assert sized.mass == pytest.approx(least_volume(s, cases), rel=1e-8)
    check(s, sized, cases, UNIT, UNIT)


def test_self_weight_alone_is_a_load_case() -> None:
    beam = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1)], [(1, 2)], pinned={0: "xyz", 1: "y", 2: "xyz"}
    )
    heavy = tc.Material(modulus=2e11, density=7850.0, strength=1e6)
    sized = tc.size(beam, [], heavy, heavy, self_weight=tc.Gravity(), minimum_area=1e-3)
    assert sized.success, sized.message
    assert sized.force.shape == (1, 2)
    assert sized.force[0, 0] > 0.0


def test_too_heavy_sections_are_named() -> None:
    dome = tc.shapes.geiger_dome()
    weak = tc.Material(modulus=200e9, density=7850.0, strength=2350.0)
    load = np.tile([0.0, 0.0, -1e3], (len(dome.nodes), 1))
    sized = tc.size(dome, [load], weak, weak, self_weight=tc.Gravity())
    assert not sized.success
    assert "their own weight" in sized.message


def test_perturbed_designs_reduce_the_mass_of_a_grid() -> None:
    s = grid(4, 4)
    alloy = tc.Material(modulus=70e9, density=2700.0, strength=200e6)
    cases = np.random.default_rng(5).normal(size=(2, 16, 3)) * [1e3, 1e3, 0.0]
    sized = tc.size(s, list(cases), alloy, alloy)
    check(s, sized, cases, alloy, alloy)
    assert sized.mass <= 6.6630  # 6.9667 kg without perturbed designs
    assert "lower bound is 3.1" in sized.message


def test_least_mass_with_buckling_is_global() -> None:
    s = grid(2, 3)
    load = np.zeros((6, 3))
    load[[2, 5]] = (1.0, -3.0, 0.0)
    bar = tc.Material(modulus=30.0, density=1.0, strength=50.0)
    string = tc.Material(modulus=30.0, density=1.0, strength=10.0)
    sized = tc.size(s, [load], string, bar)
    assert sized.success, sized.message
    check(s, sized, [load], string, bar)
    free = ~s.fixed.ravel()
    B = balance(s)[free]
    null = np.linalg.svd(B)[2][np.linalg.matrix_rank(B) :]
    start = np.linalg.lstsq(B, -load.ravel()[free], rcond=None)[0]
    strings, lengths = len(s.strings), np.concatenate([s.string_lengths, s.bar_lengths])
    rng = np.random.default_rng(0)
    for _ in range(1500):
        force = start + rng.normal(size=len(null)) * 3 @ null
        if force[:strings].min() < 0.0:
            continue
        push = np.maximum(-force[strings:], 0.0)
        area = np.maximum(
            np.abs(force[strings:]) / 50.0,
            np.sqrt(4 * push * s.bar_lengths**2 / (np.pi * 30.0)),
        )
        mass = lengths[:strings] @ force[:strings] / 10.0 + lengths[strings:] @ area
        assert mass >= sized.mass * (1 - 1e-6)


def test_tubes_are_lighter() -> None:
    load = squeeze(4)
    solid = tc.size(T_BAR, [load], ALUMINUM, ALUMINUM)
    tube = tc.size(T_BAR, [load], ALUMINUM, ALUMINUM, tube=0.8)
    assert tube.mass / solid.mass == pytest.approx(np.sqrt((1 - 0.64) / (1 + 0.64)))
    outer = tube.radius[4]
    assert np.pi * outer**2 * (1 - 0.64) == pytest.approx(tube.area[4])
    check(T_BAR, tube, [load], ALUMINUM, ALUMINUM, 0.8)


def test_minimum_area_governs_members_without_force() -> None:
    sized = tc.size(D_BAR, [squeeze(4)], ALUMINUM, ALUMINUM, minimum_area=1e-4)
    assert sized.success, sized.message
    assert sized.governs == ("minimum", "minimum", *["buckling"] * 4)
    np.testing.assert_allclose(sized.area[:2], 1e-4)
    check(D_BAR, sized, [squeeze(4)], ALUMINUM, ALUMINUM)


def test_self_weight_thickens_a_hanging_string() -> None:
    steel = tc.Material(200e9, 7850.0, 235e6)
    nodes = [(0, 0, 0), (0, 0, -100), (0, 0, -200)]
    s = tc.Structure(nodes, strings=[(0, 1), (1, 2)], pinned=[0], node_mass=1.0)
    load = np.zeros((3, 3))
    load[2, 2] = -1e4
    sized = tc.size(s, [load], steel, self_weight=tc.Gravity())
    half = 0.5 * 7850.0 * 9.81 * 100.0  # Pa, of half a string's own weight
    lower = 1e4 / (235e6 - half)
    upper = (1e4 + 2 * half * lower) / (235e6 - half)
    np.testing.assert_allclose(sized.area, [upper + lower * half / (235e6 - half) * 0, lower])
    assert sized.success


def test_structures_that_cannot_carry_themselves_fail() -> None:
    weak = tc.Material(1e6, 1e4, 1e3)
    s = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    load = np.zeros((2, 3))
    load[1, 2] = -1.0
    sized = tc.size(s, [load], weak, self_weight=tc.Gravity())
    assert not sized.success
    assert "carry their own weight" in sized.message


def test_prestress_is_chosen_so_that_elastic_forces_fit() -> None:
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)],
        strings=[(0, 1), (1, 2)],
        pinned=[0, 2],
        node_mass=1.0,
    )
    load = np.zeros((3, 3))
    load[1, 0] = 50.0
    sized = tc.size(s, [load, -load], ALUMINUM)
    np.testing.assert_allclose(sized.force, [[50, 0], [0, 50]], atol=1e-6)
    np.testing.assert_allclose(sized.prestress, 25.0, rtol=1e-6)
    check(s, sized, [load, -load], ALUMINUM, ALUMINUM)
    for sign, force in zip((1, -1), sized.force, strict=True):
        scene = tc.Scene(sized.structure, forces=tc.NodalForce(0.999 * sign * load))
        eq = tc.find_equilibrium(scene)
        assert eq.success, eq.message
        np.testing.assert_allclose(eq.tension, force, atol=0.1)


def test_given_prestress_is_superposed() -> None:
    stress = np.array([1.0, 1.0, *[-(0.5**0.5)] * 4]) * 1e4
    alone = tc.size(D_BAR, [], ALUMINUM, ALUMINUM, prestress=stress)
    np.testing.assert_allclose(alone.area[:2], 1e4 / 110e6)
    load = squeeze(4)
    sized = tc.size(D_BAR, [0 * load, load], ALUMINUM, ALUMINUM, prestress=stress)
    assert sized.success, sized.message
    np.testing.assert_array_equal(sized.prestress, stress)
    np.testing.assert_allclose(sized.force[0], stress, rtol=1e-9)
    assert sized.force[1, 0] < 1e4 < sized.force[1, 1]
    assert sized.force[1, 1] - sized.force[1, 0] == pytest.approx(1e4)
    check(D_BAR, sized, [0 * load, load], ALUMINUM, ALUMINUM)
    loose = tc.size(D_BAR, [load], ALUMINUM, ALUMINUM, prestress=0.1 * stress)
    assert not loose.success
    assert "string 0 would be compressed" in loose.message
    none = tc.size(D_BAR, [load], ALUMINUM, ALUMINUM, prestress=())
    assert none.mass == pytest.approx(8.858023, abs=5e-7)
    assert not none.prestress.any()


@pytest.mark.parametrize("width", [0.3, 1.0])
def test_stable_t_bar_is_braced(width: float) -> None:
    plane = dict.fromkeys(range(5), "z")
    s = tc.shapes.t_bar(2.0, width, pinned=plane)
    load = squeeze(5)
    loose = tc.size(s, [load], ALUMINUM, ALUMINUM)
    sized = tc.size(s, [load], ALUMINUM, ALUMINUM, stable=True)
    assert sized.success, sized.message
    assert loose.mass == pytest.approx(4.975116 / 2, abs=5e-7)
    assert loose.mass < sized.mass < 1.03 * loose.mass
    check(s, sized, [load], ALUMINUM, ALUMINUM)
    assert least_stiffness(s, sized, sized.force[0]) > -1e-3
    np.testing.assert_allclose(sized.buckling, 1.0, rtol=1e-6)
    assert tc.buckling_factor(tc.Scene(sized.structure), load).factor == sized.buckling[0]
    assert loose.buckling[0] < 1.0
    assert (
        least_stiffness(s, sized, sized.prestress + 1.01 * (sized.force[0] - sized.prestress)) < 0
    )


def least_stiffness(s: tc.Structure, sized: tc.Sized, force: np.ndarray) -> float:
    """Least eigenvalue of the elastic tangent stiffness, rigid motions in the plane left out."""
    lengths = np.concatenate([s.string_lengths, s.bar_lengths])
    pairs = np.concatenate([s.strings, s.bars])
    n = len(s.nodes)
    K = np.zeros((2 * n, 2 * n))
    for k, (a, b) in enumerate(pairs):
        d = np.zeros((2, 2 * n))
        d[:, 2 * a : 2 * a + 2], d[:, 2 * b : 2 * b + 2] = -np.eye(2), np.eye(2)
        u = (s.nodes[b] - s.nodes[a])[:2] / lengths[k]
        stiff = 60e9 * sized.area[k] / lengths[k] - force[k] / lengths[k]
        K += force[k] / lengths[k] * d.T @ d + stiff * np.outer(u @ d, u @ d)
    x, y = s.nodes[:, 0], s.nodes[:, 1]
    rigid = [np.tile([1, 0], n), np.tile([0, 1], n), np.column_stack([-y, x]).ravel()]
    Z = np.linalg.svd(np.array(rigid))[2][3:].T
    return float(np.linalg.eigvalsh(Z.T @ K @ Z)[0])


def test_sized_structure_has_masses_and_stiffness() -> None:
    sized = tc.size(D_BAR, [squeeze(4)], ALUMINUM, ALUMINUM, minimum_area=1e-5)
    s = sized.structure
    np.testing.assert_allclose(s.bar_mass, sized.member_mass[2:])
    np.testing.assert_allclose(s.bar_radius, sized.radius[2:])
    np.testing.assert_allclose(s.stiffness, 60e9 * sized.area[:2] / 2.0)
    np.testing.assert_allclose(s.bar_stiffness, 60e9 * sized.area[2:] / 2**0.5)
    np.testing.assert_allclose(s.string_mass, sized.member_mass[:2])
    assert tc.Model(tc.Scene(s.replace(bar_stiffness=None))).nx > 0


@pytest.mark.parametrize("cases", [[], [np.zeros((6, 3))], [np.zeros((6, 3))] * 2])
@pytest.mark.parametrize("stable", [False, True])
def test_no_load_needs_no_mass_and_never_buckles(cases, stable: bool) -> None:
    steel = tc.Material(210e9, 7850.0, 235e6)
    sized = tc.size(tc.shapes.prism(pinned=[0, 1, 2]), cases, steel, steel, stable=stable)
    assert sized.success, sized.message
    assert sized.mass == pytest.approx(0.0, abs=1e-9)
    assert np.all(sized.buckling == np.inf)


def test_cases_without_balance_fail_with_a_reason() -> None:
    load = np.zeros((4, 3))
    load[1, 1] = 3.0
    sized = tc.size(D_BAR, [np.zeros((4, 3)), squeeze(4), load], ALUMINUM, ALUMINUM)
    assert not sized.success
    assert "balance load case 2" in sized.message
    assert sized.mass == np.inf
    assert sized.force.shape == (3, 6)
    assert np.all(np.isfinite(sized.area))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"string": None}, "string is None: give a tenscasadi.Material"),
        ({"bar": 3.0}, "bar is 3.0: give a tenscasadi.Material"),
        ({"tube": 1.0}, "tube is 1: it must be at least 0 and below 1"),
        ({"minimum_area": -1.0}, "minimum_area of member 0 is -1"),
        ({"self_weight": 9.81}, "self_weight is 9.81: give a tenscasadi.Gravity"),
        ({"prestress": [1.0, 0, 0, 0, 0, 0]}, "prestress leaves 1 N unbalanced"),
        ({"prestress": [-1, -1, *[0.5**0.5] * 4]}, "prestress of string 0 is -1"),
        ({"load_cases": [np.zeros((3, 3))]}, r"load_cases\[0\] has shape \(3, 3\)"),
        ({"stable": 1}, "stable is 1: give True or False"),
    ],
)
def test_wrong_input_is_named(given, message: str) -> None:
    right = {"load_cases": [squeeze(4)], "string": ALUMINUM, "bar": ALUMINUM}
    with pytest.raises((TypeError, ValueError), match=message):
        tc.size(D_BAR, **{**right, **given})


@pytest.mark.parametrize("field", ["modulus", "density", "strength"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_materials_are_positive(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"Material.{field} is"):
        tc.Material(**{"modulus": 1.0, "density": 1.0, "strength": 1.0, field: value})


def test_cable_has_one_force_and_one_section() -> None:
    line = tc.Structure(
        [(-1, 0, 0), (0, 0, -0.75), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        node_mass=[0, 2.0, 0],
        pinned=[0, 2],
        cables=[[0, 1]],
    )
    load = np.zeros((3, 3))
    load[1, 2] = -1200.0
    sized = tc.size(line, [load], ALUMINUM, minimum_area=[0.0, 1e-6])
    assert sized.success, sized.message
    np.testing.assert_allclose(sized.force, 1000.0)
    np.testing.assert_allclose(sized.area, 1000.0 / 110e6)
    assert sized.governs == ("yield", "yield")
    assert sized.mass == pytest.approx(2700.0 * 2.5 * 1000.0 / 110e6)
    eq = tc.find_equilibrium(tc.Scene(sized.structure, forces=tc.NodalForce(load)))
    np.testing.assert_allclose(eq.tension, 1000.0, rtol=1e-2)
    load[1, 0] = 300.0  # along the cable, which slides
    sliding = tc.size(line, [load], ALUMINUM)
    assert not sliding.success
    assert tc.size(line.replace(cables=()), [load], ALUMINUM).success
    with pytest.raises(ValueError, match="give one value, as they are one cable"):
        tc.size(line, [load], ALUMINUM, prestress=[1.0, 2.0])


def test_plate_is_sized_by_its_load() -> None:
    nodes = [(1, 0, 0), (-1, 1, 0), (-1, -1, 0)]
    s = tc.Structure(
        [*nodes, *((x, y, 2) for x, y, _ in nodes)],
        strings=[(0, 3), (1, 4), (2, 5)],
        pinned=[3, 4, 5],
        bodies=[tc.RigidBody((0, 1, 2), mass=1.0)],
    )
    load = np.zeros((6, 3))
    load[0, 2], load[1, 2] = -100.0, -60.0
    sized = tc.size(s, [load], ALUMINUM)
    assert sized.success, sized.message
    np.testing.assert_allclose(sized.force, [[100.0, 60.0, 0.0]], atol=1e-6)


@pytest.mark.parametrize("self_weight", [None, tc.Gravity((0, 0, -9.81))])
def test_stable_table_is_braced(self_weight: tc.Gravity | None) -> None:
    """A plate on three bars, braced by strings; bars around the plate act like it."""
    angle = np.deg2rad([90, 210, 330])
    foot = np.column_stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.zeros(3)])
    legs, edges = [(0, 3), (1, 4), (2, 5)], [(0, 1), (1, 2), (2, 0)]
    strings = [(0, 4), (1, 5), (2, 3), (0, 5), (1, 3), (2, 4)]
    nodes = np.vstack([foot + (0, 0, 2), foot])
    table = tc.Structure(
        nodes, legs, strings, pinned=[3, 4, 5], bodies=[tc.RigidBody((0, 1, 2), 1.0)]
    )
    frame = tc.Structure(nodes, legs + edges, strings, pinned=[3, 4, 5])
    load = np.zeros((6, 3))
    load[:3, 2] = -2e4, -1e4, -1e4
    least = [
        tc.size(s, [load], ALUMINUM, ALUMINUM, stable=True, self_weight=self_weight)
        for s in (table, frame)
    ]
    for sized in least:
        assert sized.success, sized.message
        assert 1.0 - 1e-6 <= sized.buckling[0] <= 1.001
    assert tc.size(table, [load], ALUMINUM, ALUMINUM).buckling[0] < 0.1
    # the edges of the frame, of the least area, give way a little
    assert 0.98 < least[0].mass / least[1].mass < 1.0


@settings(max_examples=15, deadline=None)
@drawn(
    load=st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=6, max_size=6),
    strength=st.floats(1e3, 1e9),
    modulus=st.floats(1e6, 1e12),
)
def test_any_load_is_carried_or_refused(load, strength: float, modulus: float) -> None:
    s = tc.shapes.prism(diagonals=True, pinned=[0, 1, 2])
    forces = np.zeros((6, 3))
    forces[3:5] = np.reshape(load, (2, 3))
    material = tc.Material(modulus, 1000.0, strength)
    sized = tc.size(s, [forces], material, material)
    assert sized.message
    assert np.all(np.isfinite(sized.area))
    assert np.all(np.isfinite(sized.force))
    if sized.success:
        check(s, sized, [forces], material, material)
