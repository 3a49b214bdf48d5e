"""Equilibrium force densities against analytic results, by N K = W, and their refusal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from statics_cases import random_structure, row_of

from tenscasadi.statics.force_density import (
    EquilibriumError,
    equilibrium_force_density,
    find_force_density,
)
from tenscasadi.statics.least_force_density import least_force_density
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


def unbalanced(s: Structure, gamma: Any, loads: Any = 0.0) -> float:
    """Largest |W − N K| at free coordinates with the bar forces that suit best, in N."""
    N = s.nodes.T
    W = np.zeros_like(N) + np.transpose(loads)
    rest = W - N @ s.C_s.T @ np.diag(gamma) @ s.C_s
    free = ~s.fixed.T
    if len(s.bars):
        columns = np.stack(
            [(N @ s.C_b.T)[:, [k]] @ s.C_b[[k]] for k in range(len(s.bars))]
        )  # N K of λ = −1
        lam = np.linalg.lstsq(columns[:, free].T, -rest[free], rcond=None)[0]
        rest = rest + np.tensordot(lam, columns, 1)
    return float(np.abs(rest * free).max())


def hanging() -> tuple[Structure, np.ndarray]:
    """A weight between two pins: one string at 45°, one horizontal."""
    s = Structure(
        [(0, 0, 0), (-1, 0, 1), (2, 0, 0)], strings=[(0, 1), (0, 2)], pinned=[1, 2], node_mass=1.0
    )
    return s, np.array([(0, 0, -10.0), (0, 0, 0), (0, 0, 0)])


def test_weight_on_two_strings() -> None:
    s, loads = hanging()
    gamma = equilibrium_force_density(s, loads)
    np.testing.assert_allclose(
        gamma, [10.0, 5.0], rtol=1e-13
    )  # vertical: γ₀·1 = 10; horizontal: γ₁·2 = γ₀·1


def test_catenary_of_five_nodes_needs_no_minimum() -> None:
    z = np.array([0.0, -3.0, -4.0, -3.0, 0.0])
    s = Structure(
        np.column_stack([np.arange(5), 0 * z, z]),
        strings=[(i, i + 1) for i in range(4)],
        pinned=[0, 4],
        node_mass=1.0,
    )
    loads = np.zeros((5, 3))
    loads[1:4, 2] = -2.0  # a parabola with equal loads: constant horizontal force H, and H z'' = 2
    gamma = equilibrium_force_density(s, loads, minimum=0.0)
    np.testing.assert_allclose(gamma, 1.0, rtol=1e-13)


def test_minimum_decides_where_it_is_free() -> None:
    s = Structure(
        [(0, 0, 0), (-1, 0, 0), (2, 0, 0)], strings=[(0, 1), (0, 2)], pinned=[1, 2], node_mass=1.0
    )
    np.testing.assert_allclose(equilibrium_force_density(s, minimum=3.0), [6.0, 3.0], rtol=1e-13)
    np.testing.assert_allclose(
        equilibrium_force_density(s, minimum=[9.0, 1.0]), [9.0, 4.5], rtol=1e-13
    )
    assert equilibrium_force_density(s, minimum=0.0).tolist() == [0.0, 0.0]
    pushed = np.array([(3.0, 0, 0), (0, 0, 0), (0, 0, 0)])
    # γ₀ = 3 + 2 γ₁, least squares: γ₁ at its minimum
    np.testing.assert_allclose(
        equilibrium_force_density(s, pushed, minimum=1.0), [5.0, 1.0], rtol=1e-13
    )
    # γ₀ − 2 γ₁ = 4 with γ₁ ≥ 0 only: least ‖γ‖ at (4, 0)
    np.testing.assert_allclose(
        equilibrium_force_density(s, pushed * 4 / 3, minimum=0.0),
        [4.0, 0.0],
        rtol=1e-13,
        atol=1e-13,
    )


def test_least_norm_among_many() -> None:
    nodes = [(0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 2, 0), (0, -2, 0)]
    s = Structure(
        nodes, strings=[(0, 1), (0, 2), (0, 3), (0, 4)], pinned=[1, 2, 3, 4], node_mass=1.0
    )
    loads = np.zeros((5, 3))
    loads[0] = (6.0, -4.0, 0.0)
    gamma = equilibrium_force_density(s, loads, minimum=0.5)
    np.testing.assert_allclose(
        gamma, [0.5, 6.5, 2.5, 0.5], rtol=1e-12
    )  # γ₁ − γ₀ = 6, γ₂ − γ₃ = 2: each pair as small as may be
    assert gamma.min() >= 0.5


@pytest.mark.parametrize("bars", range(3, 9))
def test_prism(bars: int) -> None:
    s = shapes.prism(bars)
    gamma = equilibrium_force_density(s, minimum=2.0)
    assert gamma.min() == pytest.approx(2.0, rel=1e-12)
    assert gamma.min() >= 2.0
    np.testing.assert_allclose(gamma[2 * bars :] / gamma[0], 2 * np.sin(np.pi / bars), rtol=1e-11)
    assert unbalanced(s, gamma) < 1e-12


def test_ball_and_d_bar_have_equal_force_densities() -> None:
    for s in (
        shapes.six_bar_ball(),
        shapes.six_bar_ball(bar_length=1e-3),
        shapes.six_bar_ball(bar_length=1e3),
        shapes.d_bar(),
        shapes.t_bar(),
    ):
        gamma = equilibrium_force_density(s, minimum=5.0)
        np.testing.assert_allclose(gamma, 5.0, rtol=1e-11)
        assert unbalanced(s, gamma) < 1e-11 * s.bar_lengths.max()


def test_ball_under_load_stays_above_the_minimum() -> None:
    s = shapes.six_bar_ball(pinned=[0, 4, 8])
    chosen = 1.0 + np.random.default_rng(1).uniform(0, 4, 24)
    K = s.C_s.T @ np.diag(chosen) @ s.C_s - s.C_b.T @ np.diag([3.0, 5, 2, 6, 4, 1]) @ s.C_b
    loads = (s.nodes.T @ K).T
    gamma = equilibrium_force_density(s, loads, minimum=1.0)
    assert gamma.min() >= 1.0
    assert unbalanced(s, gamma, loads) < 1e-12
    assert np.linalg.norm(gamma) < np.linalg.norm(chosen)
    with pytest.raises(
        EquilibriumError, match="stay unbalanced"
    ):  # a push that the ball's mechanism gives way to
        equilibrium_force_density(s, np.eye(12)[:, [11]] * [0.3, 0.2, -10.0])


def test_bars_carry_what_they_must() -> None:
    s = Structure([(0, 0, 0), (0, 0, 2)], bars=[(0, 1)], pinned={0: "xyz", 1: "xy"})
    assert equilibrium_force_density(s, [(0, 0, 0), (1.0, 0, -5.0)]).shape == (0,)
    with pytest.raises(EquilibriumError) as caught:
        equilibrium_force_density(s.replace(pinned={0: "xyz", 1: "x"}), [(0, 0, 0), (0, 3.0, -5.0)])
    assert caught.value.residual == pytest.approx(3.0)


def test_no_equilibrium_names_residual_and_node() -> None:
    s, loads = hanging()
    with pytest.raises(EquilibriumError, match=r"at node 0 with 10 N") as caught:
        equilibrium_force_density(s, -loads, minimum=0.0)  # strings do not push
    assert caught.value.residual == pytest.approx(10.0)
    with pytest.raises(EquilibriumError, match="unbalanced"):
        equilibrium_force_density(shapes.prism(twist=2 * np.pi / 3))  # no self-stress at this twist
    with pytest.raises(EquilibriumError):
        equilibrium_force_density(shapes.membrane())  # nothing holds it open
    free = np.zeros((12, 3))
    free[3] = (0, 0, 5.0)
    with pytest.raises(EquilibriumError) as caught:
        equilibrium_force_density(shapes.six_bar_ball(), free)
    assert (
        5.0 / np.sqrt(12) <= caught.value.residual <= 5.0
    )  # no less than the net force, spread over all nodes
    assert isinstance(caught.value, ValueError)


def least_norm_error(s: Structure, gamma: Any, minimum: Any) -> float:
    """How far γ is from what makes it the least: γ = Aᵀ μ + ν, ν ≥ 0 only where γ is at its minimum, and μ does no work on bars."""
    A = unit_forces(s)
    active = np.eye(A.shape[1])[:, np.flatnonzero(gamma <= minimum * (1 + 1e-9) + 1e-9)]
    target = np.concatenate([gamma, np.zeros(len(s.bars))])
    return float(nnls(np.hstack([A.T, -A.T, active]), target, maxiter=10_000)[1])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0), st.booleans())
@example(145, 0.0, True)  # nearly dependent equations
def test_random_nets_are_held_or_refused(seed: int, minimum: float, feasible: bool) -> None:
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(-1, 1, (7, 3))
    strings = [
        (a, b) for a in range(7) for b in range(a) if rng.random() < 0.6 and not (a == 6 and b == 5)
    ]
    s = Structure(nodes, bars=[(5, 6)], strings=strings, pinned=[0, 1, 2], node_mass=1.0)
    chosen = minimum + rng.uniform(0.0, 5.0, len(strings))
    loads = (nodes.T @ s.C_s.T @ np.diag(chosen) @ s.C_s).T if feasible else rng.normal(size=(7, 3))
    try:
        gamma = equilibrium_force_density(s, loads, minimum)
    except EquilibriumError as error:
        residual = error.residual
    else:
        residual = 0.0
    if residual:
        assert not feasible
        return
    assert np.all(gamma >= minimum)
    assert unbalanced(s, gamma, loads) < 1e-7
    assert least_norm_error(s, gamma, minimum) < 1e-7 * np.linalg.norm(gamma)
    if feasible:
        assert np.linalg.norm(gamma) <= np.linalg.norm(chosen) * (1 + 1e-9)


# --- large structures: sparse, and the same as dense where both run ---


def unit_forces(s: Structure) -> np.ndarray:
    """Forces on free coordinates of unit force densities of strings, then of bars in tension."""
    C = np.concatenate([s.C_s, s.C_b])
    return np.einsum("mx,mn->nxm", C @ s.nodes, C)[~s.fixed]


@pytest.mark.parametrize("seed", range(30))
def test_force_densities_of_random_structures_are_the_least(seed: int) -> None:
    s, loads, minimum, pushing = random_structure(seed)
    gamma = equilibrium_force_density(s, loads, minimum, pushing)
    least = np.broadcast_to(minimum, gamma.shape).copy()
    least[pushing] = -np.inf
    assert np.all(gamma >= least)
    size = np.abs(loads).max() + 1
    assert unbalanced(s, gamma, loads) < 1e-10 * size
    assert least_norm_error(s, gamma, least) < 1e-7 * np.linalg.norm(gamma)


@pytest.mark.parametrize("seed", range(30))
def test_residual_of_no_equilibrium_is_the_least(seed: int) -> None:
    s, loads, *_ = random_structure(seed)
    weak = Structure(s.nodes, s.bars, s.strings[:4], pinned=[0], node_mass=1.0)
    pushed = loads + np.random.default_rng(seed).normal(size=loads.shape)
    with pytest.raises(EquilibriumError) as refused:
        equilibrium_force_density(weak, pushed)
    A = unit_forces(weak)
    strings, bars = A[:, :4], A[:, 4:]
    target = pushed[~weak.fixed] - strings.sum(axis=1)  # of the minimum of 1 N/m
    least = nnls(np.hstack([strings, bars, -bars]), target, maxiter=10_000)[1]
    assert refused.value.residual == pytest.approx(least, rel=1e-6)


def test_search_without_residual_finds_the_same() -> None:
    s, loads = hanging()
    for own in (loads, None, -loads, loads + [(0, 1.0, 0), (0, 0, 0), (0, 0, 0)]):
        try:
            exact = equilibrium_force_density(s, own, minimum=0.0)
        except EquilibriumError:
            assert find_force_density(s, own) is None
        else:
            assert np.array_equal(find_force_density(s, own), exact)


@pytest.mark.parametrize("seed", range(30))
def test_sparse_and_dense_matrices_give_the_same(seed: int) -> None:
    s, loads, minimum, pushing = random_structure(seed)
    A = unit_forces(s)
    count = len(s.strings)
    least, bounded = np.broadcast_to(minimum, count).copy(), np.ones(count, bool)
    least[pushing], bounded[pushing] = 0.0, False
    given = loads[~s.fixed], least, bounded
    strings, bars = A[:, :count], A[:, count:]
    dense, _ = least_force_density(strings, bars, *given)
    sparse, _ = least_force_density(sp.csc_array(strings), sp.csc_array(bars), *given)
    assert dense is not None
    np.testing.assert_allclose(sparse, dense, atol=1e-9 * abs(dense).max())


def test_two_thousand_bars() -> None:
    """Each of 667 prisms side by side has the least force densities of one prism."""
    one, count = shapes.prism(), 667
    np.testing.assert_allclose(
        equilibrium_force_density(row_of(one, count)),
        np.tile(equilibrium_force_density(one), count),
        rtol=1e-9,
    )


def test_a_string_beside_a_bar_balances_nothing_by_rounding() -> None:
    refused = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        nodes, lines = rng.normal(size=(4, 3)), {node: rng.normal(size=(2, 3)) for node in range(4)}
        strings = [(0, 1), (1, 3), (2, 3), (1, 2), (0, 3)]
        structure = Structure(nodes, bars=[(0, 1)], strings=strings, node_mass=1.0, rollers=lines)
        try:
            gamma = equilibrium_force_density(structure, rng.normal(size=(4, 3)), minimum=0.0)
        except EquilibriumError:
            refused += 1
        else:
            assert gamma.max() < 1e6
    assert 0 < refused < 40
