"""Equilibria with friction of cables: sticking, slip no further than needed, no equilibrium."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.structure.cables import wrap_angles

GRAVITY = tc.Gravity((0, 0, -9.81))


def atwood(friction: float) -> tc.Scene:
    """Masses of 3 and 2 kg hang on both sides of a fixed node."""
    s = tc.Structure(
        [(0, 0, -1), (0, 0, 0), (0, 0, -1.2)],
        strings=[(0, 1), (1, 2)],
        node_mass=[3, 0, 2],
        pinned={0: "xy", 1: "xyz", 2: "xy"},
        stiffness=1e4,
        rest_length=[1.0, 1.2],
        cables=[[0, 1]],
        cable_friction=friction,
    )
    return tc.Scene(s, gravity=GRAVITY)


def hanging(friction: float, cable: tuple[int, ...] = (0, 1, 2, 3)) -> tc.Scene:
    """Three unequal masses on vertical guides hang on a cable between two supports."""
    nodes = [(0, 0, 0), (1, 0, -0.8), (2, 0, -0.9), (2.8, 0, -0.5), (4, 0, 0)]
    strings = np.array([(0, 1), (2, 1), (2, 3), (3, 4)])
    s = tc.Structure(
        nodes,
        strings=strings,
        node_mass=[0, 1.0, 4.0, 0.5, 0],
        pinned={0: "xyz", 1: "xy", 2: "xy", 3: "xy", 4: "xyz"},
        stiffness=2e4,
        rest_length=np.linalg.norm(np.diff(nodes, axis=0), axis=1),
        cables=[cable],
        cable_friction=friction,
    )
    return tc.Scene(s, gravity=GRAVITY)


def slopes(scene: tc.Scene, eq: tc.Equilibrium) -> np.ndarray:
    """Compute ln(T₁/T₂)/θ at each node: at most μ in size."""
    s = scene.structure
    T = eq.tension[list(s.cables[0])]
    return np.log(T[:-1] / T[1:]) / wrap_angles(s.replace(nodes=eq.nodes), s.cables[0])


@pytest.mark.parametrize("friction", [0.05, 0.129])
def test_atwoods_machine_without_enough_friction_has_no_equilibrium(friction: float):
    eq = tc.find_equilibrium(atwood(friction))
    assert not eq.success
    assert "no equilibrium found, the search for slips of cable 0 stalled" in eq.message
    assert np.all(np.isfinite(eq.nodes))


def test_cure_of_a_stalled_search_finds_an_equilibrium():
    """A cable between supports has equilibria that the search from unequal tensions misses."""
    rng = np.random.default_rng(29)
    count = rng.integers(4, 8)
    z = -rng.uniform(0.2, 1.2, count)
    y = rng.normal(0, 0.1, count)
    masses = [0.0, *rng.uniform(0.5, 4, count - 2), 0.0]
    guides = ["xy" if rng.random() < 0.5 else "y" for _ in range(count - 2)]
    z[[0, -1]] = y[[0, -1]] = 0.0
    s = tc.Structure(
        np.column_stack([np.arange(count), y, z]),
        strings=[(k, k + 1) for k in range(count - 1)],
        node_mass=masses,
        pinned=dict(enumerate(["xyz", *guides, "xyz"])),
        stiffness=10 ** rng.uniform(3, 5),
        cables=[tuple(range(count - 1))],
        cable_friction=0.02,
    )
    missed = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY))
    assert not missed.success
    assert "give rest lengths at which its tensions differ less" in missed.message
    even = tc.find_equilibrium(tc.Scene(s.replace(cable_friction=0.0), gravity=GRAVITY))
    lengths = s.replace(nodes=even.nodes).string_lengths - even.tension / s.stiffness
    found = tc.find_equilibrium(tc.Scene(s.replace(rest_length=lengths), gravity=GRAVITY))
    assert found.success, found.message
    np.testing.assert_allclose(found.tension, even.tension, rtol=1e-6)


def test_atwoods_machine_rests_from_the_friction_of_its_masses_on():
    eq = tc.find_equilibrium(atwood(np.log(1.5) / np.pi + 1e-6))
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.tension, [3 * 9.81, 2 * 9.81], rtol=1e-9)


@pytest.mark.parametrize(("friction", "cable"), [(0.05, (0, 1, 2, 3)), (0.2, (3, 2, 1, 0))])
def test_cable_slips_until_its_tensions_differ_by_friction(cable, friction: float):
    scene = hanging(friction, cable)
    eq = tc.find_equilibrium(scene)
    assert eq.success, eq.message
    found = slopes(scene, eq)
    assert np.abs(found).max() <= friction * (1 + 1e-6)
    slip = np.cumsum((eq.structure.rest_length - scene.structure.rest_length)[list(cable)])
    assert slip[-1] == pytest.approx(0.0, abs=1e-12)
    slipping = np.abs(slip[:-1]) > 1e-9
    assert slipping.any()
    np.testing.assert_allclose(found[slipping], friction * np.sign(slip[:-1][slipping]), rtol=1e-5)


def test_little_friction_gives_the_equilibrium_without():
    free = tc.find_equilibrium(hanging(0.0))
    eq = tc.find_equilibrium(hanging(1e-7))
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.nodes, free.nodes, atol=1e-5)
    np.testing.assert_allclose(eq.tension, free.tension, rtol=1e-5)


def test_cable_with_much_friction_is_strings_of_their_own():
    scene = hanging(3.0)
    lone = scene.structure.replace(cables=(), cable_friction=0.0)
    eq = tc.find_equilibrium(scene)
    other = tc.find_equilibrium(tc.Scene(lone, gravity=GRAVITY))
    np.testing.assert_allclose(eq.nodes, other.nodes, atol=1e-9)
    np.testing.assert_array_equal(eq.structure.rest_length, lone.rest_length)


def test_result_sticks_where_it_is():
    scene = hanging(0.05)
    eq = tc.find_equilibrium(scene)
    again = tc.find_equilibrium(
        tc.Scene(
            scene.structure.replace(nodes=eq.nodes, rest_length=eq.structure.rest_length),
            gravity=GRAVITY,
        )
    )
    np.testing.assert_allclose(again.nodes, eq.nodes, atol=1e-8)
    st = tc.stability(eq)
    assert st.stable
    assert st.eigenvalues[0] > tc.stability(tc.find_equilibrium(hanging(0.0))).eigenvalues[0]


def test_friction_under_a_control_is_rejected():
    s = hanging(0.1).structure
    with pytest.raises(ValueError, match="takes the rest lengths of the structure"):
        tc.find_equilibrium(tc.Scene(s, control=tc.Tension(), gravity=GRAVITY))
