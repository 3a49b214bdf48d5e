"""Buckling factors against analytic results and load paths."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.statics.stability import read_state
from tenscasadi.structure.equilibrium_matrix import free_directions

END = [(0, 0, 0), (0, 0, 0), (-1.0, 0, 0), (0, 0, 0), (0, 0, 0)]


def column(**options: object) -> tc.Structure:
    """Two bars of 1 m in line with a lateral spring of 100 N/m at the joint."""
    return tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0)],
        bars=[(0, 1), (1, 2)],
        strings=[(1, 3), (1, 4)],
        stiffness=50.0,
        rest_length=0.5,
        pinned={0: "xyz", 1: "z", 2: "yz", 3: "xyz", 4: "xyz"},
        **options,
    )


def test_column_with_a_lateral_spring():
    """k l/2: 50 N."""
    found = tc.buckling_factor(tc.Scene(column()), END)
    assert found.success
    assert found.factor == pytest.approx(50.0, rel=1e-10)
    np.testing.assert_allclose(np.abs(found.mode[1]), [0, 1, 0], atol=1e-12)
    assert np.linalg.norm(found.mode) == pytest.approx(1.0)


def test_factor_is_inverse_to_the_load():
    one, two = (tc.buckling_factor(tc.Scene(column()), s * np.array(END)) for s in (1.0, 4.0))
    assert two.factor == pytest.approx(one.factor / 4, rel=1e-12)


def test_own_loads_of_the_scene_count():
    scene = tc.Scene(column(), forces=tc.NodalForce(20 * np.array(END)))
    assert tc.buckling_factor(scene, END).factor == pytest.approx(30.0, rel=1e-9)
    eq = tc.find_equilibrium(scene)
    assert tc.buckling_factor(eq, END).factor == pytest.approx(30.0, rel=1e-9)


def test_overloads_are_no_stable_equilibria():
    scene = tc.Scene(column(), strength=tc.Breaking(20.0))
    for source in (scene, tc.find_equilibrium(scene)):
        found = tc.buckling_factor(source, END)
        assert (found.success, found.factor) == (False, 0.0)
        assert "no stable equilibrium without the load: string 0 breaks, " in found.message
    strong = tc.Scene(column(), strength=tc.Breaking(30.0))
    assert tc.buckling_factor(strong, END).factor == pytest.approx(50.0, rel=1e-9)


def test_tension_never_buckles():
    found = tc.buckling_factor(tc.Scene(column()), -np.array(END))
    assert found.success
    assert found.factor == np.inf
    assert not found.mode.any()


def test_elastic_bars_buckle_like_rigid_ones_where_they_are_stiff():
    found = tc.buckling_factor(tc.Scene(column(bar_stiffness=1e7)), END)
    assert found.factor == pytest.approx(50.0, rel=1e-5)


def test_bifurcation_of_a_steep_truss():
    """Elastic bars: linear buckling is near the bifurcation of the load path."""
    s = tc.Structure(
        [(-1, 0, 0), (0, 3, 0), (1, 0, 0)],
        bars=[(0, 1), (1, 2)],
        bar_stiffness=1e5,
        pinned={0: "xyz", 1: "z", 2: "xyz"},
    )
    load = [(0, 0, 0), (0, -1.0, 0), (0, 0, 0)]
    linear = tc.buckling_factor(tc.Scene(s), load)
    assert linear.success
    assert np.abs(linear.mode[1, 0]) == pytest.approx(1.0)
    t = 1e5 * (1 / 10) / (9 / 10) * np.sqrt(10)  # Δt/l (I − e eᵀ) cancels k e eᵀ sideways
    assert linear.factor == pytest.approx(2 * t * 3 / np.sqrt(10), rel=1e-9)


def test_prism_under_its_axis():
    """The tangent stiffness at the factor, linear in it, is singular."""
    s = tc.shapes.prism(prestress=30.0, pinned=[0, 1, 2])
    load = np.zeros((6, 3))
    load[3:, 2] = -1.0
    found = tc.buckling_factor(tc.Scene(s), load)
    assert found.success
    st = tc.stability(s)
    T = st.modes.reshape(len(st.modes), 18).T
    free = free_directions(s)
    change = free @ read_state(s)[0].force_stiffness(load) @ free.T
    values = np.linalg.eigvalsh(T.T @ ((st.tangent + found.factor * change) @ T))
    assert abs(values[0]) < 1e-8 * values[-1]
    below = np.linalg.eigvalsh(T.T @ ((st.tangent + 0.99 * found.factor * change) @ T))
    assert below[0] > 0


def test_large_structures_by_lanczos():
    p, q = 16, 15
    s = tc.shapes.membrane(p, q, pinned=[*range(p), *range(p * (q - 1), p * q)], stiffness=1e3)
    s = s.replace(rest_length=0.9 * s.string_lengths)
    load = np.zeros((p * q, 3))
    load[:, 2] = np.where(np.arange(p * q) < p * q / 2, 1.0, -1.0)
    eq = tc.find_equilibrium(tc.Scene(s))
    assert eq.stable
    found = tc.buckling_factor(eq, load)
    assert found.success
    st = tc.stability(eq)
    change = read_state(eq)[0].force_stiffness(load)
    free = free_directions(s)
    K = (free.T @ st.tangent @ free).toarray()
    ratios = np.linalg.eigvals(np.linalg.solve(K, -change.toarray())).real
    assert found.factor == pytest.approx(1 / ratios.max(), rel=1e-7)


def test_no_stable_equilibrium_is_told():
    unstressed = tc.buckling_factor(tc.Scene(tc.shapes.prism()), np.ones((6, 3)))
    assert not unstressed.success
    assert unstressed.factor == 0.0
    assert "no stable equilibrium" in unstressed.message
    falling = tc.buckling_factor(
        tc.Scene(tc.shapes.prism(prestress=10.0), gravity=tc.Gravity()), np.ones((6, 3))
    )
    assert not falling.success
    free = tc.buckling_factor(tc.Scene(tc.shapes.prism(prestress=10.0)), np.ones((6, 3)))
    assert not free.success
    assert "freely" in free.message


@pytest.mark.parametrize("options", [{}, {"bar_stiffness": 1e4}], ids=["rigid", "elastic"])
@pytest.mark.parametrize("pins", [{0: "xyz"}, {0: "xyz", 1: "y"}], ids=["space", "plane"])
def test_upright_bar_on_its_foot_tips_over(pins, options):
    bar = tc.Structure([(0, 0, 0), (0, 0, 1)], bars=[(0, 1)], pinned=pins, **options)
    found = tc.buckling_factor(tc.Scene(bar), [(0, 0, 0), (0, 0, -1.0)])
    assert not found.success
    assert found.factor == 0.0
    assert "tips" in found.message
    assert np.linalg.norm(found.mode[1, :2]) == pytest.approx(1.0)
    pulled = tc.buckling_factor(tc.Scene(bar), [(0, 0, 0), (0, 0, 1.0)])
    assert pulled.success
    assert pulled.factor == np.inf


@pytest.mark.parametrize(
    ("load", "error"),
    [(np.ones((5, 3)), ValueError), ("a", TypeError), (np.zeros((5, 2)), ValueError)],
)
def test_wrong_loads_are_rejected_by_name(load, error):
    with pytest.raises(error, match="load"):
        tc.buckling_factor(tc.Scene(tc.shapes.prism(prestress=10.0)), load)
    with pytest.raises(TypeError, match="scene"):
        tc.buckling_factor(tc.shapes.prism(), load)
